//! Pinches searched for on a ball, whose distance is a formula.

use crate::support;
use drex_core::{Object, Pose};
use drex_grasp::{
    ClosureOptions, EvaluationOptions, Grasp, GripForceProblem, HandSurface, TorqueLimits, evaluate_with,
    force_closure, minimum_grip_force, pinch_grasps,
};
use drex_robot::Robot;
use nalgebra::{Point3, Vector3};

/// A ball about its frame's origin that rests on the table.
fn ball(radius_m: f64) -> Object {
    support::ball(radius_m, Point3::origin(), 0.1).with_rest_pose(Pose::translation(0.0, 0.0, radius_m))
}

fn found(hand: &str, radius_m: f64, candidates: usize, seed: u64) -> (Robot, Vec<Grasp>) {
    let robot = Robot::bundled(hand).unwrap();
    let found = pinch_grasps(&ball(radius_m), &robot, candidates, seed).unwrap();
    (robot, found)
}

#[test]
fn what_is_found_touches_is_not_inside_and_keeps_off_the_table() {
    for hand in ["leap_right", "allegro_right"] {
        let radius = 0.035;
        let (robot, found) = found(hand, radius, 3000, 0);
        assert!(found.len() > 30, "{hand}: {} grasps", found.len());
        // A finer sampling than the search used.
        let fine = HandSurface::new(&robot, 0.002).unwrap();
        let object = ball(radius);
        for f in &found {
            let poses = robot.forward_kinematics(&f.joints_rad, &f.object_from_base);
            let depth = fine.depths(&poses, object.geometry.exact(), 0.0).into_iter().fold(0.0, f64::max);
            let lowest = fine.lowest(&poses, &Vector3::z()).into_iter().fold(f64::INFINITY, f64::min);
            assert!(depth < 0.0025, "{hand}: {depth} m inside");
            assert!(lowest > -radius + 0.001, "{hand}: {lowest} m");
            let thumb = &fine.fingers[fine.thumb().unwrap()];
            let of_thumb = |link: &str| thumb.links.iter().any(|l| robot.links[*l].name == link);
            assert!(f.contacts.iter().any(|c| of_thumb(&c.link)) && f.contacts.iter().any(|c| !of_thumb(&c.link)));
            for c in &f.contacts {
                let (point, normal) = (Vector3::from(c.point_m), Vector3::from(c.normal));
                assert!((point.norm() - radius).abs() < 1e-6 && normal.dot(&point) < 0.0);
            }
            // Half of a weight is the least that pushes from below.
            assert!(f.grip_force_n.unwrap() > 0.5 * 0.1 * 9.81);
            for (q, joint) in f.joints_rad.iter().zip(&robot.joints) {
                let (low, high) = joint.limits.unwrap();
                assert!((low - 1e-12..=high + 1e-12).contains(q), "{hand}: {}", joint.name);
            }
        }
    }
}

#[test]
fn the_evaluation_of_a_found_grasp_is_the_cone_programme_on_its_contacts() {
    let radius = 0.035;
    let (robot, found) = found("leap_right", radius, 2000, 0);
    let surface = HandSurface::new(&robot, 0.003).unwrap();
    let mut ball = ball(radius);
    ball.mass_properties.center_of_mass = Point3::new(0.0, 0.002, 0.0);
    let (body, gravity) = (ball.mass_properties, ball.table().gravity());
    let mut options = EvaluationOptions::default();
    options.gamma = 1.3;
    let mut carried = 0;
    for f in found.iter().take(8) {
        let check = evaluate_with(&surface, f, &ball, &robot, &options).unwrap();
        let (joints, base, exact) = (&f.joints_rad, &f.object_from_base, ball.geometry.exact());
        let contacts = surface.contacts(&robot, joints, base, exact, &options.contact).unwrap();
        assert_eq!(check.contacts, contacts);
        let motors = TorqueLimits::of_robot(&robot, joints, base, &contacts, &gravity).unwrap();
        let closure = force_closure(&contacts, &ClosureOptions::about(body.center_of_mass)).unwrap();
        assert_eq!(
            (check.force_closure, check.epsilon, check.min_weight),
            (closure.closed, Some(closure.epsilon), Some(closure.min_weight))
        );
        assert_eq!((check.mass_kg, check.friction, check.gamma), (0.1, 0.5, 1.3));
        for (i, row) in check.fingers.iter().enumerate() {
            let finger = (i < surface.fingers.len()).then_some(i);
            assert_eq!(row.contacts, contacts.iter().filter(|c| c.finger == finger).count(), "{}", row.finger);
        }
        let free = GripForceProblem::new(contacts, 0.1, body.center_of_mass, gravity).with_gamma(1.3);
        let Ok(s) = minimum_grip_force(&free.clone().with_torques(motors)) else {
            assert!(check.grip_force_n.is_none() && !check.passed && check.torque_margin.is_none());
            continue;
        };
        carried += 1;
        assert_eq!((check.grip_force_n, check.torque_margin), (Some(s.total_n), Some(s.torque_margin)));
        assert_eq!(check.friction_margin, Some(s.friction_margin));
        for (row, n) in check.fingers.iter().zip(&s.per_finger_n) {
            assert_eq!(row.normal_n, *n, "{}", row.finger);
        }
        assert_eq!(check.fingers.last().unwrap().normal_n, s.palm_n);
        assert_eq!(check.passed, check.failures.is_empty());
        // Who asks for the verdict alone gets the same one.
        let mut verdict = options.clone();
        verdict.complete = false;
        assert_eq!(evaluate_with(&surface, f, &ball, &robot, &verdict).unwrap().passed, check.passed);
        // Without motors, and with a damage limit below what that needs at one contact.
        let mut other = options.clone();
        other.motors = false;
        let without = evaluate_with(&surface, f, &ball, &robot, &other).unwrap();
        let s = minimum_grip_force(&free).unwrap();
        assert_eq!((without.grip_force_n, without.torque_margin), (Some(s.total_n), Some(1.0)));
        other.max_normal_n = Some(0.01);
        let fragile = evaluate_with(&surface, f, &ball, &robot, &other).unwrap();
        assert!(fragile.grip_force_n.is_none() && fragile.failures.iter().any(|f| f.contains("limits")), "{fragile:?}");
        assert!(fragile.fingers.iter().all(|row| row.normal_n == 0.0));
    }
    assert!(carried > 0);
}

#[test]
fn a_thumb_without_limits_goes_both_ways() {
    let mut robot = Robot::bundled("leap_right").unwrap();
    let free = robot.require_joint("th_axl").unwrap();
    robot.joints[free].limits = None;
    let found = pinch_grasps(&ball(0.035), &robot, 2000, 0).unwrap();
    let (low, high) =
        found.iter().fold((0.0_f64, 0.0_f64), |(l, h), f| (l.min(f.joints_rad[free]), h.max(f.joints_rad[free])));
    assert!(low < -0.1 && high > 0.1, "{low} to {high} rad");
}

#[test]
fn seeds_and_threads() {
    let with = |seed: u64, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| found("leap_right", 0.03, 1200, seed).1)
    };
    let one = with(1, 1);
    assert!(!one.is_empty());
    assert_eq!(one, with(1, 2));
    assert_ne!(one, with(2, 2));
}

#[test]
fn what_is_too_wide_is_not_grasped_and_nonsense_is_refused() {
    let (robot, none) = found("leap_right", 0.2, 300, 0);
    assert!(none.is_empty());
    let mut nonsense = ball(0.03);
    nonsense.friction = f64::NAN;
    assert!(pinch_grasps(&nonsense, &robot, 10, 0).unwrap_err().to_string().contains("friction"));
}
