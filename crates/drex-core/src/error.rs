//! The error type of the crate: what was wrong, where, and what to do.

use std::path::{Path, PathBuf};

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong when data is read, checked or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read, created or replaced.
    #[error("cannot {action} {}: {source}{}", path.display(), remedy(source))]
    Io {
        /// "read", "write", "create"…
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The operating system's reason.
        #[source]
        source: std::io::Error,
    },
    /// A file was read but its content is not what it should be.
    #[error("{}{}: {what}; {remedy}", path.display(), line.map(|l| format!(", line {l}")).unwrap_or_default())]
    Content {
        /// The file.
        path: PathBuf,
        /// 1-based line, where there is one.
        line: Option<usize>,
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// A picture could not be decoded or encoded.
    #[error("cannot {action} the picture {}: {source}", path.display())]
    Picture {
        /// "read" or "write".
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The codec's reason, in its words. Boxed, so that the library behind it can change.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A capture (photos, cameras, masks) that cannot be used.
    #[error("{what}; {remedy}")]
    Capture {
        /// What is wrong, with the photo's name.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// Another program (COLMAP, ffmpeg) is missing or failed.
    #[error("{what}; {remedy}")]
    Tool {
        /// Which one, and what it said last.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// No GPU adapter, or it failed.
    #[error("{what}; {remedy}")]
    Gpu {
        /// What happened.
        what: String,
        /// What to do about it.
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

/// What to do about what the operating system says, where there is something to be done.
fn remedy(source: &std::io::Error) -> &'static str {
    use std::io::ErrorKind;
    match source.kind() {
        ErrorKind::NotFound => "; check the path",
        ErrorKind::PermissionDenied => "; get the right to do so, or choose another place",
        ErrorKind::NotADirectory => "; choose another place, a file is where a folder should be",
        ErrorKind::IsADirectory => "; give a file, this is a folder",
        ErrorKind::StorageFull => "; make room or choose another disk",
        _ => "",
    }
}

impl Error {
    /// An [`Error::Io`] for `path`.
    pub fn io(action: &'static str, path: impl AsRef<Path>, source: std::io::Error) -> Self {
        Self::Io { action, path: path.as_ref().to_path_buf(), source }
    }

    /// An [`Error::Content`] for a whole file or one `line` of it.
    pub fn content(
        path: impl AsRef<Path>,
        line: impl Into<Option<usize>>,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        let (what, remedy) = (short(what.into()), remedy.into());
        Self::Content { path: path.as_ref().to_path_buf(), line: line.into(), what, remedy }
    }

    /// `error` with the place it was found at: a value that is wrong becomes content of `path` that is wrong.
    /// Errors that already name a file stay as they are.
    pub fn at(path: impl AsRef<Path>, line: impl Into<Option<usize>>, error: Self) -> Self {
        match error {
            Self::Value { what, remedy } => Self::content(path, line, what, remedy),
            other => other,
        }
    }

    /// An [`Error::Capture`].
    pub fn capture(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Capture { what: what.into(), remedy: remedy.into() }
    }

    /// An [`Error::Tool`].
    pub fn tool(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Tool { what: what.into(), remedy: remedy.into() }
    }

    /// An [`Error::Value`].
    pub fn value(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Value { what: short(what.into()), remedy: remedy.into() }
    }
}

/// A message that quotes a file, cut where the quote is longer than anybody reads: a line can be as long as the file.
fn short(mut text: String) -> String {
    const MOST: usize = 2000;
    if let Some((end, _)) = text.char_indices().nth(MOST) {
        text.truncate(end);
        text.push('…');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_quotes_are_cut() {
        let line = "ä".repeat(1 << 20);
        let message = Error::content("a.csv", 3, format!("`{line}` is no number"), "repair it").to_string();
        assert!(message.len() < 5000 && message.starts_with("a.csv, line 3: `ä") && message.ends_with("ä…; repair it"));
    }
}
