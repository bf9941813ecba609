//! Points on the collision shapes.

use nalgebra::{Point3, Vector3};

use crate::model::Robot;

impl Robot {
    /// Points and outward unit normals on the collision shapes of `link`, in the link frame.
    pub fn surface_samples(&self, link: usize, spacing_m: f64) -> Vec<(Point3<f64>, Vector3<f64>)> {
        let _ = (link, spacing_m);
        Vec::new()
    }
}
