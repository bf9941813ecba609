//! How a LEAP hand is wired and driven.

use std::time::Duration;

use drex_robot::joint_order;

use crate::dynamixel::Timing;
use crate::{Error, Result};

/// A motor and the joint that it moves.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LeapJoint {
    /// Id of the motor.
    pub id: u8,
    /// Name of the joint in the robot model.
    pub name: String,
    /// Reading of the motor at the model's zero, ticks.
    pub zero_ticks: i32,
    /// Whether the motor counts down as the model's angle grows.
    pub reversed: bool,
    /// Homing offset (register 20) with which `zero_ticks` was read, ticks; another one in the motor is a finding.
    pub homing_offset_ticks: i32,
}

/// Gains of a motor's position loop, in the units of its control table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LeapGains {
    /// On the error: mA per tick is this over 256.
    pub p: u16,
    /// On its sum.
    pub i: u16,
    /// On its change. The mode has no damping of its own.
    pub d: u16,
}

/// How a hand is driven.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LeapOptions {
    /// The motors and their joints.
    pub joints: Vec<LeapJoint>,
    /// Gains, in the order of `joints`.
    pub gains: Vec<LeapGains>,
    /// Largest current of every motor, mA; `None` is [`MotorModel::gentle_cap_ma`](super::table::MotorModel::gentle_cap_ma) of the motors
    /// found.
    pub cap_ma: Option<f64>,
    /// Current with which torque goes on, mA.
    pub start_ma: f64,
    /// Time in which the current may rise from there to the cap.
    pub soft_start: Duration,
    /// Silence after which motors freeze where they are; zero is never.
    pub watchdog: Duration,
    /// Every how many exchanges torque, errors, voltage and temperature are read.
    pub health_every: u32,
    /// How far outside its limits a joint may be found when torque goes on, rad.
    pub outside_rad: f64,
    /// How often a motor that stopped itself because of overload is started again before it is left alone until [`turn_on`](crate::Hand::turn_on).
    pub recoveries: u32,
    /// Speed of the bus.
    pub baud: u32,
    /// How long motors may take; `None` follows the adapter's latency timer, or what is seen when connecting.
    pub timing: Option<Timing>,
}

impl Default for LeapOptions {
    fn default() -> Self {
        Self::right()
    }
}

impl LeapOptions {
    /// A right hand as its maker wires it: ids 0 to 15, 4 Mbaud, zero at half a turn.
    pub fn right() -> Self {
        let names = joint_order::find("leap_sdk").unwrap_or_default();
        let joint = |(id, name): (u8, &&str)| LeapJoint {
            id,
            name: (*name).into(),
            zero_ticks: 2048,
            reversed: false,
            homing_offset_ticks: 0,
        };
        let gains = |id| {
            if matches!(id, 0 | 4 | 8) {
                LeapGains { p: 450, i: 0, d: 150 }
            } else {
                LeapGains { p: 600, i: 0, d: 200 }
            }
        };
        Self {
            joints: (0..).zip(names).map(joint).collect(),
            gains: (0..names.len()).map(gains).collect(),
            cap_ma: None,
            start_ma: 30.0,
            soft_start: Duration::from_millis(300),
            watchdog: Duration::from_millis(40),
            health_every: 50,
            outside_rad: 0.3,
            recoveries: 3,
            baud: 4_000_000,
            timing: None,
        }
    }

    /// A left hand: the vendor builds it from the fingers of a right one, so that some motors turn the other way.
    pub fn left() -> Self {
        let reversed = joint_order::reversed_in_left("leap_left").unwrap_or_default();
        let mut options = Self::right();
        for joint in &mut options.joints {
            joint.reversed = reversed.contains(&joint.name.as_str());
        }
        options
    }

    /// The same with no motor above `cap_ma` mA.
    pub fn with_cap_ma(mut self, cap_ma: f64) -> Self {
        self.cap_ma = Some(cap_ma);
        self
    }

    /// The same with these gains for all motors.
    pub fn with_gains(mut self, gains: LeapGains) -> Self {
        self.gains.fill(gains);
        self
    }

    /// The same with motors that freeze after `silence`, a multiple of 20 ms up to 2.54 s; zero is never.
    pub fn with_watchdog(mut self, silence: Duration) -> Self {
        self.watchdog = silence;
        self
    }

    /// The same with another time for the current to rise.
    pub fn with_soft_start(mut self, time: Duration) -> Self {
        self.soft_start = time;
        self
    }

    /// The same with another reading of a motor at the zero of joint `name`, ticks.
    ///
    /// # Errors
    /// If there is no such joint.
    pub fn with_zero(mut self, name: &str, zero_ticks: i32) -> Result<Self> {
        let joint = self.joints.iter_mut().find(|j| j.name == name);
        joint.ok_or_else(|| Error::value(format!("no joint {name}"), "use a name of the robot model"))?.zero_ticks =
            zero_ticks;
        Ok(self)
    }

    /// The same with other patience.
    pub fn with_timing(mut self, timing: Timing) -> Self {
        self.timing = Some(timing);
        self
    }

    /// The watchdog in its register's unit, 20 ms.
    pub(super) fn watchdog_units(&self) -> u8 {
        // 127 at most, see `check`.
        self.watchdog.as_millis().div_ceil(20).min(127) as u8
    }

    pub(super) fn check(&self) -> Result<()> {
        let bad = |what: String| Err(Error::value(what, "start from the options of a right or left hand"));
        for (i, joint) in self.joints.iter().enumerate() {
            if joint.id > 252 || self.joints[..i].iter().any(|j| j.id == joint.id || j.name == joint.name) {
                return bad(format!("motor {} or joint {} twice, or an id above 252", joint.id, joint.name));
            }
            if joint.zero_ticks.abs() > 4096 {
                return bad(format!("a zero of joint {} at {} ticks", joint.name, joint.zero_ticks));
            }
        }
        if self.gains.len() != self.joints.len() || self.gains.iter().any(|g| g.p.max(g.i).max(g.d) > 16383) {
            return bad("gains above 16383, or not one set per joint".into());
        }
        let allowed = |x: f64| x >= 1.0 && x.is_finite();
        if let Some(bad_ma) = self.cap_ma.iter().chain([&self.start_ma]).find(|x| !allowed(**x)) {
            return bad(format!("a current of {bad_ma} mA"));
        }
        if self.watchdog > Duration::from_millis(2540) || self.health_every == 0 {
            return bad("a watchdog of more than 2.54 s, or health that is never read".into());
        }
        if !(0.0..=1.0).contains(&self.outside_rad) {
            return bad(format!("{} rad outside of the limits", self.outside_rad));
        }
        Ok(())
    }
}
