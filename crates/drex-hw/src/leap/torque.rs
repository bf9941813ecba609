//! Torque on, only when goals and limits are confirmed; torque off, confirmed.

use super::driver::{COMMAND, HEALTH, HEALTH_ADDRESS, LeapHand, command};
use super::faults::FROZEN;
use super::joint::{Joint, MotorState};
use super::off::{TorqueState, off_round};
use super::table;
use crate::dynamixel::{Answers, Port, Torque};
use crate::{Error, Result};

/// How often what is not confirmed is said again.
const TRIES: u32 = 3;

impl<P: Port> LeapHand<P> {
    /// Torque on where the joints are: goals and a small current first, confirmed, then watchdog and torque, confirmed.
    pub(super) fn energise(&mut self) -> Result<()> {
        if self.on {
            return Ok(());
        }
        self.joints.iter_mut().for_each(|j| (j.recoveries, j.absent) = (self.options.recoveries, false));
        self.set_up_all()?;
        self.regroup()?;
        let done = self.hold_here().and_then(|()| self.torque_on());
        if done.is_err() {
            // What was wrong is told; if this fails too, the watchdog is left.
            let _ = self.relax();
        }
        done
    }

    /// Sets all goals to where the joints are, with the first current, and reads whether they were taken.
    fn hold_here(&mut self) -> Result<()> {
        // A frozen motor takes no goals.
        self.tell_all(table::BUS_WATCHDOG, 0)?;
        let ids = self.ids();
        let (mut here, mut goals) = (Answers::new(&ids, 4)?, Answers::new(&ids, 18)?);
        let (place, start) = (table::PRESENT_POSITION.address, table::GOAL_CURRENT.address);
        let current = self.start_current();
        for last in [false, false, true] {
            self.read_all(place, &mut here)?;
            let mut orders = Vec::with_capacity(ids.len());
            for (j, id) in ids.iter().enumerate() {
                let Some((_, data)) = here.get(j) else { return Err(Error::Silent { id: *id }) };
                let ticks = table::PRESENT_POSITION.in_block(place, data);
                self.check_place(j, ticks)?;
                orders.push((*id, command(current, ticks)));
            }
            let items = orders.iter().map(|(id, bytes)| (*id, &bytes[..]));
            self.bus.sync_write(table::INDIRECT_DATA.address, COMMAND, items)?;
            self.read_all(start, &mut goals)?;
            let taken = |j: usize| {
                goals.get(j).map(|(_, data)| {
                    command(table::GOAL_CURRENT.in_block(start, data), table::GOAL_POSITION.in_block(start, data))
                })
            };
            let astray: Vec<usize> = (0..ids.len()).filter(|j| taken(*j) != Some(orders[*j].1)).collect();
            let Some(first) = astray.first() else { return Ok(()) };
            if last {
                return Err(self.wrong(
                    *first,
                    "does not take a goal position",
                    "check cable and supply, connect again",
                ));
            }
            // They may have been without power, and have forgotten the indirect addresses.
            astray.iter().for_each(|j| self.begin_setup(*j));
            self.set_up_all()?;
        }
        Ok(())
    }

    fn torque_on(&mut self) -> Result<()> {
        let units = self.options.watchdog_units();
        let mut under = Answers::new(&self.ids(), HEALTH)?;
        // What a motor says that is under torque and guarded by its watchdog, or was: a slow bus is not an error.
        let guarded = |(_, data): (u8, &[u8])| data[0] == 1 && [units, FROZEN].contains(&data[2]);
        self.bus.port().torque(Torque::On).map_err(|source| self.lost_port(source))?;
        let since = self.now();
        for _ in 0..TRIES {
            self.tell_all(table::BUS_WATCHDOG, units)?;
            self.spoken = self.now();
            self.tell_all(table::TORQUE_ENABLE, 1)?;
            self.read_all(HEALTH_ADDRESS, &mut under)?;
            if (0..self.joints.len()).all(|j| under.get(j).is_some_and(guarded)) {
                break;
            }
        }
        for j in 0..self.joints.len() {
            match under.get(j) {
                Some(answer) if guarded(answer) => self.joints[j].state = MotorState::Driven { since },
                Some(_) => {
                    let error = self.bus.get(self.joints[j].id, table::HARDWARE_ERROR)?;
                    let what = format!("torque does not go on: {}", table::hardware_error_text(error));
                    self.note_error(j, error);
                    // It is set up anew when somebody tries again.
                    self.fault(j, what.clone());
                    return Err(self.wrong(j, what, "check its supply, reboot it"));
                }
                None => return Err(Error::Silent { id: self.joints[j].id }),
            }
        }
        self.on = true;
        Ok(())
    }

    /// Reads from all motors of `answers`, again if some answers were lost.
    fn read_all(&mut self, address: u16, answers: &mut Answers) -> Result<()> {
        for _ in 0..TRIES {
            self.bus.sync_read(address, answers)?;
            if answers.answered() == answers.ids().len() {
                break;
            }
        }
        Ok(())
    }

    /// The current with which torque goes on, mA.
    pub(super) fn start_current(&self) -> i16 {
        let cap = self.caps_ma.iter().copied().fold(f64::INFINITY, f64::min);
        self.options.start_ma.min(cap).max(0.0) as i16
    }

    /// Torque off, confirmed by every motor.
    pub(super) fn relax(&mut self) -> Result<()> {
        self.on = false;
        // Also if it cannot be told now: who is found under torque later is told then.
        for joint in self.joints.iter_mut().filter(|j| matches!(j.state, MotorState::Driven { .. })) {
            joint.state = MotorState::TorqueOff;
        }
        let told = self.say_off();
        if matches!(&told, Err(error @ Error::Port { .. }) if !error.is_final()) && !self.lost {
            // It may be back already, under another handle.
            self.lost = true;
            return self.say_off();
        }
        told
    }

    fn say_off(&mut self) -> Result<()> {
        if self.lost {
            self.reopen()?;
        }
        self.bus.set_timing(self.patient);
        let (mut left, mut rounds) = (self.ids(), 0);
        let not_off = loop {
            let not_off = off_round(&mut self.bus, &mut left)?;
            rounds += 1;
            if left.is_empty() {
                let told = self.bus.port().torque(Torque::Off);
                return told.map_err(|source| self.lost_port(source));
            }
            let now = self.now();
            // A motor that starts again has no torque, and says so when it is back.
            let boots = |j: &Joint| matches!(j.state, MotorState::Booting { give_up, .. } if now < give_up);
            let booting = self.joints.iter().any(|j| left.contains(&j.id) && boots(j));
            if rounds >= TRIES && !booting {
                break not_off;
            }
            // From now on only those are asked that are hard to reach: the order must not wait for them.
            self.bus.set_timing(self.brisk);
        };
        let of = |id: u8| self.joints.iter().position(|j| j.id == id);
        let disobedient = not_off.iter().find(|n| n.torque == TorqueState::On);
        if let Some(j) = disobedient.and_then(|n| of(n.id)) {
            return Err(self.wrong(j, "torque does not go off", "take its power away"));
        }
        let unknown = self.joints.iter().filter(|j| left.contains(&j.id));
        let unknown: Vec<String> = unknown.map(|j| format!("{} (motor {})", j.name, j.id)).collect();
        Err(Error::TorqueUnknown { joints: unknown.join(", ") })
    }
}

impl<P: Port> Drop for LeapHand<P> {
    fn drop(&mut self) {
        // Nobody is left to be told; the watchdog stops a hand that cannot be reached.
        let _ = self.relax();
    }
}
