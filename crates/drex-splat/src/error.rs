//! The error type of the crate: what was wrong, where, and what to do.

use std::path::PathBuf;

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong between photos and Gaussians.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read or written, or its content is damaged.
    #[error(transparent)]
    Core(#[from] drex_core::Error),
    /// A picture could not be decoded or encoded.
    #[error("cannot {action} the picture {}: {source}", path.display())]
    Picture {
        /// "read" or "write".
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The codec's reason, in its words. Boxed, so that the library behind it can change.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A set of Gaussians that cannot be rendered or trained.
    #[error("{what}; {remedy}")]
    Gaussians {
        /// What is wrong, with the index of the Gaussian.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// A capture (photos, cameras, masks) that cannot be used.
    #[error("{what}; {remedy}")]
    Capture {
        /// What is wrong, with the photo's name.
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
    /// Another program (COLMAP, ffmpeg) is missing or failed.
    #[error("{what}; {remedy}")]
    Tool {
        /// Which one, and what it said last.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// No GPU adapter, or it failed.
    #[error("{what}; {remedy}")]
    Gpu {
        /// What happened.
        what: String,
        /// What to do about it.
        remedy: String,
    },
}
