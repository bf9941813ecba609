//! Torque on and off: the order of the commands, and what speaks against torque.

use std::time::Duration;

use super::driver::MOST_FRAMES;
use super::finger::Finger;
use super::{AllegroCommand, AllegroHand, AllegroInfo, AllegroVersion};
use crate::can::CanBus;
use crate::dynamixel::Torque;
use crate::{Error, Result};

/// How long a hand that was switched on may take until all fingers reported.
const FIRST_POSES: Duration = Duration::from_millis(500);
/// How long a hand may take to say what it is; some never do.
const INFO: Duration = Duration::from_millis(100);
/// How long the last answers of an adapter may take.
const LAST_ANSWERS: Duration = Duration::from_millis(30);
/// How often a bus that refuses to stop the hand is asked.
const STOP_TRIES: usize = 3;
/// How far outside its limits a joint may be found when torque goes on, rad: gears give a little, a wrong zero much more.
const OUTSIDE_RAD: f64 = 0.3;
/// Wire units per N m of a version-4 frame on a hand with older hardware.
const OLD_HARDWARE: f64 = 800.0;

impl<B: CanBus> AllegroHand<B> {
    /// Off, who are you, report, on: no torque is sent.
    pub(super) fn start(&mut self) -> Result<()> {
        for _ in 0..MOST_FRAMES {
            if self.bus.receive(Duration::ZERO)?.is_none() {
                break;
            }
        }
        self.fingers.iter_mut().for_each(Finger::forget);
        self.ages = [u32::MAX; 4];
        self.blind_since = None;
        self.motor_errors = [0; 16];
        self.sent = [0; 16];
        self.started = true;
        self.bus.torque(Torque::Ready)?;
        let o = &self.options;
        let (pose_ms, temperature_ms) = (o.pose_period_ms, o.temperature_period_ms);
        self.send(AllegroCommand::Off)?;
        self.send(AllegroCommand::AskInfo)?;
        self.send(AllegroCommand::AskSerial)?;
        self.send(AllegroCommand::Period { pose_ms, imu_ms: 0, temperature_ms })?;
        self.send(AllegroCommand::On)?;
        self.send(AllegroCommand::AskState)
    }

    /// Waits, half a second at most, until the hand has said what it is and all fingers have reported; false if something is missing
    /// then. Firmware may leave information and serial number out, but where [`AllegroStats::frames`](super::AllegroStats::frames) is
    /// still zero nobody was heard at all.
    ///
    /// # Errors
    /// [`Error::Port`] if the bus fails or refuses frames.
    pub fn wait_for_reports(&mut self) -> Result<bool> {
        let begin = self.clock.now();
        for _ in 0..MOST_FRAMES {
            let serial = self.serial.is_some() || self.options.version == AllegroVersion::V3;
            if self.info.is_some() && serial && self.all_fresh(self.clock.now()) {
                return Ok(true);
            }
            let left = FIRST_POSES.saturating_sub(self.clock.now().saturating_sub(begin));
            if left.is_zero() {
                break;
            }
            self.gather(left.min(Duration::from_millis(u64::from(self.options.pose_period_ms) * 2)))?;
        }
        Ok(false)
    }

    /// Torque off, motors off, silence; all of it is tried, the first failure is told.
    pub(super) fn stop(&mut self) -> Result<()> {
        self.driven = false;
        self.goal = None;
        if !self.started {
            return Ok(());
        }
        let mut told = Ok(());
        for _ in 0..STOP_TRIES {
            let before = self.bus.refused();
            told = self.send_stop();
            // A port that fails does not get better at once; waiting for it only delays the news.
            if told.is_ok() || self.bus.refused() == before {
                break;
            }
        }
        // What failed is tried again when the hand is dropped.
        self.started = told.is_err();
        if told.is_ok() {
            self.fingers.iter_mut().for_each(Finger::forget);
            self.blind_since = None;
            // A guard that does not hear it switches the hand off once more.
            told = self.bus.torque(Torque::Off);
        }
        told
    }

    fn send_stop(&mut self) -> Result<()> {
        let mut told = self.send_torques([0; 16]);
        let silence = AllegroCommand::Period { pose_ms: 0, imu_ms: 0, temperature_ms: 0 };
        for command in [AllegroCommand::Off, silence] {
            let sent = self.send(command);
            told = told.and(sent);
        }
        told.and_then(|()| self.bus.settle(LAST_ANSWERS))
            .and_then(|()| self.check_refusals("the hand may still be on: switch its power off"))
    }

    /// Waits for all fingers, refuses a hand in a state that torque would make worse, and takes its pose as goal.
    pub(super) fn drive(&mut self) -> Result<()> {
        if self.driven {
            return Ok(());
        }
        if !self.started {
            self.start()?;
        }
        let begin = self.clock.now();
        for _ in 0..MOST_FRAMES {
            let now = self.clock.now();
            let waited = now.saturating_sub(begin);
            let told = self.info.is_some() || waited > INFO;
            if self.all_fresh(now) && told || waited > FIRST_POSES {
                break;
            }
            self.gather(Duration::from_millis(u64::from(self.options.pose_period_ms) * 2))?;
        }
        if !self.all_fresh(self.clock.now()) {
            return Err(Error::value(
                format!("no fresh poses (never seen: {})", self.fingers_that(|f| f.seen.is_none())),
                "check the hand's power, the CAN cable and its termination, 1 Mbit/s, and the version",
            ));
        }
        self.check_hand()?;
        self.bus.torque(Torque::On)?;
        self.effort_nm = self.options.torque_caps_nm();
        self.goal = None;
        self.driven = true;
        Ok(())
    }

    /// What speaks against torque.
    fn check_hand(&self) -> Result<()> {
        if let Some(info) = self.info {
            self.check_info(info)?;
        }
        for wire in 0..16 {
            let name = &self.options.names[wire];
            if self.motor_errors[wire] != 0 {
                return Err(Error::value(
                    format!("joint {name} reports error {:#04x}", self.motor_errors[wire]),
                    "remove what blocks it, switch the hand off and on",
                ));
            }
            let (low, high) = self.limits[self.model_of_wire[wire]];
            let q = self.fingers[wire / 4].q[wire % 4];
            if !(low - OUTSIDE_RAD..=high + OUTSIDE_RAD).contains(&q) {
                return Err(Error::value(
                    format!("joint {name} at {q:.3} rad, where it cannot be ({low:.3} to {high:.3})"),
                    "check the version, and correct the joint's zero and direction in the hand file (drex hw calibrate-zero)",
                ));
            }
        }
        Ok(())
    }

    /// What the hand says about itself against torque. Not every firmware says anything.
    fn check_info(&self, info: AllegroInfo) -> Result<()> {
        let main = info.hardware >> 8;
        let hardware = format!("a hand of hardware {main}.{:02x}", info.hardware & 0xff);
        match (self.options.version, main) {
            (AllegroVersion::V4, 5..) => {
                return Err(Error::value(format!("{hardware}, driven as version 4"), "choose version 5"));
            }
            (AllegroVersion::V5, 1..=4) => {
                return Err(Error::value(format!("{hardware}, driven as version 5"), "choose version 4"));
            }
            _ => {}
        }
        if info.left && !self.left_model {
            return Err(Error::value(
                "a left hand, driven with the model of a right one",
                "connect a right hand, or give a model of the left one (side of the hand file)",
            ));
        }
        if self.options.version != AllegroVersion::V4 {
            return Ok(());
        }
        if main != 4 && self.options.wire_per_nm > OLD_HARDWARE {
            return Err(Error::value(
                format!("{hardware}, driven with {} wire units per N m", self.options.wire_per_nm),
                format!("set {OLD_HARDWARE} wire units per N m (wire_per_nm of the hand file)"),
            ));
        }
        if info.status & (AllegroInfo::TOO_HOT | AllegroInfo::MOTOR_SILENT) != 0 {
            return Err(Error::value(
                format!("the hand's status is {:#04x}: {}", info.status, info.status_names().join(", ")),
                "let it cool, switch it off and on",
            ));
        }
        Ok(())
    }
}
