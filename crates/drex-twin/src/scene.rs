//! Hand and object of a twin on its table, as the grasp stages take them.

use drex_core::Object;
use drex_retarget::{ObjectSurface, WristFit, WristFitOptions, fit_wrist};
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

    /// The options of the wrist fit.
    pub fn fit_options(&self) -> WristFitOptions {
        let mut options = WristFitOptions::default().with_seed(self.seed);
        options.friction = self.object.friction;
        options
    }

    /// Solves the wrist pose for joint angles.
    pub(crate) fn fit(&self, joints: &[f64]) -> Result<WristFit> {
        Ok(fit_wrist(&self.robot, joints, &self.surface(), &self.object.table(), &self.fit_options())?)
    }

    /// The object as retargeting takes it.
    pub fn surface(&self) -> ObjectSurface<'_> {
        ObjectSurface {
            search: &*self.object.geometry,
            exact: self.object.geometry.exact(),
            bounds: self.object.geometry.bounding_box(),
            center_of_mass: self.object.center_of_mass(),
        }
    }
}
