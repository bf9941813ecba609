//! Depth maps of a capture, as .npy files with their cameras.
//!
//! ```text
//! cargo run --release -p drex-mvs --example depth -- CAPTURE MODEL OUT [fast|default|best] [X0 Y0 Z0 X1 Y1 Z1] [gpu]
//! ```
//! CAPTURE holds the photos, MODEL a COLMAP model of them; the six numbers are a box in the model's frame in which surfaces are looked for; `gpu`
//! takes the GPU in a build with `--features wgpu`.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use drex_core::Pose;
use drex_core::capture::{Capture, CaptureOptions};
use drex_core::npy::write_npy;
use drex_mvs::{DepthMaps, MvsOptions, Preset, Region};
use nalgebra::Point3;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, model, out, rest @ ..] = arguments.as_slice() else {
        return Err("CAPTURE MODEL OUT [fast|default|best] [X0 Y0 Z0 X1 Y1 Z1] [gpu]".into());
    };
    let out = Path::new(out);
    let capture = Capture::load_model(Path::new(folder), Path::new(model), &CaptureOptions::default())?;
    let capture = capture.ok_or("there is no model")?;
    let mut options = MvsOptions::default();
    let (on_gpu, rest) = match rest {
        [rest @ .., last] if last == "gpu" => (true, rest),
        _ => (false, rest),
    };
    options.on_gpu = on_gpu;
    let mut numbers = rest;
    if let Some(preset) = rest.first() {
        options.preset = match preset.as_str() {
            "fast" => Preset::Fast,
            "default" => Preset::Default,
            "best" => Preset::Best,
            other => return Err(format!("no preset {other}").into()),
        };
        numbers = &rest[1..];
    }
    if let [x0, y0, z0, x1, y1, z1] = numbers {
        let corner =
            |x: &str, y: &str, z: &str| Ok::<_, Box<dyn Error>>(Point3::new(x.parse()?, y.parse()?, z.parse()?));
        options.region =
            Some(Region { box_from_world: Pose::identity(), corners: [corner(x0, y0, z0)?, corner(x1, y1, z1)?] });
    }
    let start = Instant::now();
    let maps = DepthMaps::estimate(&capture, &options, &|step| {
        if step.done == 0 {
            eprintln!("{:8.1} s  {} of {}", start.elapsed().as_secs_f64(), step.stage, step.total);
        }
    })?;
    let found: usize = maps.views.iter().map(|m| m.depth.iter().filter(|z| **z > 0.0).count()).sum();
    let all: usize = maps.views.iter().map(|m| m.depth.len()).sum();
    println!("{} maps, {found} of {all} pixels in {:.1} s", maps.views.len(), start.elapsed().as_secs_f64());
    std::fs::create_dir_all(out)?;
    let mut cameras = String::new();
    for (view, map) in capture.views.iter().zip(&maps.views) {
        let stem = view.name.replace('/', "_");
        let shape = [map.camera.height, map.camera.width];
        write_npy(&out.join(format!("{stem}.npy")), &shape, &map.depth)?;
        write_npy(&out.join(format!("{stem}.confidence.npy")), &shape, &map.confidence)?;
        let normals: Vec<f32> = map.normal.iter().flatten().copied().collect();
        write_npy(&out.join(format!("{stem}.normals.npy")), &[shape[0], shape[1], 3], &normals)?;
        let c = &map.camera;
        let pose = c.camera_from_world.to_homogeneous();
        let rows: Vec<String> = (0..16).map(|i| pose[(i / 4, i % 4)].to_string()).collect();
        cameras += &format!("{stem} {} {} {} {} {}\n", c.fx, c.fy, c.cx, c.cy, rows.join(" "));
    }
    std::fs::write(out.join("cameras.txt"), cameras)?;
    Ok(())
}
