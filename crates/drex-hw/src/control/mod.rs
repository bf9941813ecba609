//! A fixed-rate loop over any [`Hand`](crate::Hand), on a thread of its own: waypoints or a grasp in, telemetry and timing out.
//!
//! However the loop ends, the torque goes off: when the work is done, by the [`EStop`], by an error of the hand, by a panic, and when
//! the [`ControlLoop`] is dropped. Only a program that is killed, hangs, or is built to abort on panic leaves the hand to its
//! [guard](crate::guard), or without one to its own watchdog.

mod controller;
mod csv;
mod cycle;
mod fault_log;
mod grasp;
mod grasp_plan;
mod options;
mod stats;
mod stop;
mod telemetry;
mod thread;
mod trajectory;

pub use controller::{Controller, HoldPosition, Joints};
pub use csv::write_csv;
pub use cycle::{LoopReport, StopReason, run};
pub use fault_log::JointFault;
pub use grasp::{GraspController, GraspHandle};
pub use grasp_plan::{GraspContact, GraspOutcome, GraspPhase, GraspPlan};
pub use options::{ControlOptions, Derating};
pub use stats::{LoopStats, Quantiles};
pub use stop::EStop;
#[cfg(unix)]
pub use stop::stop_on_signals;
pub use telemetry::{Recorder, Sample, Telemetry, telemetry};
pub use thread::ControlLoop;
pub use trajectory::{Trajectory, Waypoint};
