//! Numbers of the three versions: units of the wire, largest torques, gains, zero positions.

use std::time::Duration;

use drex_robot::joint_order;

use super::AllegroVersion;
use crate::{Error, Result};

/// Largest duty of each joint, wire units of versions 3 and 4.
const DUTY_CAPS: [i16; 16] = [375, 675, 450, 285, 375, 675, 450, 285, 375, 675, 450, 285, 525, 405, 270, 270];
/// Largest duty of version 3 on 24 V, wire units.
const DUTY_CAP_24V: i16 = 500;
/// Largest current of version 5, mA.
const CURRENT_CAP_MA: i16 = 240;
/// The vendor's gains count in wire units of version 4 per rad.
const GAIN_UNIT: f64 = 1.0 / 1200.0;

/// How a joint of one hand differs from its model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct JointCalibration {
    /// Encoder counts at the model's zero.
    pub offset_counts: i32,
    /// Whether the encoder counts down as the model's angle grows.
    pub encoder_reversed: bool,
    /// Whether a positive number on the wire pushes towards smaller angles.
    pub motor_reversed: bool,
}

impl JointCalibration {
    /// Nothing to correct.
    pub const NONE: Self = Self { offset_counts: 0, encoder_reversed: false, motor_reversed: false };
}

/// Gains of one joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gains {
    /// N m per rad.
    pub kp: f64,
    /// N m s per rad.
    pub kd: f64,
}

/// How a hand is driven; tables in the order of the wire.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct AllegroOptions {
    /// Generation of the hand.
    pub version: AllegroVersion,
    /// Names of the joints in the robot model.
    pub names: [String; 16],
    /// Corrections of zero positions and directions: found once for each hand.
    pub calibration: [JointCalibration; 16],
    /// Gains of the position loop.
    pub gains: [Gains; 16],
    /// Wire units per N m: duty of versions 3 and 4, mA of version 5; for a joint with the plain gear.
    pub wire_per_nm: f64,
    /// Reduction of each joint's gear over the plain one: 2 for joints 1, 5 and 9 of a V5 Plus (576.7:1 instead of 288.35:1). Such a joint
    /// turns by less per encoder count and gives more torque per wire unit.
    pub gear_ratios: [f64; 16],
    /// Largest number on the wire; never more than the version allows.
    pub wire_caps: [i16; 16],
    /// How often the hand reports poses, ms.
    pub pose_period_ms: u16,
    /// How often versions 4 and 5 report temperatures, ms; 0 is never, as in the vendor's drivers.
    pub temperature_period_ms: u16,
    /// Poses older than this mean no torque.
    pub stale: Duration,
    /// How long an exchange waits for new poses of all fingers: zero for a loop with a clock of its own, a little more than the period
    /// for a loop paced by the hand.
    pub pose_wait: Duration,
    /// Time constant of the velocity filter, s.
    pub velocity_filter_s: f64,
}

impl AllegroOptions {
    /// The vendor's numbers. Version 3 is taken as 3.0 on 24 V; see [`Self::with_wire_per_nm`] for 2.0.
    pub fn new(version: AllegroVersion) -> Self {
        let kp = |j: usize| if matches!(j, 3 | 7 | 11 | 12 | 13 | 14) { 1000.0 } else { 600.0 };
        let kd = |j: usize| [15.0, 20.0, 15.0, 15.0, 30.0, 20.0, 20.0, 15.0][if j < 12 { j % 4 } else { j % 4 + 4 }];
        Self {
            version,
            names: joint_order::ALLEGRO_ROS.map(String::from),
            calibration: [JointCalibration::NONE; 16],
            gains: std::array::from_fn(|j| Gains { kp: kp(j) * GAIN_UNIT, kd: kd(j) * GAIN_UNIT }),
            wire_per_nm: match version {
                AllegroVersion::V3 | AllegroVersion::V4 => 1200.0,
                AllegroVersion::V5 => 1430.0,
            },
            gear_ratios: [1.0; 16],
            wire_caps: Self::allowed(version),
            pose_period_ms: if version == AllegroVersion::V5 { 2 } else { 3 },
            temperature_period_ms: 0,
            stale: Duration::from_millis(20),
            pose_wait: Duration::ZERO,
            velocity_filter_s: 0.01,
        }
    }

    /// The same with this many wire units per N m: 800 for version 3 with firmware 2 or at 8 V; for version 5 what was calibrated.
    pub fn with_wire_per_nm(mut self, wire_per_nm: f64) -> Self {
        self.wire_per_nm = wire_per_nm;
        self
    }

    /// The same with gears of other reductions.
    pub fn with_gear_ratios(mut self, gear_ratios: [f64; 16]) -> Self {
        self.gear_ratios = gear_ratios;
        self
    }

    /// The same with no joint above `cap_nm` N m, or above what the version allows.
    pub fn with_cap_nm(mut self, cap_nm: f64) -> Self {
        for j in 0..16 {
            // A conversion of floats ends at the ends of the range.
            let wire = (cap_nm * self.wire_per_nm_of(j) + 1e-9).floor().max(1.0) as i16;
            self.wire_caps[j] = self.wire_caps[j].min(wire);
        }
        self
    }

    /// The same with half of the torques that the vendor's driver clips at: 120 mA for version 5. Our choice to start with; the vendor names
    /// no continuous torque.
    pub fn with_gentle_caps(mut self) -> Self {
        self.wire_caps = self.wire_caps.map(|c| c / 2);
        self
    }

    /// The same with zero positions and directions of a certain hand.
    pub fn with_calibration(mut self, calibration: [JointCalibration; 16]) -> Self {
        self.calibration = calibration;
        self
    }

    /// The same with other gains.
    pub fn with_gains(mut self, gains: [Gains; 16]) -> Self {
        self.gains = gains;
        self
    }

    /// The same with exchanges that wait up to `wait` for new poses.
    pub fn with_pose_wait(mut self, wait: Duration) -> Self {
        self.pose_wait = wait;
        self
    }

    /// Angle of one encoder count, rad.
    pub fn rad_per_count(&self) -> f64 {
        match self.version {
            AllegroVersion::V3 | AllegroVersion::V4 => (333.3_f64 / 65536.0).to_radians(),
            AllegroVersion::V5 => 0.088_f64.to_radians(),
        }
    }

    /// Largest torque of each joint, N m, order of the wire.
    pub fn torque_caps_nm(&self) -> [f64; 16] {
        std::array::from_fn(|j| f64::from(self.wire_caps[j]) / self.wire_per_nm_of(j))
    }

    /// Wire units per N m of a joint, with its gear.
    pub fn wire_per_nm_of(&self, joint: usize) -> f64 {
        self.wire_per_nm / self.gear_ratios[joint]
    }

    /// Angle, rad, at an encoder reading.
    pub(crate) fn angle(&self, joint: usize, counts: i16) -> f64 {
        let c = &self.calibration[joint];
        let angle = f64::from(i32::from(counts) - c.offset_counts) * self.rad_per_count() / self.gear_ratios[joint];
        if c.encoder_reversed { -angle } else { angle }
    }

    /// Encoder reading at an angle, rad.
    pub(crate) fn counts(&self, joint: usize, angle: f64) -> i16 {
        let c = &self.calibration[joint];
        let angle = if c.encoder_reversed { -angle } else { angle };
        // A conversion of floats ends at the ends of the range.
        (angle * self.gear_ratios[joint] / self.rad_per_count() + f64::from(c.offset_counts)).round() as i16
    }

    /// Number on the wire for a torque, N m, of at most `limit_nm` either way; zero for what is no number.
    pub(crate) fn wire(&self, joint: usize, torque_nm: f64, limit_nm: f64) -> i16 {
        let per_nm = self.wire_per_nm_of(joint);
        let most = f64::from(self.wire_caps[joint]).min((limit_nm * per_nm + 1e-9).floor()).max(0.0);
        let wire = (torque_nm * per_nm).round().clamp(-most, most);
        let wire = if torque_nm.is_finite() && limit_nm >= 0.0 { wire as i16 } else { 0 };
        if self.calibration[joint].motor_reversed { -wire } else { wire }
    }

    /// Torque, N m, of a number on the wire.
    pub(crate) fn torque(&self, joint: usize, wire: i16) -> f64 {
        let torque = f64::from(wire) / self.wire_per_nm_of(joint);
        if self.calibration[joint].motor_reversed { -torque } else { torque }
    }

    pub(crate) fn check(&self) -> Result<()> {
        let bad = |what: String, remedy: &str| Err(Error::value(what, remedy));
        if !(self.wire_per_nm > 0.0 && self.wire_per_nm.is_finite()) {
            return bad(format!("{} wire units per N m", self.wire_per_nm), "give a finite number above zero");
        }
        if let Some(g) = self.gear_ratios.iter().find(|g| !(0.1..=10.0).contains(*g)) {
            return bad(format!("a gear ratio of {g}"), "give 0.1 to 10: 2 for the geared joints of a V5 Plus");
        }
        if let Some(g) = self.gains.iter().find(|g| ![g.kp, g.kd].iter().all(|x| *x >= 0.0 && x.is_finite())) {
            return bad(format!("gains of {} and {}", g.kp, g.kd), "give finite numbers of at least 0");
        }
        let allowed = Self::allowed(self.version);
        if let Some(j) = (0..16).find(|j| !(0..=allowed[*j]).contains(&self.wire_caps[*j])) {
            return bad(
                format!("a cap of {} on the wire for {}", self.wire_caps[j], self.names[j]),
                &format!("give 0 to {}", allowed[j]),
            );
        }
        if let Some(c) = self.calibration.iter().find(|c| c.offset_counts.abs() > 1 << 20) {
            return bad(format!("an offset of {} counts", c.offset_counts), "give one that an encoder can read");
        }
        if self.pose_period_ms == 0 || self.stale.is_zero() {
            return bad("no pose period, or no time until poses are stale".into(), "give times above zero");
        }
        if !(self.velocity_filter_s >= 0.0 && self.velocity_filter_s < 1.0) {
            return bad(format!("a velocity filter of {} s", self.velocity_filter_s), "give 0 to 1 s");
        }
        Ok(())
    }

    /// What the version allows at most.
    fn allowed(version: AllegroVersion) -> [i16; 16] {
        match version {
            AllegroVersion::V3 => DUTY_CAPS.map(|c| c.min(DUTY_CAP_24V)),
            AllegroVersion::V4 => DUTY_CAPS,
            AllegroVersion::V5 => [CURRENT_CAP_MA; 16],
        }
    }
}
