//! A grasp policy conditioned on mass, with its force in newtons.
//!
//! [`GraspPolicy::train`] learns from a [`Dataset`] of grasps, [`GraspPolicy::predict`] proposes K grasps for surface points and a mass:
//!
//! ```
//! use std::ops::ControlFlow;
//! use drex_policy::{Dataset, Error, GraspPolicy, TrainOptions};
//!
//! fn lightest_squeeze(data: &Dataset, mass_kg: f64) -> Result<f64, Error> {
//!     let options = TrainOptions::default().with_seed(1);
//!     let (policy, report) = GraspPolicy::train(data, &options, &mut |epoch| {
//!         println!("epoch {}: {:.4}", epoch.epoch, epoch.total);
//!         ControlFlow::Continue(())
//!     })?;
//!     println!("error on grasps never seen: {:?}", report.held_out);
//!     let grasps = policy.predict(&data.points, mass_kg)?;
//!     Ok(grasps.iter().map(|g| g.squeeze_n).fold(f64::INFINITY, f64::min))
//! }
//! ```
//!
//! # The network
//! Points are centred on their bounding box, scaled by the size of a hand, encoded with sines and cosines (Mildenhall et al. 2020)
//! and passed one by one through a shared perceptron; maximum and mean over the points describe the object (PointNet, Qi et al. 2017). The
//! logarithm of the mass joins there, after pooling, so the encoder runs once however many masses are asked. Two more
//! layers give K modes of: joint angles (tanh onto the joint limits), wrist translation and the first two columns of its rotation
//! (Zhou et al. 2019), squeeze, and a logit.
//!
//! # The force
//! At fixed friction and contacts the smallest squeeze is proportional to the weight. So each mode predicts the logarithm of squeeze
//! over weight, bounded by twice the range seen in training, and multiplies by m g. Within the masses of the data the ratio may depend on the mass
//! (torque limits bind for heavy objects); outside it keeps its value at the nearest mass seen, and the force goes on in proportion.
//!
//! # The loss
//! Winner takes all (Rupprecht et al. 2017): a demonstration pulls on the mode nearest to it by [`grasp_distance_m`] and, less and less as training goes on,
//! on the others; the winner also learns the squeeze, and the logits learn which mode wins. Modes start from demonstrations spread over the
//! data (k-means++), so none starts dead.
//!
//! # Conventions
//! SI units; `object_from_palm` maps palm coordinates to object coordinates; joints are named. Training uses f32; everything outside
//! the network is f64. The same data, options and seed give the same bytes with any number of threads; processors with other vector
//! units may round differently.
//!
//! # Features
//! `flex` (default): burn's CPU backend in pure Rust. burn appears nowhere in this interface.

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

/// The example of the README runs as a test.
#[cfg(all(doctest, feature = "flex"))]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
