//! The LEAP hand: 16 Dynamixel motors in current-based position mode.

mod cycle;
mod driver;
mod faults;
mod inspect;
mod joint;
mod options;
mod setup;
pub mod table;

pub use driver::LeapHand;
pub use inspect::{Finding, inspect};
pub use joint::MotorHealth;
pub use options::{LeapGains, LeapJoint, LeapOptions};
