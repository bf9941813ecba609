//! Grasp proposals for objects that nobody has trained on: one network over many objects.
//!
//! [`train`] learns from [`GraspedObject`]s, grasps that a search found and a simulator verified; [`ProposalNetwork::propose`] answers in
//! milliseconds on one core, for clouds from all sides or from one, whichever way the object is turned.

mod data;
mod forward;
mod network;
mod prototypes;
mod scene;
mod train;
mod weights;

pub use data::{GraspedObject, LABELLED_KG, LabelledGrasp};
pub use network::{HandCard, ProposalNetwork};
pub use train::{ProposalOptions, ProposalProgress, train};
