//! Convex parts of a solid, and the primitive shapes that some of them are.

use std::f64::consts::TAU;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::mesh::{convex_hull, nearest_on_triangle};
use crate::{Pose, PoseRecord, Result, SdfSample, SignedDistance, TriMesh};

/// Facets around a primitive that is drawn.
const SIDES: u32 = 32;

/// A convex part of a solid, as a collision shape: everything in the frame of the object, metres.
#[derive(Debug, Clone, PartialEq)]
pub struct ConvexPart {
    /// Its hull; near a round primitive, one of few corners.
    pub hull: TriMesh,
    /// The primitive that it is, where it is one. A simulator that knows primitives takes it for the hull.
    pub primitive: Option<Primitive>,
}

/// A primitive shape at its place in an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Primitive {
    /// Shape and size.
    pub shape: PrimitiveShape,
    /// Pose of the shape's frame in that of the object.
    pub object_from_shape: Pose,
}

/// Shape and size of a primitive, about the origin of its own frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "snake_case")]
pub enum PrimitiveShape {
    /// A ball.
    Sphere {
        /// Radius, metres.
        radius_m: f64,
    },
    /// All points within the radius of a segment along z.
    Capsule {
        /// Radius, metres.
        radius_m: f64,
        /// From the origin to an end of the segment, metres.
        half_length_m: f64,
    },
    /// A solid cylinder along z.
    Cylinder {
        /// Radius, metres.
        radius_m: f64,
        /// From the origin to an end, metres.
        half_length_m: f64,
    },
    /// A box.
    Box {
        /// Half of its sides, metres.
        half_m: [f64; 3],
    },
}

/// A primitive as files hold it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PrimitiveRecord {
    /// Shape and size.
    #[serde(flatten)]
    pub shape: PrimitiveShape,
    /// Pose of the shape's frame in that of the object.
    pub object_from_shape: PoseRecord,
}

impl ConvexPart {
    /// A part that is its hull.
    pub fn of_hull(hull: TriMesh) -> Self {
        Self { hull, primitive: None }
    }

    /// A part that is a primitive.
    ///
    /// # Errors
    /// As [`Primitive::hull`].
    pub fn of_primitive(primitive: Primitive) -> Result<Self> {
        Ok(Self { hull: primitive.hull()?, primitive: Some(primitive) })
    }

    /// Corners of the hull.
    pub fn corners(&self) -> &[Point3<f64>] {
        &self.hull.vertices
    }

    /// How far the part reaches along a direction of length one, metres.
    pub fn support(&self, direction: &Vector3<f64>) -> f64 {
        match &self.primitive {
            Some(p) => {
                let own = p.object_from_shape.inverse_transform_vector(direction);
                p.shape.support(&own) + p.object_from_shape.translation.vector.dot(direction)
            }
            None => self.corners().iter().map(|c| c.coords.dot(direction)).fold(f64::NEG_INFINITY, f64::max),
        }
    }

    /// Signed distance from the surface, exact.
    pub fn signed_distance(&self, point: &Point3<f64>) -> SdfSample {
        if let Some(p) = &self.primitive {
            let own = p.shape.signed_distance(&p.object_from_shape.inverse_transform_point(point));
            return SdfSample { gradient: p.object_from_shape * own.gradient, ..own };
        }
        let mut inside = SdfSample { distance_m: f64::NEG_INFINITY, gradient: Vector3::z() };
        let mut nearest = (f64::INFINITY, *point);
        for f in 0..self.hull.faces.len() {
            let triangle = self.hull.triangle(f);
            let [a, b, c] = triangle;
            let Some(n) = (b - a).cross(&(c - a)).try_normalize(0.0) else { continue };
            let depth = (point - a).dot(&n);
            if depth > inside.distance_m {
                inside = SdfSample { distance_m: depth, gradient: n };
            }
            let q = nearest_on_triangle(point, &triangle);
            nearest = if (point - q).norm() < nearest.0 { ((point - q).norm(), q) } else { nearest };
        }
        match (point - nearest.1).try_normalize(1e-12) {
            _ if inside.distance_m == f64::NEG_INFINITY => SdfSample { distance_m: f64::INFINITY, ..inside },
            Some(gradient) if inside.distance_m > 0.0 => SdfSample { distance_m: nearest.0, gradient },
            _ => inside,
        }
    }
}

impl SignedDistance for Vec<ConvexPart> {
    /// Of the union: exact outside, and inside where the parts do not overlap; elsewhere the surface is no nearer.
    fn signed_distance(&self, point: &Point3<f64>) -> SdfSample {
        let all = self.iter().map(|p| p.signed_distance(point));
        let none = SdfSample { distance_m: f64::INFINITY, gradient: Vector3::z() };
        all.min_by(|a, b| a.distance_m.total_cmp(&b.distance_m)).unwrap_or(none)
    }
}

impl Primitive {
    /// A hull near the primitive, with fine facets.
    ///
    /// # Errors
    /// If a size is not positive.
    pub fn hull(&self) -> Result<TriMesh> {
        let ring = |radius: f64, z: f64| {
            (0..SIDES).map(move |k| {
                let (s, c) = (TAU * f64::from(k) / f64::from(SIDES)).sin_cos();
                Point3::new(radius * c, radius * s, z)
            })
        };
        // Rings of a ball whose halves are apart.
        let ball = |radius: f64, apart: f64| -> Vec<Point3<f64>> {
            let half = |side: f64| {
                let angles = (0..=SIDES / 4).map(|k| TAU * f64::from(k) / f64::from(SIDES));
                angles.flat_map(move |a| ring(radius * a.cos(), side * (radius * a.sin() + apart)))
            };
            half(1.0).chain(half(-1.0)).collect()
        };
        let points = match self.shape {
            PrimitiveShape::Sphere { radius_m } => ball(radius_m, 0.0),
            PrimitiveShape::Capsule { radius_m, half_length_m } => ball(radius_m, half_length_m),
            PrimitiveShape::Cylinder { radius_m, half_length_m } => {
                ring(radius_m, half_length_m).chain(ring(radius_m, -half_length_m)).collect()
            }
            PrimitiveShape::Box { half_m } => (0..8)
                .map(|k| Point3::from([0, 1, 2].map(|i| if k >> i & 1 == 0 { -half_m[i] } else { half_m[i] })))
                .collect(),
        };
        Ok(convex_hull(&points)?.transformed(&self.object_from_shape))
    }
}

impl PrimitiveShape {
    /// How far the shape reaches along a direction of length one, metres, in its own frame.
    pub fn support(&self, direction: &Vector3<f64>) -> f64 {
        let (across, along) = (direction.xy().norm(), direction.z.abs());
        match *self {
            Self::Sphere { radius_m } => radius_m,
            Self::Capsule { radius_m, half_length_m } => radius_m + half_length_m * along,
            Self::Cylinder { radius_m, half_length_m } => radius_m * across + half_length_m * along,
            Self::Box { half_m } => direction.abs().dot(&Vector3::from(half_m)),
        }
    }

    /// Signed distance of a point in its own frame from the surface.
    pub fn signed_distance(&self, p: &Point3<f64>) -> SdfSample {
        let sign = |x: f64| if x < 0.0 { -1.0 } else { 1.0 };
        match *self {
            Self::Sphere { radius_m } => from_center(p.coords, radius_m),
            Self::Capsule { radius_m, half_length_m } => {
                from_center(p.coords - Vector3::z() * p.z.clamp(-half_length_m, half_length_m), radius_m)
            }
            Self::Cylinder { radius_m, half_length_m } => {
                let across = Vector3::new(p.x, p.y, 0.0);
                let outwards = across.try_normalize(0.0).unwrap_or(Vector3::x());
                corner(&[(across.norm() - radius_m, outwards), (p.z.abs() - half_length_m, Vector3::z() * sign(p.z))])
            }
            Self::Box { half_m } => corner(&[0, 1, 2].map(|i| (p[i].abs() - half_m[i], Vector3::ith(i, sign(p[i]))))),
        }
    }
}

/// Distance from a ball about the origin.
fn from_center(p: Vector3<f64>, radius_m: f64) -> SdfSample {
    SdfSample { distance_m: p.norm() - radius_m, gradient: p.try_normalize(0.0).unwrap_or(Vector3::z()) }
}

/// Distance from where faces meet at right angles, each with its normal and how far beyond it the point is.
fn corner(faces: &[(f64, Vector3<f64>)]) -> SdfSample {
    let over: Vector3<f64> = faces.iter().map(|(x, n)| n * x.max(0.0)).sum();
    match over.try_normalize(0.0) {
        Some(gradient) => SdfSample { distance_m: over.norm(), gradient },
        None => {
            let inside = faces.iter().max_by(|a, b| a.0.total_cmp(&b.0));
            inside.map_or_else(
                || from_center(Vector3::zeros(), 0.0),
                |&(distance_m, gradient)| SdfSample { distance_m, gradient },
            )
        }
    }
}

impl From<&Primitive> for PrimitiveRecord {
    fn from(p: &Primitive) -> Self {
        Self { shape: p.shape, object_from_shape: PoseRecord::from(&p.object_from_shape) }
    }
}

impl PrimitiveRecord {
    /// The primitive.
    ///
    /// # Errors
    /// As [`PoseRecord::to_pose`].
    pub fn to_primitive(self) -> Result<Primitive> {
        Ok(Primitive { shape: self.shape, object_from_shape: self.object_from_shape.to_pose()? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// No plane that holds the shape is farther from a point than its surface, and one is as far: the distance's gradient is its normal.
        /// A hull of the shape says the same to within its facets.
        #[test]
        fn support_distance_and_hull_are_of_one_shape(
            p in prop::array::uniform3(-0.2..0.2_f64),
            d in prop::array::uniform3(-1.0..1.0_f64),
        ) {
            let (p, Some(d)) = (Point3::from(p), Vector3::from(d).try_normalize(1e-3)) else { return Ok(()) };
            for shape in [
                PrimitiveShape::Sphere { radius_m: 0.1 },
                PrimitiveShape::Capsule { radius_m: 0.05, half_length_m: 0.08 },
                PrimitiveShape::Cylinder { radius_m: 0.07, half_length_m: 0.05 },
                PrimitiveShape::Box { half_m: [0.03, 0.06, 0.09] },
            ] {
                let SdfSample { distance_m, gradient } = shape.signed_distance(&p);
                prop_assert!(p.coords.dot(&d) - shape.support(&d) <= distance_m + 1e-12);
                prop_assert!((gradient.norm() - 1.0).abs() < 1e-12);
                prop_assert!((p.coords.dot(&gradient) - shape.support(&gradient) - distance_m).abs() < 1e-12);
                let at = Pose::new(Vector3::new(0.1, -0.2, 0.3), Vector3::new(0.4, 1.1, -0.3));
                let round = ConvexPart::of_primitive(Primitive { shape, object_from_shape: at }).unwrap();
                let placed = round.signed_distance(&(at * p));
                prop_assert!((placed.distance_m - distance_m).abs() < 1e-12);
                prop_assert!((placed.gradient - at * gradient).norm() < 1e-12);
                let reach = shape.support(&d) + at.translation.vector.dot(&(at * d));
                prop_assert!((round.support(&(at * d)) - reach).abs() < 1e-12);
                let facets = ConvexPart::of_hull(round.hull).signed_distance(&(at * p));
                prop_assert!(facets.distance_m - distance_m > -1e-9 && facets.distance_m - distance_m < 2e-3);
            }
        }
    }
}
