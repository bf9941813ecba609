//! Hand, object and table of a twin, as the grasp stages need them.

use anyhow::{Context, Result};
use drex_core::{MassProperties, Pose, Surface};
use drex_grasp::{CheckOptions, ContactOptions, StaticGrasp, TablePlane};
use drex_mesh::{Asset, GridOptions, GridSdf, MeshSdf};
use drex_retarget::{ObjectSurface, WristFit, WristFitOptions, fit_wrist};
use drex_robot::Robot;
use nalgebra::Vector3;

use super::Twin;
/// The search for a wrist pose asks for distances this far around the object; most of a hand is nearer.
const SEARCH_MARGIN_M: f64 = 0.1;

/// Hand, object and table.
pub struct Scene {
    /// The hand model.
    pub robot: Robot,
    /// The object.
    pub asset: Asset,
    /// Its signed distance on a grid for searching; the exact one inside it judges.
    pub sdf: GridSdf,
    /// The table under it, in the object's mesh frame.
    pub table: TablePlane,
    friction: f64,
    seed: u64,
}

impl Scene {
    /// From the manifest.
    pub fn of(twin: &Twin) -> Result<Self> {
        let robot = twin.hand()?;
        let asset = twin.asset()?.clone();
        let mut grid = GridOptions::default();
        grid.margin_m = Some(SEARCH_MARGIN_M);
        let sdf = GridSdf::with_options(MeshSdf::new(&asset.visual)?, &grid)?;
        let table = TablePlane::under(&asset.visual.vertices, Vector3::from(twin.manifest.object.up_in_mesh))
            .context("the object has no surface")?;
        Ok(Self { robot, asset, sdf, table, friction: twin.friction(), seed: twin.seed })
    }

    /// What the static check asks for.
    pub fn check_options(&self) -> CheckOptions {
        let mut options = CheckOptions::default();
        options.contact = ContactOptions::with_friction(self.friction);
        options
    }

    /// A grasp of the object with this mass.
    pub fn grasp<'a>(&'a self, joints: &'a [f64], object_from_base: Pose, body: &'a MassProperties) -> StaticGrasp<'a> {
        StaticGrasp { robot: &self.robot, joints, object_from_base, object: self.sdf.exact(), body, table: self.table }
    }

    /// The rules of the wrist fit.
    pub fn fit_options(&self) -> WristFitOptions {
        let mut options = WristFitOptions::default().with_seed(self.seed);
        options.friction = self.friction;
        options
    }

    /// Solves the wrist pose for joint angles.
    pub fn fit(&self, joints: &[f64]) -> Result<WristFit> {
        Ok(fit_wrist(&self.robot, joints, &self.surface(), &self.table, &self.fit_options())?)
    }

    /// The object as the solvers take it.
    pub fn surface(&self) -> ObjectSurface<'_> {
        ObjectSurface {
            search: &self.sdf,
            judge: self.sdf.exact(),
            bounds: self.sdf.bounds(),
            center_of_mass: self.asset.properties.center_of_mass,
        }
    }
}
