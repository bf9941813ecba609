//! A grasp policy conditioned on mass, with its force in newtons.

mod adam;
mod cloud;
mod data;
mod error;
mod evaluate;
mod files;
mod metric;
mod net;
mod norm;
mod options;
mod policy;
mod report;
mod split;
mod train;
mod weights;

pub use data::{Dataset, GRAVITY_M_S2, GraspSample, LIMIT_TOLERANCE_RAD};
pub use error::{Error, Result};
pub use metric::grasp_distance_m;
pub use options::TrainOptions;
pub use policy::{GraspPolicy, PredictedGrasp};
pub use report::{Baselines, EpochStats, GraspErrors, ModeReport, TrainReport};
