//! Where was the wrist? A grasp that was recorded as joint angles only gets its wrist pose back from the object.
//!
//! Unknowns: the six of the wrist, and a bounded correction of every joint. Conditions: the pads of the thumb and of at least two
//! fingers on the surface and opposing each other, nothing inside the object, nothing below the table. A smooth least-squares
//! problem (Levenberg-Marquardt with analytic derivatives) from many initial guesses that surround the object;
//! the answer is the best candidate that fulfils the rules, or the best that does not together with the reasons.

mod evaluation;
mod hand;
mod initial_guesses;
mod residuals;
#[cfg(test)]
mod tests;

use drex_core::{Pose, SignedDistance, TablePlane};
use drex_robot::Robot;
use nalgebra::Point3;
use rayon::prelude::*;
use serde::Serialize;

use crate::levenberg_marquardt::{HandState, LeastSquares, minimise};
use crate::{Error, Result};
pub(crate) use hand::HandModel;
use residuals::{Problem, Stage, View};

/// The object, in its own frame.
#[derive(Clone, Copy)]
pub struct ObjectSurface<'a> {
    /// Distance used by the search: a fast one, such as a grid.
    pub search: &'a dyn SignedDistance,
    /// Distance that the result is evaluated with: the exact one. May be the same.
    pub exact: &'a dyn SignedDistance,
    /// Lower and upper corner of the object's bounding box, metres.
    pub bounds: (Point3<f64>, Point3<f64>),
    /// Centre of mass, metres.
    pub center_of_mass: Point3<f64>,
}

/// Rules and effort of a wrist fit.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct WristFitOptions {
    /// Each joint may move this far from its recorded angle (after clipping to the limits), rad.
    pub max_finger_correction_rad: f64,
    /// The hand may be this deep inside the object, metres.
    pub max_penetration_m: f64,
    /// A finger is on the surface if a point of its pad is at most this far from it, metres.
    pub contact_gap_m: f64,
    /// Fingers that must be on the surface besides the thumb.
    pub min_fingers: usize,
    /// Least height of the hand over the table, metres.
    pub min_table_clearance_m: f64,
    /// Coulomb friction with which candidates are compared.
    pub friction: f64,
    /// Number of wrist poses that are tried first.
    pub initial_guesses: usize,
    /// Numbers of initial guesses that are improved roughly and that are improved to the end.
    pub kept: (usize, usize),
    /// Seed of the sequence of initial guesses.
    pub seed: u64,
    /// Distance between points on the hand: rough search, final search and verdict, metres.
    pub spacings_m: (f64, f64),
}

impl Default for WristFitOptions {
    fn default() -> Self {
        Self {
            max_finger_correction_rad: 0.15,
            max_penetration_m: 0.002,
            contact_gap_m: 0.002,
            min_fingers: 2,
            min_table_clearance_m: 0.0,
            friction: 0.5,
            initial_guesses: 512,
            kept: (96, 24),
            seed: 0,
            spacings_m: (0.008, 0.003),
        }
    }
}

impl WristFitOptions {
    /// The same with another seed.
    pub fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }
}

/// The gap of one finger.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FingerGap {
    /// Name of the finger.
    pub finger: String,
    /// Distance of its pad from the surface, mm; negative inside.
    pub gap_mm: f64,
    /// Whether the pad is within the contact gap.
    pub touches: bool,
}

/// One broken rule.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
#[serde(tag = "rule", rename_all = "snake_case")]
pub enum Rejection {
    /// The thumb is not on the surface.
    ThumbMisses {
        /// Distance of its pad, mm.
        gap_mm: f64,
    },
    /// Too few other fingers are on the surface.
    FingersMiss {
        /// Names and gaps (mm) of the fingers that do not touch.
        missing: Vec<(String, f64)>,
        /// Number of fingers besides the thumb that touch.
        touching: usize,
        /// Number of such fingers that are required.
        needed: usize,
    },
    /// The hand is too deep inside the object.
    Penetrates {
        /// The deepest link.
        link: String,
        /// Depth of the link inside the object, mm.
        depth_mm: f64,
    },
    /// The hand hits itself.
    SelfCollision {
        /// Names of the links.
        links: (String, String),
        /// How deep they are inside each other, mm.
        depth_mm: f64,
    },
    /// The joints are far from the plain retargeting's.
    #[serde(rename = "far_from_person")]
    FarFromReference {
        /// Mean distance of a joint, rad.
        mean_joint_rad: f64,
    },
    /// The wrist is far from the human wrist.
    WristMoved {
        /// Distance, mm.
        distance_mm: f64,
    },
    /// The hand reaches below the table.
    BelowTable {
        /// The lowest link.
        link: String,
        /// Depth below the table, mm.
        depth_mm: f64,
    },
}

impl Rejection {
    /// The kind of the reason, for counting.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::ThumbMisses { .. } => "thumb misses",
            Self::FingersMiss { .. } => "fingers miss",
            Self::Penetrates { .. } => "penetrates",
            Self::SelfCollision { .. } => "self-collision",
            Self::FarFromReference { .. } => "far from the plain retargeting",
            Self::WristMoved { .. } => "wrist moved",
            Self::BelowTable { .. } => "below the table",
        }
    }
}

impl std::fmt::Display for Rejection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::ThumbMisses { gap_mm } => write!(f, "the thumb misses the surface by {gap_mm:.1} mm"),
            Self::FingersMiss { missing, touching, needed } => {
                let list: Vec<String> = missing.iter().map(|(n, g)| format!("{n} by {g:.1} mm")).collect();
                write!(f, "{touching} of at least {needed} fingers touch; {} miss the surface", list.join(", "))
            }
            Self::Penetrates { link, depth_mm } => write!(f, "link \"{link}\" is {depth_mm:.1} mm inside the object"),
            Self::SelfCollision { links: (a, b), depth_mm } => {
                write!(f, "links \"{a}\" and \"{b}\" are {depth_mm:.1} mm inside each other")
            }
            Self::FarFromReference { mean_joint_rad } => {
                write!(f, "the joints are {mean_joint_rad:.2} rad on average from the plain retargeting's")
            }
            Self::WristMoved { distance_mm } => write!(f, "the wrist is {distance_mm:.0} mm from the human wrist"),
            Self::BelowTable { link, depth_mm } => write!(f, "link \"{link}\" is {depth_mm:.1} mm below the table"),
        }
    }
}

/// Whether a fit keeps the rules.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "verdict", content = "reasons", rename_all = "snake_case")]
pub enum Verdict {
    /// All rules are kept.
    Accepted,
    /// At least one rule is broken.
    Rejected(Vec<Rejection>),
}

impl Verdict {
    /// Whether the fit was accepted.
    pub fn is_accepted(&self) -> bool {
        matches!(self, Self::Accepted)
    }
}

/// A wrist pose for one grasp.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct WristFit {
    /// Pose of the robot's base in the object's frame.
    pub object_from_base: Pose,
    /// Corrected joint vector, model order, rad.
    pub joints: Vec<f64>,
    /// How far each recorded angle was moved to be within the joint's limits, rad.
    pub clipped_rad: Vec<f64>,
    /// Correction of each joint after clipping, rad.
    pub correction_rad: Vec<f64>,
    /// Gap of each finger.
    pub fingers: Vec<FingerGap>,
    /// Deepest point of the hand inside the object, mm; negative is a gap.
    pub penetration_mm: f64,
    /// Height of the hand's lowest point over the table, mm.
    pub table_clearance_mm: f64,
    /// How much the touching pads push the object out of the hand, along the palm's normal: mean over them of the part of the
    /// cosine beyond 0.3. Zero for an object between the fingers; large for a fist that presses against its side.
    pub pushed_out: f64,
    /// Whether the contacts are in force closure; false for rejected fits.
    pub force_closure: bool,
    /// Smallest sum of normal forces that carries the object, in units of its weight, at the friction of the options and without
    /// motor limits; `None` if the contacts cannot carry it.
    pub grip_force_per_weight: Option<f64>,
    /// Whether the fit keeps the rules.
    pub verdict: Verdict,
}

impl WristFit {
    /// Largest correction of a joint, rad.
    pub fn largest_correction_rad(&self) -> f64 {
        self.correction_rad.iter().fold(0.0, |m, c| m.max(c.abs()))
    }
}

/// Finds the wrist pose of one grasp: `joints` in the model's order, rad, not necessarily within the limits.
///
/// # Errors
/// If the joints do not fit the robot, the robot has no thumb or fingers, or an option is out of range.
pub fn fit_wrist(
    robot: &Robot,
    joints: &[f64],
    object: &ObjectSurface<'_>,
    table: &TablePlane,
    options: &WristFitOptions,
) -> Result<WristFit> {
    let hand = HandModel::new(robot, options)?;
    fit_one(&hand, joints, object, table, options)
}

/// [`fit_wrist`] for many grasps, in parallel; the same result for any number of threads.
///
/// # Errors
/// As [`fit_wrist`]; the message names the row.
pub fn fit_wrists(
    robot: &Robot,
    grasps: &[Vec<f64>],
    object: &ObjectSurface<'_>,
    table: &TablePlane,
    options: &WristFitOptions,
) -> Result<Vec<WristFit>> {
    let hand = HandModel::new(robot, options)?;
    grasps
        .par_iter()
        .enumerate()
        .map(|(row, joints)| {
            fit_one(&hand, joints, object, table, options).map_err(|e| match e {
                Error::Joints { what, remedy } => Error::Joints { what: format!("row {row}: {what}"), remedy },
                other => other,
            })
        })
        .collect()
}

fn fit_one(
    hand: &HandModel<'_>,
    joints: &[f64],
    object: &ObjectSurface<'_>,
    table: &TablePlane,
    options: &WristFitOptions,
) -> Result<WristFit> {
    let recorded = hand.recorded_within(joints, options.max_finger_correction_rad)?;
    let rough = Problem { hand, object, table, options, recorded: &recorded, stage: Stage::Rough };
    let mut candidates: Vec<(f64, HandState)> = initial_guesses::initial_guesses(&rough)
        .into_iter()
        .map(|s| (rough.evaluate(&s, &mut View::default()), s))
        .collect();
    keep_best(&mut candidates, options.kept.0);
    for (cost, state) in &mut candidates {
        *cost = minimise(&rough, state, 8).0;
    }
    keep_best(&mut candidates, options.kept.1);
    let mut best: Option<evaluation::Candidate> = None;
    for (_, mut state) in candidates {
        minimise(&rough, &mut state, 20);
        let fingers = residuals::nearest_fingers(&rough, &state);
        minimise(&Problem { stage: Stage::Final { fingers }, ..rough }, &mut state, 25);
        let end = evaluation::evaluate(&rough, state)?;
        if best.as_ref().is_none_or(|b| end.better_than(b)) {
            best = Some(end);
        }
    }
    // There is a start whenever options are valid, and they were checked when the hand was made.
    best.map(|b| b.fit)
        .ok_or_else(|| Error::value("no initial guess was tried", "give initial_guesses and kept of one or more"))
}

/// Sorts by cost, ties by order, and keeps the first `n`.
fn keep_best(candidates: &mut Vec<(f64, HandState)>, n: usize) {
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
    candidates.truncate(n);
}
