//! LEAP and Allegro hands under force control, safe by default, testable without a hand.

pub mod dynamixel;
pub mod emulator;
pub mod leap;

mod error;
mod hand;

pub use error::{Error, Result};
pub use hand::{EffortUnit, Hand, HandCommand, HandState, JointStatus};
