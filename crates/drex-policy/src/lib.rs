//! A grasp policy conditioned on mass, with its force in newtons.
//!
//! [`GraspPolicy::train`] learns from a [`Dataset`] of grasps, [`GraspPolicy::predict`] proposes K grasps for surface points and a mass:
//!
//! ```
//! use std::ops::ControlFlow;
//! use drex_policy::{Dataset, Error, GraspPolicy, Query, TrainOptions};
//!
//! fn least_grip_force(data: &Dataset, mass_kg: f64, friction: f64) -> Result<f64, Error> {
//!     let options = TrainOptions::default().with_seed(1);
//!     let (policy, report) = GraspPolicy::train(data, &options, &mut |epoch| {
//!         println!("epoch {}: {:.4}", epoch.epoch, epoch.total);
//!         ControlFlow::Continue(())
//!     })?;
//!     println!("error on grasps never seen: {:?}", report.held_out);
//!     let grasps = policy.predict(&Query::new(&data.objects[0].points, mass_kg, friction))?;
//!     Ok(grasps.iter().map(|g| g.grip_force_n).fold(f64::INFINITY, f64::min))
//! }
//! ```
//!
//! [`Trainer`] does the same epoch by epoch, with checkpoints that can be resumed, and goes on with grasps tried in [`Rollouts`].
//!
//! # The network
//! Points are turned upright, centred on their bounding box, scaled by the size of a hand, encoded with sines and cosines (Mildenhall et al. 2020)
//! and passed one by one through a shared perceptron; maximum and mean over the points describe the object (PointNet, Qi et al. 2017). The
//! logarithms of mass and friction and the height of the table below the object's centre join there, after pooling, so the encoder runs once
//! however many masses are asked. Two more layers give K modes of: joint angles (tanh onto the joint limits), wrist translation and
//! the first two columns of its rotation (Zhou et al. 2019), grip force, a logit, and a contact logit per finger.
//!
//! # The force
//! At fixed contacts the minimum grip force is proportional to the weight, and of two opposed contacts to one over the friction. So each mode
//! predicts the logarithm of grip force times friction over weight, bounded by twice the range seen in training. Within the masses and
//! frictions of the data the ratio may depend on both (torque limits bind for heavy objects); outside it keeps its value at the nearest one seen,
//! and the force goes on in proportion.
//!
//! # The loss
//! Minus the log-likelihood of the demonstrations under a mixture: each mode a Student's t about its joints and wrist, one learned spread per
//! joint, one of the wrist's translation, one of its rotation. It is a normalised density, so that policies can be compared by the
//! likelihood of grasps they have not seen ([`GraspPolicy::log_density`]). Every mode gets a small share of every demonstration that falls to zero
//! as training goes on; modes start from demonstrations spread over the data (k-means++), so none starts dead. Grip forces and contacts are learned
//! by the modes that explain a demonstration.
//!
//! # Conventions
//! SI units; `object_from_base` is the pose of the hand's base in the object's frame; joints are named. Training uses f32; everything outside
//! the network is f64. The same data, options and seed give the same bytes with any number of threads; processors with other vector
//! units may round differently.
//!
//! # Features
//! `flex` (default): burn's CPU backend in pure Rust. burn appears nowhere in this interface.

mod adam;
mod cloud;
mod curve;
mod data;
mod density;
mod error;
mod evaluate;
mod files;
mod loss;
mod metric;
mod net;
mod norm;
mod options;
pub mod paper;
mod policy;
pub mod proposal;
mod report;
mod sample;
mod split;
mod tensors;
mod train;
mod view;
mod weights;

pub use data::{Dataset, FRICTION_RANGE, GRAVITY_M_S2, GraspSample, LIMIT_TOLERANCE_RAD, MASS_RANGE_KG, ObjectCloud};
pub use error::{Error, Result};
pub use metric::grasp_distance_m;
pub use options::{RolloutOptions, TrainOptions};
pub use policy::{GraspPolicy, PAPER_FORCE_N, PredictedGrasp, Query, Spread, normalised_grip_force};
pub use report::{Baselines, EpochStats, GraspErrors, ModeReport, RolloutStats, TrainReport};
pub use train::{Feedback, Rollouts, Trainer};

/// The example of the README runs as a test.
#[cfg(all(doctest, feature = "flex"))]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
