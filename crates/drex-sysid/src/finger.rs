//! A compliant fingertip as the simulator sees it: a sphere on three slides, each with a position servo.
//!
//! On each axis (m + armature) q̈ = kp (command − home − q) − (kv + damping) q̇ − f, gravity compensated, with the force f of
//! the contact found by the simulator. Since the slides only translate, tip mass and armature act alike: the links are
//! massless and the whole of it is armature, which gravity does not see.

use std::sync::Arc;

use drex_core::Pose;
use drex_core::push::{FingerImpedance, FingerPush};
use drex_diffsim::{ActuatorKind, Articulation, Base, Control, Scalar, SimError};
use drex_robot::Robot;
use nalgebra::Point3;

/// A fingertip and what it is told.
#[derive(Debug, Clone)]
pub(crate) struct Finger {
    arm: Articulation<f64>,
    pub control: Control,
    home: Point3<f64>,
    /// Joint coordinates at the start.
    start: [f64; 3],
    /// Times of the encoder, seconds; empty without one.
    pub encoder_times_s: Vec<f64>,
    /// Tip positions that it reads, world.
    pub encoder: Vec<Point3<f64>>,
    /// Friction that is stated for the tip.
    pub friction: f64,
}

/// Parameters of a finger, any scalar.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FingerValues<T> {
    pub friction: T,
    /// Factors on stiffness, damping and moving mass.
    pub factors: [T; 3],
    /// Dry friction per joint, newtons.
    pub joint_friction: T,
    /// Height above what is stated, metres.
    pub height: T,
}

impl Finger {
    /// # Errors
    /// If the impedance cannot be simulated or the commands are no series.
    pub(crate) fn new(push: &FingerPush) -> Result<Self, SimError> {
        let i = &push.impedance;
        let refused = |e: drex_robot::Error| SimError::NotFinite { what: format!("the impedance of the fingertip ({e})") };
        let robot = Arc::new(Robot::from_mjcf_str(&mjcf(i), None).map_err(refused)?);
        let mut arm = Articulation::new(robot, Base::Fixed(Pose::identity()))?.with_friction(i.friction);
        for link in &mut arm.links {
            link.mass_kg = 0.0;
            link.inertia.fill(0.0);
        }
        for joint in &mut arm.joints {
            joint.armature = i.armature_kg + i.mass_kg;
        }
        arm.check()?;
        let home = Point3::from(i.home_m);
        let rows = push.commands.iter().map(|c| (c - home).as_slice().to_vec()).collect();
        let control = Control::sampled(&push.command_times_s, rows)?;
        let (encoder_times_s, encoder) =
            push.encoder.as_ref().map_or((Vec::new(), Vec::new()), |e| (e.times_s.clone(), e.positions.clone()));
        let first = encoder.first().or(push.commands.first()).copied().unwrap_or(home);
        Ok(Self { arm, control, home, start: (first - home).into(), encoder_times_s, encoder, friction: i.friction })
    }

    /// The finger with the given parameters, and its joint coordinates at the start.
    pub(crate) fn arm<T: Scalar>(&self, values: &FingerValues<T>) -> (Articulation<T>, [T; 3]) {
        let mut arm = self.arm.lift::<T>().with_friction(values.friction);
        let [stiffness, damping, inertia] = values.factors;
        for joint in &mut arm.joints {
            joint.armature *= inertia;
            joint.damping *= damping;
            joint.friction_loss = values.joint_friction;
        }
        for actuator in &mut arm.actuators {
            if let ActuatorKind::Position { kp, kv } = &mut actuator.kind {
                *kp *= stiffness;
                *kv *= damping;
            }
        }
        let mut base = Pose::<T>::identity();
        base.translation.vector.z = values.height;
        arm.base = Base::Fixed(base);
        (arm, self.start.map(T::lift))
    }

    /// What the encoder should read at the joint coordinates `q`, less what it reads at sample `k`.
    pub(crate) fn misfit(&self, k: usize, q: &[f64]) -> [f64; 3] {
        [0, 1, 2].map(|i| self.encoder[k][i] - self.home[i] - q[i])
    }
}

/// Three slides from `home`, named for their axes.
fn mjcf(i: &FingerImpedance) -> String {
    let [x, y, z] = i.home_m;
    let axes = [("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1")];
    let joints: String = axes
        .iter()
        .map(|(n, axis)| {
            format!(r#"<joint name="{n}" type="slide" axis="{axis}" damping="{}" armature="{}"/>"#, i.damping_ns_m, i.armature_kg)
        })
        .collect();
    let drives: String = axes
        .iter()
        .map(|(n, _)| format!(r#"<position name="{n}" joint="{n}" kp="{}" kv="{}"/>"#, i.kp_n_m, i.kv_ns_m))
        .collect();
    format!(
        r#"<mujoco model="fingertip"><worldbody><body name="tip" pos="{x} {y} {z}">{joints}<geom type="sphere" size="{}" mass="{}"/></body></worldbody><actuator>{drives}</actuator></mujoco>"#,
        i.radius_m,
        i.mass_kg.max(1e-6),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use drex_diffsim::{Model, Scene, State, rollout};

    /// A finger that follows a step of its command alone is a damped oscillator: x = c (1 - e^(-at) (cos wt + a/w sin wt)).
    #[test]
    fn alone_it_is_a_damped_oscillator_that_gravity_does_not_see() {
        let impedance = FingerImpedance {
            radius_m: 0.01,
            mass_kg: 0.04,
            armature_kg: 0.02,
            damping_ns_m: 0.5,
            kp_n_m: 120.0,
            kv_ns_m: 2.3,
            friction: 0.6,
            home_m: [0.1, -0.2, 0.3],
        };
        let home = Point3::from(impedance.home_m);
        let push = FingerPush {
            command_times_s: vec![0.0, 0.05],
            commands: vec![home, home + nalgebra::Vector3::x() * 0.01],
            encoder: None,
            impedance,
        };
        let finger = Finger::new(&push).unwrap();
        let one = FingerValues { friction: 0.6, factors: [1.0; 3], joint_friction: 0.0, height: 0.0 };
        let (arm, q) = finger.arm(&one);
        let start = State::new(Vec::new(), vec![arm.at_rest(&q, 0.0).unwrap()]);
        let mut model = Model::<f64>::new(Vec::new()).with_arm(arm);
        model.dt_s = 5e-5;
        let mut scene = Scene::on_table(0.5);
        scene.controls.push(finger.control.clone());
        let record = rollout(&model, &scene, &start, &[0.05, 0.08, 0.12, 0.4]).unwrap();
        let (m, a) = (0.06, 2.8 / 0.12);
        let w = (120.0_f64 / m - a * a).sqrt();
        for (t, q) in record.times_s.iter().zip(&record.joints[0]) {
            let t = t - 0.05;
            let x = 0.01 * (1.0 - (-a * t).exp() * ((w * t).cos() + a / w * (w * t).sin()));
            assert!((q[0] - x).abs() < 2e-5 && q[1] == 0.0 && q[2].abs() < 1e-12, "{t}: {q:?} {x}");
        }
    }
}
