//! The pipeline as a library: a twin folder from a scan, recorded pushes and human grasps to a mass, a policy and a grasp with the
//! right force.
//!
//! ```text
//! twin.toml ─► scan ─► identify ─► asset ─► grasps ─► train ─► evaluate ─► trial ─► execute ─► report
//!              mesh    mass.json   MJCF     on the    network   static      lift,    emulated   handed in
//!                                           object              check       shake    hand       (drex-report)
//! ```
//!
//! [`Twin::open`] reads the manifest, [`Twin::run`] does every stage whose inputs changed, [`Predictor`] gives the grasp of a
//! trained twin and [`deploy`](deploy::deploy) carries it out. What stages write is read with the types of [`records`].

pub mod deploy;
mod error;
mod hand;
mod inputs;
pub mod learn;
pub mod lock;
pub mod manifest;
pub mod masks;
mod object;
mod pipeline;
mod place;
mod predict;
mod progress;
pub mod rank;
pub mod reconstruct;
pub mod records;
pub mod scan;
mod scene;
mod stages;
pub mod timings;
mod twin;

pub use error::{Error, Result};
pub use hand::with_torque_cap;
pub use inputs::Stage;
pub use object::object_model;
pub use pipeline::{Reporter, RunOptions, RunSummary};
pub use predict::{FingerContact, PredictOptions, Prediction, Predictor, predict};
pub use progress::Progress;
pub use scene::Scene;
pub use stages::recordings;
pub use twin::Twin;

/// Runs the examples of the README as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
