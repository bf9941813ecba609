//! An object of the bench with everything that grasping it takes.

use std::sync::Arc;

use anyhow::{Context, Result};
use drex_core::{Pose, Surface};
use drex_diffsim::{Collider, ConvexPiece};
use drex_grasp::TablePlane;
use drex_mesh::{Asset, GridOptions, GridSdf, MeshSdf, asset_from_mesh, farthest_points, sample_surface};
use drex_retarget::ObjectSurface;
use drex_trial::TrialObject;
use nalgebra::{Point3, Unit, Vector3};

use super::objects::ObjectSpec;

/// The search for a grasp asks for distances this far around the object, metres.
const SEARCH_MARGIN_M: f64 = 0.08;
/// Nodes of the grid of distances.
const NODES: usize = 72 * 72 * 72;
/// Surface points that the network sees.
pub const POINTS: usize = 512;

/// An object at rest on its table.
pub struct Thing {
    pub spec: ObjectSpec,
    pub asset: Asset,
    /// On a grid for searching; the exact one inside it judges.
    pub sdf: Arc<GridSdf>,
    /// Where it rests on the table z = 0.
    pub world_from_object: Pose,
    /// The table in the object's frame.
    pub table: TablePlane,
    collider: Arc<Collider>,
}

impl Thing {
    /// Pieces, mass properties, distances, resting pose.
    pub fn new(spec: &ObjectSpec) -> Result<Self> {
        let asset =
            asset_from_mesh(&spec.mesh, &spec.asset_options()).with_context(|| format!("object \"{}\"", spec.name))?;
        Self::of_asset(spec, asset)
    }

    /// The same of an object that has been divided already.
    pub fn of_asset(spec: &ObjectSpec, asset: Asset) -> Result<Self> {
        let at = || format!("object \"{}\"", spec.name);
        let mut grid = GridOptions::default();
        (grid.nodes, grid.margin_m) = (NODES, Some(SEARCH_MARGIN_M));
        let sdf = GridSdf::with_options(MeshSdf::new(&asset.visual)?, &grid).with_context(at)?;
        let lies = asset.stable_poses.first().filter(|_| spec.up.is_none());
        let world_from_object = lies.map_or(asset.world_from_mesh_at_rest, |p| p.world_from_mesh);
        let up = Unit::new_normalize(world_from_object.rotation.inverse() * Vector3::z());
        let table = TablePlane { up, height_m: -world_from_object.translation.z };
        let pieces = asset.pieces.iter().map(|p| ConvexPiece::from_points(&p.vertices));
        let collider = Collider::convex(pieces.collect::<Result<_, _>>().with_context(at)?);
        Ok(Self {
            spec: spec.clone(),
            asset,
            sdf: Arc::new(sdf),
            world_from_object,
            table,
            collider: Arc::new(collider),
        })
    }

    /// The object as the solvers take it.
    pub fn surface(&self) -> ObjectSurface<'_> {
        ObjectSurface {
            search: &*self.sdf,
            judge: self.sdf.exact(),
            bounds: self.sdf.bounds(),
            center_of_mass: self.center_of_mass(),
        }
    }

    /// Centre of mass, mesh frame.
    pub fn center_of_mass(&self) -> Point3<f64> {
        self.asset.properties.center_of_mass
    }

    /// The object as trials take it.
    pub fn trial_object(&self) -> TrialObject {
        TrialObject {
            collider: self.collider.clone(),
            properties: self.asset.properties,
            surface: self.sdf.clone(),
            world_from_object: self.world_from_object,
            max_finger_n: self.spec.max_force_n,
        }
    }

    /// Surface points as the network sees them.
    pub fn cloud(&self, seed: u64) -> Vec<Point3<f64>> {
        let dense: Vec<_> = sample_surface(&self.asset.visual, 8 * POINTS, seed).into_iter().map(|s| s.point).collect();
        farthest_points(&dense, POINTS).into_iter().map(|i| dense[i]).collect()
    }
}
