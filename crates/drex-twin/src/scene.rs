//! Hand, object and table of a twin, as the grasp stages take them.

use drex_core::{MassProperties, Object, Pose, TablePlane};
use drex_grasp::{CheckOptions, ContactOptions, StaticGrasp};
use drex_retarget::{ObjectSurface, WristFit, WristFitOptions, fit_wrist};
use drex_robot::Robot;
use nalgebra::Vector3;

use crate::error::Context;
use crate::{Result, Twin};

/// Hand, object and table.
pub struct Scene {
    /// Model of the hand.
    pub robot: Robot,
    /// The object.
    pub object: Object,
    /// The table under the object, in the object's frame.
    pub table: TablePlane,
    seed: u64,
}

impl Scene {
    /// The scene that the manifest describes.
    pub(crate) fn of(twin: &Twin) -> Result<Self> {
        let robot = twin.hand()?;
        let object = twin.asset()?.to_object(&twin.manifest.name)?;
        let table = TablePlane::under(&object.mesh.vertices, Vector3::from(twin.manifest.object.up_in_mesh))
            .context("the object has no surface")?;
        Ok(Self { robot, object, table, seed: twin.seed })
    }

    /// The options of the static check.
    pub fn check_options(&self) -> CheckOptions {
        let mut options = CheckOptions::default();
        options.contact = ContactOptions::with_friction(self.object.friction);
        options
    }

    /// A grasp of the object with these mass properties.
    pub fn grasp<'a>(&'a self, joints: &'a [f64], object_from_base: Pose, body: &'a MassProperties) -> StaticGrasp<'a> {
        let object = self.object.geometry.exact();
        StaticGrasp { robot: &self.robot, joints, object_from_base, object, body, table: self.table }
    }

    /// The options of the wrist fit.
    pub fn fit_options(&self) -> WristFitOptions {
        let mut options = WristFitOptions::default().with_seed(self.seed);
        options.friction = self.object.friction;
        options
    }

    /// Solves the wrist pose for joint angles.
    pub(crate) fn fit(&self, joints: &[f64]) -> Result<WristFit> {
        Ok(fit_wrist(&self.robot, joints, &self.surface(), &self.table, &self.fit_options())?)
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
