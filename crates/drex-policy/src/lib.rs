//! A grasp policy conditioned on mass, with its force in newtons.

mod data;
mod error;
mod metric;
mod options;
mod policy;
mod report;

pub use data::{Dataset, GRAVITY_M_S2, GraspSample, LIMIT_TOLERANCE_RAD};
pub use error::{Error, Result};
pub use metric::grasp_distance_m;
pub use options::TrainOptions;
pub use policy::{GraspPolicy, PredictedGrasp};
pub use report::{Baselines, EpochStats, GraspErrors, ModeReport, TrainReport};
