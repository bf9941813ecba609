//! The object of the grasp examples.

use std::path::Path;

use drex_core::mesh::convex_hull;

use drex_mesh::{GridOptions, GridSdf, LengthUnit, MeshSdf, metric_mesh, solid_properties};
use drex_retarget::ObjectSurface;
use nalgebra::Point3;

pub struct Object {
    search: GridSdf,
    exact: MeshSdf,
    bounds: (Point3<f64>, Point3<f64>),
    center_of_mass: Point3<f64>,
}

impl Object {
    /// A mesh file, or its convex hull.
    pub fn load(path: &Path, hull: bool) -> Result<Self, Box<dyn std::error::Error>> {
        let (mut mesh, _) = metric_mesh(path, LengthUnit::Auto)?;
        if hull {
            mesh = convex_hull(&mesh.vertices)?;
        }
        let exact = MeshSdf::new(&mesh)?;
        let mut grid = GridOptions::default();
        grid.margin_m = Some(0.1);
        let search = GridSdf::with_options(exact.clone(), &grid)?;
        let bounds = mesh.bounds().ok_or("the mesh is empty")?;
        Ok(Self { search, exact, bounds, center_of_mass: solid_properties(&mesh)?.properties.center_of_mass })
    }

    pub fn surface(&self) -> ObjectSurface<'_> {
        ObjectSurface {
            search: &self.search,
            exact: &self.exact,
            bounds: self.bounds,
            center_of_mass: self.center_of_mass,
        }
    }
}
