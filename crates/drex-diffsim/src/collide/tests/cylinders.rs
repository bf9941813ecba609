use std::f64::consts::FRAC_PI_2;

use super::*;

const R: f64 = 0.03;
const H: f64 = 0.05;
const CAN: Shape = Shape::Cylinder { radius_m: R, half_length_m: H };

fn table() -> (Shape, Pose) {
    (cuboid(0.3, 0.3, 0.05), at(0.0, 0.0, -0.05))
}

/// Lying along x at height z, rolled by an angle.
fn lying(x: f64, z: f64, roll: f64) -> Pose {
    turned(V::new(x, 0.0, z), V::x() * roll) * turned(V::zeros(), V::y() * FRAC_PI_2)
}

#[test]
fn a_can_stands_on_its_rim_and_lies_on_two_points() {
    for (support, pose) in [(Shape::Plane, Pose::identity()), table()] {
        let p = places(&CAN, &turned(V::new(0.01, 0.02, H - 1e-5), V::z() * 0.7), &support, &pose, 0.0);
        assert_eq!(p.len(), 32);
        assert!(p.iter().all(|p| (p.depth - 1e-5).abs() < 1e-12 && (p.normal - V::z()).norm() < 1e-12));
        // Round however it is rolled: the same two sites at the same depth.
        let mut sites = None;
        for k in 0..200 {
            let pose_of_can = lying(0.02, R - 1e-6, f64::from(k) * 0.0317);
            let found = touches(&CAN, &pose_of_can, &support, &pose, 1e-7);
            let now: Vec<u32> = found.iter().map(|t| t.site).collect();
            assert_eq!(now.len(), 2, "roll {k}");
            assert_eq!(sites.get_or_insert(now.clone()), &now);
            for p in found.iter().map(|t| t.at_poses(&pose_of_can, &pose)) {
                assert!((p.depth - 1e-6).abs() < 1e-12 && (p.normal - V::z()).norm() < 1e-12);
                assert!(((p.point.x - 0.02).abs() - H).abs() < 1e-12 && p.point.y.abs() < 1e-12);
            }
        }
    }
}

#[test]
fn a_tilted_can_touches_at_the_lowest_point_of_its_rim() {
    for (support, pose) in [(Shape::Plane, Pose::identity()), table()] {
        for tilt in [0.03, 0.15, 0.25, 0.7, 1.2, 1.5] {
            for turn in [0.0, 0.05, 1.0] {
                // Lowest: the centre is at h cos + r sin over it.
                let (sin, cos) = f64::sin_cos(tilt);
                let z = H * cos + R * sin - 1e-5;
                let can = turned(V::new(0.0, 0.0, z), V::y() * tilt) * turned(V::zeros(), V::z() * turn);
                let p = places(&CAN, &can, &support, &pose, 0.0);
                let best = deepest_place(&p).unwrap();
                assert!((best.depth - 1e-5).abs() < 1e-12, "{tilt} {turn}: {best:?}");
                let lowest = can * Point3::from(turned(V::zeros(), V::z() * -turn) * V::new(R, 0.0, -H));
                assert!((best.point - lowest.coords).norm() < 1e-5);
            }
        }
    }
}

#[test]
fn a_can_over_the_edge_of_a_table_touches_on_the_edge() {
    let (table, pose) = table();
    // Lying across the edge at x = 0.3: one rim on the table, the side on the edge.
    let p = places(&CAN, &lying(0.28, R - 1e-6, 0.3), &table, &pose, 0.0);
    let mut x: Vec<f64> = p.iter().map(|p| p.point.x).collect();
    x.sort_by(f64::total_cmp);
    assert!(x.len() == 2 && (x[0] - 0.23).abs() < 1e-9 && (x[1] - 0.3).abs() < 1e-9, "{p:?}");
    assert!(p.iter().all(|p| (p.depth - 1e-6).abs() < 1e-10 && (p.normal - V::z()).norm() < 1e-9));
    // Rolling over the edge at y = 0.3, along it: the normal follows the edge.
    for angle in [0.05, 0.3, 0.8, 1.4] {
        let (sin, cos) = f64::sin_cos(angle);
        let c = V::new(0.02, 0.3, 0.0) + V::new(0.0, sin, cos) * (R - 1e-6);
        let can = turned(c, V::y() * FRAC_PI_2);
        let p = places(&CAN, &can, &table, &pose, 0.0);
        assert_eq!(p.len(), 2, "{angle}: {p:?}");
        assert!(p.iter().all(|p| (p.depth - 1e-6).abs() < 1e-10 && (p.normal - V::new(0.0, sin, cos)).norm() < 1e-6));
    }
    // Standing half over: no deeper than it is.
    let p = places(&CAN, &at(0.3, 0.0, H - 1e-5), &table, &pose, 0.0);
    assert!(p.len() > 10 && p.iter().all(|p| (p.depth - 1e-5).abs() < 1e-12 && p.point.x < 0.3 + 1e-4), "{p:?}");
}

#[test]
fn cans_touch_side_by_side_crossing_and_stacked() {
    let side = at(2.0 * R - 1e-6, 0.0, 0.02);
    for roll in [0.0, 0.05, 0.1] {
        let p = places(&CAN, &(side * turned(V::zeros(), V::z() * roll)), &CAN, &Pose::identity(), 0.0);
        let mut z: Vec<f64> = p.iter().map(|p| p.point.z).collect();
        z.sort_by(f64::total_cmp);
        assert!(z.len() == 2 && (z[0] + 0.03).abs() < 1e-9 && (z[1] - 0.05).abs() < 1e-9, "{p:?}");
        assert!(p.iter().all(|p| (p.depth - 1e-6).abs() < 1e-10 && (p.normal - V::x()).norm() < 1e-9));
    }
    let p = places(
        &CAN,
        &turned(V::new(0.01, 0.005, 2.0 * R - 1e-6), V::x() * FRAC_PI_2),
        &CAN,
        &lying(0.0, 0.0, 0.0),
        0.0,
    );
    assert!(p.len() == 1 && (p[0].depth - 1e-6).abs() < 1e-12 && (p[0].normal - V::z()).norm() < 1e-9, "{p:?}");
    assert!((p[0].point - V::new(0.01, 0.0, R)).norm() < 1e-5);
    let p = places(&CAN, &at(0.0, 0.0, 2.0 * H - 1e-5), &CAN, &Pose::identity(), 0.0);
    assert_eq!(p.len(), 32);
    assert!(p.iter().all(|p| (p.depth - 1e-5).abs() < 1e-12));
    // Lying on the end of one that stands.
    let p = places(&CAN, &lying(0.0, H + R - 1e-6, 0.2), &CAN, &Pose::identity(), 0.0);
    assert!(
        p.len() == 2 && p.iter().all(|p| (p.depth - 1e-6).abs() < 1e-9 && (p.normal - V::z()).norm() < 1e-9),
        "{p:?}"
    );
    assert!(p.iter().all(|p| (p.point.x.abs() - R).abs() < 2e-4));
}

#[test]
fn a_ball_meets_side_end_and_rim() {
    let ball = Shape::Sphere { radius_m: 0.01 };
    let check = |c: V, depth: f64, normal: V| {
        let p = places(&ball, &at(c.x, c.y, c.z), &CAN, &Pose::identity(), 1e-2);
        assert_eq!(p.len(), 1);
        assert!((p[0].depth - depth).abs() < 1e-14 && (p[0].normal - normal).norm() < 1e-12, "{c}: {:?}", p[0]);
    };
    check(V::new(0.0, R + 0.009, 0.01), 1e-3, V::y());
    check(V::new(0.01, 0.01, -H - 0.009), 1e-3, -V::z());
    check(V::new(0.0, -R - 0.006, H + 0.006), 0.01 - 0.006 * 2.0_f64.sqrt(), V::new(0.0, -1.0, 1.0).normalize());
    check(V::new(0.0, R - 0.005, 0.0), 0.015, V::y());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn a_can_is_as_deep_as_a_prism_of_many_sides(
        other in any_poly(), pa in any_pose(0.1), turn in any_pose(0.0), u in any_direction(),
    ) {
        let fine = Shape::Convex(std::sync::Arc::new(ConvexPolyhedron::prism(R, H, 256)));
        let pb = brought_together(&other, &pa, &fine, &turn, &u, 1e-3);
        let found = deepest_place(&places(&other, &pa, &CAN, &pb, 0.0)).expect("they touch");
        // Where a rim meets an edge, the prism of 32 sides is up to half a per cent of the radius inside, and flat
        // faces are found along their own normals.
        prop_assert!(found.depth > 0.6e-3 && found.depth < 1.05e-3, "{}", found.depth);
    }
}
