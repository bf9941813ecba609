//! The plane that an object stands on.

use nalgebra::{Point3, Unit, Vector3};

/// The plane that an object stands on (see [`crate::support_plane`]).
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct TablePlane {
    /// A point of it.
    pub point: Point3<f64>,
    /// Upward unit normal: to the side of the cameras.
    pub up: Unit<Vector3<f64>>,
    /// Points that belong to it; 0 for a plane that was not found among points.
    pub inliers: usize,
    /// Their root mean square distance from it, in the unit of the points.
    pub rms: f64,
    /// The same in pixels: each distance divided by what a pixel of noise does to its point.
    pub rms_px: f64,
}

impl TablePlane {
    /// A plane that is known, not found among points.
    pub fn new(point: Point3<f64>, up: Unit<Vector3<f64>>) -> Self {
        Self { point, up, inliers: 0, rms: 0.0, rms_px: 0.0 }
    }

    /// Height of a point above the plane, in the unit of the points.
    pub fn height(&self, p: &Point3<f64>) -> f64 {
        self.up.dot(&(p - self.point))
    }
}
