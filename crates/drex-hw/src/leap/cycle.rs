//! A LEAP hand under a control loop: one packet out, one packet back.

use std::time::Duration;

use super::driver::{COMMAND, LeapHand, command};
use super::joint::{Joint, MotorState};
use super::table::{self, RAD_S_PER_UNIT};
use crate::dynamixel::{Answers, Port};
use crate::{EffortUnit, Error, Hand, HandCommand, HandState, JointStatus, Result};

/// First address of a reading.
const PRESENT: u16 = table::PRESENT_CURRENT.address;
/// Exchanges in a row without any answer before the hand counts as unreachable.
const UNANSWERED: u32 = 3;

impl<P: Port> Hand for LeapHand<P> {
    fn joints(&self) -> &[String] {
        &self.names
    }

    fn limits(&self) -> &[(f64, f64)] {
        &self.limits
    }

    fn effort_unit(&self) -> EffortUnit {
        EffortUnit::Milliampere
    }

    fn effort_caps(&self) -> &[f64] {
        &self.caps_ma
    }

    fn error_text(&self, code: u8) -> String {
        table::hardware_error_text(code)
    }

    fn turn_on(&mut self) -> Result<()> {
        self.bus.set_timing(self.patient);
        if self.lost {
            self.reopen()?;
        }
        let done = self.energise();
        self.lost |= matches!(done, Err(Error::Port { .. }));
        done
    }

    fn turn_off(&mut self) -> Result<()> {
        self.relax()
    }

    /// A command that must not be followed leaves the last one in force; the joints are read all the same.
    fn cycle(&mut self, command: Option<&HandCommand>, state: &mut HandState) -> Result<()> {
        self.bus.set_timing(self.brisk);
        let refused = command.map_or(Ok(()), |c| c.check(&self.names));
        let done = self.exchange(command.filter(|_| refused.is_ok()));
        if let Err(Error::Port { .. }) = done {
            self.lost = true;
            self.joints.iter_mut().for_each(Joint::miss);
        }
        self.report(state);
        done.and(refused)
    }
}

impl<P: Port> LeapHand<P> {
    fn exchange(&mut self, command: Option<&HandCommand>) -> Result<()> {
        let back = self.lost;
        if back {
            self.reopen()?;
        }
        self.exchanges = self.exchanges.wrapping_add(1);
        let Some(mut readings) = self.readings.take() else {
            self.joints.iter_mut().for_each(Joint::miss);
            self.care()?;
            return Err(self.unreachable());
        };
        let asked = self.speak(command, &mut readings);
        let (mut answers, mut alerts) = (0, 0_u64);
        for (i, j) in self.asked.iter().enumerate() {
            let joint = &mut self.joints[*j];
            match readings.get(i).filter(|(error, _)| error & 0x7f == 0) {
                Some((error, data)) => {
                    answers += 1;
                    joint.take(data);
                    let alert = error & 0x80 != 0;
                    alerts |= u64::from(alert && !joint.alert) << j;
                    joint.alert = alert;
                }
                None => joint.miss(),
            }
        }
        for (j, joint) in self.joints.iter_mut().enumerate() {
            if !self.asked.contains(&j) {
                joint.miss();
            }
        }
        self.readings = Some(readings);
        asked?;
        (0..self.joints.len()).filter(|j| alerts & 1 << j != 0).try_for_each(|j| self.look_at_error(j))?;
        // Who was without power while the port was gone has forgotten everything.
        if back || self.exchanges.is_multiple_of(self.options.health_every) {
            self.read_health()?;
        }
        self.care()?;
        self.unanswered = if answers == 0 { self.unanswered.saturating_add(1) } else { 0 };
        if self.unanswered >= UNANSWERED { Err(self.unreachable()) } else { Ok(()) }
    }

    /// Sends commands and reads how the joints are.
    fn speak(&mut self, command: Option<&HandCommand>, readings: &mut Answers) -> Result<()> {
        let (watchdog, mut now) = (self.options.watchdog, self.now());
        let silence = now.saturating_sub(self.spoken);
        if !self.on || watchdog.is_zero() || silence <= watchdog * 3 / 4 {
            self.queue_orders(command, now)?;
        } else if silence <= watchdog {
            self.rearm_all()?;
            self.queue_orders(command, now)?;
        } else {
            // They froze. What is wanted now may be far from where they are: it is followed from the next exchange on.
            self.bus.sync_read(PRESENT, readings)?;
            now = self.now();
            self.restart_here(readings, now)?;
        }
        // From before the question on: the wait for the answers may be what takes too long.
        self.spoken = now;
        self.bus.sync_read(PRESENT, readings)
    }

    /// Queues the end of a freeze for all motors under torque: each goes on where it is, with a current that rises anew.
    fn restart_here(&mut self, readings: &Answers, now: Duration) -> Result<()> {
        self.tell_driven(0)?;
        let start = self.start_current();
        self.orders.clear();
        for (i, j) in self.asked.iter().enumerate() {
            let joint = &mut self.joints[*j];
            let (MotorState::Driven { .. }, Some((_, data))) = (joint.state, readings.get(i)) else { continue };
            joint.state = MotorState::Driven { since: now };
            self.orders.push((joint.id, command(start, table::PRESENT_POSITION.in_block(PRESENT, data))));
        }
        self.queue_commands()?;
        self.tell_driven(self.options.watchdog_units())
    }

    /// Queues the commands; they go out with the question that follows.
    fn queue_orders(&mut self, wanted: Option<&HandCommand>, now: Duration) -> Result<()> {
        let Some(wanted) = wanted.filter(|_| self.on) else { return Ok(()) };
        self.orders.clear();
        for (j, joint) in self.joints.iter().enumerate() {
            let MotorState::Driven { since } = joint.state else { continue };
            let allowed = self.allowed_ma(j, now.saturating_sub(since));
            // Rounded down: a limit is not exceeded by half a milliampere either.
            let current = wanted.effort_limit[j].min(allowed).max(0.0) as i16;
            self.orders.push((joint.id, command(current, joint.goal(wanted.position[j]))));
        }
        self.queue_commands()
    }

    fn queue_commands(&mut self) -> Result<()> {
        let items = self.orders.iter().map(|(id, bytes)| (*id, &bytes[..]));
        self.bus.queue_sync_write(table::INDIRECT_DATA.address, COMMAND, items)
    }

    /// Largest current of a motor, mA, that has been under torque for `time`.
    fn allowed_ma(&self, j: usize, time: Duration) -> f64 {
        let (cap, soft) = (self.caps_ma[j], self.options.soft_start);
        if time >= soft {
            return cap;
        }
        let start = f64::from(self.start_current());
        start + (cap - start) * time.as_secs_f64() / soft.as_secs_f64()
    }

    /// Opens the port again.
    pub(super) fn reopen(&mut self) -> Result<()> {
        if let Err(source) = self.bus.port().reopen() {
            return Err(self.lost_port(source));
        }
        self.lost = false;
        self.reconnects = self.reconnects.saturating_add(1);
        Ok(())
    }

    pub(super) fn lost_port(&mut self, source: std::io::Error) -> Error {
        let port = self.bus.port().name().to_owned();
        Error::Port { port, source, remedy: "plug it in again; it is tried at every exchange".into() }
    }

    fn unreachable(&mut self) -> Error {
        let remedy = "check the 5 V supply and the cable to the first motor".into();
        Error::NoMotors { port: self.bus.port().name().to_owned(), remedy }
    }

    fn report(&mut self, state: &mut HandState) {
        let n = self.joints.len();
        if state.lengths() != [n; 8] {
            *state = HandState::new(n);
        }
        state.time_s = self.now().saturating_sub(self.connected).as_secs_f64();
        for (j, joint) in self.joints.iter().enumerate() {
            state.position[j] = joint.position;
            state.velocity[j] = joint.velocity;
            state.effort[j] = joint.current;
            state.temperature_c[j] = joint.health.map(|h| h.temperature_c);
            state.voltage_v[j] = joint.health.map(|h| h.voltage_v);
            state.hardware_error[j] = joint.errors;
            state.age[j] = joint.missed;
            state.status[j] = joint.status();
        }
    }
}

impl Joint {
    /// Takes a reading over.
    fn take(&mut self, data: &[u8]) {
        self.missed = 0;
        let ticks = table::PRESENT_POSITION.in_block(PRESENT, data);
        if !matches!(self.state, MotorState::Driven { .. }) {
            // It may have been without power, and have forgotten how many turns it had made.
            self.count_turns(ticks, 0.0);
        }
        self.position = self.angle(ticks);
        let velocity = f64::from(table::PRESENT_VELOCITY.in_block(PRESENT, data));
        self.velocity = self.directed(velocity * RAD_S_PER_UNIT);
        self.current = self.directed(f64::from(table::PRESENT_CURRENT.in_block(PRESENT, data)));
    }

    /// Grows older.
    fn miss(&mut self) {
        self.missed = self.missed.saturating_add(1);
    }

    fn status(&self) -> JointStatus {
        match self.state {
            MotorState::Faulted { bits } => JointStatus::Faulted(bits),
            MotorState::Booting { .. } | MotorState::Setup { .. } => JointStatus::Recovering,
            _ if self.missed > 0 => JointStatus::Silent,
            MotorState::TorqueOff => JointStatus::TorqueOff,
            MotorState::Driven { .. } => JointStatus::Driven,
        }
    }
}
