//! A joint and its motor: angles and ticks, and how it is doing.

use std::time::Duration;

use super::options::{LeapGains, LeapJoint};
use super::table::{RAD_PER_TICK, TICKS_PER_TURN};

/// Ticks of a turn.
const TURN: i64 = TICKS_PER_TURN as i64;

/// What a motor said about itself when it was last asked.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct MotorHealth {
    /// Temperature, °C.
    pub temperature_c: f64,
    /// Supply voltage, V.
    pub voltage_v: f64,
    /// Hardware errors, bits as in [`table::hardware_error`](super::table::hardware_error).
    pub hardware_error: u8,
}

/// What is being done with a motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MotorState {
    /// Set up, without torque.
    TorqueOff,
    /// Under torque since then.
    Driven { since: Duration },
    /// Stopped itself or cannot be set up.
    Faulted { bits: u8 },
    /// Deaf after a reboot: is asked at `next` whether it is back.
    Booting { next: Duration, give_up: Duration },
    /// Is being set up, see [`super::setup`].
    Setup { step: u8, give_up: Duration },
}

#[derive(Debug)]
pub(super) struct Joint {
    pub id: u8,
    pub name: String,
    pub gains: LeapGains,
    pub state: MotorState,
    /// Exchanges since it last answered.
    pub missed: u32,
    /// Did not answer for so long that it is no longer asked with the others.
    pub absent: bool,
    pub recoveries: u32,
    /// Whether its last answer said that it has a hardware error.
    pub alert: bool,
    /// rad, rad/s and mA when it last answered.
    pub position: f64,
    pub velocity: f64,
    pub current: f64,
    pub health: Option<MotorHealth>,
    /// Its hardware errors when they were last read.
    pub errors: u8,
    /// What was last wrong with it.
    pub fault: Option<String>,
    zero: i64,
    sign: i64,
    /// Whole turns that the motor counts too many, in the model's direction.
    turns: i64,
    /// Limits inside which goals stay, ticks from zero in the model's direction.
    low: i64,
    high: i64,
}

impl Joint {
    /// A joint that has to be set up, with `limits` in rad.
    pub fn new(wiring: &LeapJoint, gains: LeapGains, limits: (f64, f64)) -> Self {
        Self {
            id: wiring.id,
            name: wiring.name.clone(),
            gains,
            state: MotorState::Faulted { bits: 0 },
            missed: u32::MAX,
            absent: false,
            recoveries: 0,
            alert: false,
            position: 0.0,
            velocity: 0.0,
            current: 0.0,
            health: None,
            errors: 0,
            fault: None,
            zero: i64::from(wiring.zero_ticks),
            sign: if wiring.reversed { -1 } else { 1 },
            turns: 0,
            // Rounded inwards.
            low: (limits.0 / RAD_PER_TICK).ceil() as i64,
            high: (limits.1 / RAD_PER_TICK).floor() as i64,
        }
    }

    /// Finds how many turns too many the motor counts: it forgets them without power. Whether the joint is within its limits,
    /// give or take `outside` rad, for some number of turns.
    pub fn count_turns(&mut self, ticks: i32, outside: f64) -> bool {
        let counted = self.sign * (i64::from(ticks) - self.zero);
        self.turns = (counted - (self.low + self.high) / 2 + TURN / 2).div_euclid(TURN);
        let (ticks, outside) = (counted - self.turns * TURN, (outside / RAD_PER_TICK) as i64);
        (self.low - outside..=self.high + outside).contains(&ticks)
    }

    /// Angle, rad, at a reading of the motor.
    pub fn angle(&self, ticks: i32) -> f64 {
        (self.sign * (i64::from(ticks) - self.zero) - self.turns * TURN) as f64 * RAD_PER_TICK
    }

    /// Goal for the motor, ticks, for an angle, rad, that is first clipped to the limits.
    pub fn goal(&self, angle: f64) -> i32 {
        let ticks = ((angle / RAD_PER_TICK).round() as i64).clamp(self.low, self.high);
        let goal = self.zero + self.sign * (ticks + self.turns * TURN);
        // A motor counts up to 256 turns, so that this changes nothing.
        goal.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
    }

    /// A number that the motor gives or takes with its own sign, in the model's direction, or back.
    pub fn directed(&self, value: f64) -> f64 {
        self.sign as f64 * value
    }

    /// Whether it is asked together with the others.
    pub fn is_asked(&self) -> bool {
        !self.absent && !matches!(self.state, MotorState::Booting { .. })
    }
}
