//! The shapes of one rigid thing, prepared for contact.

use drex_core::{ConvexPart, Pose, PrimitiveShape};
use nalgebra::{Point3, Vector3};

use crate::collide::CollisionGeom;
use crate::{ConvexPolyhedron, Geom, Result, Shape};

/// Shapes in the frame of a body, with what contact search needs. Made once, shared by all models of the same body.
#[derive(Debug, Clone)]
pub struct Collider {
    geoms: Vec<Geom>,
    prepared: Vec<CollisionGeom>,
    /// A ball that holds all shapes; infinite for a plane.
    center: Vector3<f64>,
    radius: f64,
}

impl Collider {
    /// Prepares shapes.
    ///
    /// # Errors
    /// If a shape has a size that is not a positive number.
    pub fn new(geoms: &[Geom]) -> Result<Self> {
        let prepared = geoms.iter().map(|g| CollisionGeom::new(&g.shape, &g.body_from_shape));
        Ok(Self::from_prepared(prepared.collect::<Result<_>>()?, geoms.to_vec()))
    }

    /// The convex parts of an object, those that are primitives as such.
    ///
    /// # Errors
    /// If a hull has no volume or a primitive a size that is not a positive number.
    pub fn of_parts(parts: &[ConvexPart]) -> Result<Self> {
        let geom = |part: &ConvexPart| {
            let Some(primitive) = part.primitive else {
                return Ok(Geom::new(Shape::Convex(ConvexPolyhedron::from_points(part.corners())?.into())));
            };
            let shape = match primitive.shape {
                PrimitiveShape::Sphere { radius_m } => Shape::Sphere { radius_m },
                PrimitiveShape::Capsule { radius_m, half_length_m } => Shape::Capsule { radius_m, half_length_m },
                PrimitiveShape::Cylinder { radius_m, half_length_m } => Shape::Cylinder { radius_m, half_length_m },
                PrimitiveShape::Box { half_m } => Shape::Box { half_m: half_m.into() },
            };
            Ok(Geom::new(shape).at(primitive.object_from_shape))
        };
        Self::new(&parts.iter().map(geom).collect::<Result<Vec<_>>>()?)
    }

    /// Convex polyhedra in the body's own frame.
    pub fn convex(pieces: Vec<ConvexPolyhedron>) -> Self {
        let geoms: Vec<Geom> = pieces.into_iter().map(|p| Geom::new(Shape::Convex(p.into()))).collect();
        // A piece was checked when it was made, and the identity is a pose.
        let prepared = geoms.iter().filter_map(|g| CollisionGeom::new(&g.shape, &g.body_from_shape).ok()).collect();
        Self::from_prepared(prepared, geoms)
    }

    /// The plane z = 0.
    pub fn plane() -> Self {
        let geom = CollisionGeom::new(&Shape::Plane, &Pose::identity());
        Self::from_prepared(geom.into_iter().collect(), vec![Geom::new(Shape::Plane)])
    }

    /// Nothing that touches.
    pub fn none() -> Self {
        Self::from_prepared(Vec::new(), Vec::new())
    }

    fn from_prepared(prepared: Vec<CollisionGeom>, geoms: Vec<Geom>) -> Self {
        let count = prepared.len().max(1) as f64;
        let center = prepared.iter().map(|g| g.center).sum::<Vector3<f64>>() / count;
        let radius = prepared.iter().map(|g| (g.center - center).norm() + g.radius).fold(0.0, f64::max);
        Self { geoms, prepared, center, radius }
    }

    /// The shapes in the form that contact search takes, in the same order.
    pub(crate) fn prepared(&self) -> &[CollisionGeom] {
        &self.prepared
    }

    /// The shapes and where they are on the body, in the order in which [`crate::ContactKey`] counts them.
    pub fn geoms(&self) -> &[Geom] {
        &self.geoms
    }

    /// Centre and radius of a ball that holds all shapes.
    pub(crate) fn bounding_sphere(&self) -> (Vector3<f64>, f64) {
        (self.center, self.radius)
    }

    /// Bound on the distance of a point of the shapes from `p`.
    pub(crate) fn reach_from(&self, p: &Point3<f64>) -> f64 {
        if self.geoms.is_empty() { 0.0 } else { (self.center - p.coords).norm() + self.radius }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_point_of_the_shapes_is_farther_than_the_reach() {
        let at = |x: f64, y: f64| Pose::translation(x, y, 0.02);
        let cuboid = Shape::Box { half_m: Vector3::new(0.03, 0.01, 0.02) };
        let geoms = [(at(0.1, 0.0), cuboid), (at(0.14, 0.03), Shape::Sphere { radius_m: 0.02 })]
            .map(|(body_from_shape, shape)| Geom { shape, body_from_shape });
        let collider = Collider::new(&geoms).unwrap();
        for p in [[0.0; 3], [-0.1, 0.02, 0.0], [0.12, 0.0, 0.01], [0.5, -0.3, 0.2]].map(Point3::from) {
            // The farthest corner, and the far side of the ball.
            let corner = |k: u32| {
                let sign = |axis: u32| if k >> axis & 1 == 0 { 1.0 } else { -1.0 };
                (at(0.1, 0.0) * Point3::new(0.03 * sign(0), 0.01 * sign(1), 0.02 * sign(2)) - p).norm()
            };
            let far = (0..8).map(corner).fold((at(0.14, 0.03) * Point3::origin() - p).norm() + 0.02, f64::max);
            let reach = collider.reach_from(&p);
            assert!((far..far + 0.1).contains(&reach), "{reach} for {far}");
            // A body turns about its centre of mass.
            let properties =
                drex_core::MassProperties { mass_kg: 1.0, center_of_mass: p, inertia: nalgebra::Matrix3::identity() };
            assert_eq!(crate::Body::new(&properties, 0.2, collider.clone().into()).reach(), reach);
        }
        assert_eq!(Collider::none().reach_from(&Point3::new(1.0, 2.0, 3.0)), 0.0);
    }
}
