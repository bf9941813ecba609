//! A grasp for an object that nobody has shown how to hold: synthesis, selection, and a trial of the best.

use std::sync::Arc;

use drex_core::Object;
use drex_grasp::{Grasp, synthesize_grasps};
use drex_robot::Robot;
use rayon::prelude::*;

use crate::assumed::check_mass_and_friction;
use crate::{
    ConditionSpread, Engine, Evaluator, GripForce, Interval, Result, SelectionOptions, TrialEvaluator, TrialOptions,
    Verdict, select_grasps, wilson,
};

/// Distinguishes the seeds of the last trials from those of the selection.
const FIND_SEED: u64 = 0x6669_6e64;

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
    check_mass_and_friction(object.mass_kg(), object.friction)?;
    let hand = Arc::new(hand.clone());
    let evaluator = TrialEvaluator::new(object, &hand, &options.trial, Engine::Diffsim)?;
    let grasps = synthesize_grasps(object, &hand, options.candidates, options.seed)?;
    let spread = ConditionSpread::around(Some(object.friction));
    let selection = SelectionOptions {
        spread,
        simulated: options.simulated,
        shake_m_s2: options.trial.shake_m_s2,
        seed: options.seed,
    };
    let selected = select_grasps(object, &hand, &grasps, &evaluator, &[object.mass_kg()], &selection)?;
    let Some(best) = selected.grasps.into_iter().find(|g| g.scores.iter().any(|s| *s > 0.0)) else { return Ok(None) };
    let grasp = best.grasp;
    let mass_kg = object.mass_kg();
    let conditions = spread.conditions(options.trials, options.seed ^ FIND_SEED);
    let tried: Vec<(Option<f64>, Verdict)> = conditions
        .into_par_iter()
        .map(|condition| {
            let assumed = condition.assumed(mass_kg);
            let closed = evaluator.close(&grasp, &assumed)?;
            Ok(match evaluator.command(&closed, &assumed, GripForce::Required)? {
                Ok(command) => {
                    let verdict = evaluator.evaluate(&command, &condition.truth(mass_kg))?.verdict;
                    (Some(command.grip_force_n), verdict)
                }
                Err(reason) => (None, reason.verdict()),
            })
        })
        .collect::<Result<_>>()?;
    let grip_force_n = tried.iter().find_map(|(force, _)| *force);
    let verdicts: Vec<Verdict> = tried.into_iter().map(|(_, verdict)| verdict).collect();
    let held = verdicts.iter().filter(|v| **v == Verdict::Success).count();
    let interval = wilson(held, verdicts.len());
    Ok(grip_force_n.map(|grip_force_n| TriedGrasp { grasp, grip_force_n, held, verdicts, interval }))
}
