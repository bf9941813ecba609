//! LEAP and Allegro hands under force control, safe by default, testable without a hand.

pub mod allegro;
pub mod can;
pub mod control;
pub mod driver;
pub mod dynamixel;
pub mod emulator;
#[cfg(unix)]
pub mod guard;
pub mod law;
pub mod leap;

mod clock;
mod error;
mod hand;

pub use clock::{Clock, SystemClock};
pub use error::{Error, Result};
pub use hand::{EffortUnit, Hand, HandCommand, HandState, JointStatus};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
