//! A LEAP hand that is not there: 16 motors on a bus, in memory or behind a pseudo-terminal.
//!
//! ```
//! use drex_hw::dynamixel::{Bus, Timing};
//! use drex_hw::emulator::leap::LeapEmulator;
//!
//! let hand = LeapEmulator::new();
//! let mut bus = Bus::new(hand.port(), Timing::default());
//! assert_eq!(bus.scan()?.len(), 16);
//! # Ok::<(), drex_hw::Error>(())
//! ```

mod fault;
mod motor;
mod physics;
mod port;
mod registers;
#[cfg(unix)]
mod serial;
mod wire;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

pub use fault::Fault;
pub use port::EmulatorPort;
#[cfg(unix)]
pub use serial::PacedLeap;
pub use wire::WriteRecord;

use crate::leap::table::{self, MotorModel, Register, Value};
use crate::{Clock, SystemClock};
use wire::{Supply, Wire};

/// An emulated LEAP hand. Clones are the same hand.
#[derive(Debug, Clone)]
pub struct LeapEmulator {
    wire: Arc<Mutex<Wire>>,
    /// When a hand that lives in real time was made.
    since: Option<SystemClock>,
}

impl Default for LeapEmulator {
    fn default() -> Self {
        Self::new()
    }
}

impl LeapEmulator {
    /// A full hand, ids 0 to 15, all joints at zero (tick 2048). Its time passes by bytes on the bus, by waits, and by
    /// [`LeapEmulator::pass`]: runs repeat exactly.
    pub fn new() -> Self {
        Self::with_model(MotorModel::Xc330M288)
    }

    /// As [`LeapEmulator::new`] with motors of another model.
    pub fn with_model(model: MotorModel) -> Self {
        Self { wire: Arc::new(Mutex::new(Wire::new(model))), since: None }
    }

    /// The same hand in real time.
    pub fn in_real_time(mut self) -> Self {
        self.since = Some(SystemClock::default());
        self
    }

    fn wire(&self) -> MutexGuard<'_, Wire> {
        // A panic in a test must not hide behind another one.
        let mut wire = self.wire.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(since) = &self.since {
            // Whoever looks sees the hand as it is now, also if nobody talks to it.
            wire.advance_to(since.now());
        }
        wire
    }

    /// Lets `time` pass; without effect on a hand in real time.
    pub fn pass(&self, time: Duration) {
        if self.since.is_none() {
            self.wire().pass(time);
        }
    }

    /// A port of this hand in memory.
    pub fn port(&self) -> EmulatorPort {
        EmulatorPort::new(self.clone())
    }

    /// Hands `request` to the motors; what they answer is appended to `reply`. For how long they hesitated, by their return delays.
    pub fn exchange(&self, request: &[u8], reply: &mut Vec<u8>) -> Duration {
        self.wire().receive(request, reply)
    }

    /// Lets `fault` happen in the next `times` questions that it concerns.
    pub fn inject(&self, fault: Fault, times: u32) {
        self.wire().inject(fault, times);
    }

    /// Lets `fault` happen once, after it could have happened `skipped` times.
    pub fn inject_later(&self, fault: Fault, skipped: u32) {
        self.wire().inject_later(fault, skipped);
    }

    /// Raises hardware errors of motor `id`.
    pub fn fail(&self, id: u8, bits: u8) {
        self.with_motor(id, |m| m.fail(bits));
    }

    /// Takes the power of motor `id` for a moment: it forgets what is in RAM.
    pub fn power_cycle(&self, id: u8) {
        let now = self.now();
        self.with_motor(id, |m| m.reboot(now));
    }

    /// Cuts the data line to motor `id`, which keeps its power and hears and says nothing, or mends it.
    pub fn detach(&self, id: u8, cut: bool) {
        self.with_motor(id, |m| m.detached = cut);
    }

    /// Supplies all motors with `volts`, less `ohms` times the sum of their currents. Below 3.5 V (register 34) a motor has the
    /// input-voltage error, below 3 V it goes without power and forgets what is in RAM.
    pub fn set_supply(&self, volts: f64, ohms: f64) {
        let mut wire = self.wire();
        wire.supply = Some(Supply { volts, ohms });
        wire.feed();
    }

    /// Lets the position sensor of motor `id` stay at what it reads now, whatever the joint does, or frees it.
    pub fn stick_encoder(&self, id: u8, stuck: bool) {
        self.with_motor(id, |m| m.body.stuck = stuck.then_some(m.body.position));
    }

    /// Lets the current sensor of motor `id` read `factor` (above zero) times the current that flows; the motor limits what it reads.
    pub fn set_current_sensor(&self, id: u8, factor: f64) {
        self.with_motor(id, |m| m.body.sensor = if factor > 0.0 { factor } else { 1.0 });
    }

    /// Pulls the plug of the port; the motors keep their power.
    pub fn unplug(&self) {
        self.wire().plugged = false;
    }

    /// Puts the plug back.
    pub fn plug(&self) {
        self.wire().plugged = true;
    }

    /// Whether the plug is in.
    pub fn plugged(&self) -> bool {
        self.wire().plugged
    }

    /// Puts something in the way of motor `id`: it cannot leave `lowest..=highest`, ticks.
    pub fn set_wall(&self, id: u8, lowest: f64, highest: f64) {
        self.with_motor(id, |m| m.body.wall = (lowest, highest));
    }

    /// Moves motor `id` by hand, ticks.
    pub fn place(&self, id: u8, ticks: f64) {
        self.with_motor(id, |m| {
            m.body.position = ticks;
            m.body.stop();
            m.show();
        });
    }

    /// A register of motor `id`; `None` if there is no such motor.
    pub fn get<T: Value>(&self, id: u8, register: Register<T>) -> Option<T> {
        self.wire().motors.iter().find(|m| m.id == id).map(|m| m.get(register))
    }

    /// Sets a register of motor `id` as if it had always been so, whatever its rules say.
    pub fn set<T: Value>(&self, id: u8, register: Register<T>, value: T) {
        self.with_motor(id, |m| m.set(register, value));
    }

    /// Speed of the bus, which is that of the first motor.
    fn baud(&self) -> u32 {
        let code = self.get(0, table::BAUD).unwrap_or_default();
        [9600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000].get(usize::from(code)).copied().unwrap_or(4_000_000)
    }

    /// Where motor `id` really is, ticks.
    pub fn position(&self, id: u8) -> Option<f64> {
        self.wire().motors.iter().find(|m| m.id == id).map(|m| m.body.position)
    }

    /// Number of motors under torque.
    pub fn under_torque(&self) -> usize {
        self.wire().motors.iter().filter(|m| m.get(table::TORQUE_ENABLE) != 0).count()
    }

    /// Starts to note every write that a motor has accepted or refused.
    pub fn record_writes(&self) {
        self.wire().record = Some(Vec::new());
    }

    /// The writes noted since [`LeapEmulator::record_writes`] or the last call, oldest first.
    pub fn take_writes(&self) -> Vec<WriteRecord> {
        self.wire().record.as_mut().map(std::mem::take).unwrap_or_default()
    }

    fn with_motor(&self, id: u8, change: impl FnOnce(&mut motor::Motor)) {
        if let Some(motor) = self.wire().motors.iter_mut().find(|m| m.id == id) {
            change(motor);
        }
    }
}

impl Clock for LeapEmulator {
    /// Time of the hand since it was made.
    fn now(&self) -> Duration {
        self.since.map_or_else(|| self.wire().now(), |since| since.now())
    }

    fn wait_until(&self, then: Duration) {
        match &self.since {
            Some(since) => since.wait_until(then),
            None => self.pass(then.saturating_sub(self.now())),
        }
    }
}
