//! A twin folder: what is given, what has been made, where things lie.

use std::cell::{OnceCell, RefCell};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use drex_core::{ASSUMED_FRICTION, fsutil};
use drex_mesh::Asset;
use drex_robot::Robot;
use drex_sfm::programs::ColmapOptions;

use crate::Result;
use crate::error::Context;
use crate::lock::Lock;
use crate::manifest::{MANIFEST, TwinManifest};

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
    /// Time after which ffmpeg, or a step of COLMAP, is stopped.
    pub tool_limit: Duration,
    pub(crate) file: PathBuf,
    pub(crate) asset: OnceCell<Asset>,
    /// Seconds that parts of the stage at work took.
    pub(crate) parts: RefCell<BTreeMap<String, f64>>,
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
        let tool_limit = ColmapOptions::default().time_limit;
        Ok(Self { root, manifest, seed, lock, tool_limit, file, asset: OnceCell::new(), parts: RefCell::default() })
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
    pub(crate) fn took(&self, part: &str, seconds: f64) {
        self.parts.borrow_mut().insert(part.to_owned(), seconds);
    }

    /// Coefficient of friction of the object against hand and table: the manifest's, or [`ASSUMED_FRICTION`].
    pub fn friction(&self) -> f64 {
        self.manifest.object.friction.unwrap_or(ASSUMED_FRICTION)
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
