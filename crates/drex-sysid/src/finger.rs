//! A compliant fingertip as the simulator sees it: a sphere on three slides, the first of them along the push.
//!
//! On each slide (m + armature) q̈ = kp (command − q) − (kv + damping) q̇ − f, gravity compensated. Along the push the force f of
//! the contact is found by the simulator, and the encoder's reading of q is an observation. Across the push the tip sticks and
//! slips on the object's face, which no simulator predicts, but the encoder tells the force: there the servo is replaced
//! by what it exerted, kp (command − q) − (kv + damping) q̇ with the q that was read, and a weak pull to that q, since a tip on a
//! round face that nothing holds runs off. Until it touches, the q of its motion alone takes the place of the one that was read, whose
//! noise would be a force. Without an encoder all slides are simulated.
//!
//! Since the slides only translate, tip mass and armature act alike: the links are massless and the whole of it is armature,
//! which gravity does not see.

use std::sync::Arc;

use drex_core::Pose;
use drex_diffsim::{
    ActuatorKind, Articulation, Base, Control, Error as SimulationError, Model, Scalar, Scene, State, rollout,
};
use drex_recording::{FingerImpedance, FingerPush};
use drex_robot::Robot;
use nalgebra::{Matrix3, Point3, Vector3};
use rand_chacha::ChaCha8Rng;

use crate::noise;

/// Pull across the push to where the tip was read, as a share of its servo.
const PULL: f64 = 0.1;
/// A reading this far from where the tip would be alone has touched the object, and one this near has not yet, metres: five and two
/// standard deviations of a usual encoder.
const TOUCHES_M: f64 = 5e-4;
const NOISE_M: f64 = 2e-4;
/// Noise of an encoder below which there is none, metres: simulators of a tip that touches nothing differ by less.
const SILENT_M: f64 = 1e-5;

/// A fingertip and what it is told.
#[derive(Debug, Clone)]
pub(crate) struct Finger {
    arm: Articulation<f64>,
    pub control: Control,
    /// Joint coordinates at the start.
    start: [f64; 3],
    /// Times of the encoder, seconds; empty without one.
    pub encoder_times_s: Vec<f64>,
    /// What it reads along the push.
    pub encoder: Vec<f64>,
    /// Friction that is stated for the tip.
    pub friction: f64,
    reading: Option<Reading>,
}

/// What the encoder read, along and across the push.
#[derive(Debug, Clone)]
struct Reading {
    positions: Vec<Vector3<f64>>,
    velocities: Vec<Vector3<f64>>,
    commands: Vec<Vector3<f64>>,
    impedance: FingerImpedance,
    /// The first sample at which the tip may touch something.
    touch: usize,
    /// Standard deviation of white noise on the positions, metres; zero where nothing tells.
    noise_m: f64,
}

impl Reading {
    /// What was read before the tip touched anything is put onto the motion that it makes alone (`free`, where it is at `times_s`), shifted
    /// by the mean of what lies between them: noise of the encoder would count as a force there and let the tip wander before it touches.
    fn steadied_by(mut self, free: &[Vector3<f64>], times_s: &[f64]) -> Self {
        let mut sum = Vector3::zeros();
        let mut strays = Vec::with_capacity(free.len());
        for (k, (read, free)) in self.positions.iter().zip(free).enumerate() {
            sum += read - free;
            strays.push((read - free - sum / (k + 1) as f64).norm());
        }
        let sure = strays.iter().take_while(|d| **d < TOUCHES_M).count();
        let alone = strays[..sure].iter().rposition(|d| *d < NOISE_M).unwrap_or(0);
        if alone < 2 {
            return self;
        }
        let mut mean = (0..alone).map(|k| self.positions[k] - free[k]).sum::<Vector3<f64>>() / alone as f64;
        mean.x = 0.0;
        self.touch = alone;
        let squares = (0..alone).map(|k| (self.positions[k] - free[k] - mean).yz().norm_squared()).sum::<f64>();
        self.noise_m = Some((squares / (2 * (alone - 1)) as f64).sqrt()).filter(|sd| *sd > SILENT_M).unwrap_or(0.0);
        // What is read across the push beside the command while nothing touches is no force.
        self.commands[..alone].iter_mut().for_each(|c| *c += mean);
        for k in 0..alone {
            let (before, after) = (k.saturating_sub(1), (k + 1).min(alone - 1));
            self.positions[k] = free[k] + mean;
            self.velocities[k] = (free[after] - free[before]) / (times_s[after] - times_s[before]);
        }
        self
    }
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
    pub(crate) fn new(push: &FingerPush) -> Result<Self, SimulationError> {
        let i = &push.impedance;
        let refused =
            |e: drex_robot::Error| SimulationError::NotFinite { what: format!("the impedance of the fingertip ({e})") };
        let axes = axes(&push.commands);
        let robot = Arc::new(Robot::from_mjcf_str(&mjcf(i, &axes), None).map_err(refused)?);
        let mut arm = Articulation::new(robot, Base::Fixed(Pose::identity()))?.with_friction(i.friction);
        for link in &mut arm.links {
            link.mass_kg = 0.0;
            link.inertia.fill(0.0);
        }
        for joint in &mut arm.joints {
            joint.armature = i.armature_kg + i.mass_kg;
        }
        let home = Point3::from(i.home_m);
        let along = |p: &Point3<f64>| axes.transpose() * (p - home);
        let commands: Vec<Vector3<f64>> = push.commands.iter().map(along).collect();
        let mut out = Self {
            control: Control::sampled(&push.command_times_s, commands.iter().map(|c| c.as_slice().to_vec()).collect())?,
            arm,
            start: commands.first().copied().unwrap_or_default().into(),
            encoder_times_s: Vec::new(),
            encoder: Vec::new(),
            friction: i.friction,
            reading: None,
        };
        if let Some(encoder) = push.encoder.as_ref().filter(|e| e.times_s.len() > 1) {
            let reading = Reading {
                positions: encoder.positions.iter().map(along).collect(),
                velocities: encoder.velocities.iter().map(|v| axes.transpose() * v).collect(),
                commands: encoder.times_s.iter().map(|t| Vector3::from_column_slice(out.control.at(*t))).collect(),
                impedance: *i,
                touch: 0,
                noise_m: 0.0,
            };
            out.encoder_times_s.clone_from(&encoder.times_s);
            out.encoder = reading.positions.iter().map(|q| q.x).collect();
            let reading = reading.steadied_by(&out.free(&encoder.times_s)?, &encoder.times_s);
            out.start = [out.encoder[0], reading.positions[0].y, reading.positions[0].z];
            out.reading = Some(reading);
            for axis in [1, 2] {
                out.arm.joints[axis].damping = 0.0;
            }
            out.pull_across(PULL)?;
        }
        out.arm.check()?;
        Ok(out)
    }

    /// Where the tip is at the given times if it touches nothing and its start was at rest, in joint coordinates.
    fn free(&self, times_s: &[f64]) -> Result<Vec<Vector3<f64>>, SimulationError> {
        let stated = FingerValues { friction: self.friction, factors: [1.0; 3], joint_friction: 0.0, height: 0.0 };
        let mut model = Model::<f64>::new(Vec::new());
        let (arm, q) = self.arm(&stated, model.dt_s);
        let start = State::new(Vec::new(), vec![arm.at_rest(&q, 0.0)?]);
        model = model.with_articulation(arm);
        let mut scene = Scene::empty();
        scene.controls.push(self.control.clone());
        let record = rollout(&model, &scene, &start, times_s)?;
        Ok(record.joints[0].iter().map(|q| Vector3::from_column_slice(q)).collect())
    }

    /// Replaces the servos across the push by the force that they exerted, plus a pull of `share` times the servo to where
    /// the tip was read. Nothing happens without an encoder.
    fn pull_across(&mut self, share: f64) -> Result<(), SimulationError> {
        let Some(reading) = &self.reading else { return Ok(()) };
        let (kp, kv) = (share * reading.impedance.kp_n_m, share * reading.impedance.kv_ns_m);
        for axis in [1, 2] {
            self.arm.actuators[axis].kind = ActuatorKind::Position { kp, kv };
        }
        self.control = self.driven_by(reading)?;
        Ok(())
    }

    /// What drives the tip, with `noise` (metres) on the readings, if there is any, and with that of differences on their velocities.
    pub(crate) fn control_with(&self, noise: &[Vector3<f64>]) -> Result<Control, SimulationError> {
        let Some(reading) = self.reading.as_ref().filter(|_| !noise.is_empty()) else {
            return Ok(self.control.clone());
        };
        let (mut reading, times_s) = (reading.clone(), &self.encoder_times_s);
        for k in 0..noise.len() {
            let (before, after) = (k.saturating_sub(1), (k + 1).min(noise.len() - 1));
            reading.positions[k] += noise[k];
            reading.velocities[k] += (noise[after] - noise[before]) / (times_s[after] - times_s[before]);
        }
        self.driven_by(&reading)
    }

    /// The commands of servos across the push that are pulled to readings.
    fn driven_by(&self, reading: &Reading) -> Result<Control, SimulationError> {
        let Reading { positions, velocities, commands, impedance: i, .. } = reading;
        let ActuatorKind::Position { kp, kv } = self.arm.actuators[1].kind else { return Ok(self.control.clone()) };
        let rows = (0..positions.len()).map(|k| {
            let next = (k + 1).min(positions.len() - 1);
            let (q, v) = ((positions[k] + positions[next]) * 0.5, (velocities[k] + velocities[next]) * 0.5);
            let across = |axis: usize| {
                let force = i.kp_n_m * (commands[k][axis] - q[axis]) - (i.kv_ns_m + i.damping_ns_m) * v[axis];
                q[axis] + (force + kv * v[axis]) / kp
            };
            vec![commands[k].x, across(1), across(2)]
        });
        Control::sampled(&self.encoder_times_s, rows.collect())
    }

    /// As much noise as the readings have from the touch on, across the push; empty if they have none.
    pub(crate) fn noise(&self, sign: f64, random: &mut ChaCha8Rng) -> Vec<Vector3<f64>> {
        let Some(reading) = self.reading.as_ref().filter(|r| r.noise_m > 0.0) else { return Vec::new() };
        let mut one = || sign * reading.noise_m * noise::normal(random);
        let drawn = |k: usize| if k < reading.touch { Vector3::zeros() } else { Vector3::new(0.0, one(), one()) };
        (0..reading.positions.len()).map(drawn).collect()
    }

    /// Whether the readings that drive the tip have noise.
    pub(crate) fn has_noise(&self) -> bool {
        self.reading.as_ref().is_some_and(|r| r.noise_m > 0.0)
    }

    /// The finger with the given parameters for steps of `dt_s`, and its joint coordinates at the start.
    ///
    /// The simulator takes the servo at the end of a step, which damps its spring by kp · dt; the servo's own damping is
    /// reduced by as much.
    pub(crate) fn arm<T: Scalar>(&self, values: &FingerValues<T>, dt_s: f64) -> (Articulation<T>, [T; 3]) {
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
                let added = kp.scaled(dt_s);
                *kv = if kv.value() > added.value() { *kv - added } else { T::zero() };
            }
        }
        let mut base = Pose::<T>::identity();
        base.translation.vector.z = values.height;
        arm.base = Base::Fixed(base);
        (arm, self.start.map(T::lift))
    }
}

/// Columns: the direction in which the command leads farthest from its start, and two across.
pub(crate) fn axes(commands: &[Point3<f64>]) -> Matrix3<f64> {
    let first = commands.first().copied().unwrap_or_default();
    let way = |p: &Point3<f64>| p - first;
    let farthest = commands.iter().map(way).max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()));
    let push = farthest.and_then(|w| w.try_normalize(1e-9)).unwrap_or_else(Vector3::x);
    let other = if push.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
    let side = other.cross(&push).normalize();
    Matrix3::from_columns(&[push, side, push.cross(&side)])
}

/// Three slides from the tip's home along the columns of `axes`.
fn mjcf(i: &FingerImpedance, axes: &Matrix3<f64>) -> String {
    let [x, y, z] = i.home_m;
    let joints: String = axes
        .column_iter()
        .enumerate()
        .map(|(n, a)| {
            format!(
                r#"<joint name="{n}" type="slide" axis="{} {} {}" damping="{}" armature="{}"/>"#,
                a.x, a.y, a.z, i.damping_ns_m, i.armature_kg
            )
        })
        .collect();
    let drives: String =
        (0..3).map(|n| format!(r#"<position name="{n}" joint="{n}" kp="{}" kv="{}"/>"#, i.kp_n_m, i.kv_ns_m)).collect();
    format!(
        r#"<mujoco model="fingertip"><worldbody><body name="tip" pos="{x} {y} {z}">{joints}<geom type="sphere" size="{}" mass="{}"/></body></worldbody><actuator>{drives}</actuator></mujoco>"#,
        i.radius_m,
        i.mass_kg.max(1e-6),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use drex_recording::EncoderTrack;
    use rand::SeedableRng;

    use crate::noise::normal;

    fn impedance(home_m: [f64; 3]) -> FingerImpedance {
        FingerImpedance {
            radius_m: 0.01,
            mass_kg: 0.04,
            armature_kg: 0.02,
            damping_ns_m: 0.5,
            kp_n_m: 120.0,
            kv_ns_m: 2.3,
            friction: 0.6,
            home_m,
        }
    }

    /// The servos across the push exert where the tip was read what they exerted in the push.
    #[test]
    fn what_is_pulled_across_exerts_the_same_force() {
        let home = Point3::origin();
        let impedance = impedance([0.0; 3]);
        let times: Vec<f64> = (0..40).map(|k| 0.01 * f64::from(k)).collect();
        let speed = nalgebra::Vector3::new(0.1, 0.02, -0.01);
        let push = FingerPush {
            command_times_s: times.clone(),
            commands: times.iter().map(|t| home + nalgebra::Vector3::new(0.1 * t, 0.01, 0.002)).collect(),
            encoder: Some(EncoderTrack {
                times_s: times.clone(),
                positions: times.iter().map(|t| home + speed * *t).collect(),
                velocities: vec![speed; times.len()],
            }),
            impedance,
        };
        let mut finger = Finger::new(&push).unwrap();
        let share = 0.3;
        finger.pull_across(share).unwrap();
        let Reading { positions, velocities, commands, .. } = finger.reading.as_ref().unwrap();
        for axis in [1, 2] {
            let ActuatorKind::Position { kp, kv } = finger.arm.actuators[axis].kind else { panic!("no servo") };
            assert!((kp / 120.0 - share).abs() < 1e-12 && (kv / 2.3 - share).abs() < 1e-12, "{kp} {kv}");
            for k in 0..39 {
                let (q, v) = ((positions[k][axis] + positions[k + 1][axis]) / 2.0, velocities[k][axis]);
                let before = 120.0 * (commands[k][axis] - q) - (2.3 + 0.5) * v;
                let after = kp * (finger.control.at(times[k])[axis] - q) - kv * v;
                assert!((before - after).abs() < 1e-9, "axis {axis}, sample {k}: {before} {after}");
            }
        }
    }

    /// What an encoder's noise would exert before the tip is about to touch something moves it nowhere.
    #[test]
    fn noise_of_the_encoder_does_not_lead_the_tip_astray() {
        let (home, ahead) = (Point3::origin(), 0.05);
        let times: Vec<f64> = (0..120).map(|k| 0.01 * f64::from(k)).collect();
        let mut push = FingerPush {
            command_times_s: times.clone(),
            commands: times.iter().map(|t| home + nalgebra::Vector3::x() * (0.1 * t)).collect(),
            encoder: None,
            impedance: impedance([0.0; 3]),
        };
        let free = Finger::new(&push).unwrap().free(&times).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let mut noisy = |x: f64| x + 1e-4 * normal(&mut random);
        // A wall stops it and leads it up.
        let read = |q: &Vector3<f64>| Vector3::new(q.x.min(ahead), q.y, 0.2 * (q.x - ahead).max(0.0)).map(&mut noisy);
        let positions: Vec<Point3<f64>> = free.iter().map(read).map(Point3::from).collect();
        let velocity = |k: usize| (positions[(k + 1).min(119)] - positions[k.saturating_sub(1)]) / 0.02;
        let velocities: Vec<_> = (0..120).map(velocity).collect();
        push.encoder = Some(EncoderTrack { times_s: times.clone(), positions: positions.clone(), velocities });
        let finger = Finger::new(&push).unwrap();
        let touch = free.iter().position(|q| q.x > ahead).unwrap();
        let went = finger.free(&times[..touch - 6]).unwrap();
        let astray = went.iter().map(|q| q.yz().norm()).fold(0.0, f64::max);
        assert!(astray < 5e-5, "{astray} m");
        // What was read is what is observed, and what was read after the touch still drives the tip.
        assert!(finger.encoder.iter().zip(&positions).all(|(q, p)| *q == p.x));
        let reading = finger.reading.as_ref().unwrap();
        let kept = &reading.positions[touch..];
        assert!(kept.iter().zip(&positions[touch..]).all(|(q, p)| *q == p.coords));
        // As much noise is drawn from then on; without noise none is.
        assert!((reading.noise_m / 1e-4 - 1.0).abs() < 0.3, "{}", reading.noise_m);
        let drawn = finger.noise(1.0, &mut random);
        let (before, after) = drawn.split_at(touch);
        assert!(
            before[..touch - 6].iter().all(|n| *n == Vector3::zeros())
                && after.iter().all(|n| n.x == 0.0 && n.y != 0.0)
        );
        push.encoder.as_mut().unwrap().positions = free.iter().copied().map(Point3::from).collect();
        let silent = Finger::new(&push).unwrap();
        assert!(!silent.has_noise() && silent.noise(1.0, &mut random).is_empty());
        // A tip that dry friction holds beside its command stays there, and that is no noise.
        let beside = Vector3::new(0.0, 3e-4, -2e-4);
        let encoder = push.encoder.as_mut().unwrap();
        encoder.positions = free.iter().map(|q| Point3::from(q + beside)).collect();
        encoder.velocities.fill(Vector3::x() * 0.1);
        let stuck = Finger::new(&push).unwrap();
        let went = stuck.free(&times).unwrap();
        let astray = went.iter().map(|q| (q - beside).yz().norm()).fold(0.0, f64::max);
        assert!(!stuck.has_noise() && astray < 5e-6, "{astray} m");
    }

    /// A finger that follows a step of its command alone is a damped oscillator: x = c (1 - e^(-at) (cos wt + a/w sin wt)).
    #[test]
    fn alone_it_is_a_damped_oscillator_that_gravity_does_not_see() {
        let impedance = impedance([0.1, -0.2, 0.3]);
        let home = Point3::from(impedance.home_m);
        let push = FingerPush {
            command_times_s: vec![0.0, 0.05],
            commands: vec![home, home + nalgebra::Vector3::x() * 0.01],
            encoder: None,
            impedance,
        };
        let finger = Finger::new(&push).unwrap();
        let one = FingerValues { friction: 0.6, factors: [1.0; 3], joint_friction: 0.0, height: 0.0 };
        let (arm, q) = finger.arm(&one, 5e-5);
        let start = State::new(Vec::new(), vec![arm.at_rest(&q, 0.0).unwrap()]);
        let mut model = Model::<f64>::new(Vec::new()).with_articulation(arm);
        model.dt_s = 5e-5;
        let mut scene = Scene::on_table(0.5);
        scene.controls.push(finger.control.clone());
        let record = rollout(&model, &scene, &start, &[0.05, 0.08, 0.12, 0.4]).unwrap();
        let (m, a) = (0.06, 2.8 / 0.12);
        let w = (120.0_f64 / m - a * a).sqrt();
        for (t, q) in record.times_s.iter().zip(&record.joints[0]) {
            let t = t - 0.05;
            let x = 0.01 * (1.0 - (-a * t).exp() * ((w * t).cos() + a / w * (w * t).sin()));
            assert!((q[0] - x).abs() < 2e-5 && q[1].abs() < 1e-12 && q[2].abs() < 1e-12, "{t}: {q:?} {x}");
        }
    }
}
