//! Derivatives from dual numbers against central differences.
#![allow(clippy::unwrap_used, missing_docs)] // a test may panic

use std::sync::Arc;

use drex_core::{MassProperties, Pose};
use drex_diffsim::{
    AppliedForce, Body, Collider, ConvexPiece, Dual, ForcePoint, Model, Part, Scalar, Scene, State, parameter, rollout,
    tangents,
};
use nalgebra::{Matrix3, Point3, RealField, Vector3};

/// Parameters: ln m, friction, shift of the centre of mass along x (m), start x (m).
type P<T> = [T; 4];

/// Final x, z and tilt of a block of 6 x 6 x 8 cm under a force from 0.1 s to 0.25 s at a height over its centre.
fn push<T: Scalar + RealField>(p: P<T>, force_n: Vector3<f64>, height: f64, until: f64) -> [T; 3] {
    let half = Vector3::new(0.03, 0.03, 0.04);
    let points: Vec<_> = (0..8)
        .map(|i| Point3::from(half.component_mul(&Vector3::from_fn(|k, _| if i >> k & 1 == 0 { -1.0 } else { 1.0 }))))
        .collect();
    let inertia = Matrix3::from_diagonal(&Vector3::new(8.3e-4, 8.3e-4, 6e-4));
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    let shape = Arc::new(Collider::convex(vec![ConvexPiece::from_points(&points).unwrap()]));
    let mut body = Body::new(&unit, p[0].exp(), shape);
    body.center_of_mass.x += p[2];
    let model = Model::new(vec![body]);
    let mut scene = Scene::on_table(p[1]);
    let at = ForcePoint::Body(Point3::new(-0.03, 0.0, height));
    scene.forces.push(AppliedForce::new(Part::Body(0), &[0.1, 0.25], &[force_n, Vector3::zeros()], at).unwrap());
    let mut start = State::at_rest(Pose::from_parts(
        Vector3::new(T::zero(), T::zero(), T::lift(0.04)).into(),
        nalgebra::UnitQuaternion::identity(),
    ));
    start.bodies[0].world_from_body.translation.vector.x += p[3];
    let end = rollout(&model, &scene, &start, &[until]).unwrap();
    let pose = end.bodies[0].poses[0];
    [pose.translation.vector.x, pose.translation.vector.z, (pose.rotation * Vector3::x()).z]
}

fn check(force_n: Vector3<f64>, height: f64, until: f64, tolerance: f64, steps: &[f64]) {
    let p0 = [0.2_f64.ln(), 0.45, 0.001, 0.0];
    let dual: P<Dual<4>> = std::array::from_fn(|i| parameter(p0[i], i));
    let exact = push(dual, force_n, height, until);
    for (k, output) in exact.iter().enumerate() {
        let j = tangents(output);
        for i in 0..4 {
            let best = steps
                .iter()
                .map(|h| {
                    let at = |s: f64| {
                        let mut p = p0;
                        p[i] += s * h;
                        push(p, force_n, height, until)[k]
                    };
                    ((at(1.0) - at(-1.0)) / (2.0 * h) - j[i]).abs()
                })
                .fold(f64::INFINITY, f64::min);
            let scale = 0.01 + j[i].abs();
            assert!(best < tolerance * scale, "output {k}, parameter {i}: derivative {}, off by {best:.2e}", j[i]);
        }
    }
}

const STEPS: [f64; 4] = [1e-4, 1e-5, 1e-6, 1e-7];

#[test]
fn a_smooth_slide() {
    check(Vector3::x() * 1.6, -0.03, 0.24, 1e-6, &STEPS);
}

#[test]
fn a_lift() {
    check(Vector3::new(0.3, 0.0, 3.0), 0.0, 0.2, 1e-6, &STEPS);
}

#[test]
fn a_tilt_with_a_sticking_edge() {
    check(Vector3::x() * 0.85, 0.035, 0.25, 1e-5, &STEPS);
}

#[test]
fn a_slide_to_rest_sticks_again() {
    check(Vector3::x() * 1.6, -0.03, 0.9, 1e-4, &STEPS);
}

#[test]
fn a_motion_without_applied_force_has_no_derivative_by_the_mass() {
    let d = push(
        [parameter::<1>(0.3_f64.ln(), 0), Dual::from_re(0.4), Dual::from_re(0.001), Dual::from_re(0.0)],
        Vector3::zeros(),
        0.0,
        0.5,
    );
    for x in d {
        assert!(tangents(&x)[0].abs() < 1e-12, "{x:?}");
    }
}

#[test]
fn duals_and_plain_numbers_move_alike() {
    let p0 = [0.2_f64.ln(), 0.45, 0.001, 0.0];
    let plain = push(p0, Vector3::x() * 0.85, 0.035, 0.6);
    let dual = push(p0.map(Dual::<2>::from_re), Vector3::x() * 0.85, 0.035, 0.6);
    for (a, b) in plain.iter().zip(&dual) {
        assert!((a - b.re).abs() < 1e-9);
    }
}
