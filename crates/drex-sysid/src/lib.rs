//! The mass of an object from a recorded push: an estimate, its interval, and a verdict whether the push can tell.
//!
//! [`identify`] simulates the push with many masses, compares with the tracked poses, and refines the best mass with
//! exact derivatives. Where a recording carries no information about the mass (a toss, a replayed hand), it says so.

mod answer;
mod error;
mod estimate;
mod identify;
mod invariance;
mod noise;
mod object;
mod options;
mod problem;
mod random;

pub use answer::{ErrorBudget, Identification, PushReport, Verdict};
pub use error::{Result, SysidError};
pub use identify::identify;
pub use object::ObjectModel;
pub use options::IdentifyOptions;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
