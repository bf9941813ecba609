//! Toy data: a box to grasp and two clearly different ways to grasp it.
#![allow(dead_code)] // not every test file uses all of it

use drex_core::Pose;
use drex_policy::{Dataset, GRAVITY_M_S2, GraspSample, ObjectCloud, TrainOptions};
use nalgebra::{Isometry3, Point3, Vector3};

/// Friction of the toy.
pub const FRICTION: f64 = 0.5;

/// Which of the two fingers each way touches with.
pub const TOUCHES: [[bool; 2]; 2] = [[true, true], [true, false]];

/// The two ways: joint angles, wrist, squeeze per weight.
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
                object_from_palm: shift * pose,
                squeeze_n: ratio * (1.0 + 0.02 * wave(i, 7)) * mass_kg * GRAVITY_M_S2,
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
