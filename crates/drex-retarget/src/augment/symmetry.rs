//! Rotations that map an object onto itself.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Point3, SymmetricEigen, Unit, UnitQuaternion, Vector3};

use drex_core::Object;

/// Points on the surface that have to come to lie on it again.
const POINTS: usize = 600;
/// Part of them that has to: scans have blemishes.
const SHARE: f64 = 0.97;
/// Orders of rotation that are tried about each axis.
const ORDERS: [u32; 7] = [2, 3, 4, 5, 6, 8, 12];
/// A group this large is enough variety.
const MOST: usize = 48;
/// Rotations nearer than this are one, rad: well below the smallest turn that is tried.
const SAME_RAD: f64 = 0.25;

/// Rotations about the centre of mass that move the surface of the object by at most `tolerance_m`, the identity first: those about
/// the axes of inertia of its surface and about the axes of its frame, and what they make together.
pub fn symmetries(object: &Object, tolerance_m: f64) -> Vec<UnitQuaternion<f64>> {
    let points = surface_points(object);
    let center = object.center_of_mass();
    let maps_onto_itself = |turn: &UnitQuaternion<f64>| {
        let on = |p: &&Point3<f64>| {
            let moved = center + turn * (*p - center);
            object.geometry.exact().signed_distance(&moved).distance_m.abs() <= tolerance_m
        };
        points.iter().filter(on).count() as f64 >= SHARE * points.len() as f64
    };
    let spread: Matrix3<f64> = points.iter().map(|p| (p - center) * (p - center).transpose()).sum();
    let inertia = SymmetricEigen::new(spread).eigenvectors;
    let mut axes: Vec<Vector3<f64>> = (0..3).map(|k| Vector3::ith(k, 1.0)).collect();
    axes.extend((0..3).map(|k| inertia.column(k).into_owned()));
    let mut group = vec![UnitQuaternion::identity()];
    if points.is_empty() {
        return group;
    }
    for axis in axes.into_iter().filter_map(|a| Unit::try_new(a, 1e-9)) {
        for order in ORDERS {
            let turn = UnitQuaternion::from_axis_angle(&axis, TAU / f64::from(order));
            if !contains(&group, &turn) && maps_onto_itself(&turn) {
                group.push(turn);
            }
        }
    }
    // Products of symmetries are symmetries but for errors that add up.
    let mut next = 1;
    while next < group.len() && group.len() < MOST {
        for k in 1..group.len() {
            let turn = group[next] * group[k];
            if group.len() < MOST && !contains(&group, &turn) && maps_onto_itself(&turn) {
                group.push(turn);
            }
        }
        next += 1;
    }
    group
}

fn contains(group: &[UnitQuaternion<f64>], turn: &UnitQuaternion<f64>) -> bool {
    group.iter().any(|g| g.angle_to(turn) < SAME_RAD)
}

/// Points of the box around the object, brought onto its surface along the distance's gradient.
fn surface_points(object: &Object) -> Vec<Point3<f64>> {
    let (lo, hi) = object.geometry.bounding_box();
    // Roberts' additive sequence in three dimensions.
    let steps = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_7];
    let place = |i: usize| {
        let mut p =
            Point3::from(Vector3::from_fn(|k, _| lo[k] + (hi[k] - lo[k]) * (0.5 + (i + 1) as f64 * steps[k]).fract()));
        let mut distance = f64::INFINITY;
        for _ in 0..3 {
            let s = object.geometry.exact().signed_distance(&p);
            distance = s.distance_m;
            p -= s.gradient * distance;
        }
        (p, distance)
    };
    let small = 0.01 * (hi - lo).norm();
    (0..POINTS).map(place).filter(|(_, d)| d.abs() < small).map(|(p, _)| p).collect()
}
