//! Bodies, scenes and sums that several tests use.
#![allow(dead_code, unreachable_pub, missing_docs, clippy::unwrap_used, clippy::print_stdout)] // not every test needs all of it

use std::sync::Arc;

use drex_core::{MassProperties, Pose};
use drex_diffsim::{Articulation, Base, Body, BodyState, Collider, Geom, Model, Scalar, Shape, State};
use drex_robot::Robot;
use nalgebra::{Matrix3, Point3, Translation3, UnitQuaternion, Vector3};

pub const G: f64 = 9.81;

/// Prints a row of the table in docs/diffsim.md and fails if the deviation is above what is allowed.
#[track_caller]
pub fn within(test: &str, truth: &str, measured: f64, allowed: f64) {
    println!("| {test} | {truth} | {measured:.1e} | {allowed:.1e} |");
    assert!(measured <= allowed, "{test}: {truth}: off by {measured:.3e}, allowed {allowed:.1e}");
}

/// |a / b - 1|.
pub fn relative(a: f64, b: f64) -> f64 {
    (a / b - 1.0).abs()
}

/// A body of unit inertia `moments` (m²) along its axes.
pub fn body<T: Scalar>(geoms: &[Geom], moments: Vector3<f64>, mass_kg: T) -> Body<T> {
    let inertia = Matrix3::from_diagonal(&moments);
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    Body::new(&unit, mass_kg, Arc::new(Collider::new(geoms).unwrap()))
}

/// A solid box.
pub fn cuboid<T: Scalar>(half_m: Vector3<f64>, mass_kg: T) -> Body<T> {
    let s = half_m.component_mul(&half_m) / 3.0;
    body(&[Geom::new(Shape::Box { half_m })], Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y), mass_kg)
}

/// A solid ball.
pub fn ball<T: Scalar>(radius_m: f64, mass_kg: T) -> Body<T> {
    body(&[Geom::new(Shape::Sphere { radius_m })], Vector3::repeat(0.4 * radius_m * radius_m), mass_kg)
}

pub fn at(x: f64, y: f64, z: f64) -> Pose {
    Pose::translation(x, y, z)
}

pub fn turned(p: Vector3<f64>, rotation: UnitQuaternion<f64>) -> Pose {
    Pose::from_parts(Translation3::from(p), rotation)
}

/// Bodies at rest.
pub fn resting(poses: &[Pose]) -> State<f64> {
    State::new(poses.iter().map(|p| BodyState::at_rest(*p)).collect(), Vec::new())
}

/// Turns z by `slope` towards x, so that a thing on it slides along +x.
pub fn down_slope(slope: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::y() * slope)
}

/// A robot of MJCF bodies and drives.
pub fn robot(bodies: &str, drives: &str) -> Arc<Robot> {
    let text = format!(
        "<mujoco model=\"test\"><compiler angle=\"radian\" autolimits=\"true\"/><worldbody>{bodies}</worldbody>\
         <actuator>{drives}</actuator></mujoco>"
    );
    Arc::new(Robot::from_mjcf_str(&text, None).unwrap())
}

pub fn fixed_arm(robot: Arc<Robot>) -> Articulation<f64> {
    Articulation::new(robot, Base::Fixed(Pose::identity())).unwrap()
}

/// Kinetic energy of the free bodies.
pub fn kinetic(model: &Model<f64>, state: &State<f64>) -> f64 {
    let each = model.bodies.iter().zip(&state.bodies).map(|(b, s)| {
        let w = s.world_from_body.rotation.inverse() * s.angular_velocity;
        0.5 * b.mass_kg * (s.velocity.norm_squared() + w.dot(&(b.unit_inertia * w)))
    });
    each.sum()
}

/// Kinetic and potential energy of the free bodies.
pub fn energy(model: &Model<f64>, state: &State<f64>, gravity: &Vector3<f64>) -> f64 {
    let fall = |(b, s): (&Body<f64>, &BodyState<f64>)| {
        -b.mass_kg * gravity.dot(&(s.world_from_body * b.center_of_mass).coords)
    };
    kinetic(model, state) + model.bodies.iter().zip(&state.bodies).map(fall).sum::<f64>()
}

/// Momentum, and angular momentum about the world's origin, of the free bodies.
pub fn momenta(model: &Model<f64>, state: &State<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let (mut p, mut l) = (Vector3::zeros(), Vector3::zeros());
    for (b, s) in model.bodies.iter().zip(&state.bodies) {
        let q = s.world_from_body.rotation;
        let spin = q * (b.unit_inertia * q.inverse_transform_vector(&s.angular_velocity)) * b.mass_kg;
        p += s.velocity * b.mass_kg;
        l += (s.world_from_body * b.center_of_mass).coords.cross(&(s.velocity * b.mass_kg)) + spin;
    }
    (p, l)
}
