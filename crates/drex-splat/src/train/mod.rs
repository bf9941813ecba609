//! From photos to Gaussians: the optimisation.

mod checkpoint;
mod density;
mod hull;
mod init;
mod model;
mod options;
mod preset;
mod state;
mod trainer;
mod views;

pub use hull::VisualHull;
pub(crate) use init::from_surface;
pub use init::{SurfacePoint, from_points};
pub use options::{Adaptive, Coarse, Density, Mcmc, Rates, SurfaceTerms, TrainOptions};
pub use preset::{DensityChoice, Preset};
pub(crate) use trainer::NEAR;
pub use trainer::{Progress, Trainer};
pub use views::Views;
