//! Shapes that touch each other.

mod convex;
mod points;
mod sdf;

use std::sync::Arc;

use drex_core::Pose;
use nalgebra::Vector3;

pub use convex::ConvexPolyhedron;
pub(crate) use points::Node;
pub use points::SurfacePoints;
pub use sdf::SdfShape;

use crate::{Error, Result};

/// A shape in its own frame, metres.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum Shape {
    /// The half space below z = 0; only for things that do not move.
    Plane,
    /// A ball about the origin.
    Sphere {
        /// Radius.
        radius_m: f64,
    },
    /// All points within `radius_m` of a segment along z.
    Capsule {
        /// Radius.
        radius_m: f64,
        /// From the origin to an end of the segment.
        half_length_m: f64,
    },
    /// A solid cylinder along z. It is round against planes, spheres, capsules and points; against boxes, convex polyhedra
    /// and other cylinders its ends are polygons of [`Shape::CYLINDER_SIDES`] corners.
    Cylinder {
        /// Radius.
        radius_m: f64,
        /// From the origin to an end.
        half_length_m: f64,
    },
    /// A box about the origin.
    Box {
        /// Half extents.
        half_m: Vector3<f64>,
    },
    /// A convex polyhedron.
    Convex(Arc<ConvexPolyhedron>),
    /// A solid given by signed distance.
    Sdf(Arc<SdfShape>),
    /// A surface given by points on it. It touches the other shapes where one of its points is inside them, so it must
    /// be as fine as what it touches; it touches no other points.
    Points(Arc<SurfacePoints>),
}

impl Shape {
    /// Corners of the polygon that stands for the end of a cylinder.
    pub const CYLINDER_SIDES: u32 = 32;

    /// Checks that sizes are positive and finite.
    ///
    /// # Errors
    /// [`Error::NotFinite`] or [`Error::Shape`], which names the size.
    pub fn check(&self) -> Result<()> {
        let size = |what: &str, x: f64| match x {
            x if !x.is_finite() => Err(Error::NotFinite { what: what.into() }),
            x if x <= 0.0 => Err(Error::Shape {
                what: format!("{what} is {x} m"),
                remedy: "give a positive length in metres".into(),
            }),
            _ => Ok(()),
        };
        match self {
            Self::Plane | Self::Convex(_) | Self::Sdf(_) | Self::Points(_) => Ok(()),
            Self::Sphere { radius_m } => size("the radius of a sphere", *radius_m),
            Self::Capsule { radius_m, half_length_m } => size("the radius of a capsule", *radius_m)
                .and_then(|()| size("the half length of a capsule", *half_length_m)),
            Self::Cylinder { radius_m, half_length_m } => size("the radius of a cylinder", *radius_m)
                .and_then(|()| size("the half length of a cylinder", *half_length_m)),
            Self::Box { half_m } => half_m.iter().try_for_each(|h| size("a half extent of a box", *h)),
        }
    }
}

/// A shape placed on a body.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Geom {
    /// Pose of the shape's frame in the frame of the body.
    pub body_from_shape: Pose,
    /// The shape.
    pub shape: Shape,
}

impl Geom {
    /// A shape in the frame of its body.
    pub fn new(shape: Shape) -> Self {
        Self { body_from_shape: Pose::identity(), shape }
    }

    /// The same, placed at `body_from_shape`.
    #[must_use]
    pub fn at(self, body_from_shape: Pose) -> Self {
        Self { body_from_shape, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_sizes_are_refused_by_name() {
        let ok = [
            Shape::Plane,
            Shape::Sphere { radius_m: 0.01 },
            Shape::Capsule { radius_m: 0.01, half_length_m: 0.1 },
            Shape::Cylinder { radius_m: 0.01, half_length_m: 0.1 },
            Shape::Box { half_m: Vector3::new(0.1, 0.2, 0.3) },
        ];
        assert!(ok.iter().all(|s| s.check().is_ok()));
        let refused = |s: Shape, name: &str| s.check().is_err_and(|e| e.to_string().contains(name));
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(refused(Shape::Sphere { radius_m: bad }, "radius of a sphere"));
            assert!(refused(Shape::Capsule { radius_m: 0.1, half_length_m: bad }, "half length of a capsule"));
            assert!(refused(Shape::Cylinder { radius_m: bad, half_length_m: 0.1 }, "radius of a cylinder"));
            assert!(refused(Shape::Box { half_m: Vector3::new(0.1, bad, 0.1) }, "half extent of a box"));
        }
    }
}
