//! Errors of the libraries as Python exceptions.

use std::io::ErrorKind;
use std::path::PathBuf;

use pyo3::PyErr;
use pyo3::exceptions::{PyOSError, PyValueError};

pyo3::create_exception!(
    drex,
    Error,
    PyValueError,
    "What drex refuses: a damaged file, an impossible number, arrays that do not fit. The message says what is wrong and what to do."
);

pyo3::create_exception!(
    drex,
    Busy,
    Error,
    "Another process works on the folder: the message says which, and the same call can be made again later."
);

pyo3::create_exception!(
    drex,
    NoCommand,
    Error,
    "There is no command for a grasp: the message says why, `verdict` how a trial of it ends."
);

/// What ends a call.
#[derive(Debug)]
pub(crate) enum Failure {
    /// A file could not be read or written: `OSError`, or its kind that fits.
    File { errno: Option<i32>, what: String, path: PathBuf },
    /// `drex.Error` with the library's message.
    Refused(String),
    /// `drex.Busy` with the library's message.
    Busy(String),
    /// An exception that Python itself raised, such as `KeyboardInterrupt`.
    Python(PyErr),
}

/// Result of everything that Python calls.
pub(crate) type Result<T, E = Failure> = std::result::Result<T, E>;

/// POSIX's number for a file that is not there.
const ENOENT: i32 = 2;

/// A refusal of this package's own.
pub(crate) fn refused<T>(what: impl Into<String>) -> Result<T> {
    Err(Failure::Refused(what.into()))
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        match failure {
            // From a number, Python makes FileNotFoundError, PermissionError and so on.
            Failure::File { errno: Some(number), what, path } => {
                PyOSError::new_err((number, what, path.display().to_string()))
            }
            Failure::File { errno: None, what, path } => PyOSError::new_err(format!("{}: {what}", path.display())),
            Failure::Refused(what) => Error::new_err(what),
            Failure::Busy(what) => Busy::new_err(what),
            Failure::Python(error) => error,
        }
    }
}

impl From<PyErr> for Failure {
    fn from(error: PyErr) -> Self {
        Self::Python(error)
    }
}

impl From<drex_core::Error> for Failure {
    fn from(error: drex_core::Error) -> Self {
        match error {
            drex_core::Error::Io { action, path, source } => {
                let missing = (source.kind() == ErrorKind::NotFound).then_some(ENOENT);
                Self::File {
                    errno: source.raw_os_error().or(missing),
                    what: format!("cannot {action}: {source}"),
                    path,
                }
            }
            other => Self::Refused(other.to_string()),
        }
    }
}

impl From<drex_mesh::Error> for Failure {
    fn from(error: drex_mesh::Error) -> Self {
        match error {
            drex_mesh::Error::Core(inner) => inner.into(),
            other => Self::Refused(other.to_string()),
        }
    }
}

impl From<drex_robot::Error> for Failure {
    fn from(error: drex_robot::Error) -> Self {
        match error {
            drex_robot::Error::Core(inner) => inner.into(),
            other => Self::Refused(other.to_string()),
        }
    }
}

impl From<drex_retarget::Error> for Failure {
    fn from(error: drex_retarget::Error) -> Self {
        match error {
            drex_retarget::Error::Core(inner) => inner.into(),
            drex_retarget::Error::Robot(inner) => inner.into(),
            other => Self::Refused(other.to_string()),
        }
    }
}

impl From<drex_sysid::SysidError> for Failure {
    fn from(error: drex_sysid::SysidError) -> Self {
        match error {
            drex_sysid::SysidError::Core(inner) => inner.into(),
            drex_sysid::SysidError::Robot(inner) => inner.into(),
            other => Self::Refused(other.to_string()),
        }
    }
}

impl From<drex_policy::Error> for Failure {
    fn from(error: drex_policy::Error) -> Self {
        match error {
            drex_policy::Error::Core(inner) => inner.into(),
            other => Self::Refused(other.to_string()),
        }
    }
}

impl From<drex_trial::Error> for Failure {
    fn from(error: drex_trial::Error) -> Self {
        Self::Refused(error.to_string())
    }
}

impl From<drex_twin::Error> for Failure {
    fn from(error: drex_twin::Error) -> Self {
        use drex_twin::Error::{Busy, Core, Mesh, Policy, Report, Retarget, Robot, Sysid, While};
        // What was done, then why it failed, as the command line puts it.
        let after = |doing: String, why: String| if doing.contains(&why) { doing } else { format!("{doing}: {why}") };
        match error {
            While { doing, source } => match Self::from(*source) {
                Self::File { errno, what, path } => Self::File { errno, what: after(doing, what), path },
                Self::Refused(why) => Self::Refused(after(doing, why)),
                Self::Busy(why) => Self::Busy(after(doing, why)),
                python => python,
            },
            Core(inner) => inner.into(),
            Mesh(inner) => inner.into(),
            Robot(inner) => inner.into(),
            Retarget(inner) => inner.into(),
            Sysid(inner) => inner.into(),
            Policy(inner) => inner.into(),
            Busy { .. } => Self::Busy(error.to_string()),
            Report(ref why) => Self::Refused(after(error.to_string(), why.to_string())),
            other => Self::Refused(other.to_string()),
        }
    }
}

impl From<drex_diffsim::Error> for Failure {
    fn from(error: drex_diffsim::Error) -> Self {
        Self::Refused(error.to_string())
    }
}

impl From<serde_json::Error> for Failure {
    fn from(error: serde_json::Error) -> Self {
        Self::Refused(format!("the answer cannot be written as JSON: {error}"))
    }
}
