//! Derivatives across events, against closed formulas and differences.

use std::sync::Arc;

use drex_core::{MassProperties, Pose};
use drex_diffsim::{Body, Collider, ConvexPolyhedron, Model, Scalar, Scene, State, parameter, rollout, tangents};
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

const SPEED: f64 = 0.3;
const GRAVITY: f64 = 9.81;

/// Where a block is `until` seconds after it was thrown flat at 0.3 m/s, `height` above a table of friction `friction`:
/// it flies, lands, slides and sticks.
fn thrown<T: Scalar>([height, friction]: [T; 2], until: f64) -> [T; 2] {
    let half = Vector3::new(0.03, 0.03, 0.02);
    let corner =
        |i: usize| Point3::from(half.component_mul(&Vector3::from_fn(|k, _| if i >> k & 1 == 0 { -1.0 } else { 1.0 })));
    let piece = ConvexPolyhedron::from_points(&(0..8).map(corner).collect::<Vec<_>>()).unwrap();
    let inertia = Matrix3::from_diagonal(&Vector3::new(4.3e-4, 4.3e-4, 6e-4));
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    let model = Model::new(vec![Body::new(&unit, T::lift(0.2), Arc::new(Collider::convex(vec![piece])))]);
    let position = Vector3::new(T::zero(), T::zero(), height + T::lift(half.z));
    let mut start = State::at_rest(Pose::from_parts(position.into(), UnitQuaternion::identity()));
    start.bodies[0].velocity.x = T::lift(SPEED);
    let p =
        rollout(&model, &Scene::on_table(friction), &start, &[until]).unwrap().bodies[0].poses[0].translation.vector;
    [p.x, p.z]
}

/// The way, v t + (v - μ w)²/(2 μ g) with the vertical speed w = √(2 g H) = g t at the landing, and its derivatives: by
/// the height H it is exactly μ, the time of the landing included.
#[test]
fn a_landing_and_a_slide_to_rest() {
    let p0 = [0.01, 0.4];
    let x = thrown([parameter::<2>(p0[0], 0), parameter(p0[1], 1)], 0.4)[0];
    let (h, mu) = (p0[0], p0[1]);
    let w = (2.0 * GRAVITY * h).sqrt();
    let left = SPEED - mu * w;
    let way = SPEED * w / GRAVITY + left * left / (2.0 * mu * GRAVITY);
    let by_friction = -w * left / (mu * GRAVITY) - left * left / (2.0 * mu * mu * GRAVITY);
    let step_s = 5e-4; // the landing is found to one step
    assert!((x.re - way).abs() < SPEED * step_s, "{x} {way}");
    assert!((tangents(&x)[0] - mu).abs() < 1e-3 * mu, "{x} {mu}");
    assert!((tangents(&x)[1] - by_friction).abs() < 0.02 * by_friction.abs(), "{x} {by_friction}");
}

/// In every phase (flight, the step of the landing, settling, sliding, rest) against differences.
#[test]
fn every_phase_of_a_landing() {
    let p0 = [0.01, 0.4];
    for until in [0.02, 0.0445, 0.045, 0.0453, 0.046, 0.05, 0.07, 0.076, 0.2] {
        let exact = thrown([parameter::<2>(p0[0], 0), parameter(p0[1], 1)], until);
        for i in 0..2 {
            for k in 0..2 {
                let d = tangents(&exact[k])[i];
                let off = [1e-5, 1e-6, 1e-7].map(|h| {
                    let at = |s: f64| {
                        thrown([p0[0] + if i == 0 { s } else { 0.0 }, p0[1] + if i == 1 { s } else { 0.0 }], until)[k]
                    };
                    ((at(h) - at(-h)) / (2.0 * h) - d).abs()
                });
                let best = off.into_iter().fold(f64::INFINITY, f64::min);
                assert!(
                    best < 1e-5 * (0.01 + d.abs()),
                    "t = {until}, output {k}, parameter {i}: {d}, off by {best:.1e}"
                );
            }
        }
    }
}
