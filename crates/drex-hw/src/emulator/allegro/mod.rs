//! An Allegro hand that is not there: sixteen joints with a drag, walls to press against, and the frames of versions 3, 4 and 5; in
//! memory, on any CAN bus, or behind a pseudo-terminal as an slcan adapter.
//!
//! ```
//! use drex_hw::allegro::{AllegroHand, AllegroOptions, AllegroVersion};
//! use drex_hw::emulator::allegro::AllegroEmulator;
//! use drex_robot::Robot;
//!
//! let hand = AllegroEmulator::new(AllegroVersion::V4);
//! let robot = Robot::bundled("allegro_right")?;
//! let driver = AllegroHand::connect_with_clock(hand.bus(), &robot, AllegroOptions::new(AllegroVersion::V4), hand.clock())?;
//! assert!(hand.is_on());
//! drop(driver);
//! assert!(!hand.is_on());
//! # Ok::<(), drex_hw::Error>(())
//! ```

mod bus;
mod device;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

pub use bus::{EmulatorBus, EmulatorClock};
pub use device::ReceivedCommand;

use crate::Result;
use crate::allegro::{AllegroInfo, AllegroOptions, AllegroReport, AllegroVersion};
use crate::can::{CanBus, CanFrame};
use device::Device;

/// How long a hand on a bus of its own waits for a frame before it looks at its joints again.
const TICK: Duration = Duration::from_micros(500);

/// An emulated Allegro hand. Clones are the same hand.
///
/// A torque that the hand was told is the torque of its joint: there is no friction but a drag, no weight and no play. Commands that stop
/// coming end the torques after 100 ms; real hands are not known to do so, see [`AllegroEmulator::set_watchdog`].
#[derive(Debug, Clone)]
pub struct AllegroEmulator {
    device: Arc<Mutex<Device>>,
    since: Instant,
    in_real_time: bool,
}

impl AllegroEmulator {
    /// A hand of this version with all joints at zero. Its time passes by frames on the bus, by waits, and by
    /// [`AllegroEmulator::pass`]: runs repeat exactly.
    pub fn new(version: AllegroVersion) -> Self {
        Self::with_options(AllegroOptions::new(version))
    }

    /// A hand with these units, zero positions and directions.
    pub fn with_options(options: AllegroOptions) -> Self {
        Self { device: Arc::new(Mutex::new(Device::new(options))), since: Instant::now(), in_real_time: false }
    }

    /// The same hand in real time; to be called before it is cloned.
    pub fn in_real_time(mut self) -> Self {
        (self.since, self.in_real_time) = (Instant::now(), true);
        self
    }

    /// The hand at this moment.
    fn device(&self) -> MutexGuard<'_, Device> {
        // A panic in a test must not hide behind another one.
        let mut device = self.device.lock().unwrap_or_else(PoisonError::into_inner);
        if self.in_real_time {
            device.advance_to(self.since.elapsed());
        }
        device
    }

    /// Time of the hand since it was made.
    pub fn now(&self) -> Duration {
        self.device().now
    }

    /// Lets `time` pass; without effect on a hand in real time.
    pub fn pass(&self, time: Duration) {
        if !self.in_real_time {
            let mut device = self.device();
            let then = device.now.saturating_add(time);
            device.advance_to(then);
        }
    }

    /// The computer's end of a bus in memory with this hand at it.
    pub fn bus(&self) -> EmulatorBus {
        EmulatorBus(self.clone())
    }

    /// The hand's clock.
    pub fn clock(&self) -> EmulatorClock {
        EmulatorClock(self.clone())
    }

    /// Lives on `bus` until `stop` is set or the bus is gone; for a hand in real time.
    ///
    /// # Errors
    /// [`crate::Error::Port`] if the bus is gone.
    pub fn serve(&self, bus: &mut dyn CanBus, stop: &AtomicBool) -> Result<()> {
        while !stop.load(Ordering::Relaxed) {
            if let Some(frame) = bus.receive(TICK)? {
                self.hear(&frame);
            }
            while let Some(frame) = self.say() {
                bus.send(&frame)?;
            }
        }
        Ok(())
    }

    /// Takes a frame from the bus.
    pub fn hear(&self, frame: &CanFrame) {
        self.device().hear(frame);
    }

    /// The next frame that the hand puts on the bus, if there is one yet.
    pub fn say(&self) -> Option<CanFrame> {
        self.device().out.pop_front()
    }

    /// Time until the next report is due; `None` if the hand is silent.
    fn until_next_report(&self) -> Option<Duration> {
        let device = self.device();
        device.next_report().map(|t| t.saturating_sub(device.now))
    }

    /// Puts something in the way of a joint, wire order: it cannot leave `lowest..=highest`, rad.
    pub fn set_wall(&self, joint: usize, lowest: f64, highest: f64) {
        if let Some(j) = self.device().joints.get_mut(joint) {
            j.wall = (lowest, highest);
        }
    }

    /// Moves a joint, wire order, by hand, rad.
    pub fn place(&self, joint: usize, q: f64) {
        if let Some(j) = self.device().joints.get_mut(joint) {
            (j.q, j.v) = (q, 0.0);
        }
    }

    /// Angles of the joints, wire order, rad.
    pub fn positions(&self) -> [f64; 16] {
        self.device().joints.map(|j| j.q)
    }

    /// Torques that act in the joints, wire order, N m.
    pub fn torques_nm(&self) -> [f64; 16] {
        let device = self.device();
        if device.on { device.joints.map(|j| j.commanded) } else { [0.0; 16] }
    }

    /// Torques with which the joints press on what is in their way, wire order, N m, signed.
    pub fn contact_torques_nm(&self) -> [f64; 16] {
        self.device().joints.map(|j| j.contact)
    }

    /// Whether the motors are on.
    pub fn is_on(&self) -> bool {
        self.device().on
    }

    /// After how long without torque commands torques become zero; `None` keeps the last ones for ever.
    pub fn set_watchdog(&self, after: Option<Duration>) {
        self.device().watchdog = after;
    }

    /// Silences a finger, 0 to 3, or lets it report again.
    pub fn mute(&self, finger: usize, mute: bool) {
        if let Some(m) = self.device().mute.get_mut(finger) {
            *m = mute;
        }
    }

    /// Sets the temperature of a joint, wire order, °C.
    pub fn heat(&self, joint: usize, celsius: u8) {
        if let Some(c) = self.device().celsius.get_mut(joint) {
            *c = celsius;
        }
    }

    /// Changes what the hand says about itself.
    pub fn set_info(&self, info: AllegroInfo) {
        self.device().info = info;
    }

    /// Lets a motor of version 5 report an error; 0 for none.
    pub fn fail(&self, motor: u8, code: u8) {
        self.device().say(AllegroReport::MotorError { motor, code });
    }

    /// Pulls the plug of the bus; the hand keeps its power.
    pub fn unplug(&self) {
        self.device().plugged = false;
    }

    /// Puts the plug back.
    pub fn plug(&self) {
        self.device().plugged = true;
    }

    /// Starts to note every command that the hand hears.
    pub fn record(&self) {
        self.device().record = Some(Vec::new());
    }

    /// The commands noted since [`AllegroEmulator::record`] or the last call, oldest first.
    pub fn take_record(&self) -> Vec<ReceivedCommand> {
        self.device().record.as_mut().map(std::mem::take).unwrap_or_default()
    }
}
