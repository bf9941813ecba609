//! Where models come from: files, text, and those that are bundled.

use std::path::Path;

use crate::xml::Node;
use crate::{Error, Result, Robot, mjcf, urdf};

/// Names and text of the bundled hands.
const BUNDLED: [(&str, &str); 2] = [
    ("leap_right", include_str!("../models/leap_right.xml")),
    ("allegro_right", include_str!("../models/allegro_right.xml")),
];

/// Names of the bundled hands that are mirror images, and what of.
const MIRRORED: [(&str, &str); 2] = [("leap_left", "leap_right"), ("allegro_left", "allegro_right")];

impl Robot {
    /// Reads a URDF or MJCF file; the root element tells which.
    ///
    /// # Errors
    /// If the file or a file that it needs cannot be read, or cannot be used as it stands.
    pub fn load(path: &Path) -> Result<Self> {
        let text = drex_core::fsutil::read_text(path)?;
        let root = Node::parse(&text, path)?;
        match root.tag.as_str() {
            "robot" => urdf::read(&root, path),
            "mujoco" => mjcf::read(&text, path, path.parent()),
            _ => Err(root.error("no robot model", "the root element must be <robot> (URDF) or <mujoco> (MJCF)")),
        }
    }

    /// Reads a URDF file.
    ///
    /// # Errors
    /// As [`Robot::load`].
    pub fn from_urdf(path: &Path) -> Result<Self> {
        let text = drex_core::fsutil::read_text(path)?;
        urdf::read(&Node::parse(&text, path)?, path)
    }

    /// Reads MJCF text. Files that it names are looked for in `folder`; without one, naming a file is an error.
    ///
    /// # Errors
    /// As [`Robot::load`].
    pub fn from_mjcf_str(xml: &str, folder: Option<&Path>) -> Result<Self> {
        mjcf::read(xml, Path::new("MJCF text"), folder)
    }

    /// A bundled hand: `leap_right`, `allegro_right`, or their mirror images `leap_left`, `allegro_left`
    /// ([`Robot::mirrored`]). The vendors' left models have other signs and zeros; load them from their own files.
    ///
    /// # Errors
    /// If there is no bundled model of that name.
    pub fn bundled(name: &str) -> Result<Self> {
        if let Some(xml) = Self::bundled_mjcf(name) {
            return mjcf::read(xml, Path::new(name), None);
        }
        match MIRRORED.iter().find(|(left, _)| *left == name) {
            Some((_, right)) => Ok(Self::bundled(right)?.mirrored()),
            None => Err(Error::UnknownModel { name: name.into(), tried: None, remedy: bundled_names() }),
        }
    }

    /// The MJCF text of a bundled hand, to be written out or put into a scene. `None` for a name that is not bundled and
    /// for the left hands: they are mirrored when they are loaded and have no text.
    pub fn bundled_mjcf(name: &str) -> Option<&'static str> {
        BUNDLED.iter().find(|(n, _)| *n == name).map(|(_, xml)| *xml)
    }

    /// A bundled model by name, or a file by path, relative to `relative_to` (the folder of the file that names it).
    ///
    /// # Errors
    /// As [`Robot::load`], and if there is neither a bundled model nor a file of that name.
    pub fn resolve(name_or_path: &str, relative_to: &Path) -> Result<Self> {
        if bundled().any(|name| name == name_or_path) {
            return Self::bundled(name_or_path);
        }
        let path = relative_to.join(name_or_path);
        if path.is_file() {
            return Self::load(&path);
        }
        Err(Error::UnknownModel { name: name_or_path.into(), tried: Some(path), remedy: bundled_names() })
    }
}

/// Names of the bundled models.
fn bundled() -> impl Iterator<Item = &'static str> {
    BUNDLED.iter().chain(&MIRRORED).map(|(name, _)| *name)
}

fn bundled_names() -> String {
    let names: Vec<&str> = bundled().collect();
    format!("give the path of a URDF or MJCF file, or one of the bundled models {}", names.join(", "))
}
