//! Current and joint torque of a motor: measured, fitted, logged with every run.
//!
//! The published numbers for one motor differ by a factor of 2.7, so that a model is an object that somebody calibrated, with its
//! [`Provenance`]. [`fit`] makes one from measured pairs; [`TorqueCurrentModel::nominal`] gives the published ones, marked as such.

mod estimate;
mod fit;
mod hysteresis;
mod limits;
mod model;
mod nnls;
mod nominal;
mod ramp;

pub use estimate::{ContactDirection, ForceEstimate, estimate_forces};
pub use fit::{Approach, Sample, fit};
pub use hysteresis::Hysteresis;
pub use limits::{ContactForce, LimitMode, LimitOptions, contact_torques, torque_limits_nm};
pub use model::{Curve, Provenance, TorqueCurrentModel};
pub use nominal::Nominal;
pub use ramp::{LimitRamp, RampOptions};
