//! Convex hulls that are boxes, cylinders, balls or capsules, as such: round where the thing itself is round.
//!
//! Candidates come from the directions that a hull has of itself, of its largest faces and of its inertia. One check decides about all:
//! every corner lies on the primitive, and no face of the hull cuts off more of it than facets do.

use std::collections::BTreeMap;

use drex_core::{Pose, Primitive, PrimitiveShape, TriMesh};
use nalgebra::{Matrix3, Matrix6, Point3, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};

use crate::mass::principal;

/// What facets may cut off a cylinder, relative to its radius: a prism of twenty sides does.
const CYLINDER_FACETS: f64 = 0.0125;
/// What facets may cut off a ball or the ends of a capsule, relative to the radius,
const BALL_FACETS: f64 = 0.08;
/// and corners that these have at least: a polyhedron of few corners is meant as one.
const BALL_CORNERS: usize = 40;
/// Faces whose normals agree to this are one face.
const SAME_NORMAL: f64 = 0.01;
/// Largest faces whose normals are tried.
const NORMALS: usize = 3;
/// Triangles below this share of the area have no normal worth asking.
const SLIVER: f64 = 1e-7;

/// The primitive that a closed convex hull is, if it is one.
///
/// Every corner of the hull lies within `tolerance` times the radius (of a box: its smallest half side) of the primitive's surface. Facets
/// may cut off 1.25 % of the radius of a cylinder (20 sides), 8 % of that of a ball or a capsule of at least 40 corners, and of a box nothing
/// beyond the tolerance. A tolerance of 0 recognises none.
pub fn primitive(hull: &TriMesh, tolerance: f64) -> Option<Primitive> {
    let properties = hull.mass_properties(1.0).ok().filter(|_| tolerance > 0.0)?;
    let center = properties.center_of_mass;
    let faces = Faces::of(hull);
    let normals = faces.largest();
    let inertia = principal(&properties).1.to_rotation_matrix().into_inner();
    let along = |axis: &Vector3<f64>| Frame::along(axis, &center);
    let boxes = normals.iter().flat_map(|a| normals.iter().filter_map(|b| Frame::of(a, b, &center)));
    let axes: Vec<Vector3<f64>> = normals.iter().copied().chain(inertia.column_iter().map(Into::into)).collect();
    let round = axes.iter().map(along);
    let candidates = boxes
        .filter_map(|f| f.cuboid(hull))
        .chain(round.clone().filter_map(|f| f.cylinder(hull)))
        .chain(ball(hull))
        .chain(round.filter_map(|f| f.capsule(hull)));
    candidates.into_iter().find(|p| faces.are_of(p, hull, tolerance))
}

/// Planes of a hull's triangles that are no slivers.
struct Faces {
    /// Outward normal, a point, area.
    planes: Vec<(Vector3<f64>, Point3<f64>, f64)>,
}

impl Faces {
    fn of(hull: &TriMesh) -> Self {
        let plane = |f: usize| {
            let [a, b, c] = hull.triangle(f);
            let normal = (b - a).cross(&(c - a));
            (normal, a, 0.5 * normal.norm())
        };
        let all: Vec<_> = (0..hull.faces.len()).map(plane).collect();
        let least = SLIVER * all.iter().map(|p| p.2).sum::<f64>();
        let planes = all.into_iter().filter(|p| p.2 > least).map(|(n, a, area)| (n.normalize(), a, area)).collect();
        Self { planes }
    }

    /// Normals of the largest faces, opposite ones as one.
    fn largest(&self) -> Vec<Vector3<f64>> {
        let mut bins: BTreeMap<[i64; 3], Vector3<f64>> = BTreeMap::new();
        for (n, _, area) in &self.planes {
            let n = n * n[n.iamax()].signum();
            let key = [0, 1, 2].map(|i| (n[i] / SAME_NORMAL).round() as i64);
            *bins.entry(key).or_default() += n * *area;
        }
        let mut sums: Vec<Vector3<f64>> = bins.into_values().collect();
        sums.sort_by(|a, b| b.norm_squared().total_cmp(&a.norm_squared()));
        sums.truncate(NORMALS);
        sums.iter().map(Vector3::normalize).collect()
    }

    /// Whether a primitive is the hull, within the tolerance and what facets cut off.
    fn are_of(&self, p: &Primitive, hull: &TriMesh, tolerance: f64) -> bool {
        let (size, cut) = match p.shape {
            PrimitiveShape::Box { half_m } => (half_m.into_iter().fold(f64::INFINITY, f64::min), 0.0),
            PrimitiveShape::Cylinder { radius_m, half_length_m } => {
                (radius_m.min(half_length_m), CYLINDER_FACETS * radius_m)
            }
            PrimitiveShape::Sphere { radius_m } | PrimitiveShape::Capsule { radius_m, .. } => {
                (radius_m, BALL_FACETS * radius_m)
            }
        };
        let back = p.object_from_shape.inverse();
        let on_surface = |v: &Point3<f64>| p.shape.signed_distance(&(back * v)).distance_m.abs() <= tolerance * size;
        let supports = |(n, a, _): &(Vector3<f64>, Point3<f64>, f64)| {
            let n = back * n;
            p.shape.support(&n) - n.dot(&(back * a).coords) <= cut + tolerance * size
        };
        size > 0.0 && hull.vertices.iter().all(on_surface) && self.planes.iter().all(supports)
    }
}

/// A frame that a primitive may have.
struct Frame {
    /// Axes in columns.
    axes: Matrix3<f64>,
    center: Point3<f64>,
}

impl Frame {
    fn along(axis: &Vector3<f64>, center: &Point3<f64>) -> Self {
        let mut other = Vector3::zeros();
        other[axis.iamin()] = 1.0;
        let x = other.cross(axis).normalize();
        Self { axes: Matrix3::from_columns(&[x, axis.cross(&x), *axis]), center: *center }
    }

    /// Of two normals of a box, if they are about square to each other.
    fn of(a: &Vector3<f64>, b: &Vector3<f64>, center: &Point3<f64>) -> Option<Self> {
        let y = b - a * a.dot(b);
        (y.norm() > 0.9).then(|| Self {
            axes: Matrix3::from_columns(&[*a, y.normalize(), a.cross(&y).normalize()]),
            center: *center,
        })
    }

    /// Lowest and highest coordinate of the corners along each axis, from the centre.
    fn extent(&self, hull: &TriMesh) -> (Vector3<f64>, Vector3<f64>) {
        let own = hull.vertices.iter().map(|v| self.axes.transpose() * (v - self.center));
        own.fold((Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)), |(lo, hi), v| {
            (lo.inf(&v), hi.sup(&v))
        })
    }

    /// A shape at `at` in this frame.
    fn placed(&self, shape: PrimitiveShape, at: Vector3<f64>) -> Primitive {
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(self.axes));
        let translation = Translation3::from(self.center + self.axes * at);
        Primitive { shape, object_from_shape: Pose::from_parts(translation, rotation) }
    }

    fn cuboid(&self, hull: &TriMesh) -> Option<Primitive> {
        let (lo, hi) = self.extent(hull);
        Some(self.placed(PrimitiveShape::Box { half_m: ((hi - lo) * 0.5).into() }, (hi + lo) * 0.5))
    }

    fn cylinder(&self, hull: &TriMesh) -> Option<Primitive> {
        let (lo, hi) = self.extent(hull);
        let own = hull.vertices.iter().map(|v| self.axes.transpose() * (v - self.center));
        let (center, radius_m) = round(own.map(|v| Vector3::new(v.x, v.y, 0.0)), &Vector3::z())?;
        let at = Vector3::new(center.x, center.y, 0.5 * (lo.z + hi.z));
        Some(self.placed(PrimitiveShape::Cylinder { radius_m, half_length_m: 0.5 * (hi.z - lo.z) }, at))
    }

    /// Of the corners on its ends, least squares: |p - c -+ h z|² = r² is linear in c, h, h c_z and r² - |c|² - h².
    fn capsule(&self, hull: &TriMesh) -> Option<Primitive> {
        let (lo, hi) = self.extent(hull);
        let unit = 0.25 * (hi.x - lo.x + hi.y - lo.y);
        let middle = (hi + lo) * 0.5;
        let ends = 0.5 * (hi.z - lo.z) - unit;
        if hull.vertices.len() < BALL_CORNERS || ends <= 0.0 || unit <= 0.0 {
            return None;
        }
        let (mut a, mut b) = (Matrix6::zeros(), Vector6::zeros());
        for v in &hull.vertices {
            let p = self.axes.transpose() * (v - self.center) - middle;
            if p.z.abs() >= ends {
                let (p, s) = (p / unit, p.z.signum());
                let row = Vector6::new(p.x, p.y, p.z, s * p.z, s, 1.0);
                a += row * row.transpose();
                b += row * p.norm_squared();
            }
        }
        let x = a.lu().solve(&b)?;
        let (center, half_length) = (Vector3::new(x[0], x[1], x[2]) * 0.5, 0.5 * x[3]);
        let radius_m = unit * (x[5] + center.norm_squared() + half_length * half_length).sqrt();
        let half_length_m = unit * half_length;
        let round = radius_m.is_finite() && half_length_m > 0.0;
        round.then(|| self.placed(PrimitiveShape::Capsule { radius_m, half_length_m }, middle + center * unit))
    }
}

fn ball(hull: &TriMesh) -> Option<Primitive> {
    let (center, radius_m) = round(hull.vertices.iter().map(|v| v.coords), &Vector3::zeros())?;
    let shape = PrimitiveShape::Sphere { radius_m };
    let enough = hull.vertices.len() >= BALL_CORNERS;
    enough.then(|| Primitive { shape, object_from_shape: Pose::from_parts(center.into(), UnitQuaternion::identity()) })
}

/// Centre and radius of the sphere nearest to points, or of the circle if all lie in a plane across `axis`: |p|² = 2 c·p + (r² - |c|²),
/// least squares.
fn round(points: impl Iterator<Item = Vector3<f64>> + Clone, axis: &Vector3<f64>) -> Option<(Vector3<f64>, f64)> {
    let n = points.clone().count() as f64;
    let mean = points.clone().sum::<Vector3<f64>>() / n;
    let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for p in points.clone() {
        let w = p - mean;
        a += w * w.transpose();
        b += w * (0.5 * w.norm_squared());
    }
    // Across the plane nothing is known; the centre stays in it.
    let center = mean + (a + axis * axis.transpose() * a.trace()).try_inverse()? * b;
    let radius = points.map(|p| (p - center).norm()).sum::<f64>() / n;
    (radius > 0.0 && radius.is_finite()).then_some((center, radius))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, sphere};
    use drex_core::mesh::convex_hull;
    use std::f64::consts::TAU;

    const TOLERANCE: f64 = 2e-3;

    fn poses() -> [Pose; 3] {
        [
            Pose::identity(),
            Pose::new(Vector3::new(0.1, -0.2, 0.3), Vector3::new(0.4, 1.1, -0.3)),
            Pose::new(Vector3::zeros(), Vector3::x() * std::f64::consts::PI),
        ]
    }

    fn hull(points: impl Iterator<Item = Point3<f64>>, pose: &Pose) -> TriMesh {
        convex_hull(&points.map(|p| pose * p).collect::<Vec<_>>()).unwrap()
    }

    fn prism(sides: usize, radius: f64, half: f64, squeeze: f64) -> impl Iterator<Item = Point3<f64>> {
        (0..2 * sides).map(move |k| {
            let a = TAU * (k / 2) as f64 / sides as f64;
            Point3::new(radius * a.cos(), radius * squeeze * a.sin(), if k % 2 == 0 { half } else { -half })
        })
    }

    /// The primitive that is found is this one: as far in any direction.
    fn assert_is(found: Option<Primitive>, shape: PrimitiveShape, pose: &Pose) {
        let found = found.unwrap_or_else(|| panic!("{shape:?} is not recognised"));
        assert_eq!(std::mem::discriminant(&found.shape), std::mem::discriminant(&shape), "{found:?}");
        // Point 0 is the middle of the cube, which has no direction.
        for k in 1..200 {
            let d = Vector3::from(crate::sequence::unit_cube_point(k)).map(|x| x - 0.5).normalize();
            let reach =
                |s: &PrimitiveShape, pose: &Pose| s.support(&(pose.inverse() * d)) + pose.translation.vector.dot(&d);
            let (a, b) = (reach(&found.shape, &found.object_from_shape), reach(&shape, pose));
            assert!((a - b).abs() < 1e-6, "{shape:?} as {found:?}: {a} {b}");
        }
    }

    #[test]
    fn hulls_of_primitives_are_recognised_wherever_they_are() {
        for pose in poses() {
            let half = [0.02, 0.03, 0.05];
            let corners = cuboid(half.map(|x| -x), half).vertices;
            assert_is(
                primitive(&hull(corners.into_iter(), &pose), TOLERANCE),
                PrimitiveShape::Box { half_m: half },
                &pose,
            );
            // Long, flat, and of equal moments about all axes.
            for half_length_m in [0.05, 0.004, 0.03 * 0.75_f64.sqrt()] {
                let shape = PrimitiveShape::Cylinder { radius_m: 0.03, half_length_m };
                for sides in [20, 38, 200] {
                    assert_is(primitive(&hull(prism(sides, 0.03, half_length_m, 1.0), &pose), TOLERANCE), shape, &pose);
                }
            }
            let ball = sphere(0.04, 3).vertices;
            assert_is(
                primitive(&hull(ball.iter().copied(), &pose), TOLERANCE),
                PrimitiveShape::Sphere { radius_m: 0.04 },
                &pose,
            );
            let capsule = ball.iter().flat_map(|p| [0.02, -0.02].map(|z| p + Vector3::z() * z));
            let shape = PrimitiveShape::Capsule { radius_m: 0.04, half_length_m: 0.02 };
            assert_is(primitive(&hull(capsule, &pose), TOLERANCE), shape, &pose);
        }
    }

    #[test]
    fn a_jitter_of_the_corners_changes_neither_the_kind_nor_the_size() {
        let jitter =
            |p: Point3<f64>, k: usize| p + Vector3::from(crate::sequence::unit_cube_point(k)).map(|x| 2e-6 * (x - 0.5));
        for pose in poses() {
            let half = [0.02, 0.03, 0.05];
            let corners = cuboid(half.map(|x| -x), half).vertices.into_iter().enumerate().map(|(k, p)| jitter(p, k));
            let found = primitive(&hull(corners, &pose), TOLERANCE).unwrap();
            assert!(matches!(found.shape, PrimitiveShape::Box { .. }), "{found:?}");
            let rims = prism(38, 0.03, 0.05, 1.0).enumerate().map(|(k, p)| jitter(p, k));
            let found = primitive(&hull(rims, &pose), TOLERANCE).unwrap();
            let PrimitiveShape::Cylinder { radius_m, half_length_m } = found.shape else { panic!("{found:?}") };
            assert!((radius_m - 0.03).abs() < 1e-6 && (half_length_m - 0.05).abs() < 2e-6, "{found:?}");
        }
    }

    #[test]
    fn what_is_no_primitive_stays_a_hull() {
        let at = Pose::identity();
        for (what, points) in [
            ("a prism of 12 sides", prism(12, 0.03, 0.05, 1.0).collect::<Vec<_>>()),
            ("an oval prism", prism(38, 0.03, 0.05, 0.95).collect()),
            (
                "a cone's frustum",
                prism(38, 0.03, 0.05, 1.0)
                    .map(|p| if p.z > 0.0 { Point3::new(0.9 * p.x, 0.9 * p.y, p.z) } else { p })
                    .collect(),
            ),
            ("half a cylinder", prism(38, 0.03, 0.05, 1.0).filter(|p| p.x > -1e-9).collect()),
            (
                "a chamfered box",
                cuboid([-0.02; 3], [0.02; 3])
                    .vertices
                    .into_iter()
                    .flat_map(|p| {
                        [0, 1, 2].map(|i| {
                            let mut q = p;
                            q[i] *= 0.9;
                            q
                        })
                    })
                    .collect(),
            ),
            ("an octahedron", sphere(0.04, 0).vertices),
            ("half a ball", sphere(0.04, 3).vertices.into_iter().filter(|p| p.z > -1e-9).collect()),
        ] {
            let found = primitive(&hull(points.into_iter(), &at), TOLERANCE);
            assert!(found.is_none(), "{what}: {found:?}");
        }
    }
}
