#![doc = include_str!("../README.md")]

mod adam;
mod answer;
pub mod bound;
pub mod calibrate;
mod checks;
mod closed_form;
mod error;
mod estimate;
mod finger;
mod fit;
mod force;
pub mod frames;
mod hand;
mod identify;
mod information;
mod invariance;
mod joint;
mod noise;
mod object;
mod options;
mod parameters;
pub mod plan;
mod primitive;
mod prior;
mod problem;
mod profile;
mod rivals;

pub use answer::{ErrorBudget, HandReport, Identification, ParameterEstimate, PushReport, Sensitivity, Verdict};
pub use closed_form::{ClosedForm, ClosedFormKind};
pub use error::{Result, SysidError};
pub use identify::{identify, identify_watched};
pub use object::ObjectModel;
pub use options::{IdentifyOptions, Method};
pub use parameters::{Knowledge, Parameter, ParameterSet};
pub use prior::MassPrior;
