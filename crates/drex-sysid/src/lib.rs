#![doc = include_str!("../README.md")]

mod answer;
pub mod bound;
pub mod calibrate;

mod error;
mod estimate;
mod finger;
pub mod frames;
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
