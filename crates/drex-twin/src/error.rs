//! What can go wrong in a twin: what was done, what was wrong, and what to do.

use std::fmt::Display;
use std::path::PathBuf;

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Why a stage, a prediction or a deployment failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// What is asked cannot be done with what the twin holds; the message says what is missing and what to do.
    #[error("{0}")]
    Refused(String),
    /// Another process works on the folder; the same can be tried again when it is done.
    #[error("another drex is at work on {}: {who}; wait until it is done, or end it", folder.display())]
    Busy {
        /// The folder.
        folder: PathBuf,
        /// The process as far as it is known, with its host where that may be another one.
        who: String,
    },
    /// [`Progress::is_stopped`](crate::Progress::is_stopped) said so.
    #[error("stopped; another run goes on from here")]
    Stopped,
    /// Something failed while something else was being done.
    #[error("{doing}")]
    While {
        /// What was being done, or the file or stage at work.
        doing: String,
        /// Why it failed.
        #[source]
        source: Box<Error>,
    },
    /// A file could not be read or written, or a setting is wrong.
    #[error(transparent)]
    Core(#[from] drex_core::Error),
    /// The operating system refused.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// A record is not what drex writes.
    #[error("{0}")]
    Json(String),
    /// The hand's model is not usable.
    #[error(transparent)]
    Robot(#[from] drex_robot::Error),
    /// The mesh or the asset cannot be made.
    #[error(transparent)]
    Mesh(#[from] drex_mesh::Error),
    /// The photos have no cameras that can be trusted.
    #[cfg(feature = "stages")]
    #[error(transparent)]
    Cameras(#[from] drex_sfm::Verdict),
    /// The object cannot be cut out of the photos.
    #[cfg(feature = "stages")]
    #[error(transparent)]
    Masks(#[from] drex_sfm::masks::MaskError),
    /// The photos cannot be used.
    #[cfg(feature = "stages")]
    #[error(transparent)]
    Splat(#[from] drex_splat::Error),
    /// The pushes do not tell the mass, or the prior is wrong.
    #[error(transparent)]
    Sysid(#[from] drex_sysid::SysidError),
    /// A demonstration cannot be retargeted.
    #[cfg(feature = "stages")]
    #[error(transparent)]
    Retarget(#[from] drex_retarget::Error),
    /// A grasp cannot be analysed.
    #[error(transparent)]
    Grasp(#[from] drex_grasp::GraspError),
    /// A grasp cannot be simulated.
    #[error(transparent)]
    Trial(#[from] drex_trial::Error),
    /// The network cannot be trained or asked.
    #[cfg(feature = "stages")]
    #[error(transparent)]
    Policy(#[from] drex_policy::Error),
    /// The hand failed.
    #[error(transparent)]
    Hardware(#[from] drex_hw::Error),
    /// The report cannot be written; reporters are handed in, see [`crate::RunOptions::report`].
    #[error("the report cannot be written")]
    Report(#[source] Box<dyn std::error::Error + Send + Sync>),
}

impl Error {
    /// A record that cannot be written or read as JSON. No `From`: it would show serde_json in the interface.
    pub(crate) fn json(error: serde_json::Error) -> Self {
        Self::Json(error.to_string())
    }

    /// The message with its causes, each said once.
    pub fn with_causes(&self) -> String {
        let mut message = self.to_string();
        let mut cause = std::error::Error::source(self);
        while let Some(error) = cause {
            let text = error.to_string();
            if !message.contains(&text) {
                message = format!("{message}: {text}");
            }
            cause = error.source();
        }
        message
    }
}

/// Says what was being done when something failed, or what is missing.
pub(crate) trait Context<T> {
    /// Adds what was being done.
    fn context(self, doing: impl Display) -> Result<T>;
    /// Adds what was being done, put together only after a failure.
    fn with_context<D: Display>(self, doing: impl FnOnce() -> D) -> Result<T>;
}

impl<T, E: Into<Error>> Context<T> for Result<T, E> {
    fn context(self, doing: impl Display) -> Result<T> {
        self.with_context(|| doing)
    }

    fn with_context<D: Display>(self, doing: impl FnOnce() -> D) -> Result<T> {
        self.map_err(|e| Error::While { doing: doing().to_string(), source: Box::new(e.into()) })
    }
}

impl<T> Context<T> for Option<T> {
    fn context(self, missing: impl Display) -> Result<T> {
        self.with_context(|| missing)
    }

    fn with_context<D: Display>(self, missing: impl FnOnce() -> D) -> Result<T> {
        self.ok_or_else(|| Error::Refused(missing().to_string()))
    }
}

/// Returns [`Error::Refused`] with a formatted message.
macro_rules! refuse {
    ($($message:tt)*) => {
        return Err($crate::Error::Refused(format!($($message)*)))
    };
}
pub(crate) use refuse;
