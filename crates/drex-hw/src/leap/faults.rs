//! Motors that stop, fall silent or come back, and a port that does.

use std::time::Duration;

use super::driver::{HEALTH_ADDRESS, LeapHand, command};
use super::joint::{MotorHealth, MotorState};
use super::table::{self, hardware_error};
use crate::dynamixel::Port;
use crate::{Error, Result};

/// Exchanges that a motor may miss before it is no longer asked with the others, whom it holds up.
const MISSES: u32 = 10;
/// How often one that is not asked is looked for.
const PROBE: Duration = Duration::from_millis(100);
/// What the watchdog register says when it has run out.
pub(super) const FROZEN: u8 = 255;

impl<P: Port> LeapHand<P> {
    /// Notes the hardware errors of a motor, in words if there are any.
    pub(super) fn note_error(&mut self, j: usize, bits: u8) {
        let joint = &mut self.joints[j];
        joint.errors = bits;
        if let Some(health) = &mut joint.health {
            health.hardware_error = bits;
        }
        if bits != 0 {
            joint.fault = Some(table::hardware_error_text(bits));
        }
    }

    /// Asks a motor whose alert bit has come on what it has.
    pub(super) fn look_at_error(&mut self, j: usize) -> Result<()> {
        let bits = match self.bus.get(self.joints[j].id, table::HARDWARE_ERROR) {
            Err(Error::Silent { .. } | Error::Refused { .. }) => {
                self.joints[j].alert = false;
                return Ok(());
            }
            other => other?,
        };
        self.note_error(j, bits);
        if bits & self.model.default_shutdown() != 0 {
            self.joints[j].state = MotorState::Faulted { bits };
        }
        Ok(())
    }

    /// Reads torque, errors, watchdog, voltage and temperature of all motors that answer.
    pub(super) fn read_health(&mut self) -> Result<()> {
        let Some(mut healths) = self.healths.take() else { return Ok(()) };
        let read = self.bus.sync_read(HEALTH_ADDRESS, &mut healths);
        let mut suspects = 0_u64;
        for (i, j) in self.asked.iter().enumerate() {
            let Some((_, &[torque, error, watchdog, decivolt, celsius])) = healths.get(i) else { continue };
            let joint = &mut self.joints[*j];
            let (driven, limp) =
                (matches!(joint.state, MotorState::Driven { .. }), joint.state == MotorState::TorqueOff);
            if (driven && (torque != 1 || watchdog == FROZEN)) || (limp && torque != 0) {
                suspects |= 1 << j;
            } else if driven || limp {
                joint.errors = error;
                joint.health = Some(MotorHealth {
                    temperature_c: f64::from(celsius),
                    voltage_v: f64::from(decivolt) / 10.0,
                    hardware_error: error,
                });
            }
        }
        self.healths = Some(healths);
        read?;
        let suspect = |j: &usize| suspects & 1 << j != 0;
        (0..self.joints.len()).filter(suspect).try_for_each(|j| self.look_again(j))
    }

    /// Finds out how a motor is that was away, and brings it to where the others are.
    pub(super) fn look_again(&mut self, j: usize) -> Result<()> {
        let id = self.joints[j].id;
        // One by one: a motor refuses to read across the addresses between them.
        let read =
            self.bus.get(id, table::TORQUE_ENABLE).and_then(|t| Ok((t, self.bus.get(id, table::HARDWARE_ERROR)?)));
        let (torque, bits) = match read {
            Err(Error::Silent { .. }) => return Ok(()),
            Err(refused @ Error::Refused { .. }) => {
                self.joints[j].fault = Some(refused.to_string());
                return Ok(());
            }
            other => other?,
        };
        let torque = torque == 1;
        self.note_error(j, bits);
        let steps = match self.joints[j].state {
            // Switched off without an error: it was without power and remembers nothing.
            MotorState::Driven { .. } if !torque && bits == 0 => {
                self.joints[j].fault = Some("lost its torque, perhaps its supply".into());
                self.begin_setup(j);
                Ok(())
            }
            MotorState::Driven { .. } if !torque => {
                self.joints[j].state = MotorState::Faulted { bits };
                Ok(())
            }
            MotorState::Driven { .. } => self.rearm(j),
            MotorState::TorqueOff if torque => self.bus.set(id, table::TORQUE_ENABLE, 0),
            _ => Ok(()),
        };
        match steps {
            Err(Error::Silent { .. }) => Ok(()),
            Err(refused @ Error::Refused { .. }) => {
                self.joints[j].fault = Some(refused.to_string());
                Ok(())
            }
            other => other,
        }
    }

    /// Lets a motor that froze take goals again: from where it is, with a current that rises anew.
    fn rearm(&mut self, j: usize) -> Result<()> {
        let id = self.joints[j].id;
        self.bus.set(id, table::BUS_WATCHDOG, 0)?;
        let here = self.bus.get(id, table::PRESENT_POSITION)?;
        self.bus.write(id, table::INDIRECT_DATA.address, &command(self.start_current(), here))?;
        self.bus.set(id, table::BUS_WATCHDOG, self.options.watchdog_units())?;
        self.joints[j].state = MotorState::Driven { since: self.now() };
        Ok(())
    }

    /// Starts the watchdogs of all motors anew with the next question: they would run out soon.
    pub(super) fn rearm_all(&mut self) -> Result<()> {
        self.tell_driven(0)?;
        self.tell_driven(self.options.watchdog_units())
    }

    /// Queues a value of the watchdog for all motors under torque.
    pub(super) fn tell_driven(&mut self, watchdog: u8) -> Result<()> {
        let (driven, value) = (self.joints.iter().filter(|j| matches!(j.state, MotorState::Driven { .. })), [watchdog]);
        self.bus.queue_sync_write(table::BUS_WATCHDOG.address, 1, driven.map(|j| (j.id, &value[..])))
    }

    /// Goes on with at most one motor that needs care, so that the others wait little.
    pub(super) fn care(&mut self) -> Result<()> {
        for j in 0..self.joints.len() {
            let joint = &mut self.joints[j];
            match joint.state {
                // Only an overload is over when the motor has let go.
                MotorState::Faulted { bits } if self.on && bits == hardware_error::OVERLOAD && joint.recoveries > 0 => {
                    joint.recoveries -= 1;
                    return self.begin_reboot(j);
                }
                _ => {
                    if self.advance(j)? {
                        return Ok(());
                    }
                }
            }
        }
        if self.joints.iter().any(|j| !j.absent && j.missed >= MISSES && j.is_asked()) {
            for joint in self.joints.iter_mut().filter(|j| j.is_asked() && j.missed >= MISSES) {
                joint.absent = true;
                joint.fault = Some("does not answer".into());
            }
            self.regroup()?;
        }
        self.probe()
    }

    /// Looks for one motor that is absent, now and then.
    fn probe(&mut self) -> Result<()> {
        let now = self.now();
        if now < self.next_probe || !self.joints.iter().any(|j| j.absent) {
            return Ok(());
        }
        self.next_probe = now + PROBE;
        let count = self.joints.len();
        let first = self.last_probed + 1;
        let Some(j) = (first..first + count).map(|j| j % count).find(|j| self.joints[*j].absent) else { return Ok(()) };
        self.last_probed = j;
        match self.bus.ping(self.joints[j].id) {
            Ok(_) => {}
            Err(lost @ Error::Port { .. }) => return Err(lost),
            Err(_) => return Ok(()),
        }
        // Where one is back, others may be.
        self.next_probe = now;
        (self.joints[j].absent, self.joints[j].missed) = (false, 0);
        self.look_again(j)?;
        self.regroup()
    }
}
