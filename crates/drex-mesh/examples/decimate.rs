//! Repairs and simplifies a mesh file: `cargo run --release -p drex-mesh --example decimate IN OUT 5000` (faces) or `... IN OUT 0.5mm`
//! (largest error). OUT is written as OBJ. Prints what was found and done, and the seconds of each step.
#![allow(clippy::print_stdout)] // a program

use std::path::Path;
use std::time::Instant;

use drex_mesh::{DecimateOptions, RepairOptions, decimate, read_mesh, repair, self_intersections, write_obj};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [from, to, target] = &arguments[..] else {
        return Err("usage: decimate IN OUT FACES|ERRORmm".into());
    };
    let mut options = DecimateOptions::default();
    match target.strip_suffix("mm") {
        Some(error) => options.max_error_m = Some(1e-3 * error.parse::<f64>()?),
        None => options.target_faces = Some(target.parse()?),
    }
    let start = Instant::now();
    let (mesh, found) = repair(&read_mesh(Path::new(from))?, &RepairOptions::default())?;
    println!("{:.2} s  {}", start.elapsed().as_secs_f64(), serde_json::to_string(&found)?);
    let start = Instant::now();
    let crossings = self_intersections(&mesh).len();
    println!("{:.2} s  {crossings} pairs of faces cross or touch", start.elapsed().as_secs_f64());
    let start = Instant::now();
    let (mesh, done) = decimate(&mesh, &options)?;
    println!("{:.2} s  {}", start.elapsed().as_secs_f64(), serde_json::to_string(&done)?);
    write_obj(Path::new(to), &mesh)?;
    Ok(())
}
