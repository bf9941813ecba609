//! Brings a mesh onto reconstructed points of the object and prints where it is.
//!
//! `cargo run --release -p drex-demo --example register_points -- MESH.obj POINTS.ply [MORE_POINTS ...]`
//! Several files are frames of a clip. Time is processor time of all threads, where the system tells it.
#![allow(clippy::print_stdout)] // the program's output

use std::path::Path;

use drex_demo::{RegisterOptions, read_points, register_sequence};
use drex_mesh::{MeshSdf, RepairOptions, read_mesh, repair};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [mesh, files @ ..] = args.as_slice() else { return Err("usage: register_points MESH POINTS...".into()) };
    let mesh = repair(&read_mesh(Path::new(mesh))?, &RepairOptions::default())?.0;
    let surface = MeshSdf::new(&mesh)?;
    let clouds = files.iter().map(|f| read_points(Path::new(f))).collect::<Result<Vec<_>, _>>()?;
    let before = processor_seconds();
    let found = register_sequence(&clouds, &surface, &RegisterOptions::default());
    let seconds = before.zip(processor_seconds()).map(|(a, b)| (b - a) / files.len().max(1) as f64);
    for (file, registration) in files.iter().zip(&found) {
        match registration {
            Ok(r) => {
                let t = r.placement.metric_pose().translation.vector;
                println!("{file}: at {:.4} {:.4} {:.4} m, {:?}", t.x, t.y, t.z, r.summary());
            }
            Err(e) => println!("{file}: {e}"),
        }
    }
    if let Some(seconds) = seconds {
        println!("{seconds:.3} s of processor time per frame");
    }
    Ok(())
}

/// Processor time of this process, from Linux's `/proc`, in its ticks of 10 ms.
fn processor_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |i: usize| fields.get(i)?.parse::<f64>().ok();
    Some((ticks(11)? + ticks(12)?) / 100.0)
}
