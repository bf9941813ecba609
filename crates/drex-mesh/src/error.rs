//! The error type of the crate: what was wrong, where, and what to do.

use std::path::PathBuf;

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong when a mesh is read, understood or written as an asset.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read or written, or its content is damaged.
    #[error(transparent)]
    Core(#[from] drex_core::Error),
    /// The name of a file does not say what format it has.
    #[error("{}: the extension {extension:?} names no mesh format; give a .stl, .obj, .ply, .gltf or .glb file", path.display())]
    UnknownExtension {
        /// The file.
        path: PathBuf,
        /// Its extension, empty if it has none.
        extension: String,
    },
    /// There is nothing in the mesh.
    #[error("{subject} has no triangles; give a mesh of the object's surface")]
    Empty {
        /// The file, or "the mesh".
        subject: String,
    },
    /// The mesh encloses no volume: it is flat, a sheet, or cancels itself.
    #[error(
        "{subject} encloses no volume ({reason}); give a mesh of the whole surface of a solid, \
         for a sheet give it thickness first"
    )]
    NoVolume {
        /// The file, or "the mesh".
        subject: String,
        /// What was measured.
        reason: String,
    },
    /// The size of the mesh fits no unit that can be assumed.
    #[error("{subject} is {extent} units across, which is {why}; state the unit of the file (m, cm, mm or in)")]
    Unit {
        /// The file, or "the mesh".
        subject: String,
        /// Largest side of the bounding box, in the file's unit.
        extent: f64,
        /// Why no unit was assumed.
        why: &'static str,
    },
    /// A depth map could not be had.
    #[error(transparent)]
    View(Box<dyn std::error::Error + Send + Sync>),
    /// A number handed in is outside what the function is defined for.
    #[error("{what}; {remedy}")]
    Value {
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
}

impl Error {
    /// An [`Error::Value`].
    pub(crate) fn value(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Value { what: what.into(), remedy: remedy.into() }
    }

    /// The same error about a named file instead of "the mesh".
    pub(crate) fn about(self, path: &std::path::Path) -> Self {
        let subject = path.display().to_string();
        match self {
            Self::Empty { .. } => Self::Empty { subject },
            Self::NoVolume { reason, .. } => Self::NoVolume { subject, reason },
            Self::Unit { extent, why, .. } => Self::Unit { subject, extent, why },
            Self::Value { what, remedy } => Self::Value { what: format!("{subject}: {what}"), remedy },
            Self::Core(drex_core::Error::Value { what, remedy }) => {
                Self::Core(drex_core::Error::content(path, None, what, remedy))
            }
            other => other,
        }
    }
}
