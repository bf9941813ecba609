//! The stages of a twin, and what each of them depends on.

use std::path::Path;

use drex_recording::PushRecording;

use crate::lock::Inputs;
use crate::manifest::ScanConfig;
use crate::{Result, Twin, records as files};

/// The stages of a twin, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Photos to a mesh.
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
    /// Gaussians that show what the photos show.
    Appearance,
    /// The page about all of it.
    Report,
}

impl Stage {
    /// All stages in their order.
    pub const ALL: [Self; 10] = [
        Self::Scan,
        Self::Identify,
        Self::Asset,
        Self::Grasps,
        Self::Train,
        Self::Evaluate,
        Self::Trial,
        Self::Execute,
        Self::Appearance,
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
            Self::Appearance => "appearance",
            Self::Report => "report",
        }
    }

    /// Whether the stage needs demonstrated grasps.
    pub(crate) fn needs_grasps(self) -> bool {
        matches!(self, Self::Grasps | Self::Train | Self::Evaluate | Self::Trial | Self::Execute)
    }
}

impl Twin {
    /// The digest of all that a stage depends on. Earlier stages' outputs count as inputs.
    pub(crate) fn inputs(&self, stage: Stage) -> Result<String> {
        let m = &self.manifest;
        let inputs = Inputs::new(self.seed);
        let mesh = self.path(&m.object.mesh);
        let inputs = match stage {
            Stage::Scan => {
                // Steps are of the stage that trains.
                let scan = m.scan.clone().map(|scan| ScanConfig { iterations: None, ..scan });
                let inputs = inputs.setting("scan", &scan)?.setting("mesh", &m.object.mesh)?;
                let files = m.scan.iter().flat_map(|scan| std::iter::once(&scan.photos).chain(&scan.masks));
                files.map(|f| self.path(f)).try_fold(inputs, |inputs, file| inputs.file(&file))?
            }
            Stage::Identify => {
                let inputs = inputs.setting("mass", &m.mass)?.setting("object", &m.object)?.file(&mesh)?;
                let inputs = self.scanned(inputs)?;
                let inputs = m.mass.prior_file.iter().try_fold(inputs, |inputs, f| inputs.file(&self.path(f)))?;
                m.mass.identify.iter().try_fold(inputs, |inputs, push| push_files(&self.path(push), inputs))?
            }
            Stage::Asset => {
                let inputs = inputs.setting("object", &m.object)?.file(&mesh)?.file(&self.path(files::MASS))?;
                self.scanned(inputs)?
            }
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
            Stage::Appearance => {
                let inputs = inputs.setting("scan", &m.scan)?.file(&self.path("mesh"))?;
                self.scanned(inputs)?
            }
            Stage::Report => {
                let inputs = inputs.setting("manifest", m)?.file(&self.path("mesh"))?.file(&self.path(files::MASS))?;
                let mut inputs = self.scanned(inputs)?;
                let trained = self.path(files::SPLAT_REPORT);
                if trained.exists() {
                    inputs = inputs.file(&trained)?;
                }
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

/// Every file that a push is read from.
fn push_files(push: &Path, inputs: Inputs) -> Result<Inputs> {
    let recording = PushRecording::load(push)?;
    recording.sources.iter().try_fold(inputs, |inputs, file| inputs.file(file))
}
