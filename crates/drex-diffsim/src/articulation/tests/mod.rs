//! Trees against an independent implementation, closed forms, finite differences and conservation.

mod dynamics;
mod joint_forces;
mod motion;

use std::sync::Arc;

use drex_core::Pose;
use drex_robot::Robot;
use nalgebra::{DMatrix, DVector, UnitQuaternion, Vector3};

use super::*;
use crate::Scalar;
use crate::path::{Path, mean_rate};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

/// Numbers in [-1, 1) that look random and are always the same.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
    fn vector(&mut self, scale: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.next()) * scale
    }
    fn pose(&mut self) -> Pose {
        Pose::from_parts(self.vector(1.0).into(), UnitQuaternion::from_scaled_axis(self.vector(1.5)))
    }
    fn many(&mut self, n: usize, scale: f64) -> Vec<f64> {
        (0..n).map(|_| self.next() * scale).collect()
    }
}

/// A robot of MJCF bodies.
fn mjcf(bodies: &str) -> Arc<Robot> {
    let text = format!(
        "<mujoco model=\"test\"><compiler angle=\"radian\" autolimits=\"true\"/><worldbody>{bodies}</worldbody></mujoco>"
    );
    Arc::new(Robot::from_mjcf_str(&text, None).unwrap())
}

/// A tree that has everything: branches, a slide, a body with two joints, anchors off the origin, a fixed link.
fn everything() -> Arc<Robot> {
    mjcf(
        r#"<body name="base"><inertial pos="0.02 -0.01 0.03" mass="1.2" diaginertia="0.004 0.005 0.006"/>
      <body name="upper" pos="0.1 0 0.05" quat="0.9 0.1 -0.3 0.2">
        <joint name="turn" axis="0.2 0.5 1" pos="0.01 0.02 -0.01" armature="0.001"/>
        <joint name="swing" axis="1 0 0.3" pos="0 0.01 0.03"/>
        <inertial pos="0.05 0.01 0" mass="0.7" fullinertia="0.002 0.003 0.0025 0.0003 -0.0002 0.0001"/>
        <body name="plate" pos="0.1 0.02 0" quat="0.7 0 0.7 0">
          <inertial pos="0 0 0.01" mass="0.2" diaginertia="1e-4 2e-4 1.5e-4"/>
          <body name="rod" pos="0 0 0.05"><joint name="slide" type="slide" axis="0.3 0 1" ref="0.02"/>
            <inertial pos="0 0.02 0.1" mass="0.3" diaginertia="1e-3 1.2e-3 3e-4"/>
            <body name="tip" pos="0 0 0.2"><joint name="wrist" axis="0 1 0" ref="0.4"/>
              <inertial pos="0.03 0 0.02" mass="0.1" diaginertia="1e-4 1e-4 5e-5"/></body></body></body></body>
      <body name="other" pos="-0.1 0.1 0" quat="0.5 0.5 -0.5 0.5"><joint name="elbow" axis="0 0 1"/>
        <inertial pos="0.06 0 0" mass="0.4" diaginertia="5e-4 9e-4 9e-4"/></body></body>"#,
    )
}

fn fixed(robot: Arc<Robot>, pose: Pose) -> Articulation<f64> {
    Articulation::new(robot, Base::Fixed(pose)).unwrap()
}

/// A state with random coordinates and velocities; the base too if it is free.
fn random_state(arm: &Articulation<f64>, numbers: &mut Numbers, speed: f64) -> ArticulationState<f64> {
    let n = arm.joints.len();
    let mut state = arm.at_rest(&numbers.many(n, 1.2), 0.0).unwrap();
    state.velocities = numbers.many(n, speed);
    if arm.base_dof() > 0 {
        state.base.world_from_base = numbers.pose();
        (state.base.velocity, state.base.angular_velocity) = (numbers.vector(speed), numbers.vector(speed));
    }
    state
}

/// Mass matrix and bias at a state.
fn equations<T: Scalar>(arm: &Articulation<T>, state: &ArticulationState<T>, t: f64) -> (Vec<T>, Vec<T>, TreeWork<T>) {
    let n = arm.dof();
    let mut work = TreeWork::default();
    arm.kinematics(state, t, 0.0, &mut work);
    let (mut m, mut b) = (vec![T::lift(f64::NAN); n * n], vec![T::lift(f64::NAN); n]);
    arm.mass_matrix(&work, &mut m);
    arm.bias(&mut work, &GRAVITY.map(T::lift), &[], &mut b);
    (m, b, work)
}

/// Total momentum, angular momentum about the world's origin and energy, link by link.
fn totals(work: &TreeWork<f64>) -> (Vector3<f64>, Vector3<f64>, f64) {
    let (mut p, mut l, mut energy) = (Vector3::zeros(), Vector3::zeros(), 0.0);
    for link in &work.links {
        let (c, w) = (link.center_of_mass(), link.angular_velocity);
        let v = link.velocity + w.cross(&(link.center - link.origin));
        p += v * link.mass;
        let spin = link.inertia.matrix() * w;
        l += c.cross(&v) * link.mass + spin;
        energy += 0.5 * (link.mass * v.norm_squared() + w.dot(&spin)) - link.mass * GRAVITY.dot(&c);
    }
    (p, l, energy)
}

/// Steps `arm` as the simulator does, but with a dense solver of its own. Returns the forces of the step and their forces.
fn step(
    arm: &Articulation<f64>,
    state: &mut ArticulationState<f64>,
    (t, h): (f64, f64),
    gravity: &Vector3<f64>,
    control: &[f64],
    work: &mut TreeWork<f64>,
) -> Vec<(JointForce<f64>, f64)> {
    let n = arm.dof();
    arm.kinematics(state, t, h, work);
    let (mut m, mut b, mut forces, mut u0) = (vec![0.0; n * n], vec![0.0; n], Vec::new(), Vec::new());
    arm.mass_matrix(work, &mut m);
    arm.step_bias(work, gravity, &[], (&m, h), &mut b);
    arm.joint_forces(state, work, control, h, &mut forces);
    arm.velocity(state, &mut u0);
    let (m, b, u0) = (DMatrix::from_row_slice(n, n, &m), DVector::from_vec(b), DVector::from_vec(u0));
    let residual = |u: &DVector<f64>| {
        let mut r = &m * (u - &u0) + &b * h;
        forces.iter().for_each(|force| r[force.dof] -= h * force.force(u[force.dof]));
        r
    };
    let mut u = u0.clone();
    for _ in 0..100 {
        let mut a = m.clone();
        forces.iter().for_each(|force| a[(force.dof, force.dof)] += h * force.stiffness(u[force.dof]));
        let r = residual(&u);
        let change = a.lu().solve(&r).unwrap();
        let mut length = 1.0;
        while length > 1e-3 && residual(&(&u - &change * length)).norm() > r.norm() {
            length *= 0.5;
        }
        u -= &change * length;
        if change.norm() < 1e-13 * (1.0 + u.norm()) {
            break;
        }
    }
    assert!(residual(&u).norm() < 1e-9 * (1.0 + b.norm() * h), "the step was not solved");
    arm.advance(state, u.as_slice(), (t, h), &forces, work);
    forces.into_iter().map(|force| (force, force.force(u[force.dof]))).collect()
}
