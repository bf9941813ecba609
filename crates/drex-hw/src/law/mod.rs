//! Current and joint torque of a motor: measured, fitted, logged with every run.
//!
//! The published numbers for one motor differ by a factor of 2.7, so that a law is an object that somebody calibrated, with its
//! [`Provenance`]. [`fit`] makes one from measured pairs; [`TorqueLaw::nominal`] gives the published ones, marked as such.

mod curve;
mod estimate;
mod fit;
mod hysteresis;
mod limits;
mod nnls;
mod nominal;
mod ramp;

pub use curve::{Curve, Provenance, TorqueLaw};
pub use estimate::{ContactDirection, ForceEstimate, estimate_forces};
pub use fit::{Approach, Sample, fit};
pub use hysteresis::Hysteresis;
pub use limits::{ContactForce, LimitMode, LimitOptions, contact_torques, torque_limits_nm};
pub use nominal::Nominal;
pub use ramp::{LimitRamp, RampOptions};
