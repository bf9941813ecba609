//! Loads, shares and the grip-force policy against closed forms and their own promises.

use crate::support::{G, down, grasp, thumb_against};
use drex_grasp::{
    Contact, GripForceError, GripForcePolicy, GripForceProblem, TorqueLimits, distribute, maximum_grip_force,
    minimum_grip_force, paper_force, required_grip_force, shake_loads,
};
use nalgebra::{DVector, Matrix3xX, Point3, Rotation3, Vector3, Vector6};
use proptest::prelude::*;

fn pinch(mass: f64) -> GripForceProblem {
    GripForceProblem::new(thumb_against(1, 0.5), mass, Point3::origin(), down())
}

/// One joint per contact: a lever of 6 cm against its normal.
fn levers(contacts: &[Contact], limit_nm: f64, own_nm: f64) -> TorqueLimits {
    let n = contacts.len();
    let jacobian = |i: usize| {
        let mut j = Matrix3xX::zeros(n);
        j.set_column(i, &(contacts[i].normal * 0.06));
        j
    };
    TorqueLimits {
        jacobians: (0..n).map(jacobian).collect(),
        limits_nm: vec![(-limit_nm, limit_nm); n],
        gravity_nm: DVector::from_element(n, own_nm),
    }
}

#[test]
fn shakes_are_the_weight_and_six_accelerations_in_any_frame() {
    let a = 0.5 * G;
    for turn in [Rotation3::identity(), Rotation3::from_euler_angles(0.4, -1.1, 2.0)] {
        let gravity = turn * down();
        let loads = shake_loads(0.2, a, &gravity);
        assert_eq!(loads.len(), 7);
        let force = |i: usize| Vector3::from(loads[i].fixed_rows::<3>(0));
        assert!((force(0) - gravity * 0.2).norm() < 1e-12);
        // Up needs more, down less, and sideways the hypotenuse.
        assert!((force(1).norm() - 0.2 * 1.5 * G).abs() < 1e-12 && (force(2).norm() - 0.2 * 0.5 * G).abs() < 1e-12);
        for i in 3..7 {
            assert!((force(i).norm() - 0.2 * G * 1.25_f64.sqrt()).abs() < 1e-12);
            assert!((force(i).dot(&gravity) - 0.2 * G * G).abs() < 1e-12);
        }
        assert!((force(3) + force(4) - force(5) - force(6)).norm() < 1e-12);
    }
    assert!(shake_loads(1.0, 1.0, &Vector3::zeros()).iter().skip(1).all(|l| (l.norm() - 1.0).abs() < 1e-12));
}

#[test]
fn a_pinch_shaken_needs_half_again_and_along_its_axis_what_the_wall_takes() {
    // Vertical: 1.5 m g / (2 μ) each. Along the pinch axis the weaker side still carries half the weight and the other
    // takes the push on top: m g / μ + m a, less than 1.5 m g / μ here.
    let problem = pinch(0.2);
    let rest = minimum_grip_force(&problem).unwrap().total_n;
    let s = required_grip_force(&problem, &shake_loads(0.2, 0.5 * G, &down())).unwrap();
    assert_eq!(s.binding_load, Some(1), "the shake upwards");
    assert!((s.total_n - 1.5 * rest).abs() < 1e-6 && (rest - 0.2 * G / 0.5).abs() < 1e-6);
    // The friction margin is that under the binding load: with a ceiling F it is 1.5 m g / (2 F).
    let s = required_grip_force(&problem.with_max_normal_n(4.0), &shake_loads(0.2, 0.5 * G, &down())).unwrap();
    assert!((s.friction_margin - (1.0 - 1.5 * 0.2 * G / 8.0 / 0.5)).abs() < 2e-3);
}

#[test]
fn a_tilted_load_on_a_pinch_is_a_closed_form() {
    // Load at angle t from the vertical in the plane across the pinch: friction carries all of it: |w| / μ.
    // In the plane of the pinch each side carries half of the vertical part (no torque), the weaker one |w| cos t / (2 μ),
    // and the other takes the push on top: |w| cos t / μ + |w| sin t.
    let mu: f64 = 0.5;
    for t in [0.1_f64, 0.7, 1.2, 1.5] {
        let w = 2.0;
        let across = Vector6::new(0.0, w * t.sin(), -w * t.cos(), 0.0, 0.0, 0.0);
        let along = Vector6::new(w * t.sin(), 0.0, -w * t.cos(), 0.0, 0.0, 0.0);
        let s = required_grip_force(&pinch(0.0), &[across]).unwrap();
        assert!((s.total_n - w / mu).abs() < 1e-6);
        let s = required_grip_force(&pinch(0.0), &[along]).unwrap();
        assert!((s.total_n - (w * t.cos() / mu + w * t.sin())).abs() < 1e-6, "{t}: {}", s.total_n);
    }
}

#[test]
fn the_load_that_cannot_be_carried_is_named() {
    let twist = Vector6::new(0.0, 0.0, 0.0, 0.1, 0.0, 0.0);
    let rest = Vector6::new(0.0, 0.0, -1.0, 0.0, 0.0, 0.0);
    let refused = required_grip_force(&pinch(0.1), &[rest, twist, rest]);
    assert!(
        matches!(&refused, Err(GripForceError::Load { load: 1, reason, .. }) if matches!(**reason, GripForceError::NoEquilibrium { .. })),
        "{refused:?}"
    );
    assert!(refused.unwrap_err().to_string().contains("load 1"));
    // Of equal loads the first.
    assert_eq!(required_grip_force(&pinch(0.1), &[rest, rest]).unwrap().binding_load, Some(0));
    assert!(matches!(required_grip_force(&pinch(0.1), &[]), Err(GripForceError::Input(_))));
    assert!(matches!(required_grip_force(&pinch(0.1), &[rest * f64::NAN]), Err(GripForceError::Input(_))));
}

#[test]
fn the_slack_of_a_pinch_is_what_is_left_of_the_normal_force() {
    let problem = pinch(0.2);
    let need = 0.2 * G / (2.0 * 0.5);
    for total in [2.0 * need, 2.5 * need, 8.0 * need] {
        let d = distribute(&problem, total).unwrap();
        assert!((d.slack_n - (0.5 * total - need)).abs() < 1e-3 * total, "{} at {total}", d.slack_n);
        assert!(
            (d.per_finger_n[0] - 0.5 * total).abs() < 1e-6 * total
                && (d.per_finger_n[3] - 0.5 * total).abs() < 1e-6 * total
        );
        assert!(d.contact_torques_nm.is_empty() && d.torque_margin == 1.0);
    }
    let refused = distribute(&problem, 1.9 * need);
    assert!(
        matches!(refused, Err(GripForceError::Total { smallest_n, largest_n, .. }) if (smallest_n - 2.0 * need).abs() < 1e-6 && largest_n.is_infinite()),
        "{refused:?}"
    );
    assert!(matches!(distribute(&problem, f64::NAN), Err(GripForceError::Input(_))));
    // Nothing to carry: all of it is slack.
    let d = distribute(&pinch(0.0), 4.0).unwrap();
    assert!((d.slack_n - 2.0).abs() < 1e-3, "{}", d.slack_n);
}

#[test]
fn the_points_of_one_pad_share_its_slack() {
    // Finger 0 touches with three points of one pad, finger 1 with one: they still push about alike.
    let mut contacts = vec![Contact::new(Point3::new(-0.03, 0.0, 0.0), Vector3::x(), 0.5).by_finger(3)];
    for [y, z] in [[0.02, 0.004], [0.022, -0.002], [0.018, -0.002]] {
        contacts.push(Contact::new(Point3::new(0.03, y, z), -Vector3::x(), 0.5).by_finger(0));
    }
    contacts.push(Contact::new(Point3::new(0.03, -0.02, 0.0), -Vector3::x(), 0.5).by_finger(1));
    let d = distribute(&GripForceProblem::new(contacts, 0.1, Point3::origin(), down()), 8.0).unwrap();
    assert!((d.per_finger_n[0] - d.per_finger_n[1]).abs() < 0.1, "{:?}", d.per_finger_n);
}

#[test]
fn motors_and_damage_limits_bound_the_grip_force() {
    let problem = pinch(0.2);
    assert!(maximum_grip_force(&problem).unwrap().is_infinite());
    let torques = levers(&problem.contacts, 0.3, 0.06);
    let limited = problem.clone().with_torques(torques);
    // 0.06 F + 0.06 <= 0.3.
    assert!((maximum_grip_force(&limited).unwrap() - 8.0).abs() < 1e-5);
    assert!((maximum_grip_force(&problem.clone().with_max_normal_n(3.0)).unwrap() - 6.0).abs() < 1e-5);
    let d = distribute(&limited, 6.0).unwrap();
    for (own, all) in d.contact_torques_nm.iter().zip(&d.joint_torques_nm) {
        assert!((own - 0.18).abs() < 1e-6 && (all - 0.24).abs() < 1e-6);
    }
    assert!((d.torque_margin - 0.2).abs() < 1e-5);
    // At the edge itself, and not beyond it.
    let edge = maximum_grip_force(&limited).unwrap();
    for total in [edge, edge * (1.0 - 1e-7), minimum_grip_force(&limited).unwrap().total_n] {
        let d = distribute(&limited, total).unwrap();
        assert!((d.normal_n.iter().sum::<f64>() - total).abs() < 3e-5 * total);
    }
    assert!(matches!(distribute(&limited, edge * 1.001), Err(GripForceError::Total { .. })));
    let refused = distribute(&limited, 9.0);
    assert!(
        matches!(refused, Err(GripForceError::Total { largest_n, .. }) if (largest_n - 8.0).abs() < 1e-4),
        "{refused:?}"
    );
    // A limit that leaves one sum and no other.
    let only = problem.clone().with_max_normal_n(0.5 * minimum_grip_force(&problem).unwrap().total_n);
    assert!(matches!(distribute(&only, 6.0), Err(GripForceError::Total { .. })));
    let weak = problem.with_torques(levers(&limited.contacts, 0.1, 0.06));
    assert!(matches!(distribute(&weak, 6.0), Err(GripForceError::Torque { .. })));
    assert!(matches!(maximum_grip_force(&weak), Err(GripForceError::Torque { .. })));
}

#[test]
fn the_law_is_required_times_margin_within_floor_and_limits() {
    let law = GripForcePolicy::default();
    let c = law.command(&pinch(0.2)).unwrap();
    // Shakes 1.5, friction 0.9 of 0.5, margin 1.25.
    let required = 1.5 * 0.2 * G / 0.45;
    assert!((c.required_n - required).abs() < 1e-5 && (c.total_n - 1.25 * required).abs() < 1e-5);
    // Of the true cone at 0.5 the worst shake uses as much as the law says of itself.
    assert!((1.5 * 0.2 * G / (0.5 * c.total_n) - law.friction_share()).abs() < 1e-6);
    assert!((c.margin - 1.25).abs() < 1e-6 && c.largest_n.is_none() && c.binding_load == 1);
    assert!((c.paper_force - 0.2 * G * 2.0 / 5.0).abs() < 1e-12 && paper_force(2.0, G, 4) == 1.0);
    // Twice the mass, twice the force.
    assert!((law.command(&pinch(0.4)).unwrap().total_n - 2.0 * c.total_n).abs() < 1e-4);
    // A feather is held with the floor.
    let light = law.command(&pinch(0.005)).unwrap();
    assert!((light.total_n - 1.0).abs() < 1e-9 && light.margin > 1.25);
    assert!((law.command(&pinch(0.0)).unwrap().total_n - 1.0).abs() < 1e-9);
    // Limits eat the margin first, then refuse.
    // Under the sideways shake one contact bears m a more than the other: 2 F = total + m a.
    let fragile = law.with_max_contact_n(0.5 * (1.1 * required + 0.2 * 0.5 * G));
    let f = fragile.command(&pinch(0.2)).unwrap();
    assert!((f.largest_n.unwrap() - 1.1 * required).abs() < 1e-3);
    assert!((f.margin - 1.1).abs() < 1e-3 && f.distribution.normal_n.iter().all(|n| *n <= 0.55 * required * 1.001));
    let fragile = law.with_max_contact_n(0.5 * 0.9 * required);
    assert!(matches!(fragile.command(&pinch(0.2)), Err(GripForceError::Load { load: 1, .. })));
    for bad in [
        law.with_margin(0.5),
        law.with_friction_uncertainty(1.0),
        law.with_floor_n(f64::NAN),
        law.with_max_contact_n(0.0),
    ] {
        assert!(matches!(bad.command(&pinch(0.2)), Err(GripForceError::Input(_))));
    }
    for mass in [1000.0, f64::NAN, -1.0] {
        let mut strong = pinch(mass);
        strong.torques = Some(levers(&strong.contacts, 0.29, 0.0));
        assert!(law.command(&strong).is_err());
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

    #[test]
    fn a_share_keeps_its_promises(contacts in grasp(), mass in 0.02..0.5f64, more in 1.02..3.0f64) {
        let problem = GripForceProblem::new(contacts.clone(), mass, Point3::origin(), down())
            .with_torques(levers(&contacts, 1.0, 0.0));
        if let (Ok(s), Ok(largest)) = (minimum_grip_force(&problem), maximum_grip_force(&problem)) {
            prop_assert!(largest >= s.total_n * (1.0 - 1e-6));
            let total = s.total_n * more;
            let outcome = distribute(&problem, total);
            if total > largest * (1.0 + 1e-4) {
                prop_assert!(matches!(outcome, Err(GripForceError::Total { .. })), "{:?}", outcome);
                return Ok(());
            }
            if total > largest * (1.0 - 1e-4) {
                return Ok(()); // at the very edge either answer is right
            }
            let d = outcome.unwrap();
            let unit = mass * G;
            let mut wrench = Vector6::new(0.0, 0.0, -unit, 0.0, 0.0, 0.0);
            for ((c, f), normal) in contacts.iter().zip(&d.forces).zip(&d.normal_n) {
                let t = c.point.coords.cross(f);
                wrench += Vector6::new(f.x, f.y, f.z, t.x, t.y, t.z);
                let tangential = (f - c.normal * f.dot(&c.normal)).norm();
                prop_assert!(tangential <= c.friction * (normal - d.slack_n) + 1e-5 * total, "no slack left");
            }
            prop_assert!(wrench.norm() < 1e-6 * (1.0 + total), "{wrench}");
            prop_assert!((d.normal_n.iter().sum::<f64>() - total).abs() < 1e-6 * total);
            prop_assert!((d.per_finger_n.iter().sum::<f64>() + d.palm_n - total).abs() < 1e-6 * total);
            prop_assert!(d.joint_torques_nm.iter().all(|t| t.abs() <= 1.0 + 1e-6) && d.torque_margin >= -1e-6);
        }
    }

    #[test]
    fn without_motors_a_larger_grip_force_never_has_less_slack(contacts in grasp(), mass in 0.02..0.5f64) {
        let problem = GripForceProblem::new(contacts, mass, Point3::origin(), down());
        if let Ok(s) = minimum_grip_force(&problem) {
            let slack: Vec<f64> =
                [1.05, 1.3, 2.0, 4.0].iter().map(|m| distribute(&problem, m * s.total_n).unwrap().slack_n).collect();
            prop_assert!(slack.windows(2).all(|w| w[1] >= w[0] - 2e-3 * s.total_n), "{:?}", slack);
        }
    }

    #[test]
    fn required_is_the_largest_of_the_smallest(contacts in grasp(), mass in 0.02..0.5f64, turn in 0.0..3.0f64) {
        let gravity = Rotation3::from_euler_angles(0.3 * turn, 0.2, 0.0) * down();
        let problem = GripForceProblem::new(contacts, mass, Point3::origin(), gravity);
        let loads = shake_loads(mass, 0.5 * G, &gravity);
        let each: Result<Vec<f64>, GripForceError> = loads
            .iter()
            .map(|l| {
                let mut one = problem.clone().with_gamma(0.0);
                one.extra_wrench = *l;
                Ok(minimum_grip_force(&one)?.total_n)
            })
            .collect();
        match (required_grip_force(&problem, &loads), each) {
            (Ok(all), Ok(each)) => {
                let most = each.iter().copied().fold(0.0, f64::max);
                prop_assert!((all.total_n - most).abs() < 1e-5 * most);
                prop_assert!((each[all.binding_load.unwrap()] - most).abs() < 1e-5 * most);
            }
            (Err(_), Err(_)) => {}
            (a, b) => prop_assert!(false, "{:?} {:?}", a, b),
        }
    }
}
