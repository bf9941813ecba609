//! Who says whether a grasp holds: a simulator, or in tests a formula.

use std::sync::Arc;

use anyhow::Result;
use drex_core::Pose;
use drex_grasp::{ContactOptions, GraspError, HandSurface, SqueezeError, SqueezeProblem, TorqueLimits};
use drex_robot::Robot;
use drex_trial::{
    Belief, Command, Judge as Engine, NoCommand, Squeeze, Trial, TrialObject, TrialOptions, Truth, Verdict,
};
use nalgebra::Vector3;
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
                // Box and Muller.
                let (u, v) = (even(0.0, 1.0), even(0.0, 1.0));
                let mass_error = (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos();
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
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Judged {
    pub verdict: Verdict,
    /// Squeeze that was commanded, N; zero without a command.
    pub squeeze_n: f64,
}

/// Plans grasps and carries them out.
pub trait Judge: Sync {
    /// A grasp ready to be carried out.
    type Plan: Send;

    /// The command for a grasp given what the hand is told; the inner error says why there is none.
    ///
    /// # Errors
    /// If the grasp is none of this hand.
    fn plan(
        &self,
        joints: &[f64],
        object_from_palm: &Pose,
        belief: &Belief,
        squeeze: Squeeze,
    ) -> Result<Result<Self::Plan, NoCommand>>;

    /// What the force law asks for on paper, at the contacts of the grasp as it is told, N; `None` if it cannot hold so.
    ///
    /// # Errors
    /// If the grasp is none of this hand.
    fn needed_n(&self, joints: &[f64], object_from_palm: &Pose, belief: &Belief) -> Result<Option<f64>>;

    /// Carries it out under what is true.
    ///
    /// # Errors
    /// If it cannot be simulated at all.
    fn run(&self, plan: &Self::Plan, truth: &Truth) -> Result<Judged>;
}

/// Rollouts in a simulator.
pub struct Rollouts {
    trial: Trial,
    engine: Engine,
    robot: Arc<Robot>,
    surface: HandSurface,
    object: TrialObject,
    options: TrialOptions,
}

/// A finger that is this near will touch when the hand closes, metres.
const TOUCH_M: f64 = 0.006;
/// A hand deeper in the object than this is no grasp, metres.
const DEEPEST_M: f64 = 0.012;

impl Rollouts {
    /// Of this object with this hand.
    ///
    /// # Errors
    /// If the hand or the object cannot be simulated.
    pub fn new(thing: &Thing, robot: &Arc<Robot>, options: &TrialOptions, engine: Engine) -> Result<Self> {
        let object = thing.trial_object();
        Ok(Self {
            trial: Trial::new(robot.clone(), object.clone(), options.clone())?,
            engine,
            robot: robot.clone(),
            surface: HandSurface::new(robot, ContactOptions::default().spacing_m)?,
            object,
            options: options.clone(),
        })
    }
}

impl Judge for Rollouts {
    type Plan = Command;

    fn plan(
        &self,
        joints: &[f64],
        object_from_palm: &Pose,
        belief: &Belief,
        squeeze: Squeeze,
    ) -> Result<Result<Command, NoCommand>> {
        Ok(self.trial.command(joints, object_from_palm, belief, squeeze)?)
    }

    fn needed_n(&self, joints: &[f64], object_from_palm: &Pose, belief: &Belief) -> Result<Option<f64>> {
        let Self { robot, surface, object, options, .. } = self;
        let distance = object.surface.as_ref();
        let links = robot.forward_kinematics(joints, object_from_palm);
        if surface.depths(&links, distance, 0.0).into_iter().any(|d| d > DEEPEST_M) {
            return Ok(None);
        }
        let mut contact = ContactOptions::with_friction(belief.friction);
        contact.max_gap_m = TOUCH_M;
        let contacts = surface.contacts(robot, joints, object_from_palm, distance, &contact)?;
        let gravity = object.world_from_object.rotation.inverse() * Vector3::new(0.0, 0.0, -9.81);
        let mut torques = TorqueLimits::of_robot(robot, joints, object_from_palm, &contacts, &gravity)?;
        torques.limits_nm = vec![(-options.torque_cap_nm, options.torque_cap_nm); robot.dof()];
        let center = object.properties.center_of_mass;
        let mut problem = SqueezeProblem::new(contacts, belief.mass_kg, center, gravity).with_torques(torques);
        problem.max_normal_n = object.max_finger_n;
        match options.law.command(&problem) {
            Ok(command) => Ok(Some(command.total_n)),
            Err(SqueezeError::Input(GraspError::Solver { .. })) => Ok(None),
            Err(SqueezeError::Input(error)) => Err(error.into()),
            Err(_) => Ok(None),
        }
    }

    fn run(&self, plan: &Command, truth: &Truth) -> Result<Judged> {
        let outcome = self.trial.run(plan, truth, self.engine)?;
        Ok(Judged { verdict: outcome.verdict, squeeze_n: outcome.squeeze_n })
    }
}

/// What a table says of a rollout for which there was no command.
pub fn verdict_of(reason: &NoCommand) -> Verdict {
    match reason {
        NoCommand::NoContact { .. } => Verdict::NoContact,
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
        type Plan = f64;

        fn plan(&self, _: &[f64], _: &Pose, belief: &Belief, squeeze: Squeeze) -> Result<Result<f64, NoCommand>> {
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

        fn needed_n(&self, joints: &[f64], pose: &Pose, belief: &Belief) -> Result<Option<f64>> {
            Ok(self.plan(joints, pose, belief, Squeeze::Needed)?.ok())
        }

        fn run(&self, plan: &f64, truth: &Truth) -> Result<Judged> {
            let holds = truth.friction * plan >= 1.5 * truth.mass_kg * 9.81;
            Ok(Judged { verdict: if holds { Verdict::Success } else { Verdict::Slip }, squeeze_n: *plan })
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
