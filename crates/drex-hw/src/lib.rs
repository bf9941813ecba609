//! LEAP and Allegro hands under force control, safe by default, testable without a hand.

pub mod allegro;
pub mod can;
pub mod control;
pub mod driver;
pub mod dynamixel;
pub mod emulator;
#[cfg(unix)]
pub mod guard;
pub mod leap;
pub mod torque_current;

mod clock;
mod error;
mod hand;
#[cfg(unix)]
mod taken_over;

pub use clock::{Clock, SystemClock};
pub use error::{Error, Result};
pub use hand::{EffortUnit, Hand, HandCommand, HandState, JointStatus};
#[cfg(unix)]
pub use taken_over::TakenOver;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
