//! Toy data: a box to grasp and two clearly different ways to grasp it.
#![allow(dead_code)] // not every test file uses all of it

use std::path::Path;

use drex_core::Pose;
use drex_policy::{Dataset, GRAVITY_M_S2, GraspSample, ObjectCloud, TrainOptions};
use nalgebra::{Isometry3, Point3, Vector3};

/// Friction of the toy.
pub const FRICTION: f64 = 0.5;

/// Which of the two fingers each way touches with.
pub const TOUCHES: [[bool; 2]; 2] = [[true, true], [true, false]];

/// The two ways: joint angles, wrist, grip force per weight.
pub fn ways() -> [(Vec<f64>, Pose, f64); 2] {
    [
        (vec![0.4, -0.3, 1.1], Isometry3::new(Vector3::new(0.0, 0.02, 0.12), Vector3::new(3.0, 0.0, 0.0)), 2.0),
        (vec![1.2, 0.5, 0.2], Isometry3::new(Vector3::new(0.09, 0.0, 0.03), Vector3::new(0.0, -1.5, 0.4)), 3.5),
    ]
}

/// `grasps` grasps, two of three the first way, each a little different, each at every mass.
pub fn toy(grasps: usize, masses_kg: &[f64]) -> Dataset {
    let wave = |i: usize, j: usize| ((7 * i + 3 * j) as f64 * 1.37).sin();
    let mut samples = Vec::new();
    for i in 0..grasps {
        let (joints, pose, ratio) = &ways()[usize::from(i % 3 == 2)];
        let joints: Vec<f64> = joints.iter().enumerate().map(|(j, q)| q + 0.03 * wave(i, j)).collect();
        let shift = Isometry3::translation(0.003 * wave(i, 4), 0.003 * wave(i, 5), 0.003 * wave(i, 6));
        for mass_kg in masses_kg {
            samples.push(GraspSample {
                object: 0,
                contacts: TOUCHES[usize::from(i % 3 == 2)].to_vec(),
                friction: FRICTION,
                joints: joints.clone(),
                object_from_base: shift * pose,
                grip_force_n: ratio * (1.0 + 0.02 * wave(i, 7)) * mass_kg * GRAVITY_M_S2,
                mass_kg: *mass_kg,
            });
        }
    }
    Dataset {
        joint_names: ["base", "middle", "tip"].map(String::from).to_vec(),
        joint_limits: vec![(-0.3, 2.0), (-0.6, 0.6), (0.0, 1.6)],
        hand: "toy_hand".into(),
        fingers: ["thumb", "finger"].map(String::from).to_vec(),
        objects: vec![ObjectCloud::upright("box", box_points())],
        samples,
    }
}

/// A grid on the surface of a box of 60 x 40 x 100 mm, off the origin.
pub fn box_points() -> Vec<Point3<f64>> {
    let mut points = Vec::new();
    for i in 0..5 {
        for j in 0..5 {
            let (u, v) = (f64::from(i) / 4.0 - 0.5, f64::from(j) / 4.0 - 0.5);
            for s in [-0.5, 0.5] {
                for (x, y, z) in [(s, u, v), (u, s, v), (u, v, s)] {
                    points.push(Point3::new(0.06 * x + 0.01, 0.04 * y, 0.1 * z + 0.05));
                }
            }
        }
    }
    points
}

/// Settings that train the toy in about a second.
pub fn small() -> TrainOptions {
    TrainOptions::default()
        .with_points(48)
        .with_hidden(24)
        .with_batch(32)
        .with_epochs(60)
        .with_modes(2)
        .with_learning_rate(5e-3)
}

/// The 132 joint vectors (16, rad) of the LEAP hand that come with D-REX; without the data says so and is none.
pub fn leap_grasps() -> Option<Vec<Vec<f64>>> {
    let Some(shared) = std::env::var_os("DREX_SHARED") else {
        eprintln!("skipped: DREX_SHARED is not set");
        return None;
    };
    let rows = read_rows(&Path::new(&shared).join("data/drex_real/demos/cookie_leap_grasps.npy"), 16);
    assert_eq!(rows.len(), 132);
    Some(rows)
}

/// Joint limits of the LEAP hand in the order of its SDK, rad.
pub fn leap_limits() -> Vec<(f64, f64)> {
    let finger = [(-1.047, 1.047), (-0.314, 2.23), (-0.506, 1.885), (-0.366, 2.042)];
    let thumb = [(-0.349, 2.094), (-0.47, 2.443), (-1.2, 1.9), (-1.34, 1.88)];
    [finger, finger, finger, thumb].concat()
}

/// The rows of a little-endian f64 `.npy` matrix in C order.
fn read_rows(path: &Path, columns: usize) -> Vec<Vec<f64>> {
    let bytes = std::fs::read(path).unwrap();
    let header = u16::from_le_bytes([bytes[8], bytes[9]]) as usize;
    let text = String::from_utf8_lossy(&bytes[10..10 + header]).into_owned();
    assert!(text.contains("<f8") && text.contains("'fortran_order': False"), "{text}");
    let values: Vec<f64> = bytes[10 + header..].as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
    values.chunks_exact(columns).map(<[f64]>::to_vec).collect()
}

/// A tin of 16 cm across and 6 cm high.
pub fn tin() -> Vec<Point3<f64>> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..512)
        .map(|i| {
            let (part, angle) = (f64::from(i) / 512.0, golden * f64::from(i));
            let (radius, z) = if i % 2 == 0 { (0.08, 0.06 * (part - 0.5)) } else { (0.08 * part.sqrt(), 0.03) };
            Point3::new(radius * angle.cos(), radius * angle.sin(), z)
        })
        .collect()
}
