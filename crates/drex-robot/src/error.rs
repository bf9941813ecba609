//! The error type of the crate.

use std::path::{Path, PathBuf};

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong when a robot model is read or asked for something it does not have.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read.
    #[error(transparent)]
    Core(#[from] drex_core::Error),
    /// The file is no well-formed XML, or no robot model.
    #[error("{}{}: {what}; {remedy}", path.display(), line.map(|l| format!(", line {l}")).unwrap_or_default())]
    Document {
        /// The file, or a stand-in for text that came from memory.
        path: PathBuf,
        /// 1-based line, where there is one.
        line: Option<u32>,
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// An element of the file cannot be used as it stands.
    #[error("{place}: {what}; {remedy}")]
    Element {
        /// Where.
        place: Box<Place>,
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// An attribute of an element cannot be used as it stands.
    #[error("{place}, {attribute}=\"{value}\": {what}; {remedy}")]
    Attribute {
        /// Where.
        place: Box<Place>,
        /// Name of the attribute.
        attribute: String,
        /// Its value in the file.
        value: String,
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// A joint was asked for that the model does not have.
    #[error("robot \"{robot}\" has no joint \"{joint}\"; its joints are {known}")]
    UnknownJoint {
        /// Name of the model.
        robot: String,
        /// The name that was asked for.
        joint: String,
        /// The names there are.
        known: String,
    },
    /// A link was asked for that the model does not have.
    #[error("robot \"{robot}\" has no link \"{link}\"; its links are {known}")]
    UnknownLink {
        /// Name of the model.
        robot: String,
        /// The name that was asked for.
        link: String,
        /// The names there are.
        known: String,
    },
    /// A model was asked for that is neither bundled nor a file.
    #[error("there is no robot model \"{name}\"{}; {remedy}", tried.as_ref().map(|p| format!(" (looked for {})", p.display())).unwrap_or_default())]
    UnknownModel {
        /// The name or path that was asked for.
        name: String,
        /// The file that was looked for.
        tried: Option<PathBuf>,
        /// What there is.
        remedy: String,
    },
    /// A value handed to a function is outside what the function is defined for.
    #[error("{what}; {remedy}")]
    Value {
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
}

/// An element in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Place {
    /// The file, or a stand-in for text that came from memory.
    pub path: PathBuf,
    /// 1-based line.
    pub line: u32,
    /// Tag, with the name of the element where it has one: `joint name="if_mcp"`.
    pub element: String,
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}, line {}, <{}>", self.path.display(), self.line, self.element)
    }
}

impl Error {
    pub(crate) fn document(
        path: &Path,
        line: impl Into<Option<u32>>,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Document { path: path.into(), line: line.into(), what: what.into(), remedy: remedy.into() }
    }

    pub(crate) fn value(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Value { what: what.into(), remedy: remedy.into() }
    }
}
