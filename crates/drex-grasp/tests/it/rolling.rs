//! Rolling against what geometry and the pendulum of moments say.

use drex_grasp::{Rolling, RollingError, rolling_path};
use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};

const G: f64 = 9.81;

fn start() -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::new(0.1, -0.2, 0.03), UnitQuaternion::from_euler_angles(0.4, -0.8, 1.9))
}

fn turned(axis: Vector3<f64>, angle: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis), angle) * start().rotation
}

#[test]
fn the_path_goes_from_start_to_goal_and_never_slips() {
    let goal = turned(Vector3::new(0.3, 0.9, 0.0), 1.7);
    let path = rolling_path(&Rolling::new(0.03, 0.05, 2.0), &start(), &goal, 200).unwrap();
    let (first, last) = (&path.waypoints[0], path.waypoints.last().unwrap());
    assert!((first.object.to_homogeneous() - start().to_homogeneous()).norm() < 1e-12);
    assert!(last.object.rotation.angle_to(&goal) < 1e-9);
    let middle = start().rotation.slerp(&goal, 0.5);
    assert!(path.waypoints[100].object.rotation.angle_to(&middle) < 1e-9, "the shortest turn");
    let moved = last.object.translation.vector - start().translation.vector;
    assert!((moved.norm() - 0.03 * 1.7).abs() < 1e-12 && moved.z.abs() < 1e-12, "radius times angle");
    assert!((last.finger_travel_m - 2.0 * moved.norm()).abs() < 1e-12);
    for w in path.waypoints.windows(2) {
        // The material point on the table stays where it is to first order, the one under the finger goes along with it.
        let step = w[1].object * w[0].object.inverse();
        let centre = nalgebra::Point3::from(w[0].object.translation.vector);
        let below = centre - Vector3::z() * 0.03;
        assert!((step * below - below).norm() < 1e-2 * (step * centre - centre).norm());
        let top = w[0].contact;
        let finger = w[1].finger_travel_m - w[0].finger_travel_m;
        assert!(((step * top - top).norm() - finger).abs() < 1e-2 * finger);
        assert!((w[0].contact - centre - Vector3::z() * 0.03).norm() < 1e-12);
    }
}

#[test]
fn the_force_is_what_the_moments_ask_for() {
    let mut r = Rolling::new(0.03, 0.05, 2.0);
    let goal = turned(Vector3::y(), 1.0);
    // Level, no resistance, no hurry: a touch will do.
    (r.resistance_m, r.acceleration_m_s2) = (0.0, 0.0);
    let path = rolling_path(&r, &start(), &goal, 4).unwrap();
    assert!((path.press_n - r.touch_n).abs() < 1e-12 && (path.force_n - r.touch_n).abs() < 1e-12);
    // Uphill by an angle s, along x: the finger's force at twice the radius holds half of the weight's share along the slope.
    let s: f64 = 0.2;
    r.table_normal = Unit::new_normalize(Vector3::new(-s.sin(), 0.0, s.cos()));
    let path = rolling_path(&r, &start(), &goal, 4).unwrap();
    let half = 0.5 * 0.05 * G * s.sin();
    assert!((path.press_n - half / 0.5).abs() < 1e-9, "{}", path.press_n);
    assert!((path.force_n - half.hypot(half / 0.5)).abs() < 1e-9);
    let push = path.waypoints[0].force;
    assert!((push.dot(&r.table_normal) + path.press_n).abs() < 1e-9);
    // Downhill it brakes with as much.
    let down = rolling_path(&r, &start(), &turned(-Vector3::y(), 1.0), 4).unwrap();
    assert!((down.press_n - path.press_n).abs() < 1e-9);
    assert!(down.waypoints[0].force.x > 0.0, "it holds back against rolling to −x");
    // Resistance on the level: 2 r μ P = b (P + m g).
    r.table_normal = Vector3::z_axis();
    r.resistance_m = 0.004;
    let path = rolling_path(&r, &start(), &goal, 4).unwrap();
    assert!((path.press_n - 0.004 * 0.05 * G / (2.0 * 0.03 * 0.5 - 0.004)).abs() < 1e-9);
    // Starting a ball from rest: 2 F = 7/5 m a, and the table has to give m a − F.
    (r.resistance_m, r.acceleration_m_s2) = (0.0, 2.0);
    let path = rolling_path(&r, &start(), &goal, 4).unwrap();
    assert!((path.press_n - 0.7 * 0.05 * 2.0 / 0.5).abs() < 1e-9);
}

#[test]
fn what_cannot_be_rolled_is_refused_by_name() {
    let r = Rolling::new(0.03, 0.05, 2.0);
    let goal = turned(Vector3::y(), 1.0);
    assert!(matches!(
        rolling_path(&r, &start(), &turned(Vector3::z(), 0.5), 4),
        Err(RollingError::Spin { spin_deg }) if (spin_deg - 0.5_f64.to_degrees()).abs() < 1e-6
    ));
    let mut gentle = r.clone();
    gentle.max_force_n = 0.01;
    assert!(matches!(rolling_path(&gentle, &start(), &goal, 4), Err(RollingError::TooMuch { .. })));
    let mut sticky = r.clone();
    sticky.resistance_m = 0.04;
    assert!(matches!(rolling_path(&sticky, &start(), &goal, 4), Err(RollingError::FingerSlips { .. })));
    let mut ice = r.clone();
    (ice.table_friction, ice.acceleration_m_s2) = (0.001, 1.0);
    assert!(matches!(rolling_path(&ice, &start(), &goal, 4), Err(RollingError::TableSlips { .. })));
    let mut none = r.clone();
    none.radius_m = 0.0;
    let mut upside = r.clone();
    upside.table_normal = -Vector3::z_axis();
    for bad in [none, upside] {
        assert!(matches!(rolling_path(&bad, &start(), &goal, 4), Err(RollingError::Input(_))));
    }
    assert!(matches!(rolling_path(&r, &start(), &goal, 0), Err(RollingError::Input(_))));
    // Nowhere to go is a path that stays.
    let path = rolling_path(&r, &start(), &start().rotation, 2).unwrap();
    assert!(path.waypoints[2].finger_travel_m < 1e-9);
}
