//! The stages of a twin, and what each of them depends on.

use std::path::Path;
use std::str::FromStr;

use drex_recording::PushRecording;

use crate::error::Context;
use crate::lock::Inputs;
use crate::manifest::ScanConfig;
use crate::{Error, Result, Twin, records as files};

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
    /// The network's grasps evaluated.
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

    /// The stages that make what this one reads.
    fn needs(self) -> &'static [Self] {
        match self {
            Self::Scan => &[],
            Self::Identify | Self::Grasps => &[Self::Scan],
            Self::Asset => &[Self::Identify],
            Self::Train => &[Self::Identify, Self::Grasps],
            Self::Evaluate | Self::Trial | Self::Execute => &[Self::Train],
            Self::Appearance => &[Self::Asset],
            Self::Report => &Self::ALL,
        }
    }

    /// These stages and all that they need, in order.
    pub(crate) fn with_needed(stages: &[Self]) -> Vec<Self> {
        let mut asked = stages.to_vec();
        // What a stage needs comes before it.
        for stage in Self::ALL.into_iter().rev() {
            if asked.contains(&stage) {
                asked.extend(stage.needs());
            }
        }
        Self::ALL.into_iter().filter(|s| asked.contains(s)).collect()
    }

    /// Whether the stage needs demonstrated grasps.
    pub(crate) fn needs_grasps(self) -> bool {
        matches!(self, Self::Grasps | Self::Train | Self::Evaluate | Self::Trial | Self::Execute)
    }
}

impl FromStr for Stage {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let names = || Self::ALL.map(Self::name).join(", ");
        Self::ALL
            .into_iter()
            .find(|s| s.name() == name)
            .with_context(|| format!("there is no stage \"{name}\"; choose from {}", names()))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_brings_what_it_needs_and_nothing_else() {
        use Stage::{Appearance, Asset, Grasps, Identify, Scan, Train, Trial};
        assert_eq!(Stage::with_needed(&[Appearance]), [Scan, Identify, Asset, Appearance]);
        assert_eq!(Stage::with_needed(&[Trial, Identify]), [Scan, Identify, Grasps, Train, Trial]);
        assert_eq!(Stage::with_needed(&[Stage::Report]), Stage::ALL);
        assert!(Stage::with_needed(&[]).is_empty());
        for stage in Stage::ALL {
            assert!(stage == Stage::Report || stage.needs().iter().all(|needed| *needed < stage));
        }
    }

    #[test]
    fn stages_are_known_by_their_names() {
        for stage in Stage::ALL {
            assert!(stage.name().parse::<Stage>().is_ok_and(|s| s == stage));
        }
        let message = "Train".parse::<Stage>().err().map(|e| e.to_string());
        assert_eq!(
            message.as_deref(),
            Some(
                "there is no stage \"Train\"; choose from scan, identify, asset, grasps, train, evaluate, trial, execute, \
                 appearance, report"
            )
        );
    }
}
