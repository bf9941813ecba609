//! The error type of the crate: what was wrong, where, and what to do.

use std::path::{Path, PathBuf};

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong when a policy is trained, used, saved or loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read or written.
    #[error(transparent)]
    Core(#[from] drex_core::Error),
    /// The data to train on cannot be used.
    #[error("training data of hand '{hand}'{}{}: {what}; {remedy}", sample.map(|s| format!(", sample {s}")).unwrap_or_default(), joint.as_ref().map(|j| format!(", joint '{j}'")).unwrap_or_default())]
    Dataset {
        /// Name of the hand.
        hand: String,
        /// 0-based index into [`Dataset::samples`](crate::Dataset::samples), where there is one.
        sample: Option<usize>,
        /// Name of the joint, where there is one.
        joint: Option<String>,
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// A training option is outside its range.
    #[error("training option '{option}': {what}")]
    Option {
        /// Name of the field of [`TrainOptions`](crate::TrainOptions).
        option: &'static str,
        /// Its value and the range it must be in.
        what: String,
    },
    /// What a prediction was asked for is outside what the policy is defined for.
    #[error("prediction: {what}; {remedy}")]
    Query {
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// A policy, a checkpoint or demonstrations are of another hand.
    #[error("policy of hand '{policy}', but '{given}' was given: {what}; {remedy}")]
    Hand {
        /// Hand of the policy or checkpoint.
        policy: String,
        /// Hand it was to be used with.
        given: String,
        /// What differs.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// A rollout failed, or its feedback cannot be used.
    #[error("rollout of object '{object}' at {mass_kg} kg and friction {friction}: {what}; {remedy}")]
    Rollout {
        /// Name of the object.
        object: String,
        /// Mass it was tried with, kg.
        mass_kg: f64,
        /// Friction it was tried with.
        friction: f64,
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// Training left the range of numbers.
    #[error("training diverged in epoch {epoch}: the loss is {loss}; lower the learning rate (it is {learning_rate})")]
    Diverged {
        /// 0-based epoch.
        epoch: usize,
        /// Value of the loss.
        loss: f64,
        /// The learning rate it happened with.
        learning_rate: f64,
    },
    /// A file of a saved policy is not what it should be.
    #[error("{}: {what}; {remedy}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// The crate was built without a backend that can compute.
    #[error("this build has no backend for the network; build drex-policy with its default feature `flex`")]
    NoBackend,
    /// The tensor library refused an operation.
    #[error("the tensor backend failed: {what}; this is a defect of drex-policy or of its backend, please report it")]
    Backend {
        /// Its message.
        what: String,
    },
}

impl Error {
    pub(crate) fn query(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Query { what: what.into(), remedy: remedy.into() }
    }

    pub(crate) fn file(path: &Path, what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::File { path: path.to_path_buf(), what: what.into(), remedy: remedy.into() }
    }
}
