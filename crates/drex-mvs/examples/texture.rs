//! The picture on a mesh, of the photos of a capture, as an OBJ with its material.
//!
//! ```text
//! cargo run --release -p drex-mvs --example texture -- CAPTURE MODEL MESH.obj OUT
//! ```
//! CAPTURE holds the photos, MODEL a COLMAP model of them; the mesh is in the model's frame and unit. Writes `OUT/textured.obj`, `.mtl` and
//! `.png`.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::error::Error;
use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

use drex_core::TriMesh;
use drex_core::capture::{Capture, CaptureOptions};
use drex_mvs::{TextureOptions, texture};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, model, mesh, out] = arguments.as_slice() else {
        return Err("CAPTURE MODEL MESH.obj OUT".into());
    };
    let out = Path::new(out);
    let capture = Capture::load_model(Path::new(folder), Path::new(model), &CaptureOptions::default())?;
    let capture = capture.ok_or("there is no model")?;
    let mesh = TriMesh::read(Path::new(mesh))?;
    let start = Instant::now();
    let made = texture(&mesh, &capture, &TextureOptions::default(), &|_| {})?;
    println!("{:#?}\n{:.1} s", made.report, start.elapsed().as_secs_f64());
    let mut text = String::from("mtllib textured.mtl\nusemtl textured\n");
    for v in &mesh.vertices {
        writeln!(text, "v {} {} {}", v.x, v.y, v.z)?;
    }
    for [u, v] in made.uv.iter().flatten() {
        writeln!(text, "vt {u} {}", 1.0 - v)?;
    }
    for (f, face) in mesh.faces.iter().enumerate() {
        let corner = |k: usize| format!("{}/{}", face[k] + 1, 3 * f + k + 1);
        writeln!(text, "f {} {} {}", corner(0), corner(1), corner(2))?;
    }
    std::fs::create_dir_all(out)?;
    std::fs::write(out.join("textured.png"), made.png)?;
    std::fs::write(out.join("textured.mtl"), "newmtl textured\nKd 1 1 1\nmap_Kd textured.png\n")?;
    std::fs::write(out.join("textured.obj"), text)?;
    Ok(())
}
