//! A box, the LEAP hand, and a grasp that was searched for.
#![allow(clippy::unwrap_used, dead_code)] // a test says what fails by failing; not every test uses everything

use std::sync::{Arc, LazyLock};

use drex_core::{ConvexPart, MassProperties, Object, Pose, Primitive, PrimitiveShape};
use drex_grasp::{EvaluationOptions, Grasp, HandSurface, evaluate_with, pinch_grasps};
use drex_robot::Robot;
use drex_trial::{Assumed, GripForce, Trial, TrialOptions};
use nalgebra::{Matrix3, Point3, Vector3};

/// Half extents of the box, m.
pub const HALF: Vector3<f64> = Vector3::new(0.025, 0.035, 0.04);

pub fn trial_of(change: impl FnOnce(&mut Object, &mut TrialOptions)) -> Trial {
    let s = HALF.component_mul(&HALF) / 3.0;
    let inertia = Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y));
    let properties = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    let shape = PrimitiveShape::Box { half_m: HALF.into() };
    let part = ConvexPart::of_primitive(Primitive { shape, object_from_shape: Pose::identity() }).unwrap();
    let mut object = Object::of_parts(vec![part], properties).with_rest_pose(Pose::translation(0.0, 0.0, HALF.z));
    let mut options = TrialOptions::default();
    change(&mut object, &mut options);
    Trial::new(Arc::new(Robot::bundled("leap_right").unwrap()), object, options).unwrap()
}

/// Grasps of the box by its upright sides that pass the evaluation at 150 g and friction 0.5, and have a command, those that need least force first; searched for once for all tests.
pub fn grasps() -> &'static [Grasp] {
    static FOUND: LazyLock<Vec<Grasp>> = LazyLock::new(searched);
    &FOUND
}

fn searched() -> Vec<Grasp> {
    let trial = trial_of(|_, _| {});
    let assumed = Assumed { mass_kg: 0.15, friction: 0.5 };
    let object = trial.object().clone().with_mass(assumed.mass_kg);
    let surface = HandSurface::new(trial.hand(), 0.003).unwrap();
    let limits = EvaluationOptions::default();
    let passes = |f: &Grasp| evaluate_with(&surface, f, &object, trial.hand(), &limits).unwrap().passed;
    let mut good: Vec<(f64, Grasp)> = pinch_grasps(&object, trial.hand(), 6000, 0)
        .unwrap()
        .into_iter()
        .filter(|f| f.contacts.iter().all(|c| c.normal[2].abs() < 0.1) && passes(f))
        .filter_map(|f| {
            let command = trial.command(&f, &assumed, GripForce::Required).unwrap().ok()?;
            Some((command.grip_force_n, f))
        })
        .collect();
    good.sort_by(|a, b| a.0.total_cmp(&b.0));
    good.into_iter().map(|g| g.1).collect()
}
