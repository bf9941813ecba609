//! One push ready to be simulated: what acts, what it stands on, what was observed.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use drex_core::trajectory::PoseNoise;
use drex_core::{Object, Pose};
use drex_diffsim::{
    AppliedForce, Body, Collider, ContactOptions, ForcePoint, Model, Part, Record, Scalar, Scene, State, StaticBody,
    rollout,
};
use drex_recording::{Drive, PushRecording, SupportBox};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;

use crate::finger::{Finger, FingerValues};
use crate::force::KnownForce;
use crate::heading::{turned, world_from_push};
use crate::parameters::{Expected, NUISANCES, Parameter, ParameterSet, SIMULATED};
use crate::{IdentifyOptions, Result, SysidError, start};

/// Spacing of the dense record that nuisances are solved on, seconds.
pub(crate) const DENSE_S: f64 = 4e-3;
/// The simulation goes on for this long after the last pose: the clock of the track may be late by as much.
const LATEST_S: f64 = 0.1;
/// Before a known force first acts, the object has this long to settle.
const SETTLE_S: f64 = 0.1;

/// What acts on the object.
#[derive(Debug, Clone)]
pub(crate) enum Action {
    Force(KnownForce),
    Finger(Box<Finger>),
    /// Nothing.
    Nothing,
}

/// Everything a simulation of a push depends on: coordinates of the simulated parameters, which may carry derivatives, errors of the
/// force in standard deviations, and noise on what drives the push (empty for none): on samples of a force, newtons, or of an encoder, metres.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Values<T> {
    pub named: [T; SIMULATED],
    pub errors: Vec<f64>,
    pub noise: Vec<Vector3<f64>>,
}

/// One entry of [`Values`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Slot {
    Named(Parameter),
    Error(usize),
}

/// A push ready to be simulated, in its own axes.
#[derive(Debug, Clone)]
pub(crate) struct Problem {
    pub name: String,
    pub world_from_push: UnitQuaternion<f64>,
    pub times_s: Vec<f64>,
    pub observed: Vec<Pose>,
    pub noise: PoseNoise,
    /// Per component of a pose: factor on its standard deviation, for what no simulation reproduces.
    pub excess: [f64; 6],
    /// Standard deviation of the encoder, metres.
    pub encoder_m: f64,
    pub start: Pose,
    pub start_velocity: Vector3<f64>,
    pub start_spin: Vector3<f64>,
    pub action: Action,
    /// What is stated of parameters; the options' word counts before the recording's.
    pub parameters: ParameterSet,
    /// What is expected of each error of the track.
    pub nuisances: [Expected; NUISANCES],
    pub contact: ContactOptions,
    /// How often it has been simulated.
    pub simulations: Arc<AtomicUsize>,
    gravity: Vector3<f64>,
    table_height_m: f64,
    boxes: Vec<SupportBox>,
    unit: drex_core::MassProperties,
    collider: Arc<Collider>,
}

impl Problem {
    pub(crate) fn new(
        recording: &PushRecording,
        object: &Object,
        collider: &Arc<Collider>,
        options: &IdentifyOptions,
        noise: PoseNoise,
    ) -> Result<Self> {
        let name = recording.name.clone();
        let mut parameters = options.parameters.or(&ParameterSet::of_recording(recording)?);
        let world_from_push = world_from_push(recording, &parameters);
        let recording = &turned(recording, &world_from_push.inverse())?;
        let first = recording.track.poses().first().ok_or_else(|| SysidError::Recording {
            push: name.clone(),
            what: "the track is empty".into(),
            remedy: "record again".into(),
        })?;
        let action = match &recording.drive {
            Drive::Force(profile) => Action::Force(KnownForce::new(profile)),
            Drive::Finger(push) => {
                let finger =
                    Finger::new(push).map_err(|source| SysidError::Simulation { push: name.clone(), source })?;
                Action::Finger(Box::new(finger))
            }
            _ => Action::Nothing,
        };
        let mut start = recording.initial_pose.unwrap_or(*first);
        let onset_s = match &action {
            Action::Force(force) => force.onset_s(),
            _ => start::onset_s(&recording.drive),
        };
        if recording.initial_pose.is_none()
            && recording.starts_at_rest
            && let Some(onset_s) = onset_s
            && let Some(found) = start::at_rest(recording, onset_s, object)
        {
            start = found;
            let place = matches!(action, Action::Finger(_)) || !recording.support.boxes.is_empty();
            parameters = parameters.or(&ParameterSet::of_unknown_start(place));
        }
        // A start that nobody states is as unsure as its track, however good the mesh.
        parameters = parameters.or(&ParameterSet::of_mesh(recording));
        Ok(Self {
            name,
            world_from_push,
            times_s: recording.track.times_s().to_vec(),
            observed: recording.track.poses().to_vec(),
            noise,
            excess: [1.0; 6],
            encoder_m: options.encoder_m,
            start,
            start_velocity: Vector3::zeros(),
            start_spin: Vector3::zeros(),
            action,
            nuisances: parameters.nuisances(),
            parameters,
            contact: options.contact,
            simulations: Arc::default(),
            gravity: recording.gravity,
            table_height_m: recording.support.table_height_m,
            boxes: recording.support.boxes.clone(),
            unit: object.mass_properties.with_mass(1.0),
            collider: Arc::clone(collider),
        })
    }

    /// Errors of the force that are estimated.
    pub(crate) fn errors(&self) -> usize {
        match &self.action {
            Action::Force(force) => force.errors.len(),
            _ => 0,
        }
    }

    /// Standard deviation of a factor on the whole force that its noise amounts to.
    pub(crate) fn factor_sd(&self) -> f64 {
        match &self.action {
            Action::Force(force) => force.factor_sd,
            _ => 0.0,
        }
    }

    /// Whether what drives the push has noise.
    pub(crate) fn is_driven_by_noise(&self) -> bool {
        match &self.action {
            Action::Force(force) => force.factor_sd > 0.0,
            Action::Finger(finger) => finger.has_noise(),
            Action::Nothing => false,
        }
    }

    /// As much noise as a known force, or what drives a finger, has already; empty if it has none.
    pub(crate) fn drive_noise(&self, sign: f64, random: &mut ChaCha8Rng) -> Vec<Vector3<f64>> {
        match &self.action {
            Action::Force(force) => force.noise(sign, random),
            Action::Finger(finger) => finger.noise(sign, random),
            _ => Vec::new(),
        }
    }

    /// Readings of the encoder.
    pub(crate) fn readings(&self) -> usize {
        match &self.action {
            Action::Finger(finger) => finger.encoder_times_s.len(),
            _ => 0,
        }
    }

    /// Whether something acts whose size does not scale with the mass.
    pub(crate) fn can_weigh(&self) -> bool {
        !matches!(self.action, Action::Nothing)
    }

    pub(crate) fn has_finger(&self) -> bool {
        matches!(self.action, Action::Finger(_))
    }

    /// Centre of mass in the mesh frame.
    pub(crate) fn center_of_mass(&self) -> Point3<f64> {
        self.unit.center_of_mass
    }

    /// The parameters as stated, with a mass and a friction.
    pub(crate) fn stated(&self, mass_kg: f64, friction: f64) -> Values<f64> {
        let mut named = Parameter::ALL.map(|p| p.to_coordinate(p.nominal()));
        named[Parameter::Mass as usize] = mass_kg.ln();
        named[Parameter::Friction as usize] = friction.ln();
        if let Action::Finger(finger) = &self.action {
            named[Parameter::FingerFriction as usize] = finger.friction.max(1e-6).ln();
        }
        let mut out = Values { named: [0.0; SIMULATED], errors: vec![0.0; self.errors()], noise: Vec::new() };
        out.named.copy_from_slice(&named[..SIMULATED]);
        out
    }

    /// The scene and model of the simulator.
    fn build<T: Scalar>(&self, values: &Values<T>, dt_s: f64) -> Result<(Model<T>, Scene<T>, State<T>)> {
        let wrap = |source| self.failed(source);
        let at = |p: Parameter| values.named[p as usize];
        let factor = |p: Parameter| at(p).exp();
        let friction = factor(Parameter::Friction);

        let mut body = Body::new(&self.unit, factor(Parameter::Mass), Arc::clone(&self.collider));
        body.center_of_mass.coords +=
            Vector3::new(at(Parameter::CenterX), at(Parameter::CenterY), at(Parameter::CenterZ));
        let roots = [Parameter::InertiaX, Parameter::InertiaY, Parameter::InertiaZ].map(|p| at(p).scaled(0.5).exp());
        for (i, root) in roots.iter().enumerate() {
            for k in 0..3 {
                body.unit_inertia[(i, k)] *= *root;
                body.unit_inertia[(k, i)] *= *root;
            }
        }
        body.material.friction = friction;
        let mut model = Model::new(vec![body]);
        model.contact = self.contact.lift();
        model.contact.frequency_rad_s *= at(Parameter::ContactStiffness).scaled(0.5).exp();
        model.contact.relaxation_s *= factor(Parameter::ContactDamping);
        model.dt_s = dt_s;

        let mut scene = Scene::empty();
        scene.gravity = self.gravity.map(T::lift);
        scene.static_bodies.push(StaticBody::table(self.table_height_m, friction));
        for b in &self.boxes {
            scene.static_bodies.push(StaticBody::cuboid(b.center_m.into(), b.half_m.into(), friction).map_err(wrap)?);
        }
        let mut arms = Vec::new();
        match &self.action {
            Action::Force(force) => self.apply(force, values, &mut scene).map_err(wrap)?,
            Action::Finger(finger) => {
                let (arm, q) = finger.arm(
                    &FingerValues {
                        friction: factor(Parameter::FingerFriction),
                        factors: [
                            factor(Parameter::ActuatorStiffness),
                            factor(Parameter::ActuatorDamping),
                            factor(Parameter::FingerInertia),
                        ],
                        joint_friction: at(Parameter::JointFriction),
                        height: at(Parameter::ContactHeight),
                    },
                    dt_s,
                );
                arms.push(arm.at_rest(&q, 0.0).map_err(wrap)?);
                scene.controls.push(finger.control_with(&values.noise).map_err(wrap)?);
                model.articulations.push(arm);
            }
            Action::Nothing => {}
        }
        let mut state = State::at_rest(self.start_pose(&at));
        state.articulations = arms;
        state.time_s = self.begin_s();
        state.bodies[0].velocity = self.start_velocity.map(T::lift);
        state.bodies[0].angular_velocity = self.start_spin.map(T::lift);
        Ok((model, scene, state))
    }

    /// The recorded force, its errors, and the moment of its height error.
    fn apply<T: Scalar>(
        &self,
        force: &KnownForce,
        values: &Values<T>,
        scene: &mut Scene<T>,
    ) -> Result<(), drex_diffsim::Error> {
        let on = Part::Body(0);
        let gain = values.named[Parameter::ForceGain as usize].exp();
        let mut put = |samples: &[Vector3<f64>], point: ForcePoint, gain: T| {
            let mut f = AppliedForce::new(on, &force.times_s, samples, point)?;
            f.gain = gain;
            scene.forces.push(f);
            Ok(())
        };
        put(&force.with(&values.errors, &values.noise), ForcePoint::Body(force.point), gain)?;
        if !force.torques_nm.is_empty() {
            put(&force.torques_nm, ForcePoint::Couple, gain)?;
        }
        let height = values.named[Parameter::ContactHeight as usize];
        // One that is zero and carries no derivative does nothing.
        if height.value() != 0.0 || (0..T::TANGENTS).any(|i| height.tangent(i) != 0.0) {
            let moments: Vec<_> = force.forces_n.iter().map(|f| Vector3::z().cross(f)).collect();
            put(&moments, ForcePoint::Couple, gain * height)?;
        }
        Ok(())
    }

    fn start_pose<T: Scalar>(&self, at: &impl Fn(Parameter) -> T) -> Pose<T> {
        let (x, q) = (self.start.translation.vector.map(T::lift), self.start.rotation.quaternion());
        let rotation = nalgebra::Quaternion::new(T::lift(q.w), T::lift(q.i), T::lift(q.j), T::lift(q.k));
        let half = at(Parameter::StartYaw).scaled(0.5);
        let yaw = nalgebra::Quaternion::new(half.cos(), T::zero(), T::zero(), half.sin());
        let shift = Vector3::new(at(Parameter::StartX), at(Parameter::StartY), at(Parameter::StartZ));
        Pose::from_parts((x + shift).into(), UnitQuaternion::new_unchecked(yaw * rotation))
    }

    /// When the simulation begins: at the start, or shortly before a known force first acts on an object at rest.
    pub(crate) fn begin_s(&self) -> f64 {
        let resting = self.start_velocity == Vector3::zeros() && self.start_spin == Vector3::zeros();
        match &self.action {
            Action::Force(force) if resting => force.onset_s().map_or(0.0, |t| (t - SETTLE_S).max(0.0)),
            _ => 0.0,
        }
    }

    /// Steps through the push and records it at `times_s`.
    pub(crate) fn run<T: Scalar>(&self, values: &Values<T>, dt_s: f64, times_s: &[f64]) -> Result<Record<T>> {
        let (model, scene, state) = self.build(values, dt_s)?;
        self.simulations.fetch_add(1, Ordering::Relaxed);
        rollout(&model, &scene, &state, times_s).map_err(|source| self.failed(source))
    }

    /// The motion at `values`, densely recorded from the start to beyond the last pose.
    pub(crate) fn simulate(&self, values: &Values<f64>, dt_s: f64) -> Result<Motion> {
        let begin = self.begin_s();
        let end = self.times_s.last().copied().unwrap_or(0.0) - self.nuisances[0].mean + LATEST_S;
        let count = ((end - begin).max(0.0) / DENSE_S).ceil() as usize + 1;
        let dense: Vec<f64> = (0..=count).map(|k| begin + k as f64 * DENSE_S).collect();
        let schedule = Schedule::new(&dense, self.encoder_times_s());
        let record = self.run(values, dt_s, &schedule.times_s)?;
        let body = &record.bodies[0];
        let pick = |k: &usize| (body.poses[*k], body.velocities[*k], body.angular_velocities[*k]);
        let samples = schedule.first.iter().map(pick).collect();
        let joints = record.joints.first();
        let tips = schedule.second.iter().filter_map(|&k| joints.and_then(|j| j.get(k)?.first().copied())).collect();
        Ok(Motion { begin_s: begin, samples, tips, unconverged_steps: record.unconverged_steps })
    }

    pub(crate) fn encoder_times_s(&self) -> &[f64] {
        match &self.action {
            Action::Finger(finger) => &finger.encoder_times_s,
            _ => &[],
        }
    }

    fn failed(&self, source: drex_diffsim::Error) -> SysidError {
        SysidError::Simulation { push: self.name.clone(), source }
    }
}

impl Values<f64> {
    pub(crate) fn set(&mut self, slot: Slot, value: f64) {
        match slot {
            Slot::Named(p) => self.named[p as usize] = value,
            Slot::Error(k) => self.errors[k] = value,
        }
    }

    pub(crate) fn lift<T: Scalar>(&self) -> Values<T> {
        Values { named: self.named.map(T::lift), errors: self.errors.clone(), noise: self.noise.clone() }
    }
}

/// Two increasing lists of times as one, and where the entries of each are in it.
pub(crate) struct Schedule {
    pub times_s: Vec<f64>,
    pub first: Vec<usize>,
    pub second: Vec<usize>,
}

impl Schedule {
    pub(crate) fn new(a: &[f64], b: &[f64]) -> Self {
        let mut out = Self { times_s: Vec::new(), first: Vec::new(), second: Vec::new() };
        let (mut i, mut j) = (0, 0);
        while i < a.len() || j < b.len() {
            let k = out.times_s.len();
            if j == b.len() || (i < a.len() && a[i] <= b[j]) {
                out.times_s.push(a[i]);
                out.first.push(k);
                i += 1;
            } else {
                out.times_s.push(b[j]);
                out.second.push(k);
                j += 1;
            }
        }
        out
    }
}

/// A simulated motion.
pub(crate) struct Motion {
    begin_s: f64,
    /// Pose, velocity of the origin in the world, angular velocity in the world, [`DENSE_S`] apart.
    samples: Vec<(Pose, Vector3<f64>, Vector3<f64>)>,
    /// The finger along the push at the times of its encoder, metres.
    pub tips: Vec<f64>,
    /// Steps that the simulator did not solve to full precision.
    pub unconverged_steps: usize,
}

impl Motion {
    /// The pose at time t; the first and the last pose hold before and after.
    pub(crate) fn at(&self, t: f64) -> Pose {
        let (k, s) = self.place(t);
        match (self.samples.get(k), self.samples.get(k + 1)) {
            (Some(a), Some(b)) => drex_core::pose::interpolate(&a.0, &b.0, s),
            (a, _) => a.or(self.samples.last()).map_or_else(Pose::identity, |s| s.0),
        }
    }

    /// Velocity of the frame's origin in the world and angular velocity in the body's frame at time t.
    pub(crate) fn velocity_at(&self, t: f64) -> (Vector3<f64>, Vector3<f64>) {
        if t < self.begin_s {
            return (Vector3::zeros(), Vector3::zeros());
        }
        let (k, _) = self.place(t);
        let Some((pose, v, w)) = self.samples.get(k + 1).or(self.samples.last()) else {
            return (Vector3::zeros(), Vector3::zeros());
        };
        (*v, pose.rotation.inverse() * w)
    }

    fn place(&self, t: f64) -> (usize, f64) {
        let x = ((t - self.begin_s) / DENSE_S).max(0.0);
        let k = x.floor();
        (k as usize, x - k)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mesh_adds_what_nobody_states_and_pins_no_unknown_start() {
        let corner = |k: i32| Point3::from([1, 2, 4].map(|bit| if k & bit == 0 { -0.02 } else { 0.02 }));
        let hull = drex_core::mesh::convex_hull(&(0..8).map(corner).collect::<Vec<_>>()).unwrap();
        let properties = hull.mass_properties(1000.0).unwrap();
        let object = Object::of_parts(vec![drex_core::ConvexPart::of_hull(hull)], properties);
        let collider = crate::object::collider(&object).unwrap();
        let track =
            drex_core::Trajectory::from_samples(&[0.0, 0.1, 0.2], &[Pose::translation(0.0, 0.0, 0.05); 3]).unwrap();
        let force = drex_recording::ForceProfile {
            times_s: vec![0.0, 0.2],
            forces_n: vec![Vector3::zeros(), Vector3::x()],
            torques_nm: Vec::new(),
            point_in_object: Point3::origin(),
        };
        let mut push = PushRecording::new("push", "mesh.obj", track, Drive::Force(force));
        push.support.boxes.push(SupportBox { center_m: [0.0, 0.0, 0.015], half_m: [0.1, 0.1, 0.015] });
        push.starts_at_rest = true;
        push.mesh_sd_m = Some(0.002);
        push.parameters.insert("center_z".into(), drex_recording::StatedParameter::Value(0.001));
        let known = |push: &PushRecording, p: Parameter| {
            let noise = PoseNoise { position_m: 1e-3, rotation_rad: 0.01 };
            Problem::new(push, &object, &collider, &IdentifyOptions::default(), noise).unwrap().parameters.get(p)
        };
        let within = |sd: f64| Some(crate::Knowledge::Prior { mean: 0.0, sd });
        assert_eq!(known(&push, Parameter::CenterX), within(0.002));
        assert_eq!(known(&push, Parameter::CenterZ), Some(crate::Knowledge::Fixed(0.001)));
        assert_eq!(known(&push, Parameter::StartX), within(0.01));
        push.initial_pose = push.track.poses().first().copied();
        assert_eq!(known(&push, Parameter::StartX), within(0.002));
        push.mesh_sd_m = Some(0.0);
        assert_eq!(known(&push, Parameter::StartX), None);
    }

    #[test]
    fn two_lists_of_times_become_one() {
        let (a, b) = ([0.0, 0.2, 0.4], [0.1, 0.2, 0.5, 0.6]);
        let s = Schedule::new(&a, &b);
        assert_eq!(s.times_s, [0.0, 0.1, 0.2, 0.2, 0.4, 0.5, 0.6]);
        assert!(s.first.iter().zip(a).all(|(k, t)| s.times_s[*k] == t));
        assert!(s.second.iter().zip(b).all(|(k, t)| s.times_s[*k] == t));
    }
}
