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
//!
//! Of many objects: [`batch`].
//!
//! Without the default feature `stages` a twin folder is read and not run: there are [`Twin`], its [`manifest`], [`lock`] and
//! [`records`], and the [`cameras`] of a scan, for programs that need neither burn nor the engine that finds cameras.

#[cfg(feature = "stages")]
mod alone;
#[cfg(feature = "stages")]
pub mod batch;
#[cfg(feature = "stages")]
pub mod born;
pub mod cameras;
#[cfg(feature = "stages")]
pub mod deploy;
mod error;
mod hand;
#[cfg(feature = "stages")]
mod inputs;
#[cfg(feature = "stages")]
pub mod learn;
pub mod lock;
pub mod manifest;
#[cfg(feature = "stages")]
pub mod masks;
#[cfg(feature = "stages")]
mod object;
#[cfg(feature = "stages")]
mod outlines;
#[cfg(feature = "stages")]
mod pipeline;
#[cfg(feature = "stages")]
mod place;
#[cfg(feature = "stages")]
mod predict;
#[cfg(feature = "stages")]
mod progress;
#[cfg(feature = "stages")]
pub mod propose;
#[cfg(feature = "stages")]
pub mod reconstruct;
pub mod records;
#[cfg(feature = "stages")]
mod scale;
#[cfg(feature = "stages")]
pub mod scan;
#[cfg(feature = "stages")]
mod scene;
#[cfg(feature = "stages")]
mod stages;
#[cfg(feature = "stages")]
mod stereo;
#[cfg(feature = "stages")]
mod surfels;
#[cfg(feature = "stages")]
mod texture;
#[cfg(feature = "stages")]
pub mod timings;
mod twin;

#[cfg(feature = "stages")]
pub use {
    alone::Alone,
    inputs::Stage,
    pipeline::{Reporter, RunOptions, RunSummary},
    predict::{PredictOptions, Prediction, Predictor, predict},
    progress::Progress,
    scene::Scene,
    stages::recordings,
};
pub use {
    error::{Error, Result},
    hand::with_torque_cap,
    twin::Twin,
};

/// Runs the examples of the README as tests.
#[cfg(all(doctest, feature = "stages"))]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
