//! The LEAP hand and a box: grasps are searched for, and each is tried with the grip force it needs and with a third of it. No file is needed.
//!
//!     cargo run --release -p drex-trial --example lift_box -- [GRASPS]
//!
//! One line per grasp: the grip force that was commanded and delivered, how the trial ended, and how it ended with a third.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::sync::Arc;

use drex_core::{ConvexPart, MassProperties, Object, Pose, Primitive, PrimitiveShape, SurfacePoint, TablePlane};
use drex_grasp::{HandSurface, SearchOptions, search_grasps};
use drex_robot::Robot;
use drex_trial::{Assumed, Engine, GripForce, Trial, TrialOptions, Truth};
use nalgebra::{Matrix3, Point3, Vector3};

/// Half extents of the box, m.
const HALF: Vector3<f64> = Vector3::new(0.025, 0.035, 0.04);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let wanted = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(8);
    let s = HALF.component_mul(&HALF) / 3.0;
    let inertia = Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y));
    let properties = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    let shape = PrimitiveShape::Box { half_m: HALF.into() };
    let part = ConvexPart::of_primitive(Primitive { shape, object_from_shape: Pose::identity() })?;
    let object = Object::of_parts(vec![part], properties).with_rest_pose(Pose::translation(0.0, 0.0, HALF.z));
    let hand = Arc::new(Robot::bundled("leap_right")?);
    let surface = HandSurface::new(&hand, 0.004)?;
    let table = TablePlane { up: Vector3::z_axis(), height_m: -HALF.z };
    let mut options = SearchOptions::default();
    options.candidates = 6000;
    let mut found = search_grasps(&hand, &surface, &*object.geometry, &sides(), &Point3::origin(), &table, &options)?;
    println!("{} grasps of {} candidates", found.len(), options.candidates);
    found.retain(|g| g.closed);
    found.sort_by(|a, b| a.grip_force_per_weight.total_cmp(&b.grip_force_per_weight));

    let trial = Trial::new(hand, object, TrialOptions::default())?;
    let told = Assumed { mass_kg: 0.15, friction: 0.5 };
    let truth = Truth::as_assumed(&told, 1);
    let mut tried = 0;
    for grasp in &found {
        if tried == wanted {
            break;
        }
        // Some grasps that were found cannot be closed, or the motors are too weak for them: that is no error, but a reason.
        let Ok(command) = trial.command(&grasp.joints, &grasp.object_from_base, &told, GripForce::Required)? else {
            continue;
        };
        tried += 1;
        let enough = trial.run(&command, &truth, Engine::Diffsim)?;
        let third = GripForce::Total(command.grip_force_n / 3.0);
        let little = match trial.command(&grasp.joints, &grasp.object_from_base, &told, third)? {
            Ok(little) => format!("{:?}", trial.run(&little, &truth, Engine::Diffsim)?.verdict),
            Err(reason) => reason.to_string(),
        };
        let held = enough.held_n.map_or("nothing".into(), |n| format!("{n:.1} N"));
        println!(
            "{:5.1} N told, {held} in the hold: {:?}; with a third: {little}",
            command.grip_force_n, enough.verdict
        );
    }
    Ok(())
}

/// Points on the four upright sides with outward normals, mesh frame.
fn sides() -> Vec<SurfacePoint> {
    let mut out = Vec::new();
    for (i, k) in (0..15).flat_map(|i| (0..15).map(move |k| (i, k))) {
        let (u, v) = (f64::from(i) / 7.0 - 1.0, f64::from(k) / 7.0 - 1.0);
        for (axis, sign) in [(0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0)] {
            let mut point = Point3::new(0.0, 0.0, 0.9 * v * HALF.z);
            point[axis] = sign * HALF[axis];
            point[1 - axis] = 0.9 * u * HALF[1 - axis];
            out.push(SurfacePoint { point, normal: Vector3::ith(axis, sign) });
        }
    }
    out
}
