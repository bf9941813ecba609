//! What can go wrong, in words that say what to do.

/// Result of this crate.
pub type Result<T, E = RetargetError> = std::result::Result<T, E>;

/// A request that cannot be worked on. A pose that makes no grasp is no error but a [`crate::Verdict`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RetargetError {
    /// The joint values are not those of this robot.
    #[error("grasp joints: {what}; {remedy}")]
    Joints {
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: &'static str,
    },
    /// The robot is no hand, or an option makes no sense.
    #[error("{what}; {remedy}")]
    Value {
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: &'static str,
    },
    /// Contacts or forces could not be computed.
    #[error(transparent)]
    Grasp(#[from] drex_grasp::GraspError),
    /// A file cannot be read or used.
    #[error(transparent)]
    File(#[from] drex_core::Error),
    /// The robot model cannot be used.
    #[error(transparent)]
    Robot(#[from] drex_robot::Error),
}

impl RetargetError {
    pub(crate) fn value(what: impl Into<String>, remedy: &'static str) -> Self {
        Self::Value { what: what.into(), remedy }
    }
}
