//! Times the training and the prediction that `tests/peers/policy_speed.py` puts beside PyTorch.
//!
//!     cargo run --release -p drex-policy --example train_speed -- [EPOCHS]
//!
//! 300 made-up demonstrations of one object at three masses (900 samples), the default network (512 points, 128 hidden, 16 modes of a
//! 16-joint hand), batches of 64. Prints one JSON line: s of the first phase, steps, ms per step, ms per prediction (median of 50), threads,
//! and CPU seconds of the process where /proc tells them.
#![allow(clippy::print_stdout)] // an example talks to its caller

use std::ops::ControlFlow;
use std::time::Instant;

use drex_policy::{Dataset, Error, GRAVITY_M_S2, GraspPolicy, GraspSample, ObjectCloud, Query, TrainOptions};
use nalgebra::{Isometry3, Point3, Vector3};

const DEMONSTRATIONS: usize = 300;
const MASSES_KG: [f64; 3] = [0.1, 0.2, 0.4];

fn main() -> Result<(), Error> {
    let epochs = std::env::args().nth(1).and_then(|a| a.parse().ok()).unwrap_or(20);
    let data = made_up();
    let options = TrainOptions::default().with_epochs(epochs).with_hold_out_every(0);
    let (policy, report) = GraspPolicy::train(&data, &options, &mut |_| ControlFlow::Continue(()))?;
    let query = Query::new(&data.objects[0].points, 0.25, 0.5);
    let mut times = Vec::new();
    for _ in 0..50 {
        let started = Instant::now();
        policy.predict(&query)?;
        times.push(1e3 * started.elapsed().as_secs_f64());
    }
    times.sort_by(f64::total_cmp);
    let steps = epochs * report.train_samples.div_ceil(options.batch);
    let line = serde_json::json!({
        "epochs": epochs,
        "samples": report.train_samples,
        "parameters": report.parameters,
        "seconds": report.seconds,
        "steps": steps,
        "ms_per_step": 1e3 * report.seconds / steps as f64,
        "ms_per_prediction": times[times.len() / 2],
        "threads": std::thread::available_parallelism().map_or(1, usize::from),
        "cpu_seconds": cpu_seconds(),
    });
    println!("{line}");
    Ok(())
}

/// Twelve kinds of grasp of a tin, each with some scatter.
fn made_up() -> Dataset {
    let wave = |i: usize, j: usize| ((7 * i + 3 * j) as f64 * 1.37).sin();
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let points = (0..512).map(|i| {
        let (part, angle) = (f64::from(i) / 512.0, golden * f64::from(i));
        let (radius, z) = if i % 2 == 0 { (0.08, 0.06 * (part - 0.5)) } else { (0.08 * part.sqrt(), 0.03) };
        Point3::new(radius * angle.cos(), radius * angle.sin(), z)
    });
    let mut samples = Vec::new();
    for i in 0..DEMONSTRATIONS {
        let kind = i % 12;
        let joints: Vec<f64> = (0..16).map(|j| 0.7 + 0.4 * wave(kind, j) + 0.05 * wave(i, j + 50)).collect();
        let turn = Isometry3::rotation(Vector3::new(3.0, 0.4 * wave(kind, 20), 0.4 * wave(kind, 21)));
        let palm =
            Isometry3::translation(0.02 * wave(kind, 22), 0.02 * wave(kind, 23), 0.12 + 0.005 * wave(i, 24)) * turn;
        for mass_kg in MASSES_KG {
            samples.push(GraspSample {
                object: 0,
                joints: joints.clone(),
                object_from_base: palm,
                contacts: (0..4).map(|f| f == 0 || wave(kind, 30 + f) > -0.5).collect(),
                grip_force_n: (1.2 + 0.3 * wave(kind, 40)) * mass_kg * GRAVITY_M_S2 / 0.5,
                mass_kg,
                friction: 0.5,
            });
        }
    }
    Dataset {
        hand: "leap_right".into(),
        joint_names: (0..16).map(|j| format!("joint{j}")).collect(),
        joint_limits: vec![(-0.5, 2.0); 16],
        fingers: ["thumb", "index", "middle", "ring"].map(String::from).to_vec(),
        objects: vec![ObjectCloud::upright("tin", points.collect())],
        samples,
    }
}

/// User and system time of this process, s, on Linux (ticks of 10 ms).
fn cpu_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = fields.get(11)?.parse::<f64>().ok()? + fields.get(12)?.parse::<f64>().ok()?;
    Some(ticks / 100.0)
}
