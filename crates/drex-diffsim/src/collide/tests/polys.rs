use super::*;

/// Overlap of two polyhedra in the direction (from a to b) where it is least: every normal of a face and every cross
/// product of two edges, and as a check of that theorem also directions all around.
fn least_overlap(a: &(Shape, Pose), b: &(Shape, Pose)) -> (f64, V) {
    let (points, other) = (corners(&a.0, &a.1), corners(&b.0, &b.1));
    let overlap = |n: &V| {
        let most = points.iter().map(|v| n.dot(v)).fold(f64::NEG_INFINITY, f64::max);
        let least = other.iter().map(|v| n.dot(v)).fold(f64::INFINITY, f64::min);
        most - least
    };
    let parts = |s: &(Shape, Pose)| match geom(&s.0).kind {
        Kind::Poly(p) => (
            p.planes.iter().map(|(n, _)| s.1 * n).collect::<Vec<V>>(),
            p.edges.iter().map(|e| s.1 * e.along).collect::<Vec<V>>(),
        ),
        _ => unreachable!(),
    };
    let ((faces, edges), (other_faces, other_edges)) = (parts(a), parts(b));
    let crosses = edges.iter().flat_map(|e| other_edges.iter().filter_map(|f| e.cross(f).try_normalize(1e-6)));
    let axes = faces.iter().chain(&other_faces).copied().chain(crosses);
    let best = axes.flat_map(|n| [n, -n]).map(|n| (overlap(&n), n)).min_by(|x, y| x.0.total_cmp(&y.0)).unwrap();
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    for i in 0..1000 {
        let z = 1.0 - f64::from(2 * i + 1) / 1000.0;
        let (sin, cos) = (golden * f64::from(i)).sin_cos();
        let n = V::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z);
        assert!(best.0 < 0.0 || overlap(&n) > best.0 - 1e-12);
    }
    best
}

fn corners(shape: &Shape, pose: &Pose) -> Vec<V> {
    match &geom(shape).kind {
        Kind::Poly(p) => p.vertices.iter().map(|v| (pose * Point3::from(*v)).coords).collect(),
        _ => unreachable!(),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn depth_and_normal_are_those_of_the_least_overlap(
        a in any_poly(), b in any_poly(), pa in any_pose(0.1), turn in any_pose(0.0), u in any_direction(),
        depth in prop_oneof![Just(1e-6), Just(1e-4), Just(2e-3)],
    ) {
        let pb = brought_together(&a, &pa, &b, &turn, &u, depth);
        let found = deepest_place(&places(&a, &pa, &b, &pb, 0.0)).expect("they touch");
        let (truth, n) = least_overlap(&(a.clone(), pa), &(b.clone(), pb));
        // A vertex some micrometres beside a face is still on it.
        // A flat face is found along its own normal, at most two degrees from the best direction.
        let flat = -n.dot(&found.normal) > 0.9994;
        let slack = if flat { 0.3 } else { 0.05 };
        prop_assert!((found.depth - truth).abs() < slack * truth + 2e-6, "{} against {truth}", found.depth);
        if truth > 1e-5 {
            // Directions of nearly the same overlap are as good.
            let along = |m: &V| {
                let most = corners(&a, &pa).iter().map(|v| m.dot(v)).fold(f64::NEG_INFINITY, f64::max);
                most - corners(&b, &pb).iter().map(|v| m.dot(v)).fold(f64::INFINITY, f64::min)
            };
            let overlap = along(&-found.normal);
            prop_assert!(overlap < 1.1 * truth + 1e-5 || n.dot(&found.normal) < -0.999, "overlap {overlap} along {}, least {truth} along {n}", found.normal);
        }
    }

    #[test]
    fn what_is_apart_does_not_touch(
        a in any_poly(), b in any_poly(), pa in any_pose(0.1), turn in any_pose(0.0), u in any_direction(),
    ) {
        let mut pb = brought_together(&a, &pa, &b, &turn, &u, 1e-7);
        pb.translation.vector += u * 1e-3;
        let (overlap, _) = least_overlap(&(a.clone(), pa), &(b.clone(), pb));
        prop_assume!(overlap < -1e-6);
        prop_assert!(places(&a, &pa, &b, &pb, 0.0).is_empty());
        // Within the margin something is reported, as a gap.
        let near = places(&a, &pa, &b, &pb, 2e-3);
        prop_assert!(near.iter().all(|p| p.depth < 1e-9));
    }
}

fn sorted(mut points: Vec<V>) -> Vec<V> {
    points.sort_by(|a, b| (a.x, a.y, a.z).partial_cmp(&(b.x, b.y, b.z)).unwrap());
    points
}

fn assert_points(found: &[Place<f64>], expected: &[[f64; 3]], tolerance: f64) {
    let key = |v: &V| v.map(|x| (x * 1e4).round() * 1e-4);
    let mut points: Vec<V> = found.iter().map(|p| p.point).collect();
    points.sort_by(|a, b| (key(a).x, key(a).y, key(a).z).partial_cmp(&(key(b).x, key(b).y, key(b).z)).unwrap());
    let expected = sorted(expected.iter().map(|p| V::from(*p)).collect());
    assert_eq!(points.len(), expected.len(), "{points:?}");
    for (p, e) in points.iter().zip(&expected) {
        assert!((p - e).norm() < tolerance, "{points:?} against {expected:?}");
    }
}

#[test]
fn a_box_flat_on_a_box_touches_at_four_corners() {
    let (small, large) = (cuboid(0.02, 0.03, 0.01), cuboid(0.2, 0.2, 0.05));
    let pose = turned(V::new(0.05, -0.02, 0.06 - 1e-5), V::z() * 0.3);
    for margin in [0.0, 1e-4] {
        let found = places(&small, &pose, &large, &Pose::identity(), margin);
        let corner = |x: f64, y: f64| (pose * Point3::new(x, y, -0.01)).coords.into();
        let expected = [corner(0.02, 0.03), corner(0.02, -0.03), corner(-0.02, 0.03), corner(-0.02, -0.03)];
        assert_points(&found, &expected, 1.01e-5);
        assert!(found.iter().all(|p| (p.normal - V::z()).norm() < 1e-12 && (p.depth - 1e-5).abs() < 1e-12));
    }
    // The large one on the small one: the same corners, pointing down from the small one.
    let found = places(&large, &at(0.0, 0.0, 0.06 - 1e-5), &small, &Pose::identity(), 0.0);
    assert_points(
        &found,
        &[[0.02, 0.03, 0.01], [0.02, -0.03, 0.01], [-0.02, 0.03, 0.01], [-0.02, -0.03, 0.01]],
        1.01e-5,
    );
    assert!(found.iter().all(|p| (p.normal - V::z()).norm() < 1e-12));
}

#[test]
fn equal_boxes_stand_on_each_others_corners() {
    let cube = cuboid(0.03, 0.03, 0.03);
    let mut sites = None;
    for k in 0..50 {
        // Shaken by less than the tolerance, the touches stay the same four.
        let s = |a: f64| ((f64::from(k) * a.sqrt()).fract() - 0.5) * 1e-6;
        let pose = turned(V::new(s(2.0), s(3.0), 0.06 - 2e-6 + s(5.0)), V::new(s(7.0), s(11.0), s(13.0)));
        let found = touches(&cube, &pose, &cube, &Pose::identity(), 1e-5);
        let now: Vec<u32> = found.iter().map(|t| t.site).collect();
        assert_eq!(now.len(), 4);
        assert_eq!(sites.get_or_insert(now.clone()), &now);
    }
}

#[test]
fn rocking_keeps_the_sites() {
    // Two faces of different sizes that take turns as the better direction.
    let (a, b) = (cuboid(0.03, 0.02, 0.01), lump(120));
    let b_low = touches(&cuboid(0.2, 0.2, 0.05), &Pose::identity(), &b, &at(0.0, 0.0, 0.05 + 0.0195), 1e-3);
    assert!(!b_low.is_empty());
    let c = cuboid(0.025, 0.028, 0.02);
    let mut sites = None;
    for k in 0..40 {
        let tilt = 2e-6 * (f64::from(k) - 20.0);
        let pose = turned(V::new(0.0, 0.0, 0.03 - 1e-6), V::new(tilt, -0.5 * tilt, 0.2));
        let now: Vec<u32> = touches(&a, &pose, &c, &Pose::identity(), 1e-4).iter().map(|t| t.site).collect();
        assert_eq!(sites.get_or_insert(now.clone()), &now, "{tilt}");
    }
}

#[test]
fn an_overhanging_box_touches_with_two_vertices_and_two_cut_edges() {
    let (brick, step) = (cuboid(0.04, 0.03, 0.015), cuboid(0.15, 0.2, 0.025));
    let (pb, ps) = (at(-0.008, 0.0, 0.065 - 1e-5), at(-0.15, 0.0, 0.025));
    let expected = [[-0.048, 0.03, 0.05], [-0.048, -0.03, 0.05], [0.0, 0.03, 0.05], [0.0, -0.03, 0.05]];
    assert_points(&places(&brick, &pb, &step, &ps, 0.0), &expected, 1.01e-5);
    assert_points(&places(&step, &ps, &brick, &pb, 0.0), &expected, 1.01e-5);
    // Tipped about the edge of the step, it touches with the two points on the edge alone.
    let edge = at(0.0, 0.0, 0.05);
    let tip =
        |angle: f64| edge * turned(V::new(0.0, 0.0, -1e-6), V::y() * angle) * edge.inverse() * at(-0.008, 0.0, 0.065);
    for angle in [1e-4, 1e-2, 0.1, 0.5] {
        let found = places(&brick, &tip(angle), &step, &ps, 0.0);
        assert_points(&found, &[[0.0, 0.03, 0.05], [0.0, -0.03, 0.05]], 2e-4);
        let up = V::new(angle.sin(), 0.0, angle.cos());
        assert!(
            found.iter().all(|p| p.normal.angle(&up) < 1e-3 || p.normal.angle(&V::z()) < 1e-3),
            "{angle} {found:?}"
        );
    }
}

#[test]
fn crossing_bars_touch_edge_to_edge() {
    // Two long square bars, each turned to stand on an edge, crossing at a right angle.
    let bar = cuboid(0.1, 0.01, 0.01);
    let on_edge = UnitQuaternion::from_scaled_axis(V::x() * std::f64::consts::FRAC_PI_4);
    let reach = 0.01 * 2.0_f64.sqrt();
    let low = Pose::from_parts(Translation3::identity(), on_edge);
    let across = UnitQuaternion::from_scaled_axis(V::z() * 1.2);
    let high = Pose::from_parts(Translation3::new(0.01, 0.004, 2.0 * reach - 3e-6), across * on_edge);
    let found = places(&bar, &high, &bar, &low, 0.0);
    assert_eq!(found.len(), 1);
    assert!((found[0].depth - 3e-6).abs() < 1e-12 && (found[0].normal - V::z()).norm() < 1e-12);
    // The axis of the upper bar passes over y = 0 at x = 0.01 - 0.004 / tan 1.2.
    assert!((found[0].point - V::new(0.01 - 0.004 / 1.2_f64.tan(), 0.0, reach)).norm() < 2e-6);
}

#[test]
fn a_box_stands_on_a_plane_with_the_vertices_that_are_below() {
    let plane = Shape::Plane;
    let cube = cuboid(0.03, 0.03, 0.03);
    let found = places(&cube, &at(0.1, 0.2, 0.03 - 1e-5), &plane, &Pose::identity(), 0.0);
    assert_eq!(found.len(), 4);
    assert!(found.iter().all(|p| (p.depth - 1e-5).abs() < 1e-15 && p.normal == V::z()));
    let tilted = turned(V::zeros(), V::x() * 0.5);
    let found = places(&plane, &tilted, &cube, &(tilted * at(0.0, 0.0, 0.03 - 1e-5)), 0.0);
    assert_eq!(found.len(), 4);
    assert!(found.iter().all(|p| (p.normal + tilted * V::z()).norm() < 1e-12));
    let lump = lump(120);
    let found = places(&lump, &at(0.0, 0.0, 0.1), &plane, &Pose::identity(), 0.0);
    assert!(found.is_empty());
}

#[test]
fn a_deep_box_still_has_a_sensible_normal() {
    // A quarter of the smaller box inside the larger one.
    let (small, large) = (cuboid(0.02, 0.02, 0.02), cuboid(0.2, 0.2, 0.05));
    let found = places(&small, &turned(V::new(0.0, 0.0, 0.06), V::z() * 0.4), &large, &Pose::identity(), 0.0);
    assert_eq!(found.len(), 4);
    assert!(found.iter().all(|p| (p.normal - V::z()).norm() < 1e-12 && (p.depth - 0.01).abs() < 1e-12));
}

#[test]
fn nonsense_poses_touch_nothing() {
    let cube = cuboid(0.03, 0.03, 0.03);
    assert!(touches(&cube, &at(f64::NAN, 0.0, 0.0), &cube, &Pose::identity(), 1e-3).is_empty());
    assert!(touches(&cube, &at(f64::INFINITY, 0.0, 0.0), &Shape::Plane, &Pose::identity(), 1e-3).is_empty());
}
