//! A box, the LEAP hand, and a grasp that was searched for.
#![allow(clippy::unwrap_used, dead_code)] // a test says what fails by failing; not every test uses everything

use std::sync::{Arc, LazyLock};

use drex_core::{ConvexPart, MassProperties, Object, Pose, Primitive, PrimitiveShape, SurfacePoint, TablePlane};
use drex_grasp::{FoundGrasp, HandSurface, SearchOptions, search_grasps};
use drex_robot::Robot;
use drex_trial::{Assumed, GripForce, Trial, TrialOptions};
use nalgebra::{Matrix3, Point3, Vector3};

/// Half extents of the box, m.
pub const HALF: Vector3<f64> = Vector3::new(0.025, 0.035, 0.04);

/// Points on the four sides, outward normals.
fn sides() -> Vec<SurfacePoint> {
    let mut out = Vec::new();
    for i in 0..15 {
        for k in 0..15 {
            let (u, v) = (f64::from(i) / 7.0 - 1.0, f64::from(k) / 7.0 - 1.0);
            for (axis, other) in [(0, 1), (1, 0)] {
                for sign in [-1.0, 1.0] {
                    let mut point = Point3::new(0.0, 0.0, v * HALF.z * 0.9);
                    point[axis] = sign * HALF[axis];
                    point[other] = u * HALF[other] * 0.9;
                    out.push(SurfacePoint { point, normal: Vector3::ith(axis, sign) });
                }
            }
        }
    }
    out
}

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

/// Grasps of the box that the hand can carry 150 g with at friction 0.5, those that grip force least first; searched for once for all tests.
pub fn grasps() -> &'static [FoundGrasp] {
    static FOUND: LazyLock<Vec<FoundGrasp>> = LazyLock::new(searched);
    &FOUND
}

fn searched() -> Vec<FoundGrasp> {
    let trial = trial_of(|_, _| {});
    let surface = HandSurface::new(trial.hand(), 0.004).unwrap();
    let table = TablePlane { up: Vector3::z_axis(), height_m: -HALF.z };
    let mut options = SearchOptions::default();
    options.candidates = 6000;
    let found =
        search_grasps(trial.hand(), &surface, &*trial.object().geometry, &sides(), &Point3::origin(), &table, &options)
            .unwrap();
    let assumed = Assumed { mass_kg: 0.15, friction: 0.5 };
    let mut good: Vec<(f64, FoundGrasp)> = found
        .into_iter()
        .filter(|f| f.closed)
        .filter_map(|f| {
            let command = trial.command(&f.joints, &f.object_from_base, &assumed, GripForce::Required).unwrap().ok()?;
            Some((command.grip_force_n, f))
        })
        .collect();
    good.sort_by(|a, b| a.0.total_cmp(&b.0));
    good.into_iter().map(|g| g.1).collect()
}
