//! Which push would weigh an object best, before anybody pushes it.
//!
//! Candidate pushes are simulated with masses over the range that is thought possible, and the expected 95 % interval of each
//! comes from the same slopes, nuisances and noise as the interval of a recorded push. Pushes are guarded: a force grows by a
//! constant factor per time, or a fingertip advances, until the object has moved by a small amount; so one push serves masses
//! far apart, and none is thrown over.
//!
//! Motion under a known force depends on force over mass alone (contact, friction and gravity scale with the mass), and
//! a force that grows by a constant factor meets every mass in the same way, only later. So a push by a known force is
//! simulated with one mass and scaled to the others; a fingertip has a stiffness and an inertia of its own and is simulated with each.

mod candidates;
mod rehearse;
mod robot;
mod standing;
mod words;
mod worth;

use std::sync::atomic::{AtomicUsize, Ordering};

use drex_core::pose::pose_from_wxyz;
use drex_core::trajectory::PoseNoise;
use drex_core::{Object, Pose};
use drex_recording::{PoseConfig, PushRecording, Support};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use self::rehearse::Stage;
pub use self::robot::{FingerLimits, ForceLimits, RobotLimits, tip_force_limit};
use self::standing::Standing;
use crate::object::collider;
use crate::{IdentifyOptions, Result, SysidError, Verdict};

/// Gravity, m/s².
const G: f64 = 9.81;

/// Options of [`plan_push`]. Build with `PlanOptions::default()` and change what differs.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PlanOptions {
    /// Masses at which a push is judged, evenly over the logarithm of the range.
    pub masses: usize,
    /// Up in the mesh frame while the object stands.
    pub up_in_mesh: Vector3<f64>,
    /// Friction to simulate with where the support does not state one. It is then unknown to the estimate.
    pub friction: f64,
    /// Noise of the tracker.
    pub noise: PoseNoise,
    /// Frames of the tracker per second.
    pub fps: f64,
    /// A push that leans the object farther than this is refused, radians.
    pub largest_tilt_rad: f64,
    /// Whether pushes that make the object fall over are tried too.
    pub topple: bool,
    /// Time step of the planner's simulations, seconds.
    pub dt_s: f64,
    /// How the push would be evaluated; `encoder_m` is taken from the finger.
    pub identify: IdentifyOptions,
}

impl Default for PlanOptions {
    fn default() -> Self {
        let identify = IdentifyOptions::default();
        Self {
            masses: 5,
            up_in_mesh: Vector3::z(),
            friction: 0.4,
            noise: PoseNoise { position_m: 2e-3, rotation_rad: 0.0175 },
            fps: 30.0,
            largest_tilt_rad: 0.35,
            topple: false,
            dt_s: identify.scan_dt_s,
            identify,
        }
    }
}

/// What a push does to the object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum PushKind {
    /// Pulls it up.
    Lift,
    /// Slides it.
    Slide,
    /// Leans it over its far edge by a few degrees.
    Tilt,
    /// Makes it fall over its far edge.
    Topple,
    /// Presses on an end that sticks out over an edge of the support.
    OverhangPress,
}

/// What pushes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum PushDrive {
    /// A known force.
    Force,
    /// A compliant fingertip.
    Finger,
}

/// A push that goes on until the object has moved enough.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct GuardedPush {
    /// What it does to the object.
    pub kind: PushKind,
    /// What pushes.
    pub drive: PushDrive,
    /// Direction of the push in the world.
    pub direction: [f64; 3],
    /// Where it touches, mesh frame, m.
    pub point_in_object_m: [f64; 3],
    /// Height of that point above what the object stands on, m.
    pub height_m: f64,
    /// Force over mass at which the object yields, by statics, N/kg.
    pub threshold_n_per_kg: f64,
    /// Force to begin with, N; of a known force.
    pub first_force_n: Option<f64>,
    /// Time in which the force doubles, s; of a known force.
    pub doubling_s: Option<f64>,
    /// Speed of the fingertip, m/s; of a fingertip, which starts a few millimetres off.
    pub speed_m_s: Option<f64>,
    /// Let go when the object leans this far, degrees.
    pub until_tilt_deg: Option<f64>,
    /// Let go when its centre of mass has moved this far, m.
    pub until_travel_m: Option<f64>,
    /// Pose of the mesh in the world at the start.
    pub start: PoseConfig,
}

/// One push, and what it would tell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct PlannedPush {
    /// The push in words, with its expected interval.
    pub text: String,
    /// Why it weighs, or does not.
    pub why: String,
    /// The verdict to expect at most of the masses.
    pub verdict: Verdict,
    /// Half the expected 95 % interval of the mass, relative (0.02: ± 2 %), averaged over the masses in the logarithm; a mass that
    /// the push does not weigh counts with the width of the range.
    pub half_width: f64,
    /// Why the push is not to be done at any mass of the range.
    pub refused: Option<String>,
    /// The push.
    pub push: GuardedPush,
    /// One per mass of the range.
    pub outcomes: Vec<PlannedOutcome>,
}

/// What a push does at one mass.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct PlannedOutcome {
    /// The mass, kg.
    pub mass_kg: f64,
    /// Largest force on the object (of the fingertip's spring), N.
    pub peak_force_n: f64,
    /// How far the object leans, degrees.
    pub tilt_deg: f64,
    /// How far its centre of mass moves, m.
    pub travel_m: f64,
    /// Duration of the recording, s.
    pub seconds: f64,
    /// Standard deviation of the logarithm of the mass that the interval would be made of.
    pub sd_log_mass: Option<f64>,
    /// The part of it that is noise: what repetitions of the push would scatter by.
    pub sd_noise: Option<f64>,
    /// Standard deviation of log(friction · mass), if friction is unknown.
    pub sd_log_mu_m: Option<f64>,
    /// The verdict to expect.
    pub verdict: Verdict,
    /// Why the push is not to be done at this mass.
    pub refused: Option<String>,
}

/// Simulates candidate pushes of an object that stands on `support` by a robot, with masses over the range `masses_kg`, and
/// ranks them by the interval on the mass that they would leave; refused ones come last.
///
/// With boxes in the support, the object is placed on each so that one end sticks out, to be pressed on; all other pushes
/// are done on the table. `progress` is told how many candidates of how many are done. Runs in rayon's current pool; the result
/// does not depend on its number of threads.
///
/// # Errors
/// If the robot can do nothing, a number is out of range, or the object does not stand.
pub fn plan_push(
    object: &Object,
    support: &Support,
    robot: &RobotLimits,
    masses_kg: [f64; 2],
    options: &PlanOptions,
    progress: impl Fn(usize, usize) + Sync,
) -> Result<Vec<PlannedPush>> {
    check(robot, masses_kg, options)?;
    let collider = collider(object)?;
    let standing = Standing::new(object, &options.up_in_mesh)?;
    let stage = Stage { object, collider, support, robot, options, dt_s: options.dt_s };
    let pushes = candidates::all(&standing, support, robot, options, stage.friction(), masses_kg[0]);
    let (masses, count, done) = (grid(masses_kg, options.masses), pushes.len(), AtomicUsize::new(0));
    let mut judged: Vec<PlannedPush> = pushes
        .into_par_iter()
        .map(|push| {
            let out = stage.judge(push, &masses);
            progress(1 + done.fetch_add(1, Ordering::Relaxed), count);
            out
        })
        .collect::<Result<_>>()?;
    judged.sort_by(|a, b| a.refused.is_some().cmp(&b.refused.is_some()).then(a.half_width.total_cmp(&b.half_width)));
    Ok(judged)
}

impl GuardedPush {
    /// A simulated recording of this push with an object of `mass_kg`, as the sensors would give it: noise on poses, force and
    /// encoder from `seed`. The friction is that of the support, or the one of the options, which the recording does not state then.
    ///
    /// # Errors
    /// If the push cannot be simulated.
    pub fn rehearse(
        &self,
        object: &Object,
        support: &Support,
        robot: &RobotLimits,
        options: &PlanOptions,
        mass_kg: f64,
        seed: u64,
    ) -> Result<PushRecording> {
        check(robot, [mass_kg; 2], options)?;
        let stage = Stage { object, collider: collider(object)?, support, robot, options, dt_s: options.identify.dt_s };
        stage.with_noise(stage.rehearse(self, mass_kg)?.recording, seed)
    }

    fn start_pose(&self) -> Result<Pose> {
        Ok(pose_from_wxyz(self.start.position_m, self.start.quat_wxyz)?)
    }

    /// Where it touches, in the world at the start.
    fn touch(&self) -> Result<Point3<f64>> {
        Ok(self.start_pose()? * Point3::from(self.point_in_object_m))
    }

    fn name(&self) -> String {
        format!("{:?} by {:?}", self.kind, self.drive).to_lowercase()
    }

    /// Whether the object has moved as far as it is to.
    fn is_reached(&self, tilt: f64, shift: &Vector3<f64>) -> bool {
        self.until_tilt_deg.is_some_and(|t| tilt.to_degrees() >= t)
            || self.until_travel_m.is_some_and(|s| shift.norm() >= s)
    }
}

/// `count` masses evenly over the logarithm of a range, both ends included.
fn grid([lo, hi]: [f64; 2], count: usize) -> Vec<f64> {
    let step = (hi / lo).ln() / (count.max(2) - 1) as f64;
    (0..count).map(|k| lo * (step * k as f64).exp()).collect()
}

fn check(robot: &RobotLimits, [lo, hi]: [f64; 2], options: &PlanOptions) -> Result<()> {
    robot.check()?;
    let bad = |option, what: &str| Err(SysidError::Option { option, what: what.into() });
    if !(lo > 0.0 && hi >= lo && hi.is_finite()) {
        return bad("masses_kg", "needs two positive masses in kilograms, the smaller first");
    }
    if options.masses == 0 {
        return bad("masses", "needs at least one mass");
    }
    let up = options.up_in_mesh.norm();
    if !(up > 1e-9 && up.is_finite()) {
        return bad("up_in_mesh", "needs a direction");
    }
    let noise = options.noise;
    let positive = [
        ("friction", options.friction),
        ("fps", options.fps),
        ("noise.position_m", noise.position_m),
        ("noise.rotation_rad", noise.rotation_rad),
        ("largest_tilt_rad", options.largest_tilt_rad),
        ("dt_s", options.dt_s),
        ("identify.dt_s", options.identify.dt_s),
    ];
    match positive.into_iter().find(|(_, x)| !(*x > 0.0 && x.is_finite())) {
        Some((option, _)) => bad(option, "needs a positive number"),
        None => Ok(()),
    }
}
