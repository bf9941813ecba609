//! The object of the grasp examples.

use std::path::Path;

use drex_core::Object;
use drex_core::mesh::convex_hull;
use drex_mesh::{GridOptions, LengthUnit, metric_mesh, solid_object};

/// A mesh file, or its convex hull.
pub fn load(path: &Path, hull: bool) -> Result<Object, Box<dyn std::error::Error>> {
    let (mut mesh, _) = metric_mesh(path, LengthUnit::Auto)?;
    if hull {
        mesh = convex_hull(&mesh.vertices)?;
    }
    let mut grid = GridOptions::default();
    grid.margin_m = Some(0.1);
    Ok(solid_object("object", &mesh, &grid)?)
}
