//! What the rest of the workspace asks of an object's geometry, whoever represents it.

use nalgebra::{Point3, Vector3};

/// A point on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// The point, metres, in the surface's frame.
    pub point: Point3<f64>,
    /// Outward unit normal there.
    pub normal: Vector3<f64>,
}

/// Signed distance at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SdfSample {
    /// Distance to the surface in metres, negative inside.
    pub distance_m: f64,
    /// Unit gradient: the direction in which the distance grows (the outward normal at the surface).
    pub gradient: Vector3<f64>,
}

/// A surface that can be asked for its nearest point and hit by rays. All in the surface's own frame, metres.
pub trait Surface: Send + Sync {
    /// The surface point nearest to `point`.
    fn nearest(&self, point: &Point3<f64>) -> SurfacePoint;
    /// The first point hit by the ray `origin + t direction`, 0 <= t <= `max_distance_m`, for a unit `direction`.
    fn ray_cast(&self, origin: &Point3<f64>, direction: &Vector3<f64>, max_distance_m: f64) -> Option<SurfacePoint>;
    /// Lower and upper corner of the axis-aligned bounding box.
    fn bounds(&self) -> (Point3<f64>, Point3<f64>);
}

/// A solid that knows how far a point is from its boundary. All in the solid's own frame, metres.
pub trait SignedDistance: Send + Sync {
    /// Signed distance and its gradient at `point`.
    fn signed_distance(&self, point: &Point3<f64>) -> SdfSample;
}
