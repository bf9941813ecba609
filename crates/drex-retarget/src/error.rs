//! What can go wrong, in words that say what to do.

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// A request that cannot be worked on. A hand that makes no grasp is no error but has failures, see [`drex_grasp::GraspEvaluation`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The joint values are not those of this robot.
    #[error("grasp joints: {what}; {remedy}")]
    Joints {
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: &'static str,
    },
    /// A hand cannot be mapped: the mapping file, or what was derived from the model, does not fit.
    #[error("{}, {key}: {what}; {remedy}", path.display())]
    Mapping {
        /// The mapping file, or the model where there is none.
        path: std::path::PathBuf,
        /// Which entry.
        key: String,
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// Contacts or forces could not be computed.
    #[error(transparent)]
    Grasp(#[from] drex_grasp::GraspError),
    /// A file cannot be read or used, the robot is no hand, or an option is outside of its range.
    #[error(transparent)]
    Core(#[from] drex_core::Error),
    /// The robot model cannot be used.
    #[error(transparent)]
    Robot(#[from] drex_robot::Error),
}

impl Error {
    pub(crate) fn value(what: impl Into<String>, remedy: &'static str) -> Self {
        drex_core::Error::value(what, remedy).into()
    }

    pub(crate) fn mapping(
        path: &std::path::Path,
        key: impl Into<String>,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Mapping { path: path.into(), key: key.into(), what: what.into(), remedy: remedy.into() }
    }
}
