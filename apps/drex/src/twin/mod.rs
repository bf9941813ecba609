//! The twin folder and its stages, in the order in which they build on each other.

mod asset;
mod evaluate;
mod execute;
pub mod files;
mod grasps;
mod identify;
mod people;
mod practice;
mod report;
mod scan;
mod scene;
mod train;
mod trial;

use std::cell::{OnceCell, RefCell};
use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use drex_core::fsutil;
use drex_core::twin::{ASSUMED_FRICTION, TwinManifest};
use drex_mesh::{Asset, build_asset, rebuild_asset};
use drex_recording::{InputChoice, PushRecording};
use drex_robot::Robot;
use drex_splat::capture::ColmapOptions;
use nalgebra::Vector3;
use serde::Serialize;

use crate::lock::{Inputs, Lock};
use crate::object::asset_options;
use crate::predict::with_torques;
use crate::timings::{self, Timing};
use crate::ui::Ui;

pub use files::{
    Evaluation, ExecutionFile, FitFile, FitRecord, JudgedGrasp, MassFile, PoseRecord, Training, TrialFile,
};
pub use scene::Scene;

/// Farthest that the manifest's up may be from the scan's: beyond it one of them is wrong.
const MOST_TILT_RAD: f64 = 0.1;

/// The stages of a twin, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Photos to Gaussians and a mesh.
    Scan,
    /// Pushes to a mass.
    Identify,
    /// Mesh and mass to a simulation asset.
    Asset,
    /// Demonstrated joint angles to grasps on the object.
    Grasps,
    /// Grasps to a network.
    Train,
    /// The network's grasps judged.
    Evaluate,
    /// The grasp lifted, held and shaken in simulation.
    Trial,
    /// The grasp carried out by an emulated hand.
    Execute,
    /// The page about all of it.
    Report,
}

impl Stage {
    const ALL: [Self; 9] = [
        Self::Scan,
        Self::Identify,
        Self::Asset,
        Self::Grasps,
        Self::Train,
        Self::Evaluate,
        Self::Trial,
        Self::Execute,
        Self::Report,
    ];

    /// The stage's name in the lock and in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scan => "scan",
            Self::Asset => "asset",
            Self::Identify => "identify",
            Self::Grasps => "grasps",
            Self::Train => "train",
            Self::Evaluate => "evaluate",
            Self::Trial => "trial",
            Self::Execute => "execute",
            Self::Report => "report",
        }
    }

    /// Whether the stage needs demonstrated grasps.
    fn needs_grasps(self) -> bool {
        matches!(self, Self::Grasps | Self::Train | Self::Evaluate | Self::Trial | Self::Execute)
    }
}

/// A twin folder that is being worked on.
pub struct Twin {
    /// The folder.
    pub root: PathBuf,
    /// What is given.
    pub manifest: TwinManifest,
    /// Seed of everything random.
    pub seed: u64,
    /// What has been made.
    pub lock: Lock,
    /// ffmpeg, or a step of COLMAP, is stopped after this time.
    pub tool_limit: Duration,
    file: PathBuf,
    asset: OnceCell<Asset>,
    /// Seconds that parts of the stage at work took.
    parts: RefCell<BTreeMap<String, f64>>,
}

/// What a run did.
#[derive(Debug, Serialize)]
pub struct RunSummary {
    /// The twin's name.
    pub name: String,
    /// Stages that were made in this run.
    pub stages_run: Vec<&'static str>,
    /// Stages that were up to date.
    pub stages_current: Vec<&'static str>,
    /// Wall time, seconds.
    pub seconds: f64,
}

impl Twin {
    /// Opens the twin at `path`: a `twin.toml` or the folder that holds it. `seed` overrides the manifest's.
    pub fn open(path: &Path, seed: Option<u64>) -> Result<Self> {
        let file = if path.is_dir() { path.join("twin.toml") } else { path.to_path_buf() };
        let manifest = TwinManifest::load(&file)?;
        let root = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_path_buf();
        let seed = seed.unwrap_or(manifest.seed);
        let lock = Lock::open(&root);
        let tool_limit = ColmapOptions::default().time_limit;
        Ok(Self { root, manifest, seed, lock, tool_limit, file, asset: OnceCell::new(), parts: RefCell::default() })
    }

    /// A file of the twin folder.
    pub fn path(&self, relative: impl AsRef<Path>) -> PathBuf {
        self.root.join(relative)
    }

    /// A file or folder of the twin folder that is written: a name from the manifest may not lead out of it, nor a link.
    pub fn output(&self, relative: impl AsRef<Path>) -> Result<PathBuf> {
        let name = relative.as_ref().to_str().context("a path in the manifest is not Unicode; rename it")?;
        Ok(fsutil::output_path(&self.root, name)?)
    }

    /// Notes for `timings.json` how many seconds a part of the stage at work took.
    pub fn took(&self, part: &str, seconds: f64) {
        self.parts.borrow_mut().insert(part.to_owned(), seconds);
    }

    /// The object, made of its mesh when it is first asked for; its pieces are those of an earlier run, where they still
    /// are what that run made of the same mesh and settings.
    pub fn asset(&self) -> Result<&Asset> {
        if let Some(asset) = self.asset.get() {
            return Ok(asset);
        }
        if self.manifest.scan.is_some() {
            self.check_up(&files::read_json(&self.path(files::SCAN))?)?;
        }
        let options = asset_options(&self.manifest.object, self.friction());
        let mesh = self.path(&self.manifest.object.mesh);
        let made = self.inputs(Stage::Asset).is_ok_and(|inputs| self.lock.is_current(Stage::Asset.name(), &inputs));
        let asset = if made { rebuild_asset(&mesh, &options, &self.root)? } else { build_asset(&mesh, &options)? };
        Ok(self.asset.get_or_init(|| asset))
    }

    /// The manifest's up has to be the scan's: that of an RGB-D recording is in the frame of its poses.
    fn check_up(&self, file: &files::ScanFile) -> Result<()> {
        let (found, said) = (Vector3::from(file.scan.up_in_mesh), Vector3::from(self.manifest.object.up_in_mesh));
        if found.angle(&said) > MOST_TILT_RAD {
            let [x, y, z] = file.scan.up_in_mesh;
            bail!(
                "{}: the scan's up is [{x:.4}, {y:.4}, {z:.4}] by {}, {:.0} degrees from that of the manifest: write it as up_in_mesh under [object]",
                self.path("twin.toml").display(),
                file.scan.up_from,
                found.angle(&said).to_degrees()
            );
        }
        Ok(())
    }

    /// Friction of the object against hand and table: the manifest's, or the stated assumption.
    pub fn friction(&self) -> f64 {
        self.manifest.object.friction.unwrap_or(ASSUMED_FRICTION)
    }

    /// The hand of the manifest, with its motors' torques known.
    ///
    /// # Errors
    /// If there is none, it cannot be read, or neither its model nor the manifest says what its motors give.
    pub fn hand(&self) -> Result<Robot> {
        let grasps = self.manifest.grasps.as_ref().context("the manifest has no [grasps]")?;
        with_torques(Robot::resolve(&grasps.hand, &self.root)?, grasps.torque_cap_nm)
    }

    /// Does every stage up to and including `last` whose inputs changed, and skips the others. With `again` the last one is
    /// done in any case.
    pub fn run_until(&mut self, last: Stage, again: bool, ui: &Ui) -> Result<RunSummary> {
        if last.needs_grasps() && self.manifest.grasps.is_none() {
            bail!(
                "{} has no [grasps] section, so there is nothing to {}; name a file of demonstrated grasps there",
                self.path("twin.toml").display(),
                last.name()
            );
        }
        let _alone = self.begin(ui)?;
        let started = Instant::now();
        let mut summary =
            RunSummary { name: self.manifest.name.clone(), stages_run: vec![], stages_current: vec![], seconds: 0.0 };
        for stage in Stage::ALL.into_iter().filter(|s| *s <= last) {
            if stage.needs_grasps() && self.manifest.grasps.is_none()
                || stage == Stage::Scan && self.manifest.scan.is_none()
            {
                continue;
            }
            let inputs = self.inputs(stage).with_context(|| format!("stage {}", stage.name()))?;
            if self.lock.is_current(stage.name(), &inputs) && !(again && stage == last) {
                ui.note(format!("{:>10}  up to date", stage.name()));
                summary.stages_current.push(stage.name());
                continue;
            }
            let begun = Instant::now();
            let outputs =
                self.make(stage, ui).with_context(|| format!("stage {} of {}", stage.name(), self.root.display()))?;
            let seconds = begun.elapsed().as_secs_f64();
            let removed = self.lock.record(stage.name(), inputs, self.seed, &outputs)?;
            if !removed.is_empty() {
                ui.note(format!(
                    "{:>10}  removed what an earlier run made and this one did not: {}",
                    "note",
                    some_of(&removed)
                ));
            }
            let parts = self.parts.take();
            timings::record(&self.root, stage.name(), Timing { parts, ..Timing::of(seconds) })?;
            ui.note(format!("{:>10}  done in {seconds:.1} s", stage.name()));
            summary.stages_run.push(stage.name());
        }
        summary.seconds = started.elapsed().as_secs_f64();
        Ok(summary)
    }

    /// Says what is not as the last run left it, and removes what a run that did not end left half-written. Until the value
    /// is dropped no other process works on this folder.
    fn begin(&self, ui: &Ui) -> Result<Option<File>> {
        self.lock.damage().iter().for_each(|damage| ui.note(format!("{:>10}  {damage}", "note")));
        let file = File::open(&self.file).with_context(|| format!("cannot read {}", self.file.display()))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                bail!("another drex is at work on {}: wait until it is done", self.root.display())
            }
            // A file system without locks: somebody else's half-written file could be one that is being written.
            Err(TryLockError::Error(_)) => return Ok(None),
        }
        let folders = ["scan", "splat", "depth", "mesh", "asset", "grasps", "policy"];
        let mut removed = fsutil::remove_unfinished(&self.root, false)?;
        for folder in folders {
            removed.extend(fsutil::remove_unfinished(&self.path(folder), true)?);
        }
        for path in removed {
            let what = path.strip_prefix(&self.root).unwrap_or(&path).display();
            ui.note(format!("{:>10}  removed {what}: a run that was stopped, or found the disk full, left it", "note"));
        }
        Ok(Some(file))
    }

    fn make(&self, stage: Stage, ui: &Ui) -> Result<Vec<PathBuf>> {
        match stage {
            Stage::Scan => scan::make(self, ui),
            Stage::Asset => asset::make(self),
            Stage::Identify => identify::make(self, ui),
            Stage::Grasps => grasps::make(self, ui),
            Stage::Train => train::make(self, ui),
            Stage::Evaluate => evaluate::make(self, ui),
            Stage::Trial => trial::make(self, ui),
            Stage::Execute => execute::make(self, ui),
            Stage::Report => report::make(self),
        }
    }

    /// The digest of all that a stage depends on. Earlier stages' outputs count as inputs.
    fn inputs(&self, stage: Stage) -> Result<String> {
        let m = &self.manifest;
        let inputs = Inputs::new(self.seed);
        let mesh = self.path(&m.object.mesh);
        let inputs = match stage {
            Stage::Scan => {
                let inputs = inputs.setting("scan", &m.scan)?.setting("mesh", &m.object.mesh)?;
                m.scan.iter().try_fold(inputs, |inputs, scan| inputs.file(&self.path(&scan.photos)))?
            }
            Stage::Identify => {
                let inputs = inputs.setting("mass", &m.mass)?.setting("object", &m.object)?.file(&mesh)?;
                let inputs = self.scanned(inputs)?;
                let inputs = m.mass.prior_file.iter().try_fold(inputs, |inputs, f| inputs.file(&self.path(f)))?;
                m.mass.identify.iter().try_fold(inputs, |inputs, push| push_files(&self.path(push), inputs))?
            }
            Stage::Asset => inputs.setting("object", &m.object)?.file(&mesh)?.file(&self.path(files::MASS))?,
            Stage::Grasps => {
                let inputs = inputs.setting("grasps", &m.grasps)?.setting("object", &m.object)?.file(&mesh)?;
                m.grasps.iter().try_fold(inputs, |inputs, g| inputs.file(&self.path(&g.file)))?
            }
            Stage::Train => {
                let inputs = inputs.setting("train", &m.train)?.setting("object", &m.object)?.file(&mesh)?;
                self.capped(inputs)?.file(&self.path(files::FITS))?.file(&self.path(files::MASS))?
            }
            Stage::Trial | Stage::Execute => {
                let inputs = inputs.setting("object", &m.object)?.setting("grasps", &m.grasps)?.file(&mesh)?;
                inputs.file(&self.path(files::POLICY))?.file(&self.path(files::MASS))?
            }
            Stage::Evaluate => {
                let inputs = inputs.setting("object", &m.object)?.file(&mesh)?.file(&self.path(files::POLICY))?;
                self.capped(inputs)?.file(&self.path(files::FITS))?.file(&self.path(files::MASS))?
            }
            Stage::Report => {
                let inputs = inputs.setting("manifest", m)?.file(&self.path("mesh"))?.file(&self.path(files::MASS))?;
                let inputs = self.scanned(inputs)?;
                if m.grasps.is_some() {
                    inputs
                        .file(&self.path(files::FITS))?
                        .file(&self.path(files::POLICY))?
                        .file(&self.path(files::EVALUATION))?
                        .file(&self.path(files::TRIAL))?
                        .file(&self.path(files::EXECUTION))?
                } else {
                    inputs
                }
            }
        };
        Ok(inputs.digest())
    }

    /// With the torque cap of the hand, if there is one.
    fn capped(&self, inputs: Inputs) -> Result<Inputs> {
        let cap_nm = self.manifest.grasps.as_ref().and_then(|g| g.torque_cap_nm);
        cap_nm.iter().try_fold(inputs, |inputs, cap| inputs.setting("torque_cap_nm", cap))
    }

    /// With what the scan stage says of itself, if there is one.
    fn scanned(&self, inputs: Inputs) -> Result<Inputs> {
        match &self.manifest.scan {
            Some(_) => inputs.file(&self.path(files::SCAN)),
            None => Ok(inputs),
        }
    }
}

/// The first names of a list, and how many more there are.
fn some_of(names: &[String]) -> String {
    const SHOWN: usize = 3;
    let more = names.len().saturating_sub(SHOWN);
    let shown = names.iter().take(SHOWN).map(String::as_str).collect::<Vec<_>>().join(", ");
    if more > 0 { format!("{shown} and {more} more") } else { shown }
}

/// Every file that a push is read from.
fn push_files(push: &Path, inputs: Inputs) -> Result<Inputs> {
    let recording = PushRecording::load(push, &InputChoice::default())?;
    recording.sources.iter().try_fold(inputs, |inputs, file| inputs.file(file))
}
