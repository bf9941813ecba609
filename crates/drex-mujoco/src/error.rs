//! The error type of the crate.

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Why a scene does not run in MuJoCo.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The model, the scene or the state cannot be simulated by drex-diffsim either.
    #[error(transparent)]
    Simulation(#[from] drex_diffsim::Error),
    /// A setting of [`MjcfOptions`](crate::MjcfOptions) is out of range.
    #[error("options of MuJoCo: {what}; start from MjcfOptions::default()")]
    Options {
        /// Name of the setting and what is wrong with it.
        what: &'static str,
    },
    /// The model has something that MuJoCo has no counterpart of, or MuJoCo or its library refuses it.
    #[error("{what}; {remedy}")]
    Unsupported {
        /// Statement of what is wrong, and where.
        what: String,
        /// Advice on what to do about it.
        remedy: String,
    },
}
