//! Contacts and the evaluation of the bundled hands on shapes with exact distances.

use crate::support;
use drex_core::{Pose, SdfSample, SignedDistance};
use drex_grasp::{
    ContactOptions, EvaluationOptions, Grasp, GraspError, GripForceProblem, HandSurface, TorqueLimits, evaluate,
    find_contacts, minimum_grip_force,
};
use drex_robot::Robot;
use nalgebra::{Isometry3, Point3, Translation3, Vector3};

struct Ball {
    center: Point3<f64>,
    radius: f64,
}

impl SignedDistance for Ball {
    fn signed_distance(&self, p: &Point3<f64>) -> SdfSample {
        let d = p - self.center;
        SdfSample { distance_m: d.norm() - self.radius, gradient: d.try_normalize(1e-12).unwrap_or_else(Vector3::z) }
    }
}

/// A ball that just touches the index fingertip from the palm's side, sunk in by `depth`.
fn ball_at_the_fingertip(robot: &Robot, q: &[f64], depth: f64) -> (Ball, usize) {
    let surface = HandSurface::new(robot, 0.002).unwrap();
    let poses = robot.forward_kinematics(q, &Isometry3::identity());
    let palm = robot.palm_link().unwrap();
    let way = poses[palm].rotation * robot.palm_normal().unwrap();
    let tip = surface.fingers[0].links.iter().copied().max().unwrap();
    let link = if surface.links[tip].samples().is_empty() { tip - 1 } else { tip };
    // The point of the link that lies furthest out of the palm.
    let furthest = surface.links[link]
        .samples()
        .iter()
        .map(|(p, _)| poses[link] * p)
        .max_by(|a, b| a.coords.dot(&way).total_cmp(&b.coords.dot(&way)))
        .unwrap();
    (Ball { center: furthest + way * (0.02 - depth), radius: 0.02 }, link)
}

#[test]
fn a_fingertip_that_touches_is_found_with_its_depth_and_normal() {
    for name in ["leap_right", "allegro_right"] {
        let robot = Robot::bundled(name).unwrap();
        let q = robot.joint_vector::<&str>([]).unwrap();
        let (ball, link) = ball_at_the_fingertip(&robot, &q, 0.001);
        let contacts =
            find_contacts(&robot, &q, &Isometry3::identity(), &ball, &ContactOptions::with_friction(0.4)).unwrap();
        let tip: Vec<_> = contacts.iter().filter(|c| c.link == link).collect();
        assert!(!tip.is_empty() && tip.len() <= 3, "{name}: {contacts:?}");
        // Sampling at 3 mm may miss the deepest point by a little.
        assert!((tip[0].depth_m - 0.001).abs() < 4e-4, "{name}: {}", tip[0].depth_m);
        assert_eq!((tip[0].finger, tip[0].friction), (Some(0), 0.4));
        for c in &contacts {
            assert!(((c.point - ball.center).norm() - ball.radius).abs() < 1e-9, "on the surface");
            assert!((c.normal - (ball.center - c.point).normalize()).norm() < 1e-9, "into the object");
        }
        let (far, _) = ball_at_the_fingertip(&robot, &q, -0.01);
        assert!(
            find_contacts(&robot, &q, &Isometry3::identity(), &far, &ContactOptions::default()).unwrap().is_empty()
        );
    }
}

#[test]
fn patches_skip_nothing() {
    let robot = Robot::bundled("leap_right").unwrap();
    let surface = HandSurface::new(&robot, 0.004).unwrap();
    let q = robot.mid_range();
    let poses = robot.forward_kinematics(&q, &Isometry3::identity());
    let center = robot.grasp_center().unwrap();
    let ball = Ball { center: poses[robot.palm_link().unwrap()] * center, radius: 0.05 };
    let depths = surface.depths(&poses, &ball, f64::INFINITY);
    let lowest = surface.lowest(&poses, &Vector3::x());
    for (link, part) in surface.links.iter().enumerate() {
        let points: Vec<_> = part.samples().iter().map(|(p, _)| poses[link] * p).collect();
        let plain = points.iter().map(|p| -ball.signed_distance(p).distance_m).fold(f64::NEG_INFINITY, f64::max);
        assert_eq!(depths[link], plain, "link {link}");
        let low = points.iter().map(|p| p.x).fold(f64::INFINITY, f64::min);
        assert!((lowest[link] - low).abs() < 1e-12 || points.is_empty());
        let inside = part.within(&poses[link], &ball, 0.001).len();
        assert_eq!(inside, points.iter().filter(|p| ball.signed_distance(p).distance_m <= 0.001).count());
    }
}

#[test]
fn torques_of_the_robot_do_the_work_of_the_contact_forces() {
    // Virtual work: the torques that hold contact forces on the fingertip equal force times displacement per joint.
    let robot = Robot::bundled("leap_right").unwrap();
    let q = robot.mid_range();
    let base = Isometry3::from_parts(
        Translation3::new(0.1, -0.2, 0.05),
        nalgebra::UnitQuaternion::from_euler_angles(0.3, 0.5, -0.2),
    );
    let finger = &robot.fingers()[0];
    let poses = robot.forward_kinematics(&q, &base);
    let tip = poses[finger.tip_link] * finger.tip_point;
    let mut contact = drex_grasp::Contact::new(tip, Vector3::new(0.2, 0.5, -0.7), 0.5);
    contact.link = finger.tip_link;
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let limits = TorqueLimits::of_robot(&robot, &q, &base, std::slice::from_ref(&contact), &gravity).unwrap();
    let force = Vector3::new(0.3, -0.4, 1.1);
    let tau = limits.jacobians[0].tr_mul(&force);
    for j in 0..robot.dof() {
        let h = 1e-6;
        let moved = |s: f64| {
            let mut p = q.clone();
            p[j] += s;
            robot.forward_kinematics(&p, &base)[finger.tip_link] * finger.tip_point
        };
        assert!((tau[j] - force.dot(&(moved(h) - moved(-h))) / (2.0 * h)).abs() < 1e-8);
    }
    // Gravity: the torque that holds the links is the slope of their potential energy.
    for j in 0..robot.dof() {
        let h = 1e-5;
        let energy = |s: f64| {
            let mut p = q.clone();
            p[j] += s;
            let poses = robot.forward_kinematics(&p, &base);
            let parts = robot.links.iter().zip(&poses).filter_map(|(l, pose)| l.inertial.map(|m| (m, pose)));
            parts.map(|(m, pose)| -m.mass_kg * gravity.dot(&(pose * m.center_of_mass).coords)).sum::<f64>()
        };
        assert!((limits.gravity_nm[j] - (energy(h) - energy(-h)) / (2.0 * h)).abs() < 1e-7);
    }
    assert!(limits.limits_nm.iter().all(|(lo, hi)| *lo < 0.0 && *hi > 0.0 && hi.is_finite()));
}

#[test]
fn an_evaluation_names_what_is_wrong() {
    let robot = Robot::bundled("leap_right").unwrap();
    let q = robot.joint_vector::<&str>([]).unwrap();
    let center = ball_at_the_fingertip(&robot, &q, 0.004).0.center;
    let ball = support::ball(0.02, center, 0.1);
    let grasp = Grasp::new(&robot, q.clone(), Pose::identity());
    let defaults = EvaluationOptions::default();
    let found = evaluate(&grasp, &ball, &robot, &defaults).unwrap();
    assert!(!found.passed && found.grip_force_n.is_none() && !found.force_closure);
    for word in ["thumb", "1 of 3 fingers", "inside the object", "below the table", "force closure", "cannot carry"] {
        assert!(found.failures.iter().any(|f| f.contains(word)), "{word}: {:?}", found.failures);
    }
    assert!((found.penetration_mm - 4.0).abs() < 0.5, "{}", found.penetration_mm);
    // How deep in object and table, and that the rules end there.
    let surface = HandSurface::new(&robot, 0.003).unwrap();
    let poses = robot.forward_kinematics(&q, &Pose::identity());
    let lowest = surface.lowest(&poses, &Vector3::z()).into_iter().fold(f64::INFINITY, f64::min);
    assert!(lowest < 0.0 && (found.table_penetration_mm + 1e3 * lowest).abs() < 1e-9, "{lowest}");
    for (beyond, says) in [(-1e-6, true), (1e-6, false)] {
        let mut options = defaults.clone();
        options.min_table_clearance_m = lowest - beyond;
        options.max_penetration_m = 1e-3 * found.penetration_mm + beyond;
        let failures = evaluate(&grasp, &ball, &robot, &options).unwrap().failures;
        for words in ["below the table", "inside the object"] {
            assert_eq!(failures.iter().any(|f| f.contains(words)), says, "{words}: {failures:?}");
        }
    }
    // A centimetre above a table nothing is below it, and for those who ask for more it is too near.
    let above = ball.clone().with_rest_pose(Pose::translation(0.0, 0.0, 0.01 - lowest));
    for (least_m, words) in [(0.0, None), (0.011, Some("only 10.0 mm above the table"))] {
        let mut options = defaults.clone();
        options.min_table_clearance_m = least_m;
        let failures = evaluate(&grasp, &above, &robot, &options).unwrap().failures;
        let about: Vec<_> = failures.iter().filter(|f| f.contains("the table")).collect();
        assert!(about.len() == words.iter().len() && words.is_none_or(|w| about[0].contains(w)), "{failures:?}");
    }
    let mut easy = defaults.clone();
    (easy.thumb, easy.min_fingers) = (false, 1);
    let failures = evaluate(&grasp, &ball, &robot, &easy).unwrap().failures;
    assert!(!failures.iter().any(|f| f.contains("the thumb") || f.contains("fingers touch")), "{failures:?}");
    let contacts: usize = found.fingers.iter().map(|c| c.contacts).sum();
    assert!(contacts == found.contacts.len() && contacts > 0 && found.fingers.last().unwrap().finger == "palm");
    // What asks for the verdict alone stops where it is clear.
    let mut verdict = defaults;
    verdict.complete = false;
    let short = evaluate(&grasp, &ball, &robot, &verdict).unwrap();
    assert!(!short.passed && short.failures.len() < found.failures.len() && short.epsilon.is_none());
}

#[test]
fn a_grasp_is_of_one_hand_and_its_joints_have_names() {
    let robot = Robot::bundled("leap_right").unwrap();
    let q: Vec<f64> = (0..robot.dof()).map(|j| 0.01 * j as f64).collect();
    let grasp = Grasp::new(&robot, q.clone(), Pose::translation(0.0, 0.0, 0.1));
    // In another order they are the same joints, also after a file.
    let mut turned = grasp.clone();
    turned.joint_names.reverse();
    turned.joints_rad.reverse();
    let text = serde_json::to_string(&turned).unwrap();
    assert_eq!(serde_json::from_str::<Grasp>(&text).unwrap(), turned);
    assert_eq!(turned.joints_of(&robot).unwrap(), q);
    let refused = |grasp: &Grasp, word: &str| match grasp.joints_of(&robot) {
        Err(GraspError::Robot(message)) => assert!(message.contains(word), "{message}"),
        other => panic!("{word}: {other:?}"),
    };
    let mut other = grasp.clone();
    other.joint_names[3] = "knee".into();
    refused(&other, &format!("nothing of joint \"{}\"", robot.joints[3].name));
    let mut short = grasp.clone();
    short.joints_rad.truncate(3);
    refused(&short, "16 joints with 3 angles");
    let mut left = grasp;
    left.hand = "allegro_right".into();
    refused(&left, "none of \"leap_right\"");
}

#[test]
fn grip_force_with_motors_is_never_smaller_than_without() {
    let robot = Robot::bundled("allegro_right").unwrap();
    let q = robot.mid_range();
    let poses = robot.forward_kinematics(&q, &Isometry3::identity());
    // A ball among the fingertips, large enough to touch all of them.
    let tips: Vec<Point3<f64>> = robot.fingers().iter().map(|f| poses[f.tip_link] * f.tip_point).collect();
    let center = Point3::from(tips.iter().map(|t| t.coords).sum::<Vector3<f64>>() / tips.len() as f64);
    let mut contacts: Vec<_> = tips.iter().map(|t| drex_grasp::Contact::new(*t, center - t, 0.8)).collect();
    for (c, f) in contacts.iter_mut().zip(robot.fingers()) {
        c.link = f.tip_link;
    }
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let limits = TorqueLimits::of_robot(&robot, &q, &Isometry3::identity(), &contacts, &gravity).unwrap();
    let problem = GripForceProblem::new(contacts, 0.3, center, gravity);
    if let (Ok(free), Ok(bound)) =
        (minimum_grip_force(&problem), minimum_grip_force(&problem.clone().with_torques(limits)))
    {
        assert!(bound.total_n >= free.total_n * (1.0 - 1e-6));
        assert_eq!(bound.joint_torques_nm.len(), robot.dof());
        assert!(bound.torque_margin >= -1e-6);
    } else {
        panic!("four contacts around a ball carry 300 g");
    }
}

#[test]
fn a_link_has_no_more_contacts_than_it_may() {
    let robot = Robot::bundled("leap_right").unwrap();
    let q = robot.mid_range();
    let (ball, link) = ball_at_the_fingertip(&robot, &q, 0.004);
    for most in 1..=4 {
        let mut options = ContactOptions::default();
        (options.max_per_link, options.separation_m) = (most, 0.0005);
        let found = find_contacts(&robot, &q, &Isometry3::identity(), &ball, &options).unwrap();
        assert_eq!(found.iter().filter(|c| c.link == link).count(), most);
    }
}
