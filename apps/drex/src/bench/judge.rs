//! Who says whether a grasp holds: a simulator, or in tests a formula.

use drex_core::stats::normal_pair;
use std::sync::Arc;

use anyhow::Result;
use drex_core::Pose;
use drex_robot::Robot;
use drex_trial::{
    Belief, Command, Frame, Judge as Engine, NoCommand, Outcome, Rehearsal, Squeeze, Trial, TrialOptions, Truth,
    Verdict,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::thing::Thing;

/// What differs from rollout to rollout; the same list for every cell of a table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Condition {
    /// True friction.
    pub friction: f64,
    /// What the hand is told of it, as a factor.
    pub friction_told: f64,
    /// Where the object is against where the hand believes it, metres and rad.
    pub shift_m: [f64; 2],
    pub turn_rad: f64,
    /// A draw of the normal distribution: how far an identified mass is off, in standard deviations.
    pub mass_error: f64,
    /// Of the shakes.
    pub seed: u64,
}

/// How conditions are drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// True friction is even in this range.
    pub friction: (f64, f64),
    /// It is told to within this share.
    pub friction_told: f64,
    /// Largest shift, metres: even in the disc.
    pub shift_m: f64,
    /// Largest turn, rad: even.
    pub turn_rad: f64,
}

impl Default for Spread {
    fn default() -> Self {
        Self { friction: (0.3, 0.8), friction_told: 0.1, shift_m: 0.005, turn_rad: 5.0_f64.to_radians() }
    }
}

impl Spread {
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
                let friction_told = 1.0 + even(-self.friction_told, self.friction_told);
                let (radius, angle) = (self.shift_m * even(0.0, 1.0).sqrt(), even(0.0, std::f64::consts::TAU));
                let turn_rad = even(-self.turn_rad, self.turn_rad);
                let [mass_error, _] = normal_pair(even(0.0, 1.0), std::f64::consts::TAU * even(0.0, 1.0));
                Condition {
                    friction,
                    friction_told,
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
    /// What the hand is told when it takes the object for `mass_kg`.
    pub fn belief(&self, mass_kg: f64) -> Belief {
        Belief { mass_kg, friction: self.friction * self.friction_told }
    }

    /// What is true of an object of `mass_kg`.
    pub fn truth(&self, mass_kg: f64) -> Truth {
        let Self { friction, shift_m, turn_rad, seed, .. } = *self;
        Truth { mass_kg, friction, shift_m, turn_rad, seed }
    }
}

/// What a judge says of a rollout.
#[derive(Debug, Clone, PartialEq)]
pub struct Judged {
    pub verdict: Verdict,
    /// Squeeze that was commanded, N; zero without a command.
    pub squeeze_n: f64,
    /// Squeeze that was delivered in the hold, N.
    pub held_n: Option<f64>,
    /// Per finger, whether it touched when the lift began.
    pub fingers: Vec<bool>,
    /// Share of the time from then on in which two fingers held.
    pub retained: f64,
    /// Share of the friction that was used.
    pub friction_used: Option<f64>,
    /// How far it stayed from slipping or turning by more than the rules allow: 1 to 0; 0 if it failed.
    pub leeway: f64,
}

impl Judged {
    /// There was no command.
    pub fn refused(reason: &NoCommand) -> Self {
        let verdict = verdict_of(reason);
        Self {
            verdict,
            squeeze_n: 0.0,
            held_n: None,
            fingers: Vec::new(),
            retained: 0.0,
            friction_used: None,
            leeway: 0.0,
        }
    }

    /// Whether the object stayed in the hand.
    pub fn held(&self) -> bool {
        self.verdict == Verdict::Success
    }
}

/// Plans grasps and carries them out.
pub trait Judge: Sync {
    /// A hand that has closed on the object where it is believed to be.
    type Grip: Send + Sync;
    /// A grip with its force, ready to be carried out.
    type Plan: Send + Sync;

    /// Closes the hand around the object as a rehearsal.
    ///
    /// # Errors
    /// If the grasp is none of this hand.
    fn grip(&self, joints: &[f64], object_from_palm: &Pose, belief: &Belief) -> Result<Self::Grip>;

    /// The command for a grip given what the hand is told; the inner error says why there is none.
    ///
    /// # Errors
    /// If a solver gives up.
    fn plan(&self, grip: &Self::Grip, belief: &Belief, squeeze: Squeeze) -> Result<Result<Self::Plan, NoCommand>>;

    /// Sum of the normal forces of that command, N.
    ///
    /// # Errors
    /// If a solver gives up.
    fn squeeze_n(&self, grip: &Self::Grip, belief: &Belief, squeeze: Squeeze) -> Result<Result<f64, NoCommand>>;

    /// Which fingers of a grip touch.
    fn fingers(&self, grip: &Self::Grip) -> Vec<bool>;

    /// Carries it out under what is true, in the engine that learning uses.
    ///
    /// # Errors
    /// If it cannot be simulated at all.
    fn practise(&self, plan: &Self::Plan, truth: &Truth) -> Result<Judged>;

    /// The same, but it ends with the first rule that is broken: what is seen of a failure is its verdict alone.
    ///
    /// # Errors
    /// If it cannot be simulated at all.
    fn try_out(&self, plan: &Self::Plan, truth: &Truth) -> Result<Judged> {
        self.practise(plan, truth)
    }

    /// Carries it out under what is true, in the engine that judges.
    ///
    /// # Errors
    /// If it cannot be simulated at all.
    fn run(&self, plan: &Self::Plan, truth: &Truth) -> Result<Judged>;
}

/// Rollouts in a simulator.
pub struct Rollouts {
    trial: Trial,
    engine: Engine,
}

impl Rollouts {
    /// Of this object with this hand.
    ///
    /// # Errors
    /// If the hand or the object cannot be simulated.
    pub fn new(thing: &Thing, robot: &Arc<Robot>, options: &TrialOptions, engine: Engine) -> Result<Self> {
        Ok(Self { trial: Trial::new(robot.clone(), thing.trial_object(), options.clone())?, engine })
    }

    /// Frames of a command that is carried out in the engine that judges.
    ///
    /// # Errors
    /// If it cannot be simulated at all.
    pub fn film(&self, plan: &Command, truth: &Truth, every_s: f64) -> Result<Vec<Frame>> {
        Ok(self.trial.film(plan, truth, self.engine, every_s)?.1)
    }
}

impl From<Outcome> for Judged {
    fn from(outcome: Outcome) -> Self {
        Self {
            leeway: outcome.leeway(),
            verdict: outcome.verdict,
            squeeze_n: outcome.squeeze_n,
            held_n: outcome.held_n,
            fingers: outcome.fingers_in_contact,
            retained: outcome.retained,
            friction_used: outcome.friction_used,
        }
    }
}

impl Judge for Rollouts {
    type Grip = Rehearsal;
    type Plan = Command;

    fn grip(&self, joints: &[f64], object_from_palm: &Pose, belief: &Belief) -> Result<Rehearsal> {
        Ok(self.trial.rehearse(joints, object_from_palm, belief)?)
    }

    fn plan(&self, grip: &Rehearsal, belief: &Belief, squeeze: Squeeze) -> Result<Result<Command, NoCommand>> {
        Ok(self.trial.squeeze(grip, belief, squeeze)?)
    }

    fn squeeze_n(&self, grip: &Rehearsal, belief: &Belief, squeeze: Squeeze) -> Result<Result<f64, NoCommand>> {
        Ok(self.trial.squeeze_n(grip, belief, squeeze)?)
    }

    fn fingers(&self, grip: &Rehearsal) -> Vec<bool> {
        grip.fingers_in_contact.clone()
    }

    fn practise(&self, plan: &Command, truth: &Truth) -> Result<Judged> {
        Ok(self.trial.run(plan, truth, Engine::Diffsim)?.into())
    }

    fn try_out(&self, plan: &Command, truth: &Truth) -> Result<Judged> {
        Ok(self.trial.try_out(plan, truth, Engine::Diffsim)?.into())
    }

    fn run(&self, plan: &Command, truth: &Truth) -> Result<Judged> {
        Ok(self.trial.run(plan, truth, self.engine)?.into())
    }
}

/// What a table says of a rollout for which there was no command.
pub fn verdict_of(reason: &NoCommand) -> Verdict {
    match reason {
        NoCommand::NoContact { .. } => Verdict::NoContact,
        NoCommand::Table { .. } => Verdict::Table,
        NoCommand::TorqueLimit(_) => Verdict::TorqueLimit,
        NoCommand::Crushes(_) => Verdict::Crushed,
        // CannotCarry, and what may be added.
        _ => Verdict::CannotCarry,
    }
}

#[cfg(test)]
pub mod fake {
    //! A judge that knows one formula: fingers that squeeze with S newtons in all carry μ S against 1.5 times the weight.

    use super::*;

    /// Every grasp works as a pinch would.
    pub struct Pinch {
        /// Largest squeeze of the motors, N.
        pub strongest_n: f64,
    }

    impl Judge for Pinch {
        type Grip = ();
        type Plan = f64;

        fn grip(&self, _: &[f64], _: &Pose, _: &Belief) -> Result<()> {
            Ok(())
        }

        fn plan(&self, (): &(), belief: &Belief, squeeze: Squeeze) -> Result<Result<f64, NoCommand>> {
            let needed = 1.5 * 1.1 * belief.mass_kg * 9.81 / (0.9 * belief.friction);
            let wanted = match squeeze {
                Squeeze::Needed => needed,
                Squeeze::Total(n) => n,
            };
            if wanted > self.strongest_n {
                return Ok(Err(NoCommand::TorqueLimit(format!("{wanted:.1} N"))));
            }
            Ok(Ok(wanted))
        }

        fn squeeze_n(&self, grip: &Self::Grip, belief: &Belief, squeeze: Squeeze) -> Result<Result<f64, NoCommand>> {
            self.plan(grip, belief, squeeze)
        }

        fn fingers(&self, (): &()) -> Vec<bool> {
            vec![true; 4]
        }

        fn practise(&self, plan: &f64, truth: &Truth) -> Result<Judged> {
            self.run(plan, truth)
        }

        fn run(&self, plan: &f64, truth: &Truth) -> Result<Judged> {
            let load = 1.5 * truth.mass_kg * 9.81;
            let carries = truth.friction * plan;
            let holds = carries >= load;
            Ok(Judged {
                verdict: if holds { Verdict::Success } else { Verdict::Slip },
                squeeze_n: *plan,
                held_n: holds.then_some(*plan),
                fingers: vec![true; 4],
                retained: if holds { 1.0 } else { 0.3 },
                friction_used: holds.then(|| load / carries),
                leeway: if holds { 1.0 - load / carries } else { 0.0 },
            })
        }
    }

    /// Pinches as strong, N, as the first joint says.
    pub struct ByHand;

    impl Judge for ByHand {
        type Grip = f64;
        type Plan = f64;

        fn grip(&self, joints: &[f64], _: &Pose, _: &Belief) -> Result<f64> {
            Ok(joints[0])
        }

        fn plan(&self, grip: &f64, belief: &Belief, squeeze: Squeeze) -> Result<Result<f64, NoCommand>> {
            Pinch { strongest_n: *grip }.plan(&(), belief, squeeze)
        }

        fn squeeze_n(&self, grip: &Self::Grip, belief: &Belief, squeeze: Squeeze) -> Result<Result<f64, NoCommand>> {
            self.plan(grip, belief, squeeze)
        }

        fn fingers(&self, _: &f64) -> Vec<bool> {
            vec![true; 4]
        }

        fn practise(&self, plan: &f64, truth: &Truth) -> Result<Judged> {
            self.run(plan, truth)
        }

        fn run(&self, plan: &f64, truth: &Truth) -> Result<Judged> {
            Pinch { strongest_n: f64::INFINITY }.run(plan, truth)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_are_the_same_whatever_their_number_and_within_the_spread() {
        let (few, many) = (Spread::default().conditions(20, 7), Spread::default().conditions(400, 7));
        assert_eq!(few[..], many[..20]);
        assert_ne!(few, Spread::default().conditions(20, 8));
        for c in &many {
            assert!((0.3..=0.8).contains(&c.friction) && (0.9..=1.1).contains(&c.friction_told));
            assert!(c.shift_m[0].hypot(c.shift_m[1]) <= 0.005 && c.turn_rad.abs() <= 0.0873);
        }
        let mean = many.iter().map(|c| c.friction).sum::<f64>() / 400.0;
        let spread = (many.iter().map(|c| c.mass_error.powi(2)).sum::<f64>() / 400.0).sqrt();
        assert!((mean - 0.55).abs() < 0.03 && (spread - 1.0).abs() < 0.12, "{mean} {spread}");
        let known = Spread::around(Some(0.6)).conditions(50, 1);
        assert!(known.iter().all(|c| (0.54..=0.66).contains(&c.friction)));
    }
}
