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

use drex_core::Object;
use drex_grasp::{EvaluationOptions, Grasp, GraspEvaluation};
use drex_robot::Robot;
use rayon::prelude::*;

use crate::levenberg_marquardt::{HandState, LeastSquares, minimise};
use crate::{Error, Result};
pub(crate) use hand::HandModel;
use residuals::{Problem, Stage, View};

/// Effort of a wrist fit.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct WristFitOptions {
    /// What an accepted grasp keeps; those of a demonstrated one.
    pub limits: EvaluationOptions,
    /// Each joint may move this far from its recorded angle (after clipping to the limits), rad.
    pub max_finger_correction_rad: f64,
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
            limits: EvaluationOptions::demonstrated(),
            max_finger_correction_rad: 0.15,
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

/// A wrist pose for one grasp.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct WristFit {
    /// The grasp: corrected joints, the wrist's pose, and where it touches.
    pub grasp: Grasp,
    /// How far each recorded angle was moved to be within the joint's limits, rad.
    pub clipped_rad: Vec<f64>,
    /// Correction of each joint after clipping, rad.
    pub correction_rad: Vec<f64>,
    /// How much the touching pads push the object out of the hand, along the palm's normal: mean over them of the part of the
    /// cosine beyond 0.3. Zero for an object between the fingers; large for a fist that presses against its side.
    pub pushed_out: f64,
    /// The grasp by the limits of the options: whether it keeps them, and why not.
    pub evaluation: GraspEvaluation,
}

impl WristFit {
    /// Largest correction of a joint, rad.
    pub fn largest_correction_rad(&self) -> f64 {
        self.correction_rad.iter().fold(0.0, |m, c| m.max(c.abs()))
    }
}

/// Finds the wrist pose of one grasp of `object` on its table: `joints` in the model's order, rad, not necessarily within the limits.
///
/// # Errors
/// If the joints do not fit the robot, the robot has no thumb or fingers, or an option is out of range.
pub fn fit_wrist(robot: &Robot, joints: &[f64], object: &Object, options: &WristFitOptions) -> Result<WristFit> {
    let hand = HandModel::new(robot, options)?;
    fit_one(&hand, joints, object, options)
}

/// [`fit_wrist`] for many grasps, in parallel; the same result for any number of threads.
///
/// # Errors
/// As [`fit_wrist`]; the message names the row.
pub fn fit_wrists(
    robot: &Robot,
    grasps: &[Vec<f64>],
    object: &Object,
    options: &WristFitOptions,
) -> Result<Vec<WristFit>> {
    let hand = HandModel::new(robot, options)?;
    grasps
        .par_iter()
        .enumerate()
        .map(|(row, joints)| {
            fit_one(&hand, joints, object, options).map_err(|e| match e {
                Error::Joints { what, remedy } => Error::Joints { what: format!("row {row}: {what}"), remedy },
                other => other,
            })
        })
        .collect()
}

fn fit_one(hand: &HandModel<'_>, joints: &[f64], object: &Object, options: &WristFitOptions) -> Result<WristFit> {
    let recorded = hand.recorded_within(joints, options.max_finger_correction_rad)?;
    let (table, bounds) = (object.table(), object.geometry.bounding_box());
    let rough = Problem { hand, object, table, bounds, options, recorded: &recorded, stage: Stage::Rough };
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
