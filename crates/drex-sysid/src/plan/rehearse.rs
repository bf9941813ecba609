//! A planned push done in simulation: with feedback, until the object has moved enough.

use std::sync::Arc;

use drex_core::{Object, Pose, Trajectory};
use drex_diffsim::Collider;
use drex_recording::{Drive, EncoderTrack, FingerPush, ForceProfile, PushRecording, Support};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::{GuardedPush, PlanOptions, PushKind, RobotLimits};
use crate::noise::normal;
use crate::problem::{Problem, Schedule};
use crate::{IdentifyOptions, Result};

/// Spacing of forces, commands and readings, seconds.
const TICK_S: f64 = 0.01;
/// Rest before the push, seconds.
const REST_S: f64 = 0.2;
/// The recording goes on for this long after letting go, seconds.
const AFTER_S: f64 = 0.5;
/// No fingertip pushes for longer, seconds.
const LONGEST_S: f64 = 4.0;
/// A force at its limit is kept up for this long, seconds.
const AT_LIMIT_S: f64 = 0.3;
/// Gap between fingertip and object at the start, metres.
const GAP_M: f64 = 0.005;
/// A fingertip that tips holds for this long before it retreats, seconds.
const HOLD_S: f64 = 0.2;
/// How far a fall is recorded, radians from upright: the landing is chaos.
const FALLEN: f64 = 1.0;
/// Time over which a reading of the encoder's speed is taken, seconds.
const GLANCE_S: f64 = 1e-3;

/// Tells the noise of a force from that of the other sensors.
const FORCE_STREAM: u64 = 0x5bd1_e995;

/// What the rehearsals of all pushes share.
pub(super) struct Stage<'a> {
    pub object: &'a Object,
    pub collider: Arc<Collider>,
    pub support: &'a Support,
    pub robot: &'a RobotLimits,
    pub options: &'a PlanOptions,
    /// Time step, seconds.
    pub dt_s: f64,
}

/// A push that was done.
pub(super) struct Rehearsal {
    /// Without noise.
    pub recording: PushRecording,
    /// Whether the object moved as far as it was to.
    pub reached: bool,
    pub peak_force_n: f64,
    /// Largest angle between the object's up and the vertical, radians.
    pub tilt: f64,
    /// Farthest way of the centre of mass, metres.
    pub travel_m: f64,
    pub seconds: f64,
}

/// A simulated drive, looked at now and then.
struct Run {
    poses: Vec<Pose>,
    tilts: Vec<f64>,
    shifts: Vec<Vector3<f64>>,
    /// Coordinates of the fingertip along and across the push, at times of their own.
    tips: Vec<Vector3<f64>>,
}

impl Stage<'_> {
    /// Does the push with an object of `mass_kg`.
    pub(super) fn rehearse(&self, push: &GuardedPush, mass_kg: f64) -> Result<Rehearsal> {
        let open = self.drive(push, None)?;
        let (times, tips) = match &open {
            Drive::Force(f) => (f.times_s.clone(), false),
            Drive::Finger(f) => (f.command_times_s.clone(), true),
            _ => (vec![0.0], false),
        };
        let run = self.simulate(push, &open, mass_kg, &times, tips)?;
        let forces: Vec<f64> = match &open {
            Drive::Finger(f) => {
                let home = Point3::from(f.impedance.home_m);
                let along = |c: &Point3<f64>| (c - home).dot(&Vector3::from(push.direction));
                f.commands.iter().zip(&run.tips).map(|(c, q)| f.impedance.kp_n_m * (along(c) - q.x).abs()).collect()
            }
            Drive::Force(f) => f.forces_n.iter().map(Vector3::norm).collect(),
            _ => Vec::new(),
        };
        let limit = self.limit(push) * (1.0 + 1e-9);
        let allowed = forces.iter().position(|f| *f > limit).unwrap_or(forces.len());
        let goal = (0..allowed.min(run.tilts.len())).find(|&k| push.is_reached(run.tilts[k], &run.shifts[k]));
        let last = goal.map_or(allowed.saturating_sub(1), |k| k + (self.robot.reaction_s / TICK_S).ceil() as usize);
        let stop_s = times.get(last.min(times.len() - 1)).copied().unwrap_or(0.0);
        let largest = |x: &[f64]| x.iter().copied().fold(0.0, f64::max);
        let peak_force_n = largest(&forces[..forces.len().min(last + 1)]);

        let drive = self.drive(push, Some(stop_s))?;
        let count = ((stop_s + AFTER_S) * self.options.fps).floor() as usize;
        let mut frames: Vec<f64> = (0..=count).map(|k| k as f64 / self.options.fps).collect();
        let mut run = self.simulate(push, &drive, mass_kg, &frames, false)?;
        if push.kind == PushKind::Topple {
            let upright = run.tilts.iter().take_while(|t| **t < FALLEN).count();
            frames.truncate(upright);
            run.poses.truncate(upright);
        }
        let mut recording = self.recording(push, drive)?;
        recording.track = Trajectory::from_samples(&frames, &run.poses)?;
        self.read_encoder(&mut recording, push, mass_kg)?;
        Ok(Rehearsal {
            reached: goal.is_some(),
            peak_force_n,
            tilt: largest(&run.tilts[..frames.len()]),
            travel_m: run.shifts.iter().map(Vector3::norm).fold(0.0, f64::max),
            seconds: frames.last().copied().unwrap_or(0.0),
            recording,
        })
    }

    /// Largest force of what pushes, newtons.
    pub(super) fn limit(&self, push: &GuardedPush) -> f64 {
        match push.speed_m_s {
            None => self.robot.force.map_or(0.0, |f| f.max_n),
            Some(_) => self.robot.finger.map_or(0.0, |f| f.max_n),
        }
    }

    /// The friction that is simulated with.
    pub(super) fn friction(&self) -> f64 {
        self.support.friction.unwrap_or(self.options.friction)
    }

    /// How such a push is evaluated.
    pub(super) fn identify_options(&self) -> IdentifyOptions {
        let mut options = self.options.identify.clone();
        options.dt_s = self.dt_s;
        options.encoder_m = self.robot.finger.and_then(|f| f.encoder_m).unwrap_or(options.encoder_m);
        options
    }

    /// What acts, until `stop_s`, or as long as it may.
    fn drive(&self, push: &GuardedPush, stop_s: Option<f64>) -> Result<Drive> {
        let direction = Vector3::from(push.direction);
        if let (Some(speed), Some(finger)) = (push.speed_m_s, &self.robot.finger) {
            let home = push.touch()? - direction * (finger.radius_m + GAP_M);
            let longest = LONGEST_S.min(REST_S + finger.stroke_m / speed);
            let stop = stop_s.unwrap_or(longest);
            let retreat = if push.until_tilt_deg.is_some() { 1.5 * speed } else { 0.0 };
            let way = |t: f64| {
                let forth = (speed * (t.min(stop) - REST_S)).clamp(0.0, finger.stroke_m);
                (forth - retreat * (t - stop - HOLD_S).max(0.0)).max(0.0)
            };
            let times = ticks(stop + if stop_s.is_some() { AFTER_S } else { 0.0 });
            return Ok(Drive::Finger(FingerPush {
                commands: times.iter().map(|t| home + direction * way(*t)).collect(),
                command_times_s: times,
                encoder: None,
                impedance: finger.impedance(home.into()),
            }));
        }
        let (first, doubling) = (push.first_force_n.unwrap_or(0.0), push.doubling_s.unwrap_or(1.0));
        let limit = self.limit(push);
        let longest = REST_S + doubling * (limit / first).log2().max(0.0) + AT_LIMIT_S;
        let stop = stop_s.unwrap_or(longest);
        let size = |t: f64| match t {
            t if t < REST_S - 1e-9 || t > stop - 1e-9 => 0.0,
            t => (first * ((t - REST_S) / doubling).exp2()).min(limit),
        };
        let times = ticks(stop + if stop_s.is_some() { AFTER_S } else { 0.0 });
        let forces_n = times.iter().map(|t| direction * size(*t)).collect();
        Ok(Drive::Force(ForceProfile {
            times_s: times,
            forces_n,
            torques_nm: Vec::new(),
            point_in_object: push.point_in_object_m.into(),
        }))
    }

    fn recording(&self, push: &GuardedPush, drive: Drive) -> Result<PushRecording> {
        let start = push.start_pose()?;
        let mut out = PushRecording::new(push.name(), "", Trajectory::from_samples(&[0.0], &[start])?, drive);
        out.initial_pose = Some(start);
        out.starts_at_rest = true;
        out.noise = Some(self.options.noise);
        out.support = self.support.clone();
        Ok(out)
    }

    /// Simulates a drive and looks at the object at `times_s`, at the fingertip there too if `tips`.
    fn simulate(&self, push: &GuardedPush, drive: &Drive, mass_kg: f64, times_s: &[f64], tips: bool) -> Result<Run> {
        let recording = self.recording(push, drive.clone())?;
        let options = self.identify_options();
        let problem = Problem::new(&recording, self.object, &self.collider, &options, self.options.noise)?;
        let record = problem.run(&problem.stated(mass_kg, self.friction()), options.dt_s, times_s)?;
        let poses = record.bodies.into_iter().next().map(|b| b.poses).unwrap_or_default();
        let start = push.start_pose()?;
        let up = start.rotation.inverse() * Vector3::z();
        let center = problem.center_of_mass();
        let joints = record.joints.into_iter().next().filter(|_| tips).unwrap_or_default();
        Ok(Run {
            tilts: poses.iter().map(|p| (p.rotation * up).angle(&Vector3::z())).collect(),
            shifts: poses.iter().map(|p| p * center - start * center).collect(),
            tips: joints.iter().map(|q| Vector3::from_iterator(q.iter().copied().chain([0.0; 3]).take(3))).collect(),
            poses,
        })
    }

    /// What the encoder of the fingertip reads, if there is one.
    fn read_encoder(&self, recording: &mut PushRecording, push: &GuardedPush, mass_kg: f64) -> Result<()> {
        if self.robot.finger.is_none_or(|f| f.encoder_m.is_none()) {
            return Ok(());
        }
        let drive = recording.drive.clone();
        let Drive::Finger(finger) = &mut recording.drive else { return Ok(()) };
        let times_s = finger.command_times_s.clone();
        let later: Vec<f64> = times_s.iter().map(|t| t + GLANCE_S).collect();
        let both = Schedule::new(&times_s, &later);
        let run = self.simulate(push, &drive, mass_kg, &both.times_s, true)?;
        let axes = crate::finger::axes(&finger.commands);
        let home = Point3::from(finger.impedance.home_m);
        let tip = |k: &usize| home + axes * run.tips[*k];
        let positions: Vec<_> = both.first.iter().map(tip).collect();
        let velocities = both.second.iter().zip(&positions).map(|(k, p)| (tip(k) - p) / GLANCE_S).collect();
        finger.encoder = Some(EncoderTrack { times_s, positions, velocities });
        Ok(())
    }

    /// A recording as the sensors give it: noise on poses, force and encoder.
    pub(super) fn with_noise(&self, mut recording: PushRecording, seed: u64) -> Result<PushRecording> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut vector = |sd: f64| Vector3::from_fn(|_, _| sd * normal(&mut rng));
        let noise = self.options.noise;
        let shaken: Vec<Pose> = recording
            .track
            .poses()
            .iter()
            .map(|p| {
                let turn = UnitQuaternion::new(vector(noise.rotation_rad));
                Pose::from_parts((p.translation.vector + vector(noise.position_m)).into(), turn * p.rotation)
            })
            .collect();
        recording.track = Trajectory::from_samples(recording.track.times_s(), &shaken)?;
        if let Drive::Finger(f) = &mut recording.drive {
            let sd = self.robot.finger.and_then(|f| f.encoder_m).unwrap_or(0.0);
            f.encoder.iter_mut().flat_map(|e| &mut e.positions).for_each(|p| *p += vector(sd));
        }
        Ok(self.with_noisy_force(recording, seed))
    }

    /// The same with noise on a known force alone.
    pub(super) fn with_noisy_force(&self, mut recording: PushRecording, seed: u64) -> PushRecording {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ FORCE_STREAM);
        let sd = self.robot.force.map_or(0.0, |f| f.noise_n);
        if let Drive::Force(f) = &mut recording.drive {
            f.forces_n.iter_mut().for_each(|f| *f += Vector3::from_fn(|_, _| sd * normal(&mut rng)));
        }
        recording
    }
}

/// Times from zero to `end_s`, [`TICK_S`] apart.
fn ticks(end_s: f64) -> Vec<f64> {
    (0..=(end_s / TICK_S).round() as usize).map(|k| k as f64 * TICK_S).collect()
}
