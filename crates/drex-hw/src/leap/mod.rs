//! The LEAP hand: 16 Dynamixel motors in current-based position mode.
//!
//! Each motor is told a goal and the largest current, mA, with which it may go there; in contact the current sets the force. Here with
//! an emulated hand; [`LeapHand::open`] takes a real one at a serial port.
//!
//! ```
//! use drex_hw::{Hand, HandCommand, HandState};
//! use drex_hw::emulator::leap::LeapEmulator;
//! use drex_hw::leap::{LeapHand, LeapOptions};
//! use drex_robot::Robot;
//!
//! let robot = Robot::bundled("leap_right")?;
//! let mut hand = LeapHand::connect(LeapEmulator::new().port(), &robot, LeapOptions::right().with_cap_ma(350.0))?;
//! for finding in hand.findings() {
//!     eprintln!("{finding}");
//! }
//! hand.turn_on()?;
//! let command = HandCommand { position: vec![0.2; 16], effort_limit: vec![100.0; 16] };
//! let mut state = HandState::new(16);
//! for _ in 0..500 {
//!     hand.cycle(Some(&command), &mut state)?;
//! }
//! assert!(state.position.iter().all(|q| *q > 0.0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Dropping the hand takes the torque off. A motor that stops itself because of overload is started again while the others go on;
//! one that does not answer keeps its old values in [`HandState`](crate::HandState) and grows older.

mod absent;
mod cycle;
mod driver;
mod faults;
mod finding;
mod inspect;
mod inspection;
mod joint;
mod off;
mod options;
mod setup;
pub mod table;
mod torque;

pub use driver::LeapHand;
pub use finding::{Finding, FindingKind, refuse_motion};
pub use inspect::inspect;
pub use inspection::{HandInspection, MotorInspection, MotorReading, inspect_hand};
pub use joint::MotorHealth;
#[cfg(unix)]
pub(crate) use off::off_round;
pub use off::{MotorOff, TorqueState, release, switch_off};
pub use options::{LeapGains, LeapJoint, LeapOptions};
