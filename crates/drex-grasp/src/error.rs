//! What can go wrong, in words that say what to do.

/// Result of this crate.
pub type Result<T, E = GraspError> = std::result::Result<T, E>;

/// A grasp that cannot be analysed. A *bad* grasp is no error: see [`crate::GripForceError`] and [`crate::GraspEvaluation`].
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GraspError {
    /// A contact is no contact: a number is not finite, the normal is not a unit vector or the friction is negative.
    #[error("contact {index}: {what}; {remedy}")]
    Contact {
        /// Index into the list of contacts.
        index: usize,
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: &'static str,
    },
    /// An option or a size is outside what the function is defined for.
    #[error("{what}; {remedy}")]
    Value {
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: &'static str,
    },
    /// The robot model refused the joint values, a link or a finger.
    #[error("robot model: {0}")]
    Robot(String),
    /// The cone solver stopped without an answer.
    #[error(
        "the cone programme stopped with {status} after {iterations} iterations; scale the problem or check the contacts for duplicates"
    )]
    Solver {
        /// The solver's own word.
        status: String,
        /// Iterations spent.
        iterations: u32,
    },
}

impl GraspError {
    pub(crate) fn value(what: impl Into<String>, remedy: &'static str) -> Self {
        Self::Value { what: what.into(), remedy }
    }
}
