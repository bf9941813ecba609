//! One block as a box, as a convex polyhedron, as points on its surface and as a signed distance: the same motion.

use std::sync::Arc;

use drex_core::{MassProperties, Pose, SdfSample, SignedDistance, TriMesh};
use drex_diffsim::{
    Body, Collider, ConvexPolyhedron, Geom, Model, Scene, SdfShape, Shape, State, SurfacePoints, rollout,
};
use nalgebra::{Matrix3, Point3, Vector3};

const HALF: Vector3<f64> = Vector3::new(0.04, 0.03, 0.02);
const G: f64 = 9.81;

/// The surface of the block with n × n squares per face.
fn mesh(n: u32) -> TriMesh {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let first = vertices.len() as u32;
            for i in 0..=n {
                for j in 0..=n {
                    let mut p = Vector3::zeros();
                    p[axis] = side * HALF[axis];
                    p[(axis + 1) % 3] = HALF[(axis + 1) % 3] * (2.0 * f64::from(i) / f64::from(n) - 1.0);
                    p[(axis + 2) % 3] = HALF[(axis + 2) % 3] * (2.0 * f64::from(j) / f64::from(n) - 1.0);
                    vertices.push(Point3::from(p));
                }
            }
            for i in 0..n {
                for j in 0..n {
                    let at = |i: u32, j: u32| first + i * (n + 1) + j;
                    let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
                    triangles.extend(if side > 0.0 { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] });
                }
            }
        }
    }
    TriMesh { vertices, faces: triangles }
}

/// The block as a signed distance.
struct Solid;

impl SignedDistance for Solid {
    fn signed_distance(&self, p: &Point3<f64>) -> SdfSample {
        let q = p.coords.abs() - HALF;
        let sign = p.coords.map(|x| if x < 0.0 { -1.0 } else { 1.0 });
        let outside = q.map(|x| x.max(0.0));
        if outside.norm() > 0.0 {
            let gradient = outside.component_mul(&sign) / outside.norm();
            return SdfSample { distance_m: outside.norm(), gradient };
        }
        let axis = q.imax();
        SdfSample { distance_m: q[axis], gradient: Vector3::ith(axis, sign[axis]) }
    }
}

fn model(shape: Shape) -> Model<f64> {
    let s = HALF.component_mul(&HALF) / 3.0;
    let inertia = Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y));
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    let mut model = Model::new(vec![Body::new(&unit, 0.3, Arc::new(Collider::new(&[Geom::new(shape)]).unwrap()))]);
    model.contact.frequency_rad_s = 300.0;
    model
}

fn shapes() -> Vec<(&'static str, Shape)> {
    let fine = mesh(20);
    let bounds = (Point3::from(-HALF), Point3::from(HALF));
    vec![
        ("box", Shape::Box { half_m: HALF }),
        ("convex polyhedron", Shape::Convex(Arc::new(ConvexPolyhedron::from_points(&fine.vertices).unwrap()))),
        ("600 points", Shape::Points(Arc::new(SurfacePoints::from_mesh(&mesh(9)).unwrap()))),
        ("2600 points", Shape::Points(Arc::new(SurfacePoints::from_mesh(&fine).unwrap()))),
        ("22000 points", Shape::Points(Arc::new(SurfacePoints::from_mesh(&mesh(60)).unwrap()))),
        ("signed distance", Shape::Sdf(Arc::new(SdfShape::new(Arc::new(Solid), bounds, 0.02).unwrap()))),
    ]
}

#[test]
fn every_shape_rests_as_deep() {
    for (name, shape) in shapes() {
        let start = State::at_rest(Pose::translation(0.0, 0.0, HALF.z + 1e-3));
        let end = rollout(&model(shape), &Scene::on_table(0.4), &start, &[1.0]).unwrap();
        let depth = HALF.z - end.bodies[0].poses[0].translation.z;
        assert!((depth / (G / 300.0_f64.powi(2)) - 1.0).abs() < 0.01, "{name}: {depth}");
        assert!(end.last.bodies[0].velocity.norm() < 1e-6, "{name}");
    }
}

/// A face carries at its corners where it is one of a polyhedron, and evenly where it is made of points: that is another
/// moment of friction. How fine the points are changes it as a sum over a face differs from the integral.
#[test]
fn the_fineness_of_a_mesh_hardly_changes_a_slide() {
    let slide = |shape: Shape| {
        let mut start = State::at_rest(Pose::translation(0.0, 0.0, HALF.z - G / 300.0_f64.powi(2)));
        start.bodies[0].velocity = Vector3::new(0.6, 0.2, 0.0);
        start.bodies[0].angular_velocity.z = 4.0;
        let end = rollout(&model(shape), &Scene::on_table(0.4), &start, &[0.4]).unwrap();
        (end.bodies[0].poses[0].translation.vector, end.bodies[0].poses[0].rotation.angle())
    };
    let ends: Vec<_> = shapes().into_iter().take(5).map(|(name, shape)| (name, slide(shape))).collect();
    for (coarse, fine, allowed) in [(0, 1, 1e-6), (2, 4, 0.05), (3, 4, 0.02)] {
        let ((name, (way, turn)), (_, (w, t))) = (ends[coarse], ends[fine]);
        assert!((way - w).norm() < allowed * w.norm(), "{name}: {way:?} {w:?}");
        assert!((turn - t).abs() < allowed * t, "{name}: {turn} {t}");
    }
}
