//! A small policy, trained in seconds on two made-up pinches of a cube, and what it answers for masses that it has not seen.
//!
//!     cargo run --release -p drex-policy --example masses
//!
//! Two opposed contacts need m g / μ newtons in sum, so the right answer is known. The data have 0.1 and 0.2 kg at friction 0.5;
//! 0.15 kg lies between, 0.4 kg and friction 0.4 outside.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::ops::ControlFlow;

use drex_policy::{Dataset, Error, GRAVITY_M_S2, GraspPolicy, GraspSample, ObjectCloud, Query, TrainOptions};
use nalgebra::{Isometry3, Point3};

fn main() -> Result<(), Error> {
    let points: Vec<_> =
        (0..8).map(|i| Point3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64) * 0.06).collect();
    let pinch = |turn: f64, mass_kg: f64| GraspSample {
        object: 0,
        joints: vec![0.8 + turn, 0.6 - turn],
        object_from_base: Isometry3::translation(0.03 + 0.1 * turn, 0.03, 0.15),
        contacts: vec![true, true],
        grip_force_n: mass_kg * GRAVITY_M_S2 / 0.5,
        mass_kg,
        friction: 0.5,
    };
    let data = Dataset {
        hand: "pincher".into(),
        joint_names: vec!["thumb".into(), "index".into()],
        joint_limits: vec![(0.0, 1.5), (0.0, 1.5)],
        fingers: vec!["thumb".into(), "index".into()],
        objects: vec![ObjectCloud::upright("cube", points.clone())],
        samples: [0.0, 0.2].iter().flat_map(|&turn| [0.1, 0.2].map(|mass| pinch(turn, mass))).collect(),
    };
    let options = TrainOptions::default().with_points(8).with_hidden(16).with_epochs(200).with_hold_out_every(0);
    let (policy, report) = GraspPolicy::train(&data, &options, &mut |epoch| {
        if epoch.epoch % 50 == 0 {
            println!("epoch {}: loss {:.3}", epoch.epoch, epoch.total);
        }
        ControlFlow::Continue(())
    })?;
    println!("{} samples, {} numbers learned in {:.1} s", report.train_samples, report.parameters, report.seconds);

    println!("  kg    μ   grip force    m g/μ   joints of the likeliest grasp");
    for (mass_kg, friction) in [(0.1, 0.5), (0.15, 0.5), (0.2, 0.5), (0.4, 0.5), (0.15, 0.4)] {
        let grasps = policy.predict(&Query::new(&points, mass_kg, friction))?;
        let Some(grasp) = grasps.first() else { continue };
        let right = mass_kg * GRAVITY_M_S2 / friction;
        println!(
            "{mass_kg:4.2}  {friction:3.1}  {:6.2} N  {right:6.2} N   {:.2?} rad",
            grasp.grip_force_n, grasp.joints
        );
    }
    Ok(())
}
