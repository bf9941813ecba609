//! What of a robot touches: its collision shapes, link by link.

use drex_robot::{Link, Robot, Shape as RobotShape};
use nalgebra::Point3;

use crate::collider::Collider;
use crate::material::Material;
use crate::{ConvexPolyhedron, Geom, Result, Shape};

/// Points per half turn on an ellipsoid.
const ELLIPSOID_ROWS: usize = 16;

/// Collision shapes of every link; meshes stand for their convex hulls.
pub(super) fn colliders(robot: &Robot) -> Result<Vec<Collider>> {
    robot.links.iter().map(collider).collect()
}

/// Friction of every link: the largest that the file gives one of its shapes, else zero, so that what it touches
/// decides.
pub(super) fn materials(robot: &Robot) -> Vec<Material<f64>> {
    let friction = |l: &Link| l.geoms.iter().filter(|g| g.collides()).filter_map(|g| g.friction).fold(0.0, f64::max);
    robot.links.iter().map(|l| Material::new(friction(l))).collect()
}

fn collider(link: &Link) -> Result<Collider> {
    let geoms =
        link.geoms.iter().filter(|g| g.collides()).map(|g| Ok(Geom::new(shape(&g.shape)?).at(g.link_from_geom)));
    Collider::new(&geoms.collect::<Result<Vec<_>>>()?)
}

fn shape(shape: &RobotShape) -> Result<Shape> {
    Ok(match shape {
        RobotShape::Sphere { radius } => Shape::Sphere { radius_m: *radius },
        RobotShape::Capsule { radius, half_length } => {
            Shape::Capsule { radius_m: *radius, half_length_m: *half_length }
        }
        RobotShape::Cylinder { radius, half_length } => {
            Shape::Cylinder { radius_m: *radius, half_length_m: *half_length }
        }
        RobotShape::Box { half } => Shape::Box { half_m: *half },
        RobotShape::Ellipsoid { radii } => Shape::Convex(ConvexPolyhedron::from_points(&ellipsoid(radii))?.into()),
        RobotShape::Mesh(mesh) => Shape::Convex(ConvexPolyhedron::from_points(&mesh.vertices)?.into()),
        _ => Shape::Plane,
    })
}

fn ellipsoid(radii: &nalgebra::Vector3<f64>) -> Vec<Point3<f64>> {
    let mut out = vec![Point3::new(0.0, 0.0, radii.z), Point3::new(0.0, 0.0, -radii.z)];
    for i in 1..ELLIPSOID_ROWS {
        let (s, c) = (std::f64::consts::PI * i as f64 / ELLIPSOID_ROWS as f64).sin_cos();
        for j in 0..2 * ELLIPSOID_ROWS {
            let (y, x) = (std::f64::consts::PI * j as f64 / ELLIPSOID_ROWS as f64).sin_cos();
            out.push(Point3::new(radii.x * s * x, radii.y * s * y, radii.z * c));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_points_of_an_ellipsoid_are_on_it_and_all_around() {
        let radii = nalgebra::Vector3::new(0.01, 0.03, 0.02);
        let points = ellipsoid(&radii);
        for p in &points {
            assert!((p.coords.component_div(&radii).norm() - 1.0).abs() < 1e-12, "{p}");
        }
        // No direction is farther than the spacing from all of them, and the mean is the centre.
        for k in 0..200_u32 {
            let z = 1.0 - (2.0 * f64::from(k) + 1.0) / 200.0;
            let (sin, cos) = (2.399_963 * f64::from(k)).sin_cos();
            let d = nalgebra::Vector3::new(cos, sin, 0.0) * (1.0 - z * z).sqrt() + nalgebra::Vector3::z() * z;
            let nearest = points.iter().map(|p| p.coords.component_div(&radii).angle(&d)).fold(f64::INFINITY, f64::min);
            assert!(nearest < 0.71 * std::f64::consts::PI / ELLIPSOID_ROWS as f64, "{nearest} rad from {d}");
        }
        let mean = points.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / points.len() as f64;
        assert!(mean.norm() < 1e-9);
    }
}
