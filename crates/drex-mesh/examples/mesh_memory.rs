//! Two million faces: read, repair, decimate, with the time and the peak memory of each step.
//!
//! `cargo run --release -p drex-mesh --example mesh_memory [FACES] [TARGET]` (default 2,100,000 and 100,000) makes a bumpy ring,
//! writes it as binary STL into a temporary folder and reads it back. Memory is the peak of the process (Linux: VmHWM).
#![allow(clippy::print_stdout)] // a program

use std::time::Instant;

use drex_core::TriMesh;
use drex_mesh::{DecimateOptions, RepairOptions, decimate, read_mesh, repair, write_stl};
use nalgebra::Point3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut numbers = std::env::args().skip(1).map(|a| a.parse::<usize>());
    let faces = numbers.next().transpose()?.unwrap_or(2_100_000);
    let target = numbers.next().transpose()?.unwrap_or(100_000);
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("ring.stl");
    write_stl(&path, &bumpy_ring(faces))?;
    report("made", Instant::now());

    let start = Instant::now();
    let mesh = read_mesh(&path)?;
    report(&format!("read {} vertices, {} faces", mesh.vertices.len(), mesh.faces.len()), start);
    let start = Instant::now();
    let (mesh, found) = repair(&mesh, &RepairOptions::default())?;
    report(&format!("repaired: {} open edges, {} crossings", found.open_edges, found.self_intersections), start);
    let start = Instant::now();
    let mut options = DecimateOptions::default();
    options.target_faces = Some(target);
    let (_, found) = decimate(&mesh, &options)?;
    let error = 1e3 * found.error_m;
    report(&format!("decimated to {} faces, {error:.3} mm, {} open edges", found.faces, found.open_edges), start);
    Ok(())
}

/// A closed ring of about `faces` triangles, 120 mm across, with bumps of 0.5 mm.
fn bumpy_ring(faces: usize) -> TriMesh {
    let across = ((faces as f64 / 8.0).sqrt() as u32).max(3);
    let around = 4 * across;
    let mut mesh = TriMesh::default();
    for i in 0..around {
        for j in 0..across {
            let (u, v) = (f64::from(i) / f64::from(around), f64::from(j) / f64::from(across));
            let (u, v) = (u * std::f64::consts::TAU, v * std::f64::consts::TAU);
            let tube = 0.015 + 0.0005 * (40.0 * u).sin() * (12.0 * v).cos();
            let r = 0.045 + tube * v.cos();
            mesh.vertices.push(Point3::new(r * u.cos(), r * u.sin(), tube * v.sin()));
            let at = |i: u32, j: u32| (i % around) * across + j % across;
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            mesh.faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

fn report(what: &str, start: Instant) {
    println!("{:>7.2} s  {:>6.0} MB  {what}", start.elapsed().as_secs_f64(), peak_mb());
}

/// Largest memory of the process so far, MB; 0 where the system does not say.
fn peak_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    line.and_then(|l| l.split_whitespace().next()?.parse::<f64>().ok()).unwrap_or(0.0) / 1024.0
}
