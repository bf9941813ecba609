//! Torque off on a hand in any state: nothing is set up, nobody is asked first, and each motor is reported on its own.

use std::time::Duration;

use drex_robot::Robot;

use super::absent::{SILENCE, nobody};
use super::driver::{joints, known_timing};
use super::options::LeapOptions;
use super::table;
use crate::dynamixel::{Bus, Port};
use crate::{Error, Result};

/// How often motors that did not confirm are told and asked again.
const ROUNDS: u32 = 3;
/// Time between two rounds: a motor that starts again is deaf for a moment.
const BETWEEN: Duration = Duration::from_millis(100);
/// How long a port that fails is opened again.
const PORT_BACK: Duration = Duration::from_secs(3);
/// How often it is tried.
const REOPEN: Duration = Duration::from_millis(50);
/// Time between two steps in which the force falls.
const STEP: Duration = Duration::from_millis(20);
/// Watchdog while the force falls, 20 ms: whoever dies meanwhile leaves motors that freeze.
const FALLING_WATCHDOG: u8 = 10;

/// Torque of a motor after it was told to take it off.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum TorqueState {
    /// The motor confirmed that its torque is off.
    Off,
    /// The motor says that its torque is still on.
    On,
    /// The motor did not answer: nobody knows.
    Unknown,
}

/// Outcome of a switch-off for one motor.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct MotorOff {
    /// Name of the joint that it moves.
    pub joint: String,
    /// Id of the motor.
    pub id: u8,
    /// Torque at the end.
    pub torque: TorqueState,
    /// Reason, in words, where the torque is not off.
    pub fault: Option<String>,
}

/// Takes the torque off all motors of `robot` behind `port`, in whatever state they are: watchdog run out, hardware error, some of
/// them mute, driven by nobody, the port just back. Nothing else is changed but the bus watchdog, which is cleared where the torque is off.
///
/// # Errors
/// If options or model do not fit, the port fails and does not come back within 3 s, or no motor answers at all
/// ([`Error::NoMotors`]); a motor that does not answer among others is [`TorqueState::Unknown`].
pub fn switch_off<P: Port>(port: P, robot: &Robot, options: &LeapOptions) -> Result<Vec<MotorOff>> {
    Switch::new(port, robot, options)?.off()
}

/// Lowers the force of all motors under torque to nothing within `time`, where they are, and then takes their torque off as
/// [`switch_off`] does. No joint is told to move: what is held is let go slowly.
///
/// # Errors
/// As [`switch_off`].
pub fn release<P: Port>(port: P, robot: &Robot, options: &LeapOptions, time: Duration) -> Result<Vec<MotorOff>> {
    let mut switch = Switch::new(port, robot, options)?;
    match switch.fade(time) {
        // Off all the same, also where the port went away.
        Ok(()) | Err(Error::Port { .. }) => switch.off(),
        Err(other) => Err(other),
    }
}

struct Switch<P> {
    bus: Bus<P>,
    motors: Vec<MotorOff>,
    baud: u32,
}

impl<P: Port> Switch<P> {
    fn new(port: P, robot: &Robot, options: &LeapOptions) -> Result<Self> {
        options.check()?;
        let timing = known_timing(&port, options).unwrap_or_default();
        let motor = |j: super::joint::Joint| MotorOff {
            joint: j.name,
            id: j.id,
            torque: TorqueState::Unknown,
            fault: Some("did not answer".into()),
        };
        let motors = joints(robot, options)?.into_iter().map(motor).collect();
        let mut bus = Bus::new(port, timing);
        bus.limit_silence(Some(SILENCE));
        Ok(Self { bus, motors, baud: options.baud })
    }

    /// Writes one byte to all motors; nobody confirms it.
    fn tell_all(&mut self, register: table::Register<u8>, value: u8) -> Result<()> {
        let value = [value];
        self.bus.sync_write(register.address, 1, self.motors.iter().map(|m| (m.id, &value[..])))
    }

    fn off(mut self) -> Result<Vec<MotorOff>> {
        for round in 0..ROUNDS {
            if round > 0 {
                self.bus.pause(BETWEEN).or_else(|e| self.reopen(e))?;
            }
            self.round().or_else(|e| self.reopen(e).and_then(|()| self.round()))?;
            if self.motors.iter().all(|m| m.torque == TorqueState::Off) {
                break;
            }
            if self.motors.iter().all(|m| m.torque == TorqueState::Unknown) {
                let ids: Vec<u8> = self.motors.iter().map(|m| m.id).collect();
                return Err(nobody(&mut self.bus, &ids, self.baud));
            }
        }
        Ok(self.motors)
    }

    /// Tells and asks those that have not confirmed.
    fn round(&mut self) -> Result<()> {
        // Motors that were told to be quiet would look mute.
        self.tell_all(table::STATUS_LEVEL, 2)?;
        let open = |m: &MotorOff| m.torque != TorqueState::Off;
        let mut left = self.motors.iter().filter(|m| open(m)).map(|m| m.id).collect();
        let mut not_off = off_round(&mut self.bus, &mut left)?;
        for motor in self.motors.iter_mut().filter(|m| open(m)) {
            let found = not_off.iter().position(|n| n.id == motor.id).map(|k| not_off.swap_remove(k));
            (motor.torque, motor.fault) =
                found.map_or((TorqueState::Off, None), |found| (found.torque, Some(found.fault)));
        }
        Ok(())
    }

    /// Opens a port that failed again, for a while.
    fn reopen(&mut self, error: Error) -> Result<()> {
        if !matches!(error, Error::Port { .. }) {
            return Err(error);
        }
        let end = self.bus.port().now() + PORT_BACK;
        while self.bus.port().reopen().is_err() {
            let now = self.bus.port().now();
            if now >= end {
                return Err(error);
            }
            self.bus.port().wait_until(now + REOPEN);
        }
        self.bus.limit_silence(Some(SILENCE));
        Ok(())
    }

    /// Lets goal PWM and goal current of the motors under torque fall to zero.
    fn fade(&mut self, time: Duration) -> Result<()> {
        let (start, mut driven) = (table::GOAL_PWM.address, Vec::new());
        self.tell_all(table::STATUS_LEVEL, 2)?;
        for motor in &self.motors {
            let mut limits = [0; 4];
            let read = self.bus.get(motor.id, table::TORQUE_ENABLE).and_then(|torque| {
                self.bus.read(motor.id, start, &mut limits)?;
                Ok(torque != 0)
            });
            match read {
                Ok(true) => driven.push((
                    motor.id,
                    table::GOAL_PWM.in_block(start, &limits),
                    table::GOAL_CURRENT.in_block(start, &limits),
                )),
                Err(lost @ Error::Port { .. }) => return Err(lost),
                // Without torque there is nothing to lower; who does not answer is told with the others.
                _ => {}
            }
        }
        if driven.is_empty() {
            return Ok(());
        }
        // A motor that froze takes no goals, and has taken its place for its goal.
        self.tell_all(table::BUS_WATCHDOG, 0)?;
        self.tell_all(table::BUS_WATCHDOG, FALLING_WATCHDOG)?;
        let steps = time.as_millis().div_ceil(STEP.as_millis()).clamp(1, 500) as u32;
        for step in 1..=steps {
            let left = f64::from(steps - step) / f64::from(steps);
            let scaled = |value: i16| ((f64::from(value) * left) as i16).to_le_bytes();
            let orders: Vec<(u8, [u8; 4])> = driven
                .iter()
                .map(|(id, pwm, current)| {
                    let ([a, b], [c, d]) = (scaled(*pwm), scaled(*current));
                    (*id, [a, b, c, d])
                })
                .collect();
            self.bus.sync_write(start, 4, orders.iter().map(|(id, bytes)| (*id, &bytes[..])))?;
            self.bus.pause(STEP)?;
        }
        Ok(())
    }
}

/// A motor that did not confirm that its torque is off.
pub(crate) struct NotOff {
    pub(crate) id: u8,
    /// On or unknown.
    pub(crate) torque: TorqueState,
    /// Reason, in words.
    pub(crate) fault: String,
}

/// Orders motors to take their torque off and asks each; who confirms it leaves `left`, the others are returned. The order goes out again
/// with every question, so that a motor that could not be reached is off as soon as it can.
///
/// # Errors
/// If the port fails.
pub(crate) fn off_round<P: Port>(bus: &mut Bus<P>, left: &mut Vec<u8>) -> Result<Vec<NotOff>> {
    let (asked, off, mut not_off) = (left.clone(), [0], Vec::new());
    for id in &asked {
        bus.queue_sync_write(table::TORQUE_ENABLE.address, 1, left.iter().map(|id| (*id, &off[..])))?;
        let (torque, fault) = match bus.get(*id, table::TORQUE_ENABLE) {
            Ok(0) => {
                left.retain(|l| l != id);
                continue;
            }
            Ok(_) => (TorqueState::On, "says that its torque is still on".into()),
            Err(lost @ Error::Port { .. }) => return Err(lost),
            Err(Error::Silent { .. }) => (TorqueState::Unknown, "did not answer".into()),
            Err(other) => (TorqueState::Unknown, other.to_string()),
        };
        not_off.push(NotOff { id: *id, torque, fault });
    }
    // The others keep their watchdogs: whoever did not hear that its torque goes off stays frozen at least.
    let done = asked.iter().filter(|id| !left.contains(id));
    bus.sync_write(table::BUS_WATCHDOG.address, 1, done.map(|id| (*id, &off[..])))?;
    Ok(not_off)
}
