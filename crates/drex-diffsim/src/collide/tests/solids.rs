use std::sync::Arc;

use drex_core::{SdfSample, SignedDistance, TriMesh};

use super::*;
use crate::collide::feature::Feature;
use crate::{SdfShape, SurfacePoints};

/// A ball of this radius.
struct BallSdf(f64);
impl SignedDistance for BallSdf {
    fn signed_distance(&self, point: &Point3<f64>) -> SdfSample {
        let r = point.coords.norm();
        SdfSample { distance_m: r - self.0, gradient: point.coords / r }
    }
}

/// A box of these half extents.
struct BoxSdf(V);
impl SignedDistance for BoxSdf {
    fn signed_distance(&self, point: &Point3<f64>) -> SdfSample {
        let q = point.coords.abs() - self.0;
        let out = q.sup(&V::zeros());
        let sign = point.coords.map(|x| 1.0_f64.copysign(x));
        if out.norm() > 0.0 {
            return SdfSample { distance_m: out.norm(), gradient: (out / out.norm()).component_mul(&sign) };
        }
        let k = q.imax();
        SdfSample { distance_m: q[k], gradient: V::ith(k, sign[k]) }
    }
}

pub(super) fn sdf_ball(radius: f64) -> Shape {
    let corner = Point3::from(V::repeat(radius));
    let sdf = SdfShape::new(Arc::new(BallSdf(radius)), ((-corner.coords).into(), corner), 2e-3).unwrap();
    Shape::Sdf(Arc::new(sdf))
}

fn sdf_box(half: V) -> Shape {
    let sdf = SdfShape::new(Arc::new(BoxSdf(half)), ((-half).into(), half.into()), 2e-3).unwrap();
    Shape::Sdf(Arc::new(sdf))
}

/// A ball of about 4 n² vertices; a place on the sphere is a vertex of the finer ones as well.
fn ball_mesh(radius: f64, n: u32) -> TriMesh {
    let corner = |k: u32| [V::x(), V::y(), V::z(), -V::x(), -V::y(), -V::z()][k as usize];
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    for octant in 0..8_u32 {
        let flip = (octant & 1) ^ (octant >> 1 & 1) ^ (octant >> 2 & 1);
        let [a, b, c] =
            [corner(3 * (octant & 1)), corner(1 + 3 * (octant >> 1 & 1)), corner(2 + 3 * (octant >> 2 & 1))];
        let at = |i: u32, j: u32| {
            let (i, j, n) = (f64::from(i), f64::from(j), f64::from(n));
            Point3::from((a * (n - i - j) + b * i + c * j).normalize() * radius)
        };
        for i in 0..n {
            for j in 0..n - i {
                let mut add = |t: [Point3<f64>; 3]| {
                    let k = vertices.len() as u32;
                    faces.push(if flip == 0 { [k, k + 1, k + 2] } else { [k, k + 2, k + 1] });
                    vertices.extend(t);
                };
                add([at(i, j), at(i + 1, j), at(i, j + 1)]);
                if i + j + 1 < n {
                    add([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
                }
            }
        }
    }
    TriMesh::new(vertices, faces).unwrap()
}

pub(super) fn ball_points(radius: f64, n: u32) -> Shape {
    Shape::Points(Arc::new(SurfacePoints::from_mesh(&ball_mesh(radius, n)).unwrap()))
}

#[test]
fn a_ball_of_points_weighs_what_its_surface_does() {
    let Shape::Points(p) = ball_points(0.05, 40) else { unreachable!() };
    let sphere = 4.0 * std::f64::consts::PI * 0.05 * 0.05;
    assert!((p.areas_m2().iter().sum::<f64>() / sphere - 1.0).abs() < 2e-3);
}

#[test]
fn round_shapes_touch_a_solid_as_they_touch_the_ball_that_it_is() {
    let (solid, ball) = (sdf_ball(0.03), Shape::Sphere { radius_m: 0.03 });
    let pose = turned(V::new(0.1, 0.2, 0.3), V::new(0.4, 0.5, 0.6));
    for (shape, relative) in [
        (Shape::Sphere { radius_m: 0.01 }, turned(V::new(0.0, 0.024, 0.0318), V::zeros())),
        (Shape::Capsule { radius_m: 0.01, half_length_m: 0.05 }, turned(V::new(0.0395, 0.001, 0.013), V::y() * 0.1)),
        (Shape::Capsule { radius_m: 0.01, half_length_m: 0.05 }, turned(V::new(0.0, 0.0, 0.0895), V::y() * 0.01)),
    ] {
        let other = pose * relative;
        let expected = deepest_place(&places(&shape, &other, &ball, &pose, 0.0)).unwrap();
        let found = deepest_place(&places(&shape, &other, &solid, &pose, 0.0)).unwrap();
        assert!((found.depth - expected.depth).abs() < 1e-9, "{found:?} {expected:?}");
        assert!((found.normal - expected.normal).norm() < 1e-5 && (found.point - expected.point).norm() < 1e-6);
    }
}

#[test]
fn faces_edges_and_corners_touch_a_solid() {
    let ball = sdf_ball(0.03);
    let block = cuboid(0.05, 0.06, 0.04);
    let tilt = turned(V::new(0.3, 0.1, 0.2), V::new(0.2, -0.4, 0.9));
    let corner = V::new(0.05, 0.06, 0.04);
    let outwards = corner.normalize();
    for (center, normal, tolerance) in [
        (V::new(0.011, 0.013, 0.0698), V::z(), 5e-5),
        (V::new(0.011, 0.06, 0.04) + V::new(0.0, 0.6, 0.8) * 0.0298, V::new(0.0, 0.6, 0.8), 5e-5),
        (corner + outwards * 0.0298, outwards, 1e-12),
    ] {
        let p = places(&ball, &(tilt * at(center.x, center.y, center.z)), &block, &tilt, 0.0);
        let best = deepest_place(&p).unwrap();
        // A lattice point is within 1.5 mm of the deepest: less deep by 1.5² / (2 30) mm at most.
        assert!(best.depth < 2e-4 + 1e-12 && best.depth > 2e-4 - tolerance, "{best:?}");
        assert!((best.normal - tilt * normal).norm() < 0.06, "{best:?}");
    }
    let p = places(&ball, &at(0.2, 0.1, 0.0298), &Shape::Plane, &Pose::identity(), 0.0);
    let best = deepest_place(&p).unwrap();
    assert!(best.depth > 1.5e-4 && best.depth < 2e-4 + 1e-12 && best.normal.z > 0.99);
    assert!(places(&ball, &at(0.2, 0.1, 0.0301), &Shape::Plane, &Pose::identity(), 0.0).is_empty());
    // A solid flat on a large table: a patch as large as its foot.
    let solid = sdf_box(V::new(0.02, 0.03, 0.01));
    let p = places(&solid, &at(0.2003, 0.1004, 0.06 - 1e-5), &cuboid(0.4, 0.4, 0.05), &Pose::identity(), 0.0);
    assert!((p.len() as f64 / (0.04 * 0.06 / 4e-6) - 1.0).abs() < 0.1, "{}", p.len());
    assert!(p.iter().all(|p| (p.depth - 1e-5).abs() < 1e-12 && (p.normal - V::z()).norm() < 1e-9));
}

#[test]
fn points_touch_every_solid_shape_from_outside() {
    let n = 24;
    let points = ball_points(0.05, n);
    let down = V::new(0.0, 0.0, -0.05);
    let depth = 1e-4;
    let below = |z: f64| at(0.0, 0.0, -0.05 - z + depth);
    let shapes = [
        (Shape::Plane, at(0.0, 0.0, -0.05 + depth)),
        (Shape::Sphere { radius_m: 0.02 }, below(0.02)),
        (Shape::Capsule { radius_m: 0.02, half_length_m: 0.03 }, below(0.05)),
        (Shape::Cylinder { radius_m: 0.02, half_length_m: 0.03 }, below(0.03)),
        (cuboid(0.02, 0.03, 0.04), below(0.04)),
        (Shape::Convex(Arc::new(ConvexPolyhedron::cuboid(&V::new(0.02, 0.03, 0.04)))), below(0.04)),
        (sdf_ball(0.02), below(0.02)),
        (sdf_box(V::new(0.02, 0.03, 0.04)), below(0.04)),
    ];
    let common = turned(V::new(0.3, -0.2, 0.1), V::new(0.5, 0.4, -0.3));
    for (shape, pose) in shapes {
        let found = touches(&points, &common, &shape, &(common * pose), 0.0);
        let places: Vec<_> = found.iter().map(|t| t.at_poses(&common, &(common * pose))).collect();
        let best = deepest_place(&places).unwrap();
        assert!((best.depth - depth).abs() < 1e-9, "{shape:?} {best:?}");
        assert!((best.normal - common * V::z()).norm() < 1e-6);
        assert!((best.point - (common * Point3::from(down)).coords).norm() < depth);
        let Shape::Points(p) = &points else { unreachable!() };
        assert!(found.iter().all(|t| t.weight == p.areas_m2()[t.site as usize]));
        // The vertices of a mesh that are inside, and no others.
        let signed = |x: &Point3<f64>| match &shape {
            Shape::Plane => x.z,
            Shape::Sphere { radius_m } => x.coords.norm() - radius_m,
            Shape::Capsule { radius_m, half_length_m } => {
                (x.coords - V::z() * x.z.clamp(-half_length_m, *half_length_m)).norm() - radius_m
            }
            Shape::Cylinder { radius_m, half_length_m } => {
                (x.xy().coords.norm() - radius_m).max(x.z.abs() - half_length_m)
            }
            Shape::Sdf(s) => s.sample(x).distance_m,
            _ => (x.coords.abs() - V::new(0.02, 0.03, 0.04)).max(),
        };
        let inside = p.points().filter(|x| signed(&(pose.inverse() * x)) < 0.0).count();
        assert_eq!(found.len(), inside, "{shape:?}");
    }
}

#[test]
fn a_fine_mesh_costs_what_touches_it() {
    let table = cuboid(0.3, 0.3, 0.05);
    let tilt = turned(V::zeros(), V::new(0.7, 0.5, 0.2));
    for (shape, pose) in [
        (table, tilt * at(0.0, 0.0, -0.1)),
        (Shape::Plane, tilt * at(0.0, 0.0, -0.05)),
        (sdf_ball(0.03), tilt * at(0.0, 0.0, -0.08)),
    ] {
        let visits = |n: u32| {
            let Shape::Points(points) = ball_points(0.05, n) else { unreachable!() };
            let g = geom(&shape);
            let mut boxes = 0;
            let mut seen = 0;
            // A descent like that of the search, counted.
            let near = |center: &V, reach: f64| match &g.kind {
                Kind::Sdf { sdf, .. } => sdf.sample(&(pose.inverse() * Point3::from(*center))).distance_m < reach,
                kind => crate::collide::ball::nearest(kind, &(pose.inverse() * Point3::from(*center)).coords, reach)
                    .is_some_and(|f| f.0 < reach),
            };
            points.tree().visit(
                |node| {
                    boxes += 1;
                    near(&node.center, node.half.norm() + 1e-5)
                },
                |_, _| seen += 1,
            );
            (
                points.points().len(),
                boxes,
                seen,
                touches(&Shape::Points(points.clone()), &Pose::identity(), &shape, &pose, 1e-5).len(),
            )
        };
        let (few, many) = (visits(16), visits(132));
        assert!(few.0 < 1100 && many.0 > 68_000);
        assert!(many.1 < 700 && many.2 < 700 && many.3 < 100, "{few:?} {many:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(30))]

    #[test]
    fn duals_agree_with_finite_differences_at_solids_and_points(
        other in any_solid(), u in any_direction(), turn in any_pose(0.0), first in any::<bool>(),
    ) {
        let (solid, points) = (sdf_ball(0.03), ball_points(0.03, 40));
        let pose = turned(V::new(0.1, 0.2, 0.3), V::new(0.4, 0.5, 0.6));
        let pb = brought_together(&Shape::Sphere { radius_m: 0.03 }, &pose, &other, &turn, &u, 2e-4);
        for shape in [&solid, &points] {
            let found = if first { touches(shape, &pose, &other, &pb, 2e-4) } else { touches(&other, &pb, shape, &pose, 2e-4) };
            // An edge may pass between the points of a surface.
            prop_assert!(!found.is_empty() || matches!(shape, Shape::Points(_)));
            for touch in found.iter().take(3) {
                let (pa, pb) = if first { (&pose, &pb) } else { (&pb, &pose) };
                super::derivatives::check(touch, pa, pb, if matches!(touch.feature, Feature::BallSdf { .. }) { 1e-3 } else { 2e-5 })?;
            }
        }
    }
}

#[test]
fn what_cannot_touch_is_named() {
    let (sdf, points) = (sdf_ball(0.02), ball_points(0.02, 4));
    let all = [
        Shape::Plane,
        Shape::Sphere { radius_m: 0.01 },
        Shape::Capsule { radius_m: 0.01, half_length_m: 0.02 },
        Shape::Cylinder { radius_m: 0.01, half_length_m: 0.02 },
        cuboid(0.02, 0.02, 0.02),
        lump(20),
        sdf.clone(),
        points.clone(),
    ];
    for (i, a) in all.iter().enumerate() {
        for (j, b) in all.iter().enumerate() {
            assert_eq!(supported(a, b), !(i == j && matches!(i, 0 | 6 | 7)), "{a:?} {b:?}");
            if supported(a, b) {
                // A little inside each other, something is found.
                let z = if i == 0 || j == 0 { 0.009 } else { 0.015 };
                let (pa, pb) =
                    if i == 0 { (at(0.0, 0.0, 0.0), at(0.0, 0.0, z)) } else { (at(0.0, 0.0, z), at(0.0, 0.0, 0.0)) };
                let found = deepest(&geom(a), &pa, &geom(b), &pb, &mut CollideWork::default());
                assert!(found.is_some_and(|d| d > 0.0 && d < 0.06), "{a:?} {b:?}: {found:?}");
            }
        }
    }
}
