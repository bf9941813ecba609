//! The asset as grasping, trials and identification take it.

use std::path::Path;
use std::sync::Arc;

use drex_core::fsutil::{from_json, read_text};
use drex_core::{ASSUMED_FRICTION, MassProperties, Object, PoseRecord, PrimitiveRecord, TriMesh};
use nalgebra::{Matrix3, Point3};
use serde::Deserialize;

use super::Asset;
use super::write;
use crate::{GridOptions, GridSdf, MeshSdf, Result, read_mesh, solid_properties};

/// How far around the object a search for grasps asks for distances, metres; most of a hand is nearer.
const SEARCH_MARGIN_M: f64 = 0.1;

/// Density of water.
const WATER_KG_M3: f64 = 1000.0;

impl Asset {
    /// The object in the asset's rest pose, with its signed distance on a grid for searching and the exact one behind it.
    ///
    /// # Errors
    /// If the mesh has no surface.
    pub fn to_object(&self, name: &str) -> Result<Object> {
        let grid = GridOptions { margin_m: Some(SEARCH_MARGIN_M), ..GridOptions::default() };
        let geometry = Arc::new(GridSdf::with_options(MeshSdf::new(&self.visual)?, &grid)?);
        Ok(self.object_with(name, geometry))
    }

    /// The same without the grid, which takes longer to make than a few thousand exact distances.
    ///
    /// # Errors
    /// If the mesh has no surface.
    pub fn to_exact_object(&self, name: &str) -> Result<Object> {
        Ok(self.object_with(name, Arc::new(MeshSdf::new(&self.visual)?)))
    }

    fn object_with(&self, name: &str, geometry: Arc<dyn drex_core::SolidGeometry>) -> Object {
        Object {
            name: name.to_owned(),
            mesh: Arc::new(self.visual.clone()),
            convex_parts: Arc::new(self.convex_parts.clone()),
            mass_properties: self.properties,
            geometry,
            friction: self.friction,
            max_finger_n: None,
            world_from_object: self.world_from_mesh_at_rest,
        }
    }
}

/// The object of a closed mesh, filled with water, that is held and not simulated: without convex parts, which take the most time of an asset.
/// `grid` is for its fast distances; it rests as its mesh stands.
///
/// # Errors
/// If the mesh has no surface or no volume.
pub fn solid_object(name: &str, mesh: &TriMesh, grid: &GridOptions) -> Result<Object> {
    let solid = solid_properties(mesh)?.properties;
    let mut object = Object::of_parts(Vec::new(), solid.with_mass(WATER_KG_M3 * solid.mass_kg));
    object.name = name.to_owned();
    object.mesh = Arc::new(mesh.clone());
    object.geometry = Arc::new(GridSdf::with_options(MeshSdf::new(mesh)?, grid)?);
    Ok(object)
}

/// Reads back the object of the asset that [`Asset::write`] wrote into the folder `out`, with exact distances and at
/// [`ASSUMED_FRICTION`]: nothing is repaired, divided or settled again.
///
/// # Errors
/// If `out` holds no whole asset, or one of an earlier version.
pub fn read_object(out: &Path, name: &str) -> Result<Object> {
    #[derive(Deserialize)]
    struct Written {
        mass_kg: f64,
        center_of_mass_m: [f64; 3],
        inertia_kg_m2: [[f64; 3]; 3],
        world_from_mesh_at_rest: PoseRecord,
        primitives: Vec<Option<PrimitiveRecord>>,
    }
    let report = out.join("mesh/report.json");
    let written: Written = from_json(&report, &read_text(&report)?)?;
    let mesh = read_mesh(&out.join("mesh/visual.obj"))?;
    Ok(Object {
        name: name.to_owned(),
        convex_parts: Arc::new(write::read_parts(out, &written.primitives)?),
        mass_properties: MassProperties {
            mass_kg: written.mass_kg,
            center_of_mass: Point3::from(written.center_of_mass_m),
            inertia: Matrix3::from_fn(|r, c| written.inertia_kg_m2[r][c]),
        },
        geometry: Arc::new(MeshSdf::new(&mesh)?),
        mesh: Arc::new(mesh),
        friction: ASSUMED_FRICTION,
        max_finger_n: None,
        world_from_object: written.world_from_mesh_at_rest.to_pose()?,
    })
}
