//! What identification refuses.

use drex_diffsim::Error as SimulationError;

/// Result of this crate.
pub type Result<T, E = SysidError> = std::result::Result<T, E>;

/// Why a push cannot be evaluated at all. That a push carries no information is no error: it is a verdict.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SysidError {
    /// No recording was given.
    #[error("no recording was given; name at least one push")]
    NoRecording,
    /// The track has too few poses.
    #[error("push `{push}`: the track has {poses} poses; at least {needed} are needed")]
    TooFewPoses {
        /// Name of the push.
        push: String,
        /// Poses there are.
        poses: usize,
        /// Poses needed.
        needed: usize,
    },
    /// The mesh cannot serve as a rigid body.
    #[error("the object's mesh {what}; {remedy}")]
    Object {
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// An option is outside its range.
    #[error("option {option}: {what}")]
    Option {
        /// Name of the option.
        option: &'static str,
        /// What is wrong, and what to do.
        what: String,
    },
    /// A parameter cannot be what was stated.
    #[error("parameter {name} {what}; {remedy}")]
    Parameter {
        /// Its name.
        name: String,
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// The recording contradicts itself or the object.
    #[error("push `{push}`: {what}; {remedy}")]
    Recording {
        /// Name of the push.
        push: String,
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// Frames and clocks of a track cannot be found.
    #[error("frames of the track: {what}; {remedy}")]
    Frames {
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// A hand cannot be calibrated, or a calibration cannot be used.
    #[error("calibration of the hand: {what}; {remedy}")]
    Calibration {
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// The robot's model is unusable.
    #[error(transparent)]
    Robot(#[from] drex_robot::Error),
    /// The simulator refused the push.
    #[error("push `{push}`: {source}")]
    Simulation {
        /// Name of the push.
        push: String,
        /// Its reason.
        #[source]
        source: SimulationError,
    },
    /// Masses or tensors of the mesh are unusable.
    #[error(transparent)]
    Core(#[from] drex_core::Error),
}
