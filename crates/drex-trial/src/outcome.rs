//! How a trial ends, and what is measured in it.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Farthest that the object may slide over a finger, m, and turn in the hand, rad.
pub(crate) const SLIP_M: f64 = 0.005;
pub(crate) const TURN_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;
/// The hand may brush the table with this force, N.
pub(crate) const TABLE_N: f64 = 1.0;

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

impl fmt::Display for Verdict {
    /// The name that it has in files, such as "no_contact".
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_verdict_is_called_as_in_files() {
        assert_eq!(Verdict::CannotCarry.to_string(), "cannot_carry");
    }

    #[test]
    fn the_safety_margin_is_what_the_rules_of_slip_and_turn_leave() {
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
