//! The error type of the crate: what was wrong, where, and what to do.

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong between photos and Gaussians.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read or written, its content is damaged, a capture cannot be used, or a GPU is missing or failed.
    #[error(transparent)]
    Core(#[from] drex_core::Error),
    /// A set of Gaussians that cannot be rendered or trained.
    #[error("{what}; {remedy}")]
    Gaussians {
        /// What is wrong, with the index of the Gaussian.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// Training cannot start or go on.
    #[error("{what}; {remedy}")]
    Training {
        /// What is wrong, with the iteration.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// An option outside what it is defined for.
    #[error("{what}; {remedy}")]
    Option {
        /// The option and its value.
        what: String,
        /// What it may be.
        remedy: String,
    },
}
