//! The LEAP hand grasps a box as heavy as told, lifts it, holds it and is shaken, with several squeezes and in both engines.
//!
//!     cargo run --release -p drex-trial --example lift_hold_shake [--features mujoco]
#![allow(clippy::print_stdout)] // the output is the point of an example

use std::sync::Arc;
use std::time::Instant;

use drex_core::{MassProperties, Pose, SdfSample, SignedDistance};
use drex_diffsim::{Collider, Geom, Shape};
use drex_robot::Robot;
use drex_trial::{Belief, Judge, Squeeze, Trial, TrialObject, TrialOptions, Truth};
use nalgebra::{Matrix3, Point3, Translation3, UnitQuaternion, Vector3};

/// Half extents of the box, m.
const HALF: Vector3<f64> = Vector3::new(0.025, 0.04, 0.03);
/// A pinch of it: thumb against index and middle finger.
const GRASP: [(&str, f64); 12] = [
    ("if_mcp", 0.323),
    ("if_rot", 0.0332),
    ("if_pip", 1.3067),
    ("if_dip", 0.6129),
    ("mf_mcp", 0.4686),
    ("mf_rot", -0.1072),
    ("mf_pip", 0.5256),
    ("mf_dip", 1.2977),
    ("th_cmc", 1.493),
    ("th_axl", 0.8261),
    ("th_mcp", 1.623),
    ("th_ipl", -1.34),
];

/// Signed distance of the box.
struct Cuboid;

impl SignedDistance for Cuboid {
    fn signed_distance(&self, point: &Point3<f64>) -> SdfSample {
        let q = point.coords.abs() - HALF;
        let sign = point.coords.map(|x| if x < 0.0 { -1.0 } else { 1.0 });
        let outside = q.map(|x| x.max(0.0));
        if outside.norm() > 0.0 {
            return SdfSample { distance_m: outside.norm(), gradient: outside.normalize().component_mul(&sign) };
        }
        let k = q.imax();
        SdfSample { distance_m: q[k], gradient: Vector3::ith(k, sign[k]) }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let hand = Arc::new(Robot::bundled("leap_right")?);
    let s = HALF.component_mul(&HALF) / 3.0;
    let inertia = Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y));
    let object = TrialObject {
        collider: Arc::new(Collider::new(&[Geom::new(Shape::Box { half_m: HALF })])?),
        properties: MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia },
        surface: Arc::new(Cuboid),
        world_from_object: Pose::translation(0.0, 0.0, HALF.z),
        max_finger_n: None,
    };
    let palm_from_object = Pose::from_parts(
        Translation3::new(-0.00776, -0.02648, -0.10179),
        UnitQuaternion::from_euler_angles(0.0, 0.0, 0.393),
    );
    let joints = hand.joint_vector(GRASP)?;
    let trial = Trial::new(Arc::clone(&hand), object, TrialOptions::default())?;
    println!(
        "{:>6} {:>5} {:>6} | {:>8} {:>9} {:>8} {:>8} {:>8} {:>8} {:>6} {:>6}",
        "kg", "mu", "N", "judge", "verdict", "at s", "peak N", "slip mm", "turn", "used", "s"
    );
    for (mass_kg, friction, part) in
        [(0.2, 0.5, 1.0), (0.2, 0.5, 0.5), (0.1, 0.5, 1.0), (0.05, 0.3, 1.0), (0.3, 0.7, 1.0)]
    {
        let belief = Belief { mass_kg: mass_kg * part, friction };
        let begun = Instant::now();
        let command = match trial.command(&joints, &palm_from_object.inverse(), &belief, Squeeze::Needed)? {
            Ok(command) => command,
            Err(reason) => {
                println!("{mass_kg:>6} {friction:>5}: {reason}");
                continue;
            }
        };
        let planned_s = begun.elapsed().as_secs_f64();
        for judge in [Judge::Diffsim, Judge::Mujoco] {
            for seed in 0..3 {
                let truth = Truth { mass_kg, ..Truth::as_believed(&belief, seed) };
                let begun = Instant::now();
                let o = match trial.run(&command, &truth, judge) {
                    Ok(o) => o,
                    Err(drex_trial::Error::NoMujoco) => continue,
                    Err(other) => return Err(other.into()),
                };
                println!(
                    "{mass_kg:>6} {friction:>5} {:>6.2} | {judge:>8?} {:>9} {:>8.2} {:>8.2} {:>8.2} {:>8.2} {:>6.2} {:>6.3} {planned_s:.3}",
                    o.squeeze_n,
                    format!("{:?}", o.verdict),
                    o.failed_at_s.unwrap_or(f64::NAN),
                    o.peak_finger_n,
                    1e3 * o.slip_m,
                    o.turn_rad.to_degrees(),
                    o.friction_used.unwrap_or(f64::NAN),
                    begun.elapsed().as_secs_f64()
                );
            }
        }
    }
    Ok(())
}
