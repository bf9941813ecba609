//! The asset as grasping, trials and identification take it.

use std::sync::Arc;

use drex_core::Object;

use super::Asset;
use crate::{GridOptions, GridSdf, MeshSdf, Result};

/// How far around the object a search for grasps asks for distances, metres; most of a hand is nearer.
const SEARCH_MARGIN_M: f64 = 0.1;

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
            convex_parts: Arc::new(self.pieces.iter().map(|p| p.vertices.clone()).collect()),
            mass_properties: self.properties,
            geometry,
            friction: self.friction,
            max_finger_n: None,
            world_from_object: self.world_from_mesh_at_rest,
        }
    }
}
