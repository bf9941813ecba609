//! What a trial is about, what the hand is told, and what came of it.

use drex_core::Pose;
use drex_grasp::GripForcePolicy;
use serde::{Deserialize, Serialize};

use crate::reach::Reach;
use crate::watch::{SLIP_M, TURN_RAD};
use crate::{ContactForce, Error, Result};

/// The engine that a trial runs in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Engine {
    /// drex-diffsim: the engine that rollouts of the training use.
    Diffsim,
    /// MuJoCo, never used in training; only in builds with the feature `mujoco`.
    Mujoco,
}

impl Engine {
    /// Whether this build has the engine.
    ///
    /// # Errors
    /// [`Error::NoMujoco`].
    pub fn check(self) -> Result<()> {
        match self {
            Self::Mujoco if !cfg!(feature = "mujoco") => Err(Error::NoMujoco),
            _ => Ok(()),
        }
    }
}

/// What the hand assumes of the object before it grasps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Assumed {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Friction between hand and object.
    pub friction: f64,
}

/// What is true in a trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Friction between hand and object, and of the object on the table.
    pub friction: f64,
    /// Where the object is against where the hand believes it: the true resting pose is
    /// `shift * Object::world_from_object` with a shift in the plane and a turn about the vertical through the object.
    pub shift_m: [f64; 2],
    /// Turn about the vertical, rad.
    pub turn_rad: f64,
    /// Seed of the directions in which the hand is shaken.
    pub seed: u64,
}

/// How much the hand grips: sum of normal forces over all contacts, N.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GripForce {
    /// What the cone programme says for the assumed, times the margin of the options.
    Required,
    /// This many newtons, or as many as the motors can give.
    Total(f64),
}

/// What is sent to the hand.
#[derive(Debug, Clone, PartialEq)]
pub struct Command {
    /// Joint angles of the grasp, model order, rad.
    pub joints: Vec<f64>,
    /// Where the palm goes, given where the object is believed to be.
    pub world_from_palm: Pose,
    /// Joint torques of the grip force, Jᵀ f, N m, without what holds the hand's own weight.
    pub torques_nm: Vec<f64>,
    /// Most that each joint brings to bear on the object, N m: the largest of its torques with this grip force at rest and under the shakes that the
    /// law reckons with. A joint that holds its place with no more than its torque at rest gives way when the object is shaken.
    pub limits_nm: Vec<f64>,
    /// Sum of the normal forces, N.
    pub grip_force_n: f64,
    /// Sum of the normal forces per finger, N; the palm is not among them.
    pub per_finger_n: Vec<f64>,
    /// The forces that make the grip force, with the believed object at rest on the table.
    pub contact_forces: Vec<ContactForce>,
    pub(crate) reach: Reach,
}

/// Why there is no command.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NoCommand {
    /// The grasp does not touch the believed object with two fingers.
    #[error("{touching} fingers touch the object; a grasp needs two")]
    NoContact {
        /// Fingers that touch.
        touching: usize,
    },
    /// On its way to the object the hand would press on the table.
    #[error("the closing hand presses on the table with {force_n:.1} N; take a grasp that is higher")]
    Table {
        /// Largest force, N.
        force_n: f64,
    },
    /// The contacts cannot carry the believed weight.
    #[error("the contacts cannot carry the object: {0}")]
    CannotCarry(String),
    /// The motors cannot give the torques.
    #[error("the motors are too weak: {0}")]
    TorqueLimit(String),
    /// The object would be damaged.
    #[error("the grip force would damage the object: {0}")]
    Crushes(String),
}

impl NoCommand {
    /// The verdict on a grasp for which there is no command.
    pub fn verdict(&self) -> Verdict {
        match self {
            Self::NoContact { .. } => Verdict::NoContact,
            Self::Table { .. } => Verdict::Table,
            Self::TorqueLimit(_) => Verdict::TorqueLimit,
            Self::Crushes(_) => Verdict::Crushed,
            Self::CannotCarry(_) => Verdict::CannotCarry,
        }
    }
}

/// How a trial ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Verdict {
    /// The object stayed in the hand through lift, hold and shakes.
    Success,
    /// Fewer than two fingers touched it when the lift began.
    NoContact,
    /// The hand hit the table.
    Table,
    /// It moved in the hand by more than allowed.
    Slip,
    /// It left the hand.
    Drop,
    /// A finger pressed harder than it stands.
    Crushed,
    /// Hand and object were inside each other by more than allowed.
    Penetration,
    /// The motors were asked for more than they have: no command was possible.
    TorqueLimit,
    /// The contacts cannot carry the load on paper: no command was possible.
    CannotCarry,
    /// The simulation did not come to an end.
    Diverged,
}

/// What was measured in a trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Outcome {
    /// How it ended.
    pub verdict: Verdict,
    /// When the first rule was broken, s; `None` for a success.
    pub failed_at_s: Option<f64>,
    /// Grip force that was commanded, N.
    #[serde(rename = "squeeze_n")]
    pub grip_force_n: f64,
    /// Grip force that was delivered: sum of the normal forces of hand and object, mean over the hold, N; `None` if the trial ended before.
    pub held_n: Option<f64>,
    /// Largest normal force of one finger, N.
    pub peak_finger_n: f64,
    /// Longest way that the object slid over the skin of one finger after the lift began, m.
    pub slip_m: f64,
    /// Largest turn of it in the palm's frame after the lift began, rad.
    pub turn_rad: f64,
    /// Deepest penetration of hand and object, m.
    pub penetration_m: f64,
    /// Fingers that touched at the end of the grip force.
    pub fingers_in_contact: Vec<bool>,
    /// Share of the time from the start of the lift in which at least two fingers held it.
    pub retained: f64,
    /// Share of the friction cone that was used in the hold, weighed by normal force; 1 slips.
    pub friction_used: Option<f64>,
}

impl Outcome {
    /// Whether the object stayed in the hand.
    pub fn succeeded(&self) -> bool {
        self.verdict == Verdict::Success
    }

    /// How far the trial stayed from breaking the rules of slip and turn: 1 if nothing moved in the hand, 0 at a limit and for every failure.
    pub fn safety_margin(&self) -> f64 {
        let used = (self.slip_m / SLIP_M).max(self.turn_rad / TURN_RAD);
        if self.succeeded() { (1.0 - used).max(0.0) } else { 0.0 }
    }
}

/// What can be seen of a trial at one time.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Frame {
    /// From the start of the trial, s.
    pub time_s: f64,
    /// The hand's base.
    pub world_from_base: Pose,
    /// Joint angles, model order, rad.
    pub joints: Vec<f64>,
    /// The object.
    pub world_from_object: Pose,
    /// Normal force of each finger, smoothed over 10 ms, N.
    pub finger_n: Vec<f64>,
}

/// The rules and times of the protocol.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct TrialOptions {
    /// How much harder than just enough it grips.
    pub law: GripForcePolicy,
    /// Acceleration of the shakes, m/s².
    pub shake_m_s2: f64,
    /// Time step of both engines, 1e-4 to 0.004 s.
    pub dt_s: f64,
}

impl Default for TrialOptions {
    fn default() -> Self {
        Self { law: GripForcePolicy::default(), shake_m_s2: 0.5 * 9.81, dt_s: 2e-3 }
    }
}

impl Truth {
    /// What is believed is true.
    pub fn as_assumed(assumed: &Assumed, seed: u64) -> Self {
        Self { mass_kg: assumed.mass_kg, friction: assumed.friction, shift_m: [0.0; 2], turn_rad: 0.0, seed }
    }

    pub(crate) fn check(&self) -> Result<()> {
        check_mass_and_friction(self.mass_kg, self.friction)?;
        if !(self.shift_m.iter().all(|x| x.abs() < 1.0) && self.turn_rad.is_finite()) {
            return Err(Error::value(
                format!(
                    "the object is {:?} m and {} rad away from where it is believed to be",
                    self.shift_m, self.turn_rad
                ),
                "give metres and radians",
            ));
        }
        Ok(())
    }
}

impl TrialOptions {
    pub(crate) fn check(&self) -> Result<()> {
        let demands = [
            ("shake_m_s2", self.shake_m_s2, self.shake_m_s2 >= 0.0),
            ("dt_s", self.dt_s, (1e-4..=0.004).contains(&self.dt_s)),
        ];
        match demands.into_iter().find(|(_, value, met)| !(*met && value.is_finite())) {
            Some((name, value, _)) => {
                Err(Error::value(format!("option {name} is {value}"), "start from TrialOptions::default()"))
            }
            None => Ok(()),
        }
    }
}

/// Masses from a gram to a hundred kilograms, frictions from nearly nothing to five.
pub(crate) fn check_mass_and_friction(mass_kg: f64, friction: f64) -> Result<()> {
    if !(1e-3..=100.0).contains(&mass_kg) {
        return Err(Error::value(format!("a mass of {mass_kg} kg"), "give kilograms, 0.001 to 100"));
    }
    if !(1e-3..=5.0).contains(&friction) {
        return Err(Error::value(format!("a friction of {friction}"), "give a Coulomb coefficient, 0.001 to 5"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leeway_is_what_the_rules_of_slip_and_turn_leave() {
        let of = |verdict, slip_mm: f64, turn_deg: f64| {
            let outcome = Outcome {
                verdict,
                failed_at_s: None,
                grip_force_n: 5.0,
                held_n: None,
                peak_finger_n: 0.0,
                slip_m: 1e-3 * slip_mm,
                turn_rad: turn_deg.to_radians(),
                penetration_m: 0.0,
                fingers_in_contact: Vec::new(),
                retained: 1.0,
                friction_used: None,
            };
            outcome.safety_margin()
        };
        // 5 mm and 15 degrees are the limits.
        assert!((of(Verdict::Success, 2.0, 3.0) - 0.6).abs() < 1e-12);
        assert!((of(Verdict::Success, 0.5, 12.0) - 0.2).abs() < 1e-12);
        assert!((of(Verdict::Success, 0.0, 0.0) - 1.0).abs() < 1e-12);
        assert!(of(Verdict::Drop, 2.0, 3.0) < 1e-12);
    }
}
