use super::*;
use crate::collide::ball::nearest;

#[test]
fn spheres_and_planes() {
    let ball = Shape::Sphere { radius_m: 0.02 };
    let p = places(&ball, &at(0.1, 0.0, 0.019), &Shape::Plane, &Pose::identity(), 0.0);
    assert_eq!(p.len(), 1);
    assert!((p[0].depth - 1e-3).abs() < 1e-15 && p[0].normal == V::z());
    assert!((p[0].point - V::new(0.1, 0.0, -0.0005)).norm() < 1e-15, "half way");
    let other = Shape::Sphere { radius_m: 0.01 };
    let p = places(&ball, &at(0.0, 0.0, 0.0), &other, &at(0.0, 0.0295, 0.0), 0.0);
    assert!((p[0].depth - 5e-4).abs() < 1e-15 && (p[0].normal + V::y()).norm() < 1e-15);
    assert!((p[0].point - V::new(0.0, 0.01975, 0.0)).norm() < 1e-15);
    // Concentric: a depth, and a normal that is a number.
    let p = places(&ball, &Pose::identity(), &other, &Pose::identity(), 0.0);
    assert!((p[0].depth - 0.03).abs() < 1e-15 && (p[0].normal.norm() - 1.0).abs() < 1e-15);
}

#[test]
fn a_sphere_meets_face_edge_and_corner_of_a_box() {
    let (ball, block) = (Shape::Sphere { radius_m: 0.02 }, cuboid(0.05, 0.05, 0.05));
    let check = |c: V, depth: f64, normal: V| {
        let p = places(&ball, &at(c.x, c.y, c.z), &block, &Pose::identity(), 1e-2);
        assert_eq!(p.len(), 1);
        assert!((p[0].depth - depth).abs() < 1e-14 && (p[0].normal - normal).norm() < 1e-12, "{c}: {:?}", p[0]);
    };
    check(V::new(0.01, 0.02, 0.069), 1e-3, V::z());
    check(V::new(0.01, -0.071, 0.02), -1e-3, -V::y());
    check(V::new(0.06, 0.02, 0.06), 0.02 - 0.01 * 2.0_f64.sqrt(), V::new(1.0, 0.0, 1.0).normalize());
    check(V::new(0.06, -0.06, 0.06), 0.02 - 0.01 * 3.0_f64.sqrt(), V::new(1.0, -1.0, 1.0).normalize());
    // The centre inside: out through the nearest face.
    check(V::new(0.01, 0.02, 0.045), 0.025, V::z());
}

#[test]
fn a_capsule_lies_on_two_points_and_stands_on_one() {
    let capsule = Shape::Capsule { radius_m: 0.01, half_length_m: 0.04 };
    let lying = turned(V::new(0.0, 0.0, 0.01 - 1e-5), V::y() * std::f64::consts::FRAC_PI_2);
    let block = cuboid(0.2, 0.2, 0.05);
    let top = at(0.0, 0.0, -0.05);
    for (shape, pose) in [(Shape::Plane, Pose::identity()), (block, top)] {
        let p = places(&capsule, &lying, &shape, &pose, 0.0);
        assert_eq!(p.len(), 2);
        assert!(p.iter().all(|p| (p.depth - 1e-5).abs() < 1e-12 && (p.point.x.abs() - 0.04).abs() < 1e-12));
        let p = places(&capsule, &at(0.0, 0.0, 0.05 - 1e-5), &shape, &pose, 0.0);
        assert_eq!(p.len(), 1);
    }
    // Across a bar narrower than itself: where it crosses the two edges.
    let p = places(&capsule, &lying, &cuboid(0.02, 0.2, 0.05), &top, 0.0);
    assert_eq!(p.len(), 2);
    assert!(p.iter().all(|p| (p.depth - 1e-5).abs() < 1e-12 && (p.point.x.abs() - 0.02).abs() < 1e-12), "{p:?}");
    assert!(p.iter().all(|p| (p.normal - V::z()).norm() < 1e-9));
    // Driven through a box, both ends outside: out through the nearest face.
    let block = cuboid(0.02, 0.2, 0.05);
    let p = places(&capsule, &lying, &block, &at(0.0, 0.0, 0.045), 0.0);
    assert!(!p.is_empty() && p.iter().all(|p| (p.depth - 0.025).abs() < 1e-4 && p.normal.z < -0.99), "{p:?}");
    let p =
        places(&capsule, &turned(V::zeros(), V::new(0.3, 1.2, 0.4)), &cuboid(0.02, 0.02, 0.02), &Pose::identity(), 0.0);
    assert!(!p.is_empty() && p.iter().all(|p| p.depth > 0.02), "{p:?}");
    // Over one edge with one end on the face.
    let p = places(&capsule, &lying, &cuboid(0.05, 0.2, 0.05), &at(-0.04, 0.0, -0.05), 0.0);
    let mut x: Vec<f64> = p.iter().map(|p| p.point.x).collect();
    x.sort_by(f64::total_cmp);
    assert!(x.len() == 2 && (x[0] + 0.04).abs() < 1e-9 && (x[1] - 0.01).abs() < 1e-9, "{p:?}");
}

#[test]
fn capsules_cross_at_one_point_and_lie_along_each_other_at_two() {
    let (a, b) = (
        Shape::Capsule { radius_m: 0.01, half_length_m: 0.04 },
        Shape::Capsule { radius_m: 0.02, half_length_m: 0.06 },
    );
    let x = turned(V::new(0.003, 0.0, 0.03 - 1e-5), V::y() * std::f64::consts::FRAC_PI_2);
    let y = turned(V::new(0.0, 0.01, 0.0), V::x() * std::f64::consts::FRAC_PI_2);
    let p = places(&a, &x, &b, &y, 0.0);
    assert_eq!(p.len(), 1);
    assert!((p[0].depth - 1e-5).abs() < 1e-12 && (p[0].normal - V::z()).norm() < 1e-12);
    assert!((p[0].point - V::new(0.0, 0.0, 0.02)).norm() < 1e-5);
    let p = places(&a, &at(0.03 - 1e-5, 0.0, 0.05), &b, &Pose::identity(), 0.0);
    let mut z: Vec<f64> = p.iter().map(|p| p.point.z).collect();
    z.sort_by(f64::total_cmp);
    assert!(z.len() == 2 && (z[0] - 0.01).abs() < 1e-12 && (z[1] - 0.06).abs() < 1e-12, "{p:?}");
    // End to end.
    let p = places(&a, &at(0.0, 0.0, 0.13 - 1e-5), &b, &Pose::identity(), 0.0);
    assert_eq!(p.len(), 1);
    assert!((p[0].normal - V::z()).norm() < 1e-12);
}

/// Distance of x, outside, from a polyhedron: all faces, all edges, all vertices.
fn distance_to_poly(poly: &crate::collide::geom::Poly, x: &V) -> f64 {
    let edge = |e: &crate::collide::geom::Edge| {
        let (v, w) = (poly.vertex(e.ends[0]), poly.vertex(e.ends[1]));
        (x - v - e.along * e.along.dot(&(x - v)).clamp(0.0, (w - v).norm())).norm()
    };
    let face = |f: usize| {
        let (n, d) = poly.planes[f];
        let over = poly.sides(f as u32).iter().all(|s| s.cut.0.dot(x) <= s.cut.1);
        if over && n.dot(x) > d { n.dot(x) - d } else { f64::INFINITY }
    };
    poly.edges.iter().map(edge).chain((0..poly.planes.len()).map(face)).fold(f64::INFINITY, f64::min)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn the_nearest_feature_of_a_polyhedron_is_nearest(
        n in prop_oneof![Just(8), Just(14), Just(60), Just(120)], u in any_direction(), r in 1.05..3.0_f64,
    ) {
        let shape = if n == 8 { cuboid(0.02, 0.03, 0.045) } else { lump(n) };
        let g = geom(&shape);
        let Kind::Poly(poly) = &g.kind else { unreachable!() };
        let x = u * (r * 0.04);
        let Some((found, _)) = nearest(&g.kind, &x, 1.0) else { panic!() };
        if found > 1e-6 {
            let truth = distance_to_poly(poly, &x);
            prop_assert!((found - truth).abs() < 1e-12, "{found} {truth}");
        }
    }

    #[test]
    fn a_capsule_is_as_deep_as_the_ball_that_is_deepest_along_it(
        other in any_solid(), pa in any_pose(0.1), turn in any_pose(0.0), u in any_direction(),
        depth in prop_oneof![Just(1e-6), Just(1e-4), Just(1e-3)],
    ) {
        let capsule = Shape::Capsule { radius_m: 0.012, half_length_m: 0.04 };
        let pb = brought_together(&other, &pa, &capsule, &turn, &u, depth);
        let found = deepest_place(&places(&other, &pa, &capsule, &pb, 0.0)).expect("they touch");
        let ball = Shape::Sphere { radius_m: 0.012 };
        let mut truth = f64::NEG_INFINITY;
        for i in 0..=400 {
            let p = pb * at(0.0, 0.0, 0.04 * (f64::from(i) / 200.0 - 1.0));
            truth = truth.max(deepest_place(&places(&other, &pa, &ball, &p, 0.01)).map_or(f64::NEG_INFINITY, |p| p.depth));
        }
        // Flat on the end of a cylinder, the sides of its prism stand for the rim.
        let slack = if matches!(other, Shape::Cylinder { .. }) { 1e-5 } else { 1e-9 };
        prop_assert!(found.depth > truth - slack && found.depth < truth + 2e-5, "{} {truth}", found.depth);
    }
}
