//! The LEAP hand and a box: grasps are searched for, and each is tried with the grip force it needs and with a third of it. No file is needed.
//!
//!     cargo run --release -p drex-trial --example lift_box -- [GRASPS]
//!
//! One line per grasp: the grip force that was commanded and delivered, how the trial ended, and how it ended with a third.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::sync::Arc;

use drex_core::{ConvexPart, MassProperties, Object, Pose, Primitive, PrimitiveShape};
use drex_grasp::pinch_grasps;
use drex_robot::Robot;
use drex_trial::{Assumed, Engine, GripForce, Trial, TrialOptions, Truth};
use nalgebra::{Matrix3, Point3, Vector3};

/// Half extents of the box, m.
const HALF: Vector3<f64> = Vector3::new(0.025, 0.035, 0.04);

/// Pinches that are looked at.
const CANDIDATES: usize = 6000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let wanted = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(8);
    let s = HALF.component_mul(&HALF) / 3.0;
    let inertia = Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y));
    let properties = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    let shape = PrimitiveShape::Box { half_m: HALF.into() };
    let part = ConvexPart::of_primitive(Primitive { shape, object_from_shape: Pose::identity() })?;
    let object = Object::of_parts(vec![part], properties).with_rest_pose(Pose::translation(0.0, 0.0, HALF.z));
    let hand = Arc::new(Robot::bundled("leap_right")?);
    let mut found = pinch_grasps(&object, &hand, CANDIDATES, 0)?;
    println!("{} grasps of {CANDIDATES} candidates", found.len());
    found.sort_by(|a, b| a.grip_force_n.unwrap_or(f64::NAN).total_cmp(&b.grip_force_n.unwrap_or(f64::NAN)));

    let trial = Trial::new(hand, object, TrialOptions::default())?;
    let assumed = Assumed { mass_kg: 0.15, friction: 0.5 };
    let truth = Truth::as_assumed(&assumed, 1);
    let mut tried = 0;
    for grasp in &found {
        if tried == wanted {
            break;
        }
        // Some grasps that were found cannot be closed, or the motors are too weak for them: that is no error, but a reason.
        let Ok(command) = trial.command(grasp, &assumed, GripForce::Required)? else {
            continue;
        };
        tried += 1;
        let enough = trial.run(&command, &truth, Engine::Diffsim)?;
        let third = GripForce::Total(command.grip_force_n / 3.0);
        let little = match trial.command(grasp, &assumed, third)? {
            Ok(little) => format!("{:?}", trial.run(&little, &truth, Engine::Diffsim)?.verdict),
            Err(reason) => reason.to_string(),
        };
        let held = enough.held_n.map_or("nothing".into(), |n| format!("{n:.1} N"));
        println!(
            "{:5.1} N commanded, {held} in the hold: {:?}; with a third: {little}",
            command.grip_force_n, enough.verdict
        );
    }
    Ok(())
}
