//! A grasp for an object that nobody has shown how to hold: synthesis, selection, and a trial of the best.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use drex_core::Object;
use drex_grasp::{Grasp, synthesize_grasps};
use drex_robot::Robot;

use crate::assumed::check_mass_and_friction;
use crate::{
    ConditionSpread, Engine, Interval, Result, SelectionOptions, Stoppable, TrialEvaluator, TrialOptions, Verdict,
    rollouts, select_grasps, wilson,
};

/// Distinguishes the seeds of the last trials from those of the selection.
const FIND_SEED: u64 = 0x6669_6e64;
/// Closings and trials of the selection for one grasp that is simulated, about as many as there are for a box.
const STEPS_PER_SIMULATED: usize = 30;

/// The effort of [`find_grasp`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct FindOptions {
    /// Pinches that are looked at; a fiftieth as many power grasps are tried.
    pub candidates: usize,
    /// Grasps that are simulated before one is chosen.
    pub simulated: usize,
    /// Trials of the chosen grasp, under conditions that the selection has not seen.
    pub trials: usize,
    /// Protocol of the trials.
    pub trial: TrialOptions,
    /// Seed of everything random.
    pub seed: u64,
}

impl Default for FindOptions {
    /// 20,000 candidates, 20 simulated grasps, 24 trials of the chosen one.
    fn default() -> Self {
        Self { candidates: 20_000, simulated: 20, trials: 24, trial: TrialOptions::default(), seed: 0 }
    }
}

/// A grasp that was chosen, and how it went.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct TriedGrasp {
    /// The grasp.
    pub grasp: Grasp,
    /// Grip force for the object's mass and friction, sum of the normal forces, N.
    pub grip_force_n: f64,
    /// Share of the conditions of the selection under which it held. It was chosen for them; the trials have others.
    pub selected_share: f64,
    /// Number of trials in which the object stayed in the hand.
    pub held: usize,
    /// How each trial ended.
    pub verdicts: Vec<Verdict>,
    /// 95 % interval of the share of trials that hold (Wilson).
    pub interval: Interval,
}

/// Finds a grasp of the object by the hand that holds in simulation; `None` if none does. The same for any number of threads.
///
/// # Errors
/// If the mass or friction of the object is none, the hand has no thumb, finger or collision shapes, its model does not say what its motors give, or the object cannot be
/// simulated.
pub fn find_grasp(object: &Object, hand: &Robot, options: &FindOptions) -> Result<Option<TriedGrasp>> {
    find_grasp_watched(object, hand, options, &|_| ControlFlow::Continue(()))
}

/// [`find_grasp`], which tells `watch` about which part of the work is done, from 0 to 1, and stops where that says so. It is called from
/// several threads.
///
/// # Errors
/// As [`find_grasp`]; [`Error::Stopped`](crate::Error::Stopped) if it was stopped.
pub fn find_grasp_watched(
    object: &Object,
    hand: &Robot,
    options: &FindOptions,
    watch: &(dyn Fn(f64) -> ControlFlow<()> + Sync),
) -> Result<Option<TriedGrasp>> {
    let grasps = |hand: &Robot| Ok(synthesize_grasps(object, hand, options.candidates, options.seed)?);
    find(object, hand, &grasps, options, watch)
}

/// [`find_grasp_watched`] among these grasps of the hand instead of those of a search.
///
/// # Errors
/// As [`find_grasp_watched`]; if one is no grasp of the hand.
pub fn find_grasp_among(
    object: &Object,
    hand: &Robot,
    grasps: &[Grasp],
    options: &FindOptions,
    watch: &(dyn Fn(f64) -> ControlFlow<()> + Sync),
) -> Result<Option<TriedGrasp>> {
    find(object, hand, &|_| Ok(grasps.to_vec()), options, watch)
}

fn find(
    object: &Object,
    hand: &Robot,
    grasps: &dyn Fn(&Robot) -> Result<Vec<Grasp>>,
    options: &FindOptions,
    watch: &(dyn Fn(f64) -> ControlFlow<()> + Sync),
) -> Result<Option<TriedGrasp>> {
    check_mass_and_friction(object.mass_kg(), object.friction)?;
    let hand = Arc::new(hand.clone());
    let evaluator = TrialEvaluator::new(object, &hand, &options.trial, Engine::Diffsim)?;
    let done = AtomicUsize::new(0);
    let all = (STEPS_PER_SIMULATED * options.simulated + 2 * options.trials) as f64;
    let go_on = || watch((done.fetch_add(1, Ordering::Relaxed) as f64 / all).min(1.0));
    let evaluator = Stoppable::new(&evaluator, &go_on);
    let grasps = grasps(&hand)?;
    let spread = ConditionSpread::around(Some(object.friction));
    let selection = SelectionOptions {
        spread,
        simulated: options.simulated,
        shake_m_s2: options.trial.shake_m_s2,
        seed: options.seed,
    };
    let selected = select_grasps(object, &hand, &grasps, &evaluator, &[object.mass_kg()], &selection)?;
    let Some(best) = selected.grasps.into_iter().find(|g| g.scores.iter().any(|s| *s > 0.0)) else { return Ok(None) };
    let selected_share = best.scores.iter().filter(|s| **s > 0.0).count() as f64 / best.scores.len() as f64;
    let grasp = best.grasp;
    let conditions = spread.conditions(options.trials, options.seed ^ FIND_SEED);
    let tried = rollouts(&evaluator, &grasp, object.mass_kg(), &conditions)?;
    // Without a command there is no force.
    let grip_force_n = tried.iter().map(|t| t.grip_force_n).find(|n| *n > 0.0);
    let verdicts: Vec<Verdict> = tried.iter().map(|t| t.verdict).collect();
    let held = verdicts.iter().filter(|v| **v == Verdict::Success).count();
    let interval = wilson(held, verdicts.len());
    let _ = watch(1.0);
    Ok(grip_force_n.map(|grip_force_n| TriedGrasp { grasp, grip_force_n, selected_share, held, verdicts, interval }))
}
