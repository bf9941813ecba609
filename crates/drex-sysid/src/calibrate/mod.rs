//! Joint friction of a hand from its own logs, and from that the torque with which it pushes.
//!
//! [`hand`] fits friction, load factor and inertia of each kind of joint from the logs of any number of runs of one hand,
//! without being told when it touches something. [`HandCalibration::extra_torque`] then says, joint by joint and moment by
//! moment, how much torque a log shows beyond friction, gravity and inertia, and how well that is known; [`ExtraTorque::touches`]
//! which fingers push, and when; [`ExtraTorque::tip_force`] with what force.

mod extra;
mod friction;
mod signals;

use std::collections::BTreeMap;
use std::path::Path;

use drex_core::fsutil;
use drex_robot::Robot;
use serde::{Deserialize, Serialize};

pub use self::extra::{ExtraTorque, TipForce, Touch};
pub use self::signals::HandRun;
use crate::{Result, SysidError};
use friction::{LoadPrior, Sequence};
use signals::{LEAST_SPEED, Signals};

/// Version of the file format.
const SCHEMA: u32 = 1;
/// How well the load factor of one kind of joint tells that of another, as a fraction.
const UNSEEN_FACTOR_SD: f64 = 0.5;
/// Shorter motions show a joint's play and ringing, not its friction, rad.
const LEAST_TRAVEL: f64 = 0.1;

/// Settings of [`hand`].
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct CalibrateOptions {
    /// How well the masses of the links are known, as a fraction: gravity is the yardstick of every torque.
    pub link_mass_sd: f64,
}

impl Default for CalibrateOptions {
    fn default() -> Self {
        Self { link_mass_sd: 0.1 }
    }
}

/// The calibration of a hand; save and load it as JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct HandCalibration {
    /// Version of the format: 1.
    pub schema: u32,
    /// Name of the robot's model.
    pub robot: String,
    /// The runs it was made from.
    pub runs: Vec<String>,
    /// How well the masses of the links are known, as a fraction.
    pub link_mass_sd: f64,
    /// Joints that moved, in the order of the robot. The others are not calibrated.
    pub joints: Vec<JointCalibration>,
    /// What the user should know.
    pub remarks: Vec<String>,
}

/// Friction and inertia of one joint: effort = s·coulomb + viscous·v + load_factor·(gravity + contact) + inertia·a, s the sign
/// of v. Efforts in N m as logged; pairs are value and standard deviation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct JointCalibration {
    /// Name of the joint.
    pub joint: String,
    /// The joints that were fitted together because they are alike, this one among them.
    pub alike: Vec<String>,
    /// Coulomb friction, N m.
    pub coulomb_nm: [f64; 2],
    /// Effort per torque of load; above one because gears lose a share of what they carry.
    pub load_factor: [f64; 2],
    /// Whether the load factor was seen (gravity changed along the motion) or is that of the hand's other joints.
    pub load_factor_seen: bool,
    /// Viscous friction, N m s/rad; zero where none was seen.
    pub viscous_nms: [f64; 2],
    /// Inertia at the drive, links included, kg m².
    pub inertia_kg_m2: [f64; 2],
    /// Inertia of the drive alone, kg m², where it stands out of the links'.
    pub armature_kg_m2: Option<[f64; 2]>,
    /// Standard deviation of the effort of a free joint about this, N m.
    pub noise_nm: f64,
    /// What differs from one free motion to the next: standard deviation of means over 0.3 s, N m of effort.
    pub repeatability_nm: f64,
    /// Share of inertia·a that is missed while the joint accelerates hard.
    pub start_error: f64,
    /// Largest |effort − load factor·gravity| at which the joint was seen to stand, N m.
    pub holds_nm: f64,
    /// Covariance of coulomb, load factor, inertia, viscous.
    pub covariance: [[f64; 4]; 4],
    /// Where it was seen to move freely.
    pub spans: Vec<FreeSpan>,
}

/// A stretch of a log in which a joint moved and touched nothing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FreeSpan {
    /// Name of the run.
    pub run: String,
    /// Name of the joint.
    pub joint: String,
    /// First and last time, seconds of that log.
    pub from_to_s: [f64; 2],
}

/// Calibrates the hand `robot` from `runs` of it.
///
/// # Errors
/// If there is no run, a log has no efforts or is of another hand, or no joint moves.
pub fn hand(runs: &[HandRun<'_>], robot: &Robot, options: &CalibrateOptions) -> Result<HandCalibration> {
    if runs.is_empty() {
        return Err(refuse("no run was given".into(), "name at least one run of this hand"));
    }
    let signals = runs.iter().map(|r| Signals::of(r, robot)).collect::<Result<Vec<_>>>()?;
    let groups = alike(robot);
    let moved: Vec<Vec<Sequence>> = groups.iter().map(|g| sequences(&signals, g)).collect();
    // First the joints whose load changes, which show the load factor; then the others with what these showed.
    let open = LoadPrior(1.5, 1.5);
    let first: Vec<_> = moved.iter().map(|s| friction::fit(s, open)).collect();
    let seen = |f: &friction::Fit| f.covariance[1][1].sqrt() < 0.25 * f.values[1] && f.gravity_range > 2.0 * f.noise;
    let factors: Vec<f64> = first.iter().flatten().filter(|f| seen(f)).map(|f| f.values[1]).collect();
    let shared = match factors.len() {
        0 => 1.5,
        n => factors.iter().sum::<f64>() / n as f64,
    };
    let mut joints = BTreeMap::new();
    for ((group, moved), fit) in groups.iter().zip(&moved).zip(first) {
        let Some(fit) = fit else { continue };
        let is_seen = seen(&fit);
        let held = if is_seen { Some(fit) } else { friction::fit(moved, LoadPrior(shared, 1e-3)) };
        let Some(mut fit) = held else { continue };
        if !is_seen {
            fit.covariance[1][1] = (UNSEEN_FACTOR_SD * shared).powi(2);
        }
        let names: Vec<String> = group.iter().map(|&j| robot.joints[j].name.clone()).collect();
        for &j in group {
            joints.insert(j, calibration(j, robot, &names, &fit, is_seen, moved, runs, &signals));
        }
    }
    if joints.is_empty() {
        return Err(refuse(
            "no joint moves faster than 0.1 rad/s in any run".into(),
            "give runs in which the hand moves",
        ));
    }
    let mut remarks = Vec::new();
    if factors.is_empty() {
        remarks.push(
            "gravity hardly changes along these motions: how much effort a load costs is a guess, and so is the size of every contact torque"
                .into(),
        );
    }
    Ok(HandCalibration {
        schema: SCHEMA,
        robot: robot.name.clone(),
        runs: runs.iter().map(|r| r.name.to_owned()).collect(),
        link_mass_sd: options.link_mass_sd,
        joints: joints.into_values().collect(),
        remarks,
    })
}

/// Refuses a log whose efforts cannot be those of `robot`.
pub(crate) fn check(run: &HandRun<'_>, robot: &Robot) -> Result<()> {
    Signals::of(run, robot).map(|_| ())
}

impl HandCalibration {
    /// Reads a calibration.
    ///
    /// # Errors
    /// If the file cannot be read or is no calibration of this version.
    pub fn load(path: &Path) -> Result<Self> {
        let read: Self = fsutil::from_json(path, &fsutil::read_text(path)?)?;
        if read.schema != SCHEMA {
            return Err(refuse(
                format!("{} has schema {}, known is {SCHEMA}", path.display(), read.schema),
                "calibrate again with this version",
            ));
        }
        Ok(read)
    }

    /// Writes the calibration as JSON.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self)
            .map_err(|e| refuse(format!("the calibration cannot be written as JSON: {e}"), "report this"))?;
        Ok(fsutil::write_atomic(path, text.as_bytes())?)
    }

    /// Refuses another hand.
    pub(crate) fn check(&self, robot: &Robot) -> Result<()> {
        if robot.name != self.robot {
            return Err(refuse(
                format!("it is of the hand `{}`, not of `{}`", self.robot, robot.name),
                "calibrate the hand that made the log",
            ));
        }
        Ok(())
    }

    /// The calibration of the joint called `name`.
    pub fn joint(&self, name: &str) -> Option<&JointCalibration> {
        self.joints.iter().find(|j| j.joint == name)
    }
}

impl JointCalibration {
    /// Effort that friction takes at `speed` (rad/s, positive) under a load of `load_nm` (gravity and contact along the motion,
    /// N m), with its standard deviation: the friction curve. Not defined at rest.
    pub fn friction_nm(&self, speed: f64, load_nm: f64) -> [f64; 2] {
        let lost = (self.load_factor[0] - 1.0) * load_nm;
        let x = [1.0, load_nm, 0.0, speed];
        [self.coulomb_nm[0] + self.viscous_nms[0] * speed + lost, self.spread(&x).hypot(self.repeatability_nm)]
    }

    /// Standard deviation of x · (coulomb, load factor, inertia, viscous).
    pub(crate) fn spread(&self, x: &[f64; 4]) -> f64 {
        let product = |i: usize| (0..4).map(|j| x[i] * self.covariance[i][j] * x[j]).sum::<f64>();
        (0..4).map(product).sum::<f64>().max(0.0).sqrt()
    }
}

pub(crate) fn refuse(what: String, remedy: &str) -> SysidError {
    SysidError::Calibration { what, remedy: remedy.into() }
}

/// Joints that are built alike: the same place in fingers with as many joints, thumbs apart, the same drive; all others are alone.
fn alike(robot: &Robot) -> Vec<Vec<usize>> {
    let mut groups: BTreeMap<(usize, usize, u64), Vec<usize>> = BTreeMap::new();
    let mut single: Vec<usize> = (0..robot.dof()).collect();
    for finger in robot.fingers().iter().filter(|f| !f.is_thumb) {
        for (k, &j) in finger.joints.iter().enumerate() {
            let drive = robot.actuators.iter().find(|a| a.joint == j).and_then(|a| a.force_range);
            let limit = drive.map(|r| r.1).or(robot.joints[j].effort_limit).unwrap_or(0.0);
            groups.entry((finger.joints.len(), k, limit.to_bits())).or_default().push(j);
            single.retain(|&s| s != j);
        }
    }
    groups.into_values().chain(single.into_iter().map(|j| vec![j])).collect()
}

/// The motions of the joints of one group.
fn sequences(signals: &[Signals], group: &[usize]) -> Vec<Sequence> {
    let mut all = Vec::new();
    for (run, s) in signals.iter().enumerate() {
        for &joint in group {
            let moving = |k: usize| s.velocity[joint].get(k).is_some_and(|v| v.abs() > LEAST_SPEED);
            let mut k = 0;
            while k < s.times_s.len() {
                let end = (k..s.times_s.len()).find(|&i| !moving(i)).unwrap_or(s.times_s.len());
                let travel = if end > k { (s.position[joint][end - 1] - s.position[joint][k]).abs() } else { 0.0 };
                if travel > LEAST_TRAVEL {
                    let sign = s.velocity[joint][k].signum();
                    let signed = |v: &[f64]| v[k..end].iter().map(|x| sign * x).collect::<Vec<f64>>();
                    all.push(Sequence {
                        run,
                        joint,
                        times_s: s.times_s[k..end].to_vec(),
                        effort: signed(&s.effort[joint]),
                        gravity: signed(&s.gravity[joint]),
                        acceleration: signed(&s.acceleration[joint]),
                        speed: signed(&s.velocity[joint]),
                    });
                }
                k = end + 1;
            }
        }
    }
    all
}

#[allow(clippy::too_many_arguments)] // one call; a struct would only repeat these names
fn calibration(
    j: usize,
    robot: &Robot,
    names: &[String],
    fit: &friction::Fit,
    is_seen: bool,
    moved: &[Sequence],
    runs: &[HandRun<'_>],
    signals: &[Signals],
) -> JointCalibration {
    let sd = |i: usize| fit.covariance[i][i].sqrt();
    let pair = |i: usize| [fit.values[i], sd(i)];
    let mut spans = Vec::new();
    for (s, free) in moved.iter().zip(&fit.free) {
        let mut k = 0;
        while k < free.len() {
            let end = (k..free.len()).find(|&i| free[i] < 0.5).unwrap_or(free.len());
            if end >= k + 10 {
                let from_to_s = [s.times_s[k], s.times_s[end - 1]];
                spans.push(FreeSpan {
                    run: runs[s.run].name.into(),
                    joint: robot.joints[s.joint].name.clone(),
                    from_to_s,
                });
            }
            k = end + 1;
        }
    }
    let mut holds = 0.0_f64;
    for s in signals {
        for k in 0..s.velocity[j].len() {
            if s.velocity[j][k].abs() < 0.01 && s.acceleration[j][k].abs() < 0.5 {
                holds = holds.max((s.effort[j][k] - fit.values[1] * s.gravity[j][k]).abs());
            }
        }
    }
    let links = signals.first().map_or(0.0, |s| {
        let q = s.joint_vector(robot, 0);
        robot.mass_matrix(&q)[(j, j)] - robot.joints[j].armature
    });
    // The load factor applies to the links' inertia as to any load; what is left belongs to the drive.
    let drive = fit.values[2] - fit.values[1] * links;
    JointCalibration {
        joint: robot.joints[j].name.clone(),
        alike: names.to_vec(),
        coulomb_nm: pair(0),
        load_factor: pair(1),
        load_factor_seen: is_seen,
        viscous_nms: pair(3),
        inertia_kg_m2: pair(2),
        armature_kg_m2: (drive > 3.0 * sd(2)).then(|| [drive, sd(2).hypot(0.1 * links * fit.values[1])]),
        noise_nm: fit.noise,
        repeatability_nm: fit.repeatability,
        start_error: fit.start_error,
        holds_nm: holds,
        covariance: fit.covariance,
        spans,
    }
}
