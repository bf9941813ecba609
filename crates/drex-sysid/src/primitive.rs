//! Convex pieces that are finely faceted cylinders, as cylinders: round where the thing itself is round, and as fast to
//! simulate however fine its mesh is.

use drex_core::Pose;
use drex_diffsim::{ConvexPolyhedron, Geom, Shape};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Corners that a polygon must have to be a circle. A prism of as many sides is within 1.2 % of its cylinder.
const CORNERS: usize = 20;
/// Deviation of a corner from the circle, relative to its radius.
const ROUND: f64 = 2e-3;

/// The pieces as shapes.
pub(crate) fn geoms(pieces: &[ConvexPolyhedron]) -> Vec<Geom> {
    pieces.iter().map(|p| cylinder(p).unwrap_or_else(|| Geom::new(Shape::Convex(p.clone().into())))).collect()
}

/// The cylinder whose rims hold all corners of a piece.
fn cylinder(piece: &ConvexPolyhedron) -> Option<Geom> {
    let planes = piece.planes();
    let many = |i: &usize| piece.face(*i).len() >= CORNERS;
    let top = (0..planes.len()).find(many)?;
    let axis = planes[top].0;
    let bottom = (0..planes.len()).filter(many).find(|&j| planes[j].0.dot(&axis) < -1.0 + 1e-6)?;
    let corners =
        |face: usize| piece.face(face).iter().filter_map(|&v| piece.vertices().get(v as usize)).map(|p| p.coords);
    if piece.face(top).len() + piece.face(bottom).len() != piece.vertices().len() {
        return None;
    }
    let (center, radius) = circle(corners(top), &axis)?;
    let on_circle = |v: Vector3<f64>| {
        let w = v - center;
        ((w - axis * w.dot(&axis)).norm() / radius - 1.0).abs() < ROUND
    };
    if !corners(top).chain(corners(bottom)).all(on_circle) {
        return None;
    }
    // No side much longer than the others: the polygon is a circle all around.
    let widest = 1.5 * std::f64::consts::TAU * radius / CORNERS as f64;
    for face in [top, bottom] {
        let loop_: Vec<Vector3<f64>> = corners(face).collect();
        if (0..loop_.len()).any(|k| (loop_[k] - loop_[(k + 1) % loop_.len()]).norm() > widest) {
            return None;
        }
    }
    let length = planes[top].1 + planes[bottom].1;
    let middle = center - axis * (center.dot(&axis) - planes[top].1 + 0.5 * length);
    let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &axis).unwrap_or_else(|| {
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
    });
    let shape = Shape::Cylinder { radius_m: radius, half_length_m: 0.5 * length };
    Some(Geom::new(shape).at(Pose::from_parts(Translation3::from(middle), rotation)))
}

/// Centre and radius of the circle nearest to points in a plane across `axis`: |p|² = 2 c·p + (r² - |c|²), least squares.
fn circle(points: impl Iterator<Item = Vector3<f64>> + Clone, axis: &Vector3<f64>) -> Option<(Vector3<f64>, f64)> {
    let n = points.clone().count() as f64;
    let mean = points.clone().sum::<Vector3<f64>>() / n;
    let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for p in points.clone() {
        let w = p - mean;
        a += w * w.transpose();
        b += w * (0.5 * w.norm_squared());
    }
    // Across the plane nothing is known; the centre stays in it.
    let offset = (a + axis * axis.transpose() * a.trace()).try_inverse()? * b;
    let center = mean + offset;
    let radius = points.map(|p| (p - center).norm()).sum::<f64>() / n;
    (radius > 0.0 && radius.is_finite()).then_some((center, radius))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn prism(sides: usize, pose: &Pose, squeeze: f64) -> ConvexPolyhedron {
        let points: Vec<Point3<f64>> = (0..2 * sides)
            .map(|k| {
                let a = std::f64::consts::TAU * (k / 2) as f64 / sides as f64;
                let z = if k % 2 == 0 { 0.05 } else { -0.05 };
                pose * Point3::new(0.03 * a.cos(), 0.03 * squeeze * a.sin(), z)
            })
            .collect();
        ConvexPolyhedron::from_points(&points).unwrap()
    }

    #[test]
    fn fine_prisms_are_cylinders_and_others_are_not() {
        for pose in [
            Pose::identity(),
            Pose::new(Vector3::new(0.1, -0.2, 0.3), Vector3::new(0.4, 1.1, -0.3)),
            Pose::new(Vector3::zeros(), Vector3::x() * std::f64::consts::PI),
        ] {
            let found = cylinder(&prism(38, &pose, 1.0)).unwrap();
            let Shape::Cylinder { radius_m, half_length_m } = found.shape else { panic!("{:?}", found.shape) };
            assert!((radius_m - 0.03).abs() < 1e-9 && (half_length_m - 0.05).abs() < 1e-9);
            let place = found.body_from_shape;
            assert!((place.translation.vector - pose.translation.vector).norm() < 1e-9);
            assert!((place * Vector3::z()).cross(&(pose * Vector3::z())).norm() < 1e-6);
            assert!(cylinder(&prism(12, &pose, 1.0)).is_none() && cylinder(&prism(38, &pose, 0.95)).is_none());
        }
    }
}
