//! Whether a grasp holds under conditions that are drawn: by simulation, or in tests by a formula.

use std::borrow::Cow;
use std::sync::Arc;

use drex_core::Object;
use drex_core::stats::normal_pair;
use drex_grasp::Grasp;
use drex_robot::Robot;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::{
    Assumed, ClosingPlan, Command, Engine, Frame, GripForce, Mismatch, NoCommand, Outcome, Result, Trial, TrialOptions,
    Truth, Verdict,
};

/// What differs from rollout to rollout.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Condition {
    /// True coefficient of friction.
    pub friction: f64,
    /// Ratio of the friction that the hand assumes to the true one.
    pub friction_factor: f64,
    /// Shift of the object in the plane of the table against where the hand assumes it, metres.
    pub shift_m: [f64; 2],
    /// Turn of the object about the vertical against how the hand assumes it, rad.
    pub turn_rad: f64,
    /// Error of an identified mass in standard deviations: a draw of the standard normal distribution.
    pub mass_error: f64,
    /// Seed of the directions in which the hand is shaken.
    pub seed: u64,
}

/// The distribution that conditions are drawn from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConditionSpread {
    /// Range of the true coefficient of friction, which is uniform in it.
    pub friction: (f64, f64),
    /// Largest relative error of the friction that the hand assumes, which is uniform.
    pub friction_error: f64,
    /// Largest shift, metres: uniform in the disc of this radius.
    pub shift_m: f64,
    /// Largest turn either way, rad: uniform.
    pub turn_rad: f64,
}

impl Default for ConditionSpread {
    fn default() -> Self {
        Self { friction: (0.3, 0.8), friction_error: 0.1, shift_m: 0.005, turn_rad: 5.0_f64.to_radians() }
    }
}

impl ConditionSpread {
    /// The spread for an object whose friction is known: a tenth around it.
    pub fn around(friction: Option<f64>) -> Self {
        let mut spread = Self::default();
        if let Some(mu) = friction {
            spread.friction = (0.9 * mu, 1.1 * mu);
        }
        spread
    }

    /// The first `n` conditions of a seed.
    pub fn conditions(&self, n: usize, seed: u64) -> Vec<Condition> {
        (0..n)
            .map(|i| {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                rng.set_stream(i as u64);
                let mut even = |lo: f64, hi: f64| lo + (hi - lo) * rng.random::<f64>();
                let friction = even(self.friction.0, self.friction.1);
                let friction_factor = 1.0 + even(-self.friction_error, self.friction_error);
                let (radius, angle) = (self.shift_m * even(0.0, 1.0).sqrt(), even(0.0, std::f64::consts::TAU));
                let turn_rad = even(-self.turn_rad, self.turn_rad);
                let [mass_error, _] = normal_pair(even(0.0, 1.0), std::f64::consts::TAU * even(0.0, 1.0));
                Condition {
                    friction,
                    friction_factor,
                    shift_m: [radius * angle.cos(), radius * angle.sin()],
                    turn_rad,
                    mass_error,
                    seed: rng.random(),
                }
            })
            .collect()
    }
}

impl Condition {
    /// The properties that a hand assumes which takes the object for `mass_kg`.
    pub fn assumed(&self, mass_kg: f64) -> Assumed {
        Assumed { mass_kg, friction: self.friction * self.friction_factor }
    }

    /// The true properties of an object of `mass_kg`.
    pub fn truth(&self, mass_kg: f64) -> Truth {
        let Self { friction, shift_m, turn_rad, seed, .. } = *self;
        Truth { mass_kg, friction, shift_m, turn_rad, seed }
    }
}

/// What became of a rollout.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// How the trial ended.
    pub verdict: Verdict,
    /// Grip force that was commanded, sum of the normal forces, N; zero without a command.
    pub grip_force_n: f64,
    /// Grip force that was delivered in the hold, N.
    pub held_n: Option<f64>,
    /// Largest normal force of one finger in the whole trial, N; zero without a command.
    pub peak_finger_n: f64,
    /// For each finger whether it touched when the lift began.
    pub fingers: Vec<bool>,
    /// Share of the time from the start of the lift in which at least two fingers held the object.
    pub retained: f64,
    /// Share of the friction cone that was used in the hold.
    pub friction_used: Option<f64>,
    /// Distance from slipping or turning by more than the rules allow, from 1 (nothing moved) to 0 (at a limit, or failed).
    pub safety_margin: f64,
}

impl Evaluation {
    /// The evaluation of a grasp for which there is no command.
    pub fn refused(reason: &NoCommand) -> Self {
        let verdict = reason.verdict();
        Self {
            verdict,
            grip_force_n: 0.0,
            held_n: None,
            peak_finger_n: 0.0,
            fingers: Vec::new(),
            retained: 0.0,
            friction_used: None,
            safety_margin: 0.0,
        }
    }

    /// Whether the object stayed in the hand.
    pub fn held(&self) -> bool {
        self.verdict == Verdict::Success
    }
}

/// Plans grasps and evaluates them.
pub trait Evaluator: Sync {
    /// A hand that has closed on the object where it is assumed to be.
    type Closed: Send + Sync;
    /// A closed hand with its grip force, ready to be carried out.
    type Command: Send + Sync;

    /// Closes the hand around the object in a dry run.
    ///
    /// # Errors
    /// If the grasp is none of the hand.
    fn close(&self, grasp: &Grasp, assumed: &Assumed) -> Result<Self::Closed>;

    /// The hand as the grasp has it, without a dry run: its contacts are those of the grasp at rest.
    ///
    /// # Errors
    /// If the grasp is none of the hand.
    fn as_proposed(&self, grasp: &Grasp, assumed: &Assumed) -> Result<Self::Closed>;

    /// The command of a closed hand given what is assumed; the inner error says why there is none.
    ///
    /// # Errors
    /// If a solver gives up.
    fn command(
        &self,
        closed: &Self::Closed,
        assumed: &Assumed,
        force: GripForce,
    ) -> Result<Result<Self::Command, NoCommand>>;

    /// Sum of the normal forces of that command, N.
    ///
    /// # Errors
    /// If a solver gives up.
    fn grip_force_n(
        &self,
        closed: &Self::Closed,
        assumed: &Assumed,
        force: GripForce,
    ) -> Result<Result<f64, NoCommand>>;

    /// For each finger whether it touches in the closed hand.
    fn fingers(&self, closed: &Self::Closed) -> Vec<bool>;

    /// Carries a command out under what is true, in the engine that learning uses.
    ///
    /// # Errors
    /// If it cannot be simulated at all.
    fn validate(&self, command: &Self::Command, truth: &Truth) -> Result<Evaluation>;

    /// The same until the first rule is broken: of a failure only the verdict is known.
    ///
    /// # Errors
    /// If it cannot be simulated at all.
    fn validate_until_failure(&self, command: &Self::Command, truth: &Truth) -> Result<Evaluation> {
        self.validate(command, truth)
    }

    /// Carries a command out under what is true, in the engine that evaluates.
    ///
    /// # Errors
    /// If it cannot be simulated at all.
    fn evaluate(&self, command: &Self::Command, truth: &Truth) -> Result<Evaluation>;
}

/// The grasp under each of the conditions: commanded for an object of `mass_kg` as the hand assumes it there, and carried out in the
/// engine that evaluates. The same for any number of threads.
///
/// # Errors
/// If the grasp is none of the hand, or cannot be simulated at all.
pub fn rollouts<E: Evaluator>(
    evaluator: &E,
    grasp: &Grasp,
    mass_kg: f64,
    conditions: &[Condition],
) -> Result<Vec<Evaluation>> {
    let rollout = |condition: &Condition| {
        let assumed = condition.assumed(mass_kg);
        let closed = evaluator.close(grasp, &assumed)?;
        match evaluator.command(&closed, &assumed, GripForce::Required)? {
            Ok(command) => evaluator.evaluate(&command, &condition.truth(mass_kg)),
            Err(reason) => Ok(Evaluation::refused(&reason)),
        }
    };
    conditions.par_iter().map(rollout).collect()
}

/// Evaluation by trials in a simulator.
pub struct TrialEvaluator {
    trial: Trial,
    engine: Engine,
    /// What is off where it evaluates.
    evaluated: Option<Mismatch>,
}

impl TrialEvaluator {
    /// Prepares trials of this object with this hand; [`Evaluator::evaluate`] runs them in `engine`.
    ///
    /// # Errors
    /// As [`Trial::new`].
    pub fn new(object: &Object, robot: &Arc<Robot>, options: &TrialOptions, engine: Engine) -> Result<Self> {
        let trial = Trial::new(robot.clone(), object.clone(), options.clone())?;
        Ok(Self { trial, engine, evaluated: None })
    }

    /// [`Evaluator::evaluate`] with another hand and another object than those that are planned for, drawn anew for each [`Truth`].
    #[must_use]
    pub fn evaluating_with(self, mismatch: Mismatch) -> Self {
        Self { evaluated: Some(mismatch), ..self }
    }

    /// The hand and the object.
    pub fn trial(&self) -> &Trial {
        &self.trial
    }

    /// Frames of a command that is carried out in the engine that evaluates, one every `every_s` seconds.
    ///
    /// # Errors
    /// As [`Trial::record`].
    pub fn record(&self, command: &Command, truth: &Truth, every_s: f64) -> Result<Vec<Frame>> {
        Ok(self.evaluated(truth)?.record(command, truth, self.engine, every_s)?.1)
    }

    /// The trial by which it evaluates.
    fn evaluated(&self, truth: &Truth) -> Result<Cow<'_, Trial>> {
        match &self.evaluated {
            Some(mismatch) => Ok(Cow::Owned(self.trial.mismatched(mismatch, truth.seed)?)),
            None => Ok(Cow::Borrowed(&self.trial)),
        }
    }
}

impl From<Outcome> for Evaluation {
    fn from(outcome: Outcome) -> Self {
        Self {
            safety_margin: outcome.safety_margin(),
            verdict: outcome.verdict,
            grip_force_n: outcome.grip_force_n,
            held_n: outcome.held_n,
            peak_finger_n: outcome.peak_finger_n,
            fingers: outcome.fingers_in_contact,
            retained: outcome.retained,
            friction_used: outcome.friction_used,
        }
    }
}

impl Evaluator for TrialEvaluator {
    type Closed = ClosingPlan;
    type Command = Command;

    fn close(&self, grasp: &Grasp, assumed: &Assumed) -> Result<ClosingPlan> {
        self.trial.plan_closing(grasp, assumed)
    }

    fn as_proposed(&self, grasp: &Grasp, _: &Assumed) -> Result<ClosingPlan> {
        self.trial.closing_as_proposed(grasp)
    }

    fn command(&self, closed: &ClosingPlan, assumed: &Assumed, force: GripForce) -> Result<Result<Command, NoCommand>> {
        self.trial.command_closed(closed, assumed, force)
    }

    fn grip_force_n(
        &self,
        closed: &ClosingPlan,
        assumed: &Assumed,
        force: GripForce,
    ) -> Result<Result<f64, NoCommand>> {
        self.trial.grip_force_n(closed, assumed, force)
    }

    fn fingers(&self, closed: &ClosingPlan) -> Vec<bool> {
        closed.fingers_in_contact.clone()
    }

    fn validate(&self, command: &Command, truth: &Truth) -> Result<Evaluation> {
        Ok(self.trial.run(command, truth, Engine::Diffsim)?.into())
    }

    fn validate_until_failure(&self, command: &Command, truth: &Truth) -> Result<Evaluation> {
        Ok(self.trial.run_until_failure(command, truth, Engine::Diffsim)?.into())
    }

    fn evaluate(&self, command: &Command, truth: &Truth) -> Result<Evaluation> {
        Ok(self.evaluated(truth)?.run(command, truth, self.engine)?.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_are_the_same_whatever_their_number_and_within_the_spread() {
        let (few, many) = (ConditionSpread::default().conditions(20, 7), ConditionSpread::default().conditions(400, 7));
        assert_eq!(few[..], many[..20]);
        assert_ne!(few, ConditionSpread::default().conditions(20, 8));
        for c in &many {
            assert!((0.3..=0.8).contains(&c.friction) && (0.9..=1.1).contains(&c.friction_factor));
            assert!(c.shift_m[0].hypot(c.shift_m[1]) <= 0.005 && c.turn_rad.abs() <= 0.0873);
        }
        let mean = many.iter().map(|c| c.friction).sum::<f64>() / 400.0;
        let spread = (many.iter().map(|c| c.mass_error.powi(2)).sum::<f64>() / 400.0).sqrt();
        assert!((mean - 0.55).abs() < 0.03 && (spread - 1.0).abs() < 0.12, "{mean} {spread}");
        let known = ConditionSpread::around(Some(0.6)).conditions(50, 1);
        assert!(known.iter().all(|c| (0.54..=0.66).contains(&c.friction)));
    }
}
