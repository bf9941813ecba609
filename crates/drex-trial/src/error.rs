//! The error type of the crate: what was wrong, where, and what to do.

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong when a grasp is tried. A grasp that fails is no error.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A number means nothing.
    #[error("trial: {what}; {remedy}")]
    Value {
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// The simulator refused the model.
    #[error("the trial cannot be simulated: {0}")]
    Simulation(#[from] drex_diffsim::Error),
    /// MuJoCo refused the model.
    #[cfg(feature = "mujoco")]
    #[error("the trial cannot be simulated: {0}")]
    Mujoco(drex_mujoco::Error),
    /// The hand's model lacks what a trial needs.
    #[error("the hand cannot be tried: {0}")]
    Hand(#[from] drex_robot::Error),
    /// Contacts or forces could not be computed.
    #[error("the grasp cannot be analysed: {0}")]
    Grasp(#[from] drex_grasp::GraspError),
    /// The caller stopped the work.
    #[error("stopped before it was done; start it again")]
    Stopped,
    /// The engine is not part of this build.
    #[error(
        "this build has no MuJoCo; build with the feature `mujoco` (the README of drex-mujoco tells how) or simulate with diffsim"
    )]
    NoMujoco,
}

#[cfg(feature = "mujoco")]
impl From<drex_mujoco::Error> for Error {
    fn from(error: drex_mujoco::Error) -> Self {
        match error {
            drex_mujoco::Error::Simulation(error) => Self::Simulation(error), // a divergence reads alike in both engines
            error => Self::Mujoco(error),
        }
    }
}

impl Error {
    pub(crate) fn value(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Value { what: what.into(), remedy: remedy.into() }
    }
}
