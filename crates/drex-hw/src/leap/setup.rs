//! A motor from whatever state it is in to one that may be given torque: step by step, so that others can be driven in between.

use std::time::Duration;

use super::driver::{COMMAND, HEALTH, LeapHand, SETUP_TIME};
use super::inspect::FAST_FIRMWARE;
use super::joint::MotorState;
use super::table::{self, CURRENT_BASED_POSITION, MotorModel, Register, Value};
use crate::dynamixel::Port;
use crate::{Error, Result};

/// How long a motor that was rebooted is left alone.
const BOOT: Duration = Duration::from_millis(200);
/// How often it is asked after that.
const ASK: Duration = Duration::from_millis(50);
/// What the indirect data stand for: a command, then a motor's health.
const INDIRECT: [u16; COMMAND + HEALTH] = [
    table::GOAL_CURRENT.address,
    table::GOAL_CURRENT.address + 1,
    table::GOAL_POSITION.address,
    table::GOAL_POSITION.address + 1,
    table::GOAL_POSITION.address + 2,
    table::GOAL_POSITION.address + 3,
    table::TORQUE_ENABLE.address,
    table::HARDWARE_ERROR.address,
    table::BUS_WATCHDOG.address,
    // The low byte is enough: the limit is 7 V.
    table::PRESENT_VOLTAGE.address,
    table::PRESENT_TEMPERATURE.address,
];

/// What comes after a step.
enum Next {
    Step(u8),
    Boot,
    Done,
}

impl<P: Port> LeapHand<P> {
    /// Sets up a motor from the beginning, in the exchanges to come.
    pub(super) fn begin_setup(&mut self, j: usize) {
        let give_up = self.now() + SETUP_TIME;
        self.joints[j].state = MotorState::Setup { step: 0, give_up };
    }

    /// Sets up every motor that is neither limp nor driven, and waits for it.
    pub(super) fn set_up_all(&mut self) -> Result<()> {
        for j in 0..self.joints.len() {
            if let MotorState::Faulted { .. } = self.joints[j].state {
                // Not all at once: behind a slow adapter the last ones would have no time left.
                self.begin_setup(j);
                self.settle(j)?;
                // Waiting for all of a hand without power would take half a minute.
                self.check_set_up(j)?;
            }
        }
        loop {
            let mut waiting = None;
            for j in 0..self.joints.len() {
                self.settle(j)?;
                self.check_set_up(j)?;
                if let MotorState::Booting { .. } = self.joints[j].state {
                    waiting = Some(j);
                }
            }
            let Some(j) = waiting else { return Ok(()) };
            self.bus.pause(ASK)?;
            self.advance(j)?;
        }
    }

    fn check_set_up(&self, j: usize) -> Result<()> {
        let MotorState::Faulted { .. } = self.joints[j].state else { return Ok(()) };
        let what = self.joints[j].fault.clone().unwrap_or_else(|| "cannot be set up".into());
        Err(self.wrong(j, what, "then try again"))
    }

    /// Goes on with the setup of a motor until it is done, or has to wait.
    fn settle(&mut self, j: usize) -> Result<()> {
        while let MotorState::Setup { .. } = self.joints[j].state {
            self.advance(j)?;
        }
        Ok(())
    }

    /// Starts a motor again; torque and errors go.
    pub(super) fn begin_reboot(&mut self, j: usize) -> Result<()> {
        let next = self.now() + BOOT;
        self.joints[j].state = MotorState::Booting { next, give_up: next + SETUP_TIME };
        match self.bus.reboot(self.joints[j].id) {
            // If it did not hear, its error is seen again and it is told again.
            Ok(()) | Err(Error::Silent { .. } | Error::Refused { .. }) => self.regroup(),
            Err(lost) => Err(lost),
        }
    }

    /// Goes one step on with a motor that boots or is set up. Only a failing port is an error; a motor that cannot be set up is
    /// faulted. Whether anything was sent.
    pub(super) fn advance(&mut self, j: usize) -> Result<bool> {
        let now = self.now();
        let (outcome, give_up, again) = match self.joints[j].state {
            MotorState::Booting { next, .. } if now < next => return Ok(false),
            MotorState::Booting { give_up, .. } => {
                let there = self.bus.ping(self.joints[j].id).map(|_| Next::Step(0));
                (there, give_up, MotorState::Booting { next: now + ASK, give_up })
            }
            MotorState::Setup { step, give_up } => (self.step(j, step), give_up, MotorState::Setup { step, give_up }),
            _ => return Ok(false),
        };
        let was_booting = matches!(again, MotorState::Booting { .. });
        let outcome = outcome
            .and_then(|next| if let Next::Boot = next { self.begin_reboot(j).map(|()| Next::Boot) } else { Ok(next) });
        match outcome {
            Ok(Next::Step(step)) => self.joints[j].state = MotorState::Setup { step, give_up },
            Ok(Next::Boot) => {
                // The time that it may take is not extended.
                if let MotorState::Booting { next, .. } = self.joints[j].state {
                    self.joints[j].state = MotorState::Booting { next, give_up };
                }
                if now > give_up {
                    let what = table::hardware_error_text(self.joints[j].errors);
                    self.fault(j, format!("{what}, also after a reboot"));
                }
            }
            Ok(Next::Done) => {
                self.joints[j].state = if self.on { MotorState::Driven { since: now } } else { MotorState::TorqueOff };
            }
            Err(Error::Silent { .. }) if now <= give_up => self.joints[j].state = again,
            Err(error @ Error::Port { .. }) => return Err(error),
            // The joint is known.
            Err(Error::Joint { what, remedy, .. }) => self.fault(j, format!("{what}; {remedy}")),
            Err(error) => self.fault(j, error.to_string()),
        }
        if was_booting && self.joints[j].is_asked() {
            self.regroup()?;
        }
        Ok(true)
    }

    pub(super) fn fault(&mut self, j: usize, fault: String) {
        let joint = &mut self.joints[j];
        joint.state = MotorState::Faulted { bits: joint.errors };
        joint.fault = Some(fault);
    }

    fn step(&mut self, j: usize, step: u8) -> Result<Next> {
        let id = self.joints[j].id;
        let next = match step {
            0 => {
                let pong = self.bus.ping(id)?;
                if pong.model != self.model.number() {
                    let found = MotorModel::from_number(pong.model).map_or("something else", MotorModel::name);
                    let what = format!("is an {found} (model {}), others are {}", pong.model, self.model.name());
                    return Err(self.wrong(j, what, "build the hand with motors of one kind"));
                }
                if pong.firmware < FAST_FIRMWARE {
                    // In a common answer it would be missing for ever.
                    self.bus.set_fast(false);
                }
                let error = self.bus.get(id, table::HARDWARE_ERROR)?;
                self.note_error(j, error);
                if error != 0 {
                    return Ok(Next::Boot);
                }
                Next::Step(1)
            }
            1 => {
                self.bus.set(id, table::TORQUE_ENABLE, 0)?;
                // A motor that froze takes no goals.
                self.bus.set(id, table::BUS_WATCHDOG, 0)?;
                Next::Step(2)
            }
            2 => {
                self.keep(id, table::RETURN_DELAY, 0)?;
                self.keep(id, table::DRIVE_MODE, 0)?;
                self.keep(id, table::STARTUP, 0)?;
                self.keep(id, table::MODE, CURRENT_BASED_POSITION)?;
                Next::Step(3)
            }
            3 => {
                self.keep(id, table::CURRENT_LIMIT, self.caps_ma[j] as u16)?;
                self.keep(id, table::SHUTDOWN, self.model.default_shutdown())?;
                Next::Step(4)
            }
            4 => {
                // After the mode: a change of mode sets the gains back.
                let g = self.joints[j].gains;
                let ([a, b], [c, d], [e, f]) = (g.d.to_le_bytes(), g.i.to_le_bytes(), g.p.to_le_bytes());
                self.bus.write(id, table::POSITION_D.address, &[a, b, c, d, e, f])?;
                self.bus.write(id, table::FEEDFORWARD.address, &[0; 4])?;
                Next::Step(5)
            }
            5 => {
                let pwm = self.bus.get(id, table::PWM_LIMIT)?;
                self.bus.set(id, table::GOAL_PWM, i16::try_from(pwm).unwrap_or(i16::MAX))?;
                self.bus.write(id, table::PROFILE_ACCELERATION.address, &[0; 8])?;
                Next::Step(6)
            }
            6 => {
                let map = INDIRECT.map(u16::to_le_bytes);
                self.bus.write(id, table::INDIRECT_ADDRESS.address, map.as_flattened())?;
                Next::Step(7)
            }
            7 => {
                // Also after the mode: a change of mode allows all the current there is.
                self.bus.set(id, table::GOAL_CURRENT, self.start_current())?;
                let here = self.bus.get(id, table::PRESENT_POSITION)?;
                if self.on {
                    self.check_place(j, here)?;
                }
                self.bus.set(id, table::GOAL_POSITION, here)?;
                if self.on { Next::Step(8) } else { Next::Done }
            }
            _ => {
                self.bus.set(id, table::BUS_WATCHDOG, self.options.watchdog_units())?;
                self.bus.set(id, table::TORQUE_ENABLE, 1)?;
                Next::Done
            }
        };
        Ok(next)
    }

    /// Writes a register that is kept without power only if it has to change: it wears out.
    fn keep<T: Value + PartialEq>(&mut self, id: u8, register: Register<T>, value: T) -> Result<()> {
        if self.bus.get(id, register)? != value {
            self.bus.set(id, register, value)?;
        }
        Ok(())
    }

    /// Counts the turns of a joint; refuses one that is where it cannot be.
    pub(super) fn check_place(&mut self, j: usize, ticks: i32) -> Result<()> {
        if self.joints[j].count_turns(ticks, self.options.outside_rad) {
            return Ok(());
        }
        let (low, high) = self.limits[j];
        let what = format!(
            "at {:.3} rad (tick {ticks}), where it cannot be ({low:.3} to {high:.3})",
            self.joints[j].angle(ticks)
        );
        Err(self.wrong(
            j,
            what,
            "mount its horn again in the right place, or set another zero for this joint (drex hw calibrate-zero)",
        ))
    }
}
