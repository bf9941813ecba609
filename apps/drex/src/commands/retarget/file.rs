//! The JSON file of a retargeted clip.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Result;
use drex_core::fsutil;
use drex_demo::{Demonstration, FrameFlag, Side};
use drex_grasp::SelfCollision;
use drex_retarget::{FingerContact, RetargetedFrame, ScaleReport, TargetHand};
use serde::Serialize;

use super::Object;
use crate::cli::RetargetArgs;
use drex_core::PoseRecord;
use drex_twin::lock::digest_of;

/// The file.
#[derive(Serialize)]
struct File<'a, F, G> {
    format: &'static str,
    /// Name of the model.
    hand: &'a str,
    /// What the command line called it; of a file its name.
    model: String,
    side: Side,
    objective: &'a str,
    unit: &'static str,
    joint_names: Vec<&'a str>,
    demonstration: Given,
    object: Option<GivenObject>,
    scale: &'a ScaleReport,
    notes: Vec<&'a str>,
    frames: &'a [F],
    #[serde(skip_serializing_if = "<[G]>::is_empty")]
    grasps: &'a [G],
}

/// An input file.
#[derive(Serialize)]
struct Given {
    /// Its name.
    file: String,
    sha256: String,
}

#[derive(Serialize)]
struct GivenObject {
    #[serde(flatten)]
    file: Given,
    /// Whether its convex hull was taken instead.
    hull: bool,
}

/// A frame of a plain objective.
#[derive(Serialize)]
pub struct FrameRecord<'a> {
    /// Number in the demonstration, from 0.
    frame: usize,
    t_s: f64,
    q: &'a [f64],
    q_filtered: &'a [f64],
    source_from_base: Option<PoseRecord>,
    /// `null` where the frame is no hand.
    objective: Option<f64>,
    residual_mm: BTreeMap<&'static str, Option<f64>>,
    flags: &'a [FrameFlag],
}

impl<'a> FrameRecord<'a> {
    pub fn new(frame: usize, f: &'a RetargetedFrame) -> Self {
        Self {
            frame,
            t_s: f.t_s,
            q: &f.q,
            q_filtered: &f.q_filtered,
            source_from_base: f.source_from_base.as_ref().map(PoseRecord::from),
            objective: Some(f.objective).filter(|o| o.is_finite()),
            residual_mm: f.fingers.iter().map(|r| (r.finger.name(), r.residual_mm)).collect(),
            flags: &f.flags,
        }
    }
}

/// A frame of the grasp objective.
#[derive(Serialize)]
pub struct GraspRecord<'a> {
    /// Number in the demonstration, from 0.
    pub frame: usize,
    pub t_s: f64,
    pub q: &'a [f64],
    pub accepted: bool,
    /// Why not, one sentence each.
    pub reasons: &'a [String],
    pub object_from_base: PoseRecord,
    pub held: bool,
    pub fingers: &'a [FingerContact],
    pub penetration_mm: f64,
    pub deepest_link: Option<&'a str>,
    pub self_collision: Option<&'a SelfCollision>,
    pub mean_joint_distance_rad: f64,
    pub largest_joint_distance_rad: f64,
    pub wrist_shift_mm: f64,
    pub wrist_turn_rad: f64,
    pub joint_speed_rad_s: f64,
    pub force_closure: bool,
    pub grip_force_per_weight: Option<f64>,
    pub flags: &'a [FrameFlag],
}

/// A grasp that was made of an accepted frame.
#[derive(Serialize)]
pub struct AugmentedRecord<'a> {
    /// Number of that frame in the demonstration.
    pub frame: usize,
    /// Which of the object's symmetries it was turned by, 0 for none.
    pub symmetry: usize,
    /// How far the wrist was shifted
    pub noise_shift_mm: f64,
    /// and turned before it was solved again.
    pub noise_turn_rad: f64,
    pub grasp: GraspRecord<'a>,
}

/// Writes the file whole or not at all.
#[allow(clippy::too_many_arguments)] // one per part of the file
pub fn write(
    out: &Path,
    args: &RetargetArgs,
    demo: &Demonstration,
    hand: &TargetHand,
    object: Option<&Object>,
    scale: &ScaleReport,
    frames: &[impl Serialize],
    grasps: &[impl Serialize],
) -> Result<()> {
    // Not the path as it was typed: the same inputs give the same file from wherever they are named.
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let given = |path: &Path, sha256: String| Given { file: name(path), sha256 };
    let file = File {
        format: "drex-retargeted/1",
        hand: &hand.robot.name,
        model: name(Path::new(&args.hand)),
        side: hand.side,
        objective: args.objective.name(),
        unit: "rad",
        joint_names: hand.robot.joint_names(),
        demonstration: given(&args.demo, digest_of(&fsutil::read_bytes(&args.demo)?)),
        object: object
            .zip(args.object.as_ref())
            .map(|(o, path)| GivenObject { file: given(path, o.sha256.clone()), hull: args.object_hull }),
        scale,
        notes: demo.notes.iter().chain(&hand.notes).map(String::as_str).collect(),
        frames,
        grasps,
    };
    let mut text = serde_json::to_vec(&file)?;
    text.push(b'\n');
    Ok(fsutil::write_atomic(out, &text)?)
}
