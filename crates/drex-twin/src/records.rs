//! What the stages write for each other and for people: JSON with units in the field names.

use std::path::Path;

use crate::Result;
use crate::error::Context;
use drex_core::{PoseRecord, fsutil};
use drex_grasp::{Grasp, GraspChange, GraspEvaluation, GraspOrigin, GripForcePolicy};
use drex_hw::driver::ContactRecord;
use drex_robot::Robot;
use drex_sysid::{Identification, MassDistribution, MassPosterior, MassPrior, MassSource};
use drex_trial::{DemonstrationCounts, ValidatedGrasp};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

mod scan;

pub use self::scan::{
    FrameReport, GapReport, OtherPlane, Refinement, ScanFile, SplatReport, SplatScore, SplatScores, SplatSet,
};

/// Masses by which a posterior is spoken for: 95 of them are below its 95 % quantile.
const LIKELY: usize = 100;

/// Result of the scan stage.
pub const SCAN: &str = "splat/scan.json";
/// How well the Gaussians match photos that they have not seen; not there where the scan came with depth maps.
pub const SPLAT_REPORT: &str = "splat/report.json";
/// Folder of pictures of the Gaussians from where photos were held out.
pub const HELD_OUT: &str = "splat/held_out";
/// Result of the identify stage.
pub const MASS: &str = "mass.json";
/// Result of the grasps stage.
pub const FITS: &str = "grasps/wrist_fits.json";
/// Picture of the demonstrations of people on the hand.
pub const SHEET: &str = "grasps/contact_sheet.png";
/// Folder of the trained network.
pub const POLICY: &str = "policy/network";
/// Curve and baselines of the training.
pub const TRAINING: &str = "policy/training.json";
/// Losses of each epoch of the training.
pub const CURVE: &str = "policy/curve.csv";
/// Result of the evaluate stage.
pub const EVALUATION: &str = "policy/evaluation.json";
/// Result of the trial stage.
pub const TRIAL: &str = "policy/trial.json";

/// Result of the execute stage.
pub const EXECUTION: &str = "policy/execution.json";
/// Log of the hand's joints while the execute stage ran.
pub const EXECUTION_LOG: &str = "policy/execution.csv";

/// `mass.json`: the posterior of the mass and what it is made of.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct MassFile {
    /// Median of the posterior, kg: the mass of the simulation asset.
    pub mass_kg: f64,
    /// Where it comes from.
    pub source: MassSource,
    /// 95 % interval of the posterior, kg.
    pub ci95_kg: [f64; 2],
    /// Standard deviation of the posterior, kg.
    pub sd_kg: f64,
    /// Mass that grasps are made for, kg ([`MassPosterior::grip_kg`] with the margin of the grip-force policy).
    pub grip_kg: f64,
    /// What was known before the pushes.
    pub prior: Option<MassPrior>,
    /// Ends of the 95 % interval of what the pushes alone say, kg, each absent where they leave that side open; absent where they say
    /// nothing.
    pub push_ci95_kg: Option<[Option<f64>; 2]>,
    /// How far prior and pushes contradict each other, in standard deviations; absent without both.
    pub contradiction_sd: Option<f64>,
    /// The posterior, from which trials draw.
    pub posterior: MassDistribution,
    /// What the pushes said; absent when there were none.
    pub identification: Option<Identification>,
}

impl MassFile {
    /// The file of a posterior, with the answer of the pushes that are part of it.
    pub fn new(posterior: MassPosterior, identification: Option<Identification>) -> Self {
        let of = &posterior.distribution;
        Self {
            mass_kg: of.median_kg(),
            source: posterior.source,
            ci95_kg: of.interval95_kg(),
            sd_kg: of.sd_kg(),
            grip_kg: posterior.grip_kg(GripForcePolicy::default().margin),
            push_ci95_kg: posterior.push_ci95_kg,
            contradiction_sd: posterior.contradiction_sd,
            prior: posterior.prior,
            posterior: posterior.distribution,
            identification,
        }
    }

    /// Masses that are as likely as each other, evenly spread quantiles of the posterior, kg: with what is known of the friction they say how hard to
    /// grip ([`drex_trial::Uncertainty`]).
    pub fn likely_kg(&self) -> Vec<f64> {
        (0..LIKELY).map(|i| self.posterior.quantile_kg((i as f64 + 0.5) / LIKELY as f64)).collect()
    }
}

/// `grasps/wrist_fits.json`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FitFile {
    /// Layout version.
    pub schema: u32,
    /// The hand model: a bundled name or a file relative to the twin.
    pub hand: String,
    /// Joint names of the columns of `joints_rad`.
    pub joint_names: Vec<String>,
    /// Demonstrations read, fitted and accepted.
    pub demonstrations: usize,
    /// Of those, how many the fit accepted.
    pub accepted: usize,
    /// The demonstrations of people that the grasps come from; none for a robot's.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub clips: Vec<ClipRecord>,
    /// A robot's: one record per demonstration, in the order of the file. People's: one per held frame of a clip, then one per
    /// grasp that was made of them.
    pub grasps: Vec<FitRecord>,
}

/// One demonstration on the object.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FitRecord {
    /// Row in the file of demonstrations, from 0; of people's clips a running number.
    pub demonstration: usize,
    /// Whether it holds the rules of the fit.
    pub accepted: bool,
    /// Why not, one sentence each.
    pub reasons: Vec<String>,
    /// Joint angles after correction, rad.
    pub joints_rad: Vec<f64>,
    /// Largest distance that a recorded angle was outside its joint's limits, rad.
    pub largest_clipping_rad: f64,
    /// Change of each joint after clipping, rad; for a frame of a clip from what the person's hand alone asks for, for a grasp
    /// made of a frame from that frame.
    pub correction_rad: Vec<f64>,
    /// The largest of them.
    pub largest_correction_rad: f64,
    /// Pose of the hand's base in the object's mesh frame.
    pub object_from_base: PoseRecord,
    /// Deepest penetration of hand into object, mm.
    pub penetration_mm: f64,
    /// Lowest point of the hand above the table, mm.
    pub table_clearance_mm: f64,
    /// Fingers on the surface, by name.
    pub touching: Vec<String>,
    /// How much the touching pads push the object out of the hand: 0 for an object between the fingers, towards 1 for a fist
    /// that presses against its side. Not measured in clips of people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pushed_out: Option<f64>,
    /// Smallest sum of normal forces that carries the object, in units of its weight; absent when the contacts cannot.
    #[serde(rename = "squeeze_per_weight")]
    pub grip_force_per_weight: Option<f64>,
    /// Where it comes from, for demonstrations of people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<FitSource>,
}

impl FitRecord {
    /// The record of an evaluated grasp of an object of this weight, N; `correction_rad` is what led to its joints.
    #[cfg(feature = "stages")]
    pub(crate) fn of(
        demonstration: usize,
        grasp: &Grasp,
        evaluation: &GraspEvaluation,
        correction_rad: Vec<f64>,
        weight_n: f64,
    ) -> Self {
        let touching = evaluation.fingers.iter().filter(|f| f.touches);
        Self {
            demonstration,
            accepted: evaluation.passed,
            reasons: evaluation.failures.clone(),
            joints_rad: grasp.joints_rad.clone(),
            largest_clipping_rad: 0.0,
            largest_correction_rad: correction_rad.iter().fold(0.0, |m, c| c.abs().max(m)),
            correction_rad,
            object_from_base: PoseRecord::from(&grasp.object_from_base),
            penetration_mm: evaluation.penetration_mm,
            table_clearance_mm: evaluation.table_clearance_mm,
            touching: touching.map(|f| f.finger.clone()).collect(),
            pushed_out: None,
            grip_force_per_weight: evaluation.grip_force_n.map(|n| n / weight_n),
            source: None,
        }
    }

    /// The grasp of the record, of this hand. What it touches is not written down.
    ///
    /// # Errors
    /// If the pose in the file is none.
    pub fn grasp(&self, robot: &Robot) -> Result<Grasp> {
        let grasp = Grasp::new(robot, self.joints_rad.clone(), self.object_from_base.to_pose()?);
        Ok(Grasp { origin: self.origin(), source: self.demonstration, ..grasp })
    }

    /// Where it comes from.
    pub fn origin(&self) -> GraspOrigin {
        if self.is_augmented() { GraspOrigin::Refined } else { GraspOrigin::Retargeted }
    }

    /// Whether it was made of a frame rather than recorded.
    pub fn is_augmented(&self) -> bool {
        self.source.as_ref().is_some_and(|s| s.symmetry.is_some())
    }
}

/// The frame that a grasp comes from.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FitSource {
    /// The demonstration, relative to the twin folder.
    pub file: String,
    /// Number of the frame in it, from 0.
    pub frame: usize,
    /// For a grasp that was made of that frame: which of the object's symmetries it was turned by, 0 for none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub symmetry: Option<usize>,
}

/// One demonstration of a person.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ClipRecord {
    /// The file, relative to the twin folder.
    pub file: String,
    /// Number of its frames.
    pub frames: usize,
    /// Number of frames in which the person holds the object.
    pub held: usize,
    /// Number of frames with the object held that were accepted.
    pub accepted: usize,
    /// Robot hand per person's hand.
    pub scale: f64,
    /// Number of variants of accepted frames that were tried.
    pub attempts: usize,
    /// Number of variants that became grasps.
    pub augmented: usize,
    /// Remarks of the reader.
    pub notes: Vec<String>,
}

/// `policy/evaluation.json`: predicted grasps, evaluated at rest.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Evaluation {
    /// Mass that the grasps were asked for and evaluated at, kg.
    pub mass_kg: f64,
    /// Friction that was assumed.
    pub friction: f64,
    /// The network's grasps as predicted.
    pub predicted: Vec<EvaluatedGrasp>,
    /// The same after the wrist was solved again on the object with small finger corrections.
    pub refined: Vec<EvaluatedGrasp>,
    /// The demonstrations that it learned from, for comparison.
    pub demonstrations: Vec<EvaluatedGrasp>,
}

/// A grasp and its evaluation.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct EvaluatedGrasp {
    /// Joint angles, rad, in the order of the grasp file.
    pub joints_rad: Vec<f64>,
    /// Pose of the hand's base in the object's mesh frame.
    pub object_from_base: PoseRecord,
    /// Grip force that the network asks for, N; absent for demonstrations.
    #[serde(rename = "predicted_squeeze_n")]
    pub predicted_grip_force_n: Option<f64>,
    /// Weight of the mode among the network's answers; absent for demonstrations.
    pub weight: Option<f64>,
    /// The evaluation.
    pub check: GraspEvaluation,
}

/// `policy/training.json`; not read without the feature `stages`, whose crates train.
#[cfg(feature = "stages")]
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Training {
    /// Counts of the grasps that were learned, those included that were held out to measure errors with.
    pub learned: drex_grasp::OriginCounts,
    /// Counts of the grasps that were tried: all that fit the object, and what a search found.
    pub tried: drex_grasp::OriginCounts,
    /// Pairs of grasp and mass.
    pub samples: usize,
    /// Curve, held-out errors, baselines.
    pub report: drex_policy::TrainReport,
    /// What was tried in simulation before it was learned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub practice: Option<PracticeRecord>,
}

/// What became of the grasps that were tried in simulation.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct PracticeRecord {
    /// Number of grasps that the motors can hold once the hand has closed.
    pub commanded: usize,
    /// Number of grasps that held under most conditions.
    pub robust: usize,
    /// What became of the demonstrated ones.
    #[serde(default)]
    pub demonstrations: DemonstrationCounts,
    /// The grasps that were learned, the best first.
    #[serde(default)]
    pub learned: Vec<LearnedGrasp>,
}

/// A grasp that was learned because it held in simulation.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct LearnedGrasp {
    /// The grasp.
    pub grasp: Grasp,
    /// Number of conditions under which it held, and of those under which it was tried.
    pub held: [usize; 2],
    /// The demonstrated grasp that it is or was made of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub demonstration: Option<Grasp>,
    /// How far it is from that.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub change: Option<GraspChange>,
}

impl From<&ValidatedGrasp> for LearnedGrasp {
    fn from(g: &ValidatedGrasp) -> Self {
        let demonstration = g.demonstration.as_deref();
        Self {
            grasp: g.grasp.clone(),
            held: [g.holds(), g.scores.len()],
            demonstration: demonstration.cloned(),
            change: demonstration.map(|d| g.grasp.change_from(d)),
        }
    }
}

/// `policy/trial.json`: the grasp that `drex grasp` gives, lifted, held and shaken in simulation.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TrialFile {
    /// Layout: 1.
    pub schema: u32,
    /// The hand.
    pub hand: String,
    /// Its joints, in the order of [`RecordedFrame::joints_rad`].
    pub joint_names: Vec<String>,
    /// Mass that the hand takes the object for, kg.
    pub mass_kg: f64,
    /// Median of the posterior that true masses are drawn from, kg.
    pub mass_median_kg: f64,
    /// Its 95 % interval, kg.
    pub mass_ci95_kg: [f64; 2],
    /// Its standard deviation, kg.
    pub mass_sd_kg: f64,
    /// Lowest and highest friction that is true in a rollout.
    pub friction: [f64; 2],
    /// Number of rollouts that succeeded.
    pub held: usize,
    /// Number of rollouts.
    pub n: usize,
    /// 95 % interval of the share that succeeds (Wilson).
    pub interval: [f64; 2],
    /// Each rollout.
    pub rollouts: Vec<RolloutRecord>,
    /// The first rollout that succeeded, or the first that could be carried out; empty if none could.
    #[serde(rename = "film")]
    pub recording: Vec<RecordedFrame>,
    /// Index of the rollout that is recorded.
    pub filmed: Option<usize>,
}

/// One rollout.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RolloutRecord {
    /// What became of it.
    pub verdict: drex_trial::Verdict,
    /// True mass, kg.
    pub mass_kg: f64,
    /// True friction.
    pub friction: f64,
    /// Which of the network's proposals was taken, from 1; 0 if none could be.
    pub proposal: usize,
    /// Grip force that was commanded, N.
    #[serde(rename = "squeeze_n")]
    pub grip_force_n: f64,
    /// Grip force that was delivered in the hold, N; absent if the rollout ended before.
    pub held_n: Option<f64>,
    /// Share of the friction that was used in the hold.
    pub friction_used: Option<f64>,
}

/// What can be seen of a rollout at one time.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RecordedFrame {
    /// From the start, s.
    pub time_s: f64,
    /// The hand's base in the world.
    pub world_from_base: PoseRecord,
    /// Angles of its joints, rad.
    pub joints_rad: Vec<f64>,
    /// The object's mesh frame in the world.
    pub world_from_object: PoseRecord,
    /// Normal force of each finger, N.
    pub finger_n: Vec<f64>,
}

/// `policy/execution.json`: the grasp of `drex deploy` carried out by an emulated hand.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ExecutionFile {
    /// Layout: 1.
    pub schema: u32,
    /// The hand.
    pub hand: String,
    /// Whether the motors are emulated; what stands in their way then are stops where the grasp touches.
    pub emulated: bool,
    /// Why no hand moved; absent if one did. All that follows is empty then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_driven: Option<String>,
    /// Unit of the limits: mA or N m.
    pub unit: String,
    /// Joints of what follows.
    pub joint_names: Vec<String>,
    /// Angles before the fingers close, rad.
    pub open_rad: Vec<f64>,
    /// Angles that closing fingers are commanded, rad.
    pub closed_rad: Vec<f64>,
    /// Most that each joint may press with while the fingers close, in `unit`.
    pub closing_limits: Vec<f64>,
    /// Most that each joint may press with in the hold, in `unit`.
    pub force_limits: Vec<f64>,
    /// Whether the fingers touched and the object was held to the end.
    pub held: bool,
    /// The joints that touched.
    pub contacts: Vec<ContactRecord>,
}

/// Writes a value as indented JSON.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let mut text = serde_json::to_vec_pretty(value).map_err(crate::Error::json)?;
    text.push(b'\n');
    fsutil::write_atomic(path, &text)?;
    Ok(())
}

/// The same of a file that need not be there.
pub fn read_json_if_there<T: DeserializeOwned>(path: &Path) -> Result<Option<T>> {
    path.exists().then(|| read_json(path)).transpose()
}

/// Reads what [`write_json`] wrote.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    serde_json::from_slice(&fsutil::read_bytes(path)?)
        .map_err(crate::Error::json)
        .with_context(|| format!("{} is not what drex wrote there; delete it and run again", path.display()))
}
