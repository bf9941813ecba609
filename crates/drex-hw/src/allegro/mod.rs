//! The Allegro hand over CAN, versions 3, 4 and 5: torques out, poses in, the position loop on the computer.

mod driver;
mod finger;
mod frames;
mod off;
mod options;
mod power;
mod trait_hand;

pub use driver::{AllegroHand, AllegroStats};
pub use frames::{AllegroCommand, AllegroInfo, AllegroReport, AllegroVersion};
pub use off::{AllegroOff, reports_poses, switch_off};
pub use options::{AllegroOptions, Gains, JointCalibration};
