//! Hand and object of a twin on its table, as the grasp stages take them.

use drex_core::Object;
use drex_retarget::{WristFit, WristFitOptions, fit_wrist};
use drex_robot::Robot;

use crate::{Result, Twin};

/// A hand, and the object on its table.
pub struct Scene {
    /// Model of the hand.
    pub robot: Robot,
    /// The object.
    pub object: Object,
    seed: u64,
}

impl Scene {
    /// The scene that the manifest describes.
    pub(crate) fn of(twin: &Twin) -> Result<Self> {
        let robot = twin.hand()?;
        let object = twin.asset()?.to_object(&twin.manifest.name)?;
        Ok(Self { robot, object, seed: twin.seed })
    }

    /// Solves the wrist pose for joint angles (model order, rad).
    pub(crate) fn fit(&self, joints: &[f64]) -> Result<WristFit> {
        Ok(fit_wrist(&self.robot, joints, &self.object, &WristFitOptions::default().with_seed(self.seed))?)
    }
}
