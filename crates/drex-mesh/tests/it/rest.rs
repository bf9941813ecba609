//! Stable poses: analytic probabilities, and that an object at rest stays there.

use std::f64::consts::{PI, TAU};

use drex_core::mesh::convex_hull;

use drex_mesh::{RestOptions, RestPose, settled_pose, stable_poses};
use nalgebra::{Point3, Unit, UnitQuaternion, Vector3};
use proptest::prelude::*;

fn poses(points: &[Point3<f64>], center: Point3<f64>) -> Vec<RestPose> {
    stable_poses(points, &center, &RestOptions::default()).unwrap()
}

fn corners(half: [f64; 3]) -> Vec<Point3<f64>> {
    let sign = |i: usize, k: usize| if i >> k & 1 == 1 { 1.0 } else { -1.0 };
    (0..8).map(|i| Point3::from([0, 1, 2].map(|k| sign(i, k) * half[k]))).collect()
}

/// Solid angle of a rectangle 2 a by 2 b seen from the height h over its middle.
fn rectangle(a: f64, b: f64, h: f64) -> f64 {
    4.0 * (a * b / ((a * a + h * h) * (b * b + h * h)).sqrt()).asin()
}

fn prism(sides: usize, radius: f64, half_height: f64) -> Vec<Point3<f64>> {
    (0..2 * sides)
        .map(|i| {
            let a = TAU * (i / 2) as f64 / sides as f64;
            Point3::new(radius * a.cos(), radius * a.sin(), if i % 2 == 0 { half_height } else { -half_height })
        })
        .collect()
}

/// A simulation of rolling that knows nothing of faces: the height of the centre over the lowest corner, downhill.
fn height(points: &[Point3<f64>], center: &Point3<f64>, down: &Vector3<f64>) -> f64 {
    points.iter().map(|p| (p - center).dot(down)).fold(f64::NEG_INFINITY, f64::max)
}

#[test]
fn a_box_rests_on_six_faces_with_their_solid_angles() {
    let half = [0.05, 0.03, 0.01];
    let found = poses(&corners(half), Point3::origin());
    assert_eq!(found.len(), 6);
    for pose in &found {
        let k = pose.support_normal_in_mesh.iamax();
        let (a, b) = (half[(k + 1) % 3], half[(k + 2) % 3]);
        assert!((pose.probability - rectangle(a, b, half[k]) / (4.0 * PI)).abs() < 1e-12);
        assert!((pose.rest_height_m - half[k]).abs() < 1e-12 && (pose.tipping_margin_m - a.min(b)).abs() < 1e-12);
        assert!((pose.tipping_angle_rad().tan() - a.min(b) / half[k]).abs() < 1e-12);
        let down = pose.world_from_mesh * pose.support_normal_in_mesh.into_inner();
        assert!((down + Vector3::z()).norm() < 1e-12);
        let center = pose.world_from_mesh * Point3::origin();
        assert!((center - Point3::new(0.0, 0.0, half[k])).norm() < 1e-12);
    }
    assert!(found.windows(2).all(|w| w[0].probability >= w[1].probability));
}

#[test]
fn a_long_prism_rests_on_its_sides_and_a_flat_one_on_its_ends() {
    let n = 12;
    // Seen from the centre, a side is a rectangle at the apothem.
    let (r, h) = (0.02_f64, 0.05);
    let (apothem, half_side) = (r * (PI / n as f64).cos(), r * (PI / n as f64).sin());
    let found = poses(&prism(n, r, h), Point3::origin());
    assert_eq!(found.len(), n + 2);
    for pose in &found {
        let side = rectangle(half_side, h, apothem) / (4.0 * PI);
        let end = 0.5 * (1.0 - n as f64 * side);
        let truth = if pose.support_normal_in_mesh.z.abs() < 0.5 { side } else { end };
        assert!((pose.probability - truth).abs() < 1e-12, "{pose:?}");
    }
    // A coin: the faces of the rim hold nothing worth a mention.
    let coin = poses(&prism(n, r, 0.001), Point3::origin());
    assert!(coin[0].probability + coin[1].probability > 0.9);
}

#[test]
fn a_leaning_prism_rolls_off_its_ends() {
    // Sheared so far that the centre is not above the ends: only the sides remain.
    let leaning: Vec<_> = corners([0.01, 0.01, 0.05]).iter().map(|p| Point3::new(p.x + 0.4 * p.z, p.y, p.z)).collect();
    let found = poses(&leaning, Point3::origin());
    let steep = |p: &RestPose| p.support_normal_in_mesh.z.abs() > 0.9;
    assert!(found.iter().all(|p| !steep(p)), "{found:?}");
    assert_eq!(found.len(), 4);
    let sum: f64 = found.iter().map(|p| p.probability).sum();
    assert!((sum - 1.0).abs() < 1e-12);
}

#[test]
fn a_tetrahedron_with_a_heavy_corner() {
    let tip = 1.0 / 3.0_f64.sqrt();
    let t = [[tip, tip, tip], [tip, -tip, -tip], [-tip, tip, -tip], [-tip, -tip, tip]].map(Point3::from);
    let even = poses(&t, Point3::origin());
    assert_eq!(even.len(), 4);
    assert!(even.iter().all(|p| (p.probability - 0.25).abs() < 1e-12 && (p.rest_height_m - 1.0 / 3.0).abs() < 1e-12));
    // A body inside a regular tetrahedron rests on all four faces; the one opposite of a heavy corner is the least likely.
    let heavy = poses(&t, Point3::from(t[0].coords * 0.7));
    assert_eq!(heavy.len(), 4);
    assert!((heavy[3].support_normal_in_mesh.into_inner() + t[0].coords).norm() < 1e-12);
    assert!((heavy[3].rest_height_m - (1.0 / 3.0 + 0.7)).abs() < 1e-12);
    let sum: f64 = heavy.iter().map(|p| p.probability).sum();
    assert!((sum - 1.0).abs() < 1e-12 && heavy[3].probability < 0.1);
    assert!((heavy[0].probability - heavy[2].probability).abs() < 1e-12);
}

#[test]
fn a_ragged_foot_is_one_pose() {
    // A box whose lower face has bumps of 0.2 mm.
    let mut points = corners([0.04, 0.03, 0.05]);
    let mut state = 1u64;
    for i in 0..400 {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        let noise = (state >> 11) as f64 / (1u64 << 53) as f64;
        let (x, y) = (f64::from(i % 20) / 19.0 * 2.0 - 1.0, f64::from(i / 20) / 19.0 * 2.0 - 1.0);
        points.push(Point3::new(0.038 * x, 0.028 * y, -0.05 - 2e-4 * noise));
    }
    let found = poses(&points, Point3::origin());
    let feet: Vec<_> = found.iter().filter(|p| p.support_normal_in_mesh.z < -0.9).collect();
    assert_eq!(feet.len(), 1, "{feet:?}");
    assert!(feet[0].tipping_margin_m > 0.02, "{:?}", feet[0]);
    let settled = settled_pose(&points, &Point3::origin(), &Vector3::z(), &RestOptions::default()).unwrap();
    assert!(settled.support_normal_in_mesh.angle(&-Vector3::z()) < 0.01);
    assert!(settled.tipping_margin_m > 0.02);
}

#[test]
fn let_go_askew_it_settles_on_the_face_below() {
    let half = [0.05, 0.03, 0.01];
    let up = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.2) * Vector3::z();
    let pose = settled_pose(&corners(half), &Point3::origin(), &up, &RestOptions::default()).unwrap();
    assert!((pose.support_normal_in_mesh.into_inner() + Vector3::z()).norm() < 1e-9);
    // The opposite direction has no unique shortest turn.
    let over = settled_pose(&corners(half), &Point3::origin(), &-Vector3::z(), &RestOptions::default()).unwrap();
    assert!((over.world_from_mesh * -Vector3::z() - Vector3::z()).norm() < 1e-9);
}

#[test]
fn impossible_bodies_are_refused() {
    let points = corners([0.05, 0.03, 0.01]);
    let options = RestOptions::default();
    let outside = stable_poses(&points, &Point3::new(0.0, 0.0, 0.02), &options).unwrap_err().to_string();
    assert!(outside.contains("outside of the convex hull"), "{outside}");
    assert!(stable_poses(&points, &Point3::new(f64::NAN, 0.0, 0.0), &options).is_err());
    assert!(stable_poses(&points[..3], &Point3::origin(), &options).is_err());
    assert!(settled_pose(&points, &Point3::origin(), &Vector3::zeros(), &options).is_err());
    assert!(settled_pose(&points, &Point3::origin(), &Vector3::repeat(f64::NAN), &options).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn probabilities_sum_to_one_and_every_pose_is_a_local_minimum(
        cloud in proptest::collection::vec(proptest::array::uniform3(-0.1..0.1f64), 8..60),
        weights in proptest::collection::vec(0.01..1.0f64, 60),
    ) {
        let points: Vec<Point3<f64>> = cloud.iter().map(|&p| Point3::from(p)).collect();
        prop_assume!(convex_hull(&points).is_ok());
        let total: f64 = weights[..points.len()].iter().sum();
        let center = Point3::from(
            points.iter().zip(&weights).map(|(p, w)| p.coords * *w).sum::<Vector3<f64>>() / total,
        );
        let found = poses(&points, center);
        prop_assert!((found.iter().map(|p| p.probability).sum::<f64>() - 1.0).abs() < 1e-9);
        for pose in &found {
            prop_assert!(pose.tipping_margin_m > 0.0 && pose.probability > 0.0);
            let down = pose.support_normal_in_mesh;
            let at_rest = height(&points, &center, &down);
            prop_assert!((at_rest - pose.rest_height_m).abs() < 1e-9);
            // Tilted by less than the tipping angle about any axis, the centre is higher: the object rolls back. Facets that
            // are one face within the tolerance may be lower by that much.
            let tilt = (0.5 * pose.tipping_angle_rad()).min(0.02);
            for k in 0..12 {
                let a = TAU * f64::from(k) / 12.0;
                let sideways = Unit::new_normalize(down.cross(&Vector3::ith(down.iamin(), 1.0)));
                let axis = UnitQuaternion::from_axis_angle(&down, a) * sideways;
                let tilted = UnitQuaternion::from_axis_angle(&axis, tilt) * down.into_inner();
                prop_assert!(height(&points, &center, &tilted) > at_rest - 1e-4 * 0.35, "{pose:?}");
            }
        }
    }
}
