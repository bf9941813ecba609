//! A twin folder: what is given, what has been made, where things lie.

#[cfg(feature = "stages")]
use std::cell::{OnceCell, RefCell};
use std::path::{Path, PathBuf};

use drex_core::fsutil;
use drex_robot::Robot;

use crate::Result;
use crate::error::{Context, refuse};
use crate::lock::Lock;
use crate::manifest::{MANIFEST, TwinManifest};
use crate::records::{MASS, MassFile, read_json};

/// Endings of demonstrations in a folder.
const ENDINGS: [&str; 3] = ["json", "jsonl", "npz"];

/// An open twin folder.
pub struct Twin {
    /// Path of the folder.
    pub root: PathBuf,
    /// The manifest: what is given.
    pub manifest: TwinManifest,
    /// Seed of everything random.
    pub seed: u64,
    /// The lock: what has been made, and of what.
    pub lock: Lock,
    /// The manifest's path.
    pub file: PathBuf,
    /// Time after which ffmpeg, or a step of COLMAP, is stopped.
    #[cfg(feature = "stages")]
    pub tool_limit: std::time::Duration,
    #[cfg(feature = "stages")]
    pub(crate) asset: OnceCell<drex_mesh::Asset>,
    /// Seconds that parts of the stage at work took.
    #[cfg(feature = "stages")]
    pub(crate) parts: RefCell<std::collections::BTreeMap<String, f64>>,
}

impl Twin {
    /// Opens the twin at `path`: a `twin.toml` or the folder that holds it.
    ///
    /// # Errors
    /// If the manifest cannot be read or a setting in it makes no sense; the message names file, line and remedy.
    pub fn open(path: &Path) -> Result<Self> {
        let file = if path.is_dir() { path.join(MANIFEST) } else { path.to_path_buf() };
        let manifest = TwinManifest::load(&file)?;
        let root = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_path_buf();
        let seed = manifest.seed;
        let lock = Lock::open(&root);
        Ok(Self {
            root,
            manifest,
            seed,
            lock,
            file,
            #[cfg(feature = "stages")]
            tool_limit: drex_sfm::programs::ColmapOptions::default().time_limit,
            #[cfg(feature = "stages")]
            asset: OnceCell::new(),
            #[cfg(feature = "stages")]
            parts: RefCell::default(),
        })
    }

    /// The twin with another seed than the manifest's, if one is given.
    #[must_use]
    pub fn with_seed(mut self, seed: Option<u64>) -> Self {
        self.seed = seed.unwrap_or(self.seed);
        self
    }

    /// Path of a file of the twin folder.
    pub fn path(&self, relative: impl AsRef<Path>) -> PathBuf {
        self.root.join(relative)
    }

    /// Path of a file or folder of the twin folder that is to be written.
    ///
    /// # Errors
    /// If the name, which may come from the manifest, or a link leads out of the folder.
    pub fn output(&self, relative: impl AsRef<Path>) -> Result<PathBuf> {
        let name = relative.as_ref().to_str().context("a path in the manifest is not Unicode; rename it")?;
        Ok(fsutil::output_path(&self.root, name)?)
    }

    /// Notes for `timings.json` how many seconds a part of the stage at work took.
    #[cfg(feature = "stages")]
    pub(crate) fn took(&self, part: &str, seconds: f64) {
        self.parts.borrow_mut().insert(part.to_owned(), seconds);
    }

    /// Coefficient of friction of the object against hand and table: [`TwinManifest::friction`].
    pub fn friction(&self) -> f64 {
        self.manifest.friction().0
    }

    /// Lowest and highest friction that a hand has to reckon with: twice what the manifest states, or all that the protocol knows where it states none.
    #[cfg(feature = "stages")]
    pub fn friction_range(&self) -> (f64, f64) {
        self.manifest.object.friction.map_or(drex_trial::Uncertainty::ANY_FRICTION, |f| (f, f))
    }

    /// The files of the demonstrations: that of the manifest, or every one in its folder by name.
    ///
    /// # Errors
    /// If the manifest has no `[grasps]`, or its folder cannot be listed or holds none.
    pub fn demonstrations(&self) -> Result<Vec<PathBuf>> {
        let grasps = self.manifest.grasps.as_ref().context("the manifest has no [grasps]")?;
        let path = self.path(&grasps.file);
        if !path.is_dir() {
            return Ok(vec![path]);
        }
        let entries = std::fs::read_dir(&path).with_context(|| format!("cannot list {}", path.display()))?;
        let mut files: Vec<PathBuf> = entries
            .map(|e| e.map(|e| e.path()))
            .collect::<Result<_, _>>()
            .with_context(|| path.display().to_string())?;
        files.retain(|f| f.extension().is_some_and(|e| ENDINGS.iter().any(|ending| e.eq_ignore_ascii_case(ending))));
        files.sort();
        if files.is_empty() {
            refuse!("{} holds no demonstration: put .json, .jsonl or .npz files there", path.display());
        }
        Ok(files)
    }

    /// The mass that the stage identify found.
    ///
    /// # Errors
    /// If there is none yet, or its record cannot be read.
    pub fn mass(&self) -> Result<MassFile> {
        let path = self.path(MASS);
        if !path.is_file() {
            refuse!("{} has no mass yet: run its stage identify first", self.root.display());
        }
        read_json(&path)
    }

    /// Model of the manifest's hand, with its motors' torques known.
    ///
    /// # Errors
    /// If there is none, it cannot be read, or neither its model nor the manifest says what its motors give.
    pub fn hand(&self) -> Result<Robot> {
        let grasps = self.manifest.grasps.as_ref().context("the manifest has no [grasps]")?;
        crate::hand::with_torque_cap(Robot::resolve(&grasps.hand, &self.root)?, grasps.torque_cap_nm)
    }
}
