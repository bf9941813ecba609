//! Tea tins whose truth is known: their mesh and a simulated push, as the bundled twins and [`crate::twins`] have them.

mod push;

use std::f64::consts::PI;
use std::fmt::Write as _;

use anyhow::Result;
use drex_core::TriMesh;
use nalgebra::{Point3, Vector3};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

pub use self::push::{Pulse, RecordedPush, TiltPush};

/// Sides of the plain tin and of its lid.
pub const SIDES: u32 = 8;
/// Distance between opposite sides of a tin, metres.
pub const WIDTH_M: f64 = 0.062;
/// Height at which a tin is pushed, metres.
pub const PUSH_HEIGHT_M: f64 = 0.066;
/// The pulses that rock a tin.
pub const PULSES: [Pulse; 2] =
    [Pulse { start_s: 0.30, length_s: 0.20, peak: 1.25 }, Pulse { start_s: 0.95, length_s: 0.22, peak: 1.22 }];

/// Distance between opposite sides and height of the plain tin and of its lid, metres.
const TIN_M: (f64, f64) = (WIDTH_M, 0.070);
const LID_M: (f64, f64) = (0.046, 0.012);

/// The plain tin and its lid, prisms of so many sides, standing on z = 0.
///
/// # Errors
/// If there are fewer than three sides.
pub fn plain_tin(sides: u32) -> Result<[TriMesh; 2]> {
    Ok([prism(sides, TIN_M, 0.0)?, prism(sides, LID_M, TIN_M.1)?])
}

/// A closed prism over a regular polygon of `n` sides, standing on z = `bottom_m`.
fn prism(n: u32, (across_m, height_m): (f64, f64), bottom_m: f64) -> Result<TriMesh> {
    anyhow::ensure!(n >= 3, "a prism of {n} sides encloses nothing: give three or more");
    let radius = across_m / 2.0 / (PI / f64::from(n)).cos();
    let ring = |z: f64| {
        (0..n).map(move |i| {
            let angle = 2.0 * PI * (f64::from(i) + 0.5) / f64::from(n);
            Point3::new(radius * angle.cos(), radius * angle.sin(), z)
        })
    };
    let vertices = ring(bottom_m).chain(ring(bottom_m + height_m)).collect();
    let mut faces = Vec::new();
    for i in 0..n {
        let j = (i + 1) % n;
        faces.push([i, j, n + j]);
        faces.push([i, n + j, n + i]);
    }
    for i in 1..n - 1 {
        faces.push([0, i + 1, i]);
        faces.push([n, n + i, n + i + 1]);
    }
    Ok(TriMesh::new(vertices, faces)?)
}

/// All shells as one mesh.
///
/// # Errors
/// If a shell is malformed.
pub fn merged(shells: &[TriMesh]) -> Result<TriMesh> {
    let mut all = TriMesh::default();
    for shell in shells {
        all.append(shell);
    }
    Ok(TriMesh::new(all.vertices, all.faces)?)
}

/// The shells one after the other, with their names, as the text of an OBJ file; `maker` is who made it.
pub fn obj_text(shells: &[TriMesh], names: &[&str], maker: &str) -> String {
    let mut text = format!("# A tea tin, metres, z up, standing on z = 0. Made by {maker}.\n");
    let mut first = 1;
    for (shell, name) in shells.iter().zip(names) {
        let _ = writeln!(text, "o {name}");
        for v in &shell.vertices {
            let _ = writeln!(text, "v {:.6} {:.6} {:.6}", v.x, v.y, v.z);
        }
        for f in &shell.faces {
            let _ = writeln!(text, "f {} {} {}", f[0] + first, f[1] + first, f[2] + first);
        }
        first += shell.vertices.len() as u32;
    }
    text
}

/// Three independent standard normal numbers.
pub fn normal3(random: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| drex_core::stats::normal_pair(random.random(), 2.0 * PI * random.random::<f64>())[0])
}
