//! The error type of the crate: what was wrong, where, and what to do.

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong between a program and a hand.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A number means nothing or is not allowed.
    #[error("hand: {what}; {remedy}")]
    Value {
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// The port failed.
    #[error("port {port}: {source}; {remedy}")]
    Port {
        /// Name of the port.
        port: String,
        /// What the system said.
        source: std::io::Error,
        /// What to do about it.
        remedy: String,
    },
}

impl Error {
    pub(crate) fn value(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Value { what: what.into(), remedy: remedy.into() }
    }
}
