#![doc = include_str!("../README.md")]

mod adam;
mod answer;
pub mod bound;
pub mod calibrate;
mod checks;
mod distribution;
mod ensemble;
mod error;
mod estimate;
mod finger;
mod fit;
mod force;
pub mod frames;
mod hand;
mod heading;
mod identify;
mod invariance;
mod joint;
mod noise;
mod object;
mod options;
mod parameters;
pub mod plan;
mod posterior;
mod prior;
mod problem;
mod start;

pub use answer::{ErrorBudget, HandReport, Identification, ParameterEstimate, PushReport, Sensitivity, Verdict};
pub use distribution::MassDistribution;
pub use error::{Result, SysidError};
pub use identify::{identify, identify_watched};
pub use options::{IdentifyOptions, Method};
pub use parameters::{Knowledge, Parameter, ParameterSet};
pub use posterior::{CONTRADICTS_SD, MassPosterior, MassSource};
pub use prior::{GUESS_SD_LOG, MassPrior, WEIGHED_SD_LOG};
