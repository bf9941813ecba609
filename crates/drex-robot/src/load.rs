//! Where models come from: files, text, and the two that are bundled.

use std::path::Path;

use crate::{Error, Result, Robot};

impl Robot {
    /// Reads a URDF or MJCF file; the root element tells which.
    ///
    /// # Errors
    /// If the file or a file that it needs cannot be read, or cannot be used as it stands.
    pub fn load(path: &Path) -> Result<Self> {
        Err(Error::document(path, None, "not yet", "wait"))
    }

    /// Reads a URDF file.
    ///
    /// # Errors
    /// As [`Robot::load`].
    pub fn from_urdf(path: &Path) -> Result<Self> {
        Self::load(path)
    }

    /// Reads an MJCF file.
    ///
    /// # Errors
    /// As [`Robot::load`].
    pub fn from_mjcf(path: &Path) -> Result<Self> {
        Self::load(path)
    }

    /// Reads MJCF text. Files that it names are looked for in `folder`; without one, naming a file is an error.
    ///
    /// # Errors
    /// As [`Robot::load`].
    pub fn from_mjcf_str(xml: &str, folder: Option<&Path>) -> Result<Self> {
        let _ = (xml, folder);
        Self::load(Path::new("text"))
    }

    /// A bundled hand: `leap_right` or `allegro_right`.
    ///
    /// # Errors
    /// If there is no bundled model of that name.
    pub fn bundled(name: &str) -> Result<Self> {
        Self::load(Path::new(name))
    }

    /// A bundled model by name, or a file by path, relative to `relative_to` (the folder of the file that names it).
    ///
    /// # Errors
    /// As [`Robot::load`], and if there is neither a bundled model nor a file of that name.
    pub fn resolve(name_or_path: &str, relative_to: &Path) -> Result<Self> {
        Self::load(&relative_to.join(name_or_path))
    }
}
