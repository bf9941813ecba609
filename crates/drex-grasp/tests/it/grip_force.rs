//! The cone programme against closed forms.

use crate::support::{G, down, grasp, thumb_against};
use drex_grasp::{Contact, GripForceError, GripForceProblem, TorqueLimits, minimum_grip_force};
use nalgebra::{DVector, Isometry3, Matrix3xX, Point3, Translation3, UnitQuaternion, Vector3, Vector6};
use proptest::prelude::*;

fn pinch(mu: f64) -> Vec<Contact> {
    vec![
        Contact::new(Point3::new(-0.03, 0.0, 0.0), Vector3::x(), mu).by_finger(0),
        Contact::new(Point3::new(0.03, 0.0, 0.0), -Vector3::x(), mu).by_finger(3),
    ]
}

#[test]
fn two_opposed_contacts_need_half_the_weight_over_mu_each() {
    let s = minimum_grip_force(&GripForceProblem::new(pinch(0.5), 0.206, Point3::origin(), down())).unwrap();
    for f in &s.normal_n {
        assert!((f - 0.206 * G / (2.0 * 0.5)).abs() < 1e-6, "{f}");
    }
    assert!((s.per_finger_n[0] - 2.02086).abs() < 1e-5 && s.per_finger_n[1] == 0.0);
    // The two forces lift exactly the weight.
    assert!((s.forces[0] + s.forces[1] + down() * 0.206).norm() < 1e-7);
    // Opposed flat contacts hold at any friction if nothing limits the force.
    assert!(s.friction_margin > 0.99, "{}", s.friction_margin);
}

#[test]
fn a_thumb_against_three_fingers_needs_the_weight_over_mu() {
    for (mass, sum) in [(0.117, 2.30), (0.206, 4.04), (0.324, 6.36)] {
        let s =
            minimum_grip_force(&GripForceProblem::new(thumb_against(3, 0.5), mass, Point3::origin(), down())).unwrap();
        assert!((s.total_n - mass * G / 0.5).abs() < 1e-6);
        assert!((s.total_n - sum).abs() < 0.006, "{} for {mass} kg", s.total_n);
        assert!((s.per_finger_n[3] - 0.5 * s.total_n).abs() < 1e-6, "the thumb carries half");
    }
}

#[test]
fn three_contacts_around_a_vertical_cylinder() {
    // At 120° around the axis, frictional force straight up: each carries a third, f_n = m g / (3 mu), and the normals balance.
    let mu = 0.4;
    let contacts = (0..3)
        .map(|k| {
            let (s, c) = (std::f64::consts::TAU * f64::from(k) / 3.0).sin_cos();
            Contact::new(Point3::new(0.04 * c, 0.04 * s, 0.0), Vector3::new(-c, -s, 0.0), mu)
        })
        .collect();
    let s = minimum_grip_force(&GripForceProblem::new(contacts, 0.3, Point3::origin(), down())).unwrap();
    for f in &s.normal_n {
        assert!((f - 0.3 * G / (3.0 * mu)).abs() < 1e-6);
    }
}

#[test]
fn a_tray_carries_without_friction() {
    let contacts = (0..3)
        .map(|k| {
            let (s, c) = (std::f64::consts::TAU * f64::from(k) / 3.0).sin_cos();
            Contact::new(Point3::new(0.04 * c, 0.04 * s, -0.02), Vector3::z(), 0.0)
        })
        .collect();
    let s = minimum_grip_force(&GripForceProblem::new(contacts, 0.3, Point3::origin(), down())).unwrap();
    assert!((s.total_n - 0.3 * G).abs() < 1e-6);
    assert_eq!(s.friction_margin, 1.0);
}

#[test]
fn the_friction_margin_of_a_wedge_is_known() {
    // Two faces lean inwards at the top by an angle a (normals point up by a below... and pinch upwards): with the normals
    // tilted *down* by a, the cones reach level only while atan(mu) >= a, so the margin is 1 - tan(a)/mu.
    let (a, mu) = (0.2_f64, 0.5);
    let contacts = [1.0, -1.0]
        .map(|side| Contact::new(Point3::new(-0.03 * side, 0.0, 0.0), Vector3::new(side * a.cos(), 0.0, -a.sin()), mu));
    let s = minimum_grip_force(&GripForceProblem::new(contacts.to_vec(), 0.1, Point3::origin(), down())).unwrap();
    assert!((s.friction_margin - (1.0 - a.tan() / mu)).abs() < 2e-3, "{}", s.friction_margin);
    // And the force: 2 f_n (mu cos a - sin a) = m g.
    assert!((s.normal_n[0] - 0.1 * G / (2.0 * (mu * a.cos() - a.sin()))).abs() < 1e-6);
}

#[test]
fn a_ceiling_on_the_force_is_the_friction_margin_of_a_pinch() {
    // At most F per contact: friction may fall to m g / (2 F).
    let s =
        minimum_grip_force(&GripForceProblem::new(pinch(0.5), 0.2, Point3::origin(), down()).with_max_normal_n(4.0))
            .unwrap();
    assert!((s.friction_margin - (1.0 - 0.2 * G / (2.0 * 4.0) / 0.5)).abs() < 2e-3);
    let refused =
        minimum_grip_force(&GripForceProblem::new(pinch(0.5), 0.2, Point3::origin(), down()).with_max_normal_n(1.9));
    assert!(
        matches!(refused, Err(GripForceError::NormalForce { needed_n, .. }) if (needed_n - 1.962).abs() < 1e-5),
        "{refused:?}"
    );
}

#[test]
fn a_floor_on_the_force_binds() {
    let s =
        minimum_grip_force(&GripForceProblem::new(pinch(0.5), 0.01, Point3::origin(), down()).with_min_normal_n(1.0))
            .unwrap();
    assert!((s.total_n - 2.0).abs() < 1e-6);
    let idle =
        minimum_grip_force(&GripForceProblem::new(pinch(0.5), 0.0, Point3::origin(), down()).with_min_normal_n(0.3))
            .unwrap();
    assert!((idle.total_n - 0.6).abs() < 1e-6);
    let none = minimum_grip_force(&GripForceProblem::new(pinch(0.5), 0.0, Point3::origin(), down())).unwrap();
    assert_eq!(none.total_n, 0.0);
}

/// Finger 0 is a lever of 6 cm that pushes along x; finger 3 is fixed to the world.
fn lever(limit_nm: f64) -> TorqueLimits {
    let mut pushes = Matrix3xX::zeros(1);
    pushes[(0, 0)] = 0.06;
    TorqueLimits {
        jacobians: vec![pushes, Matrix3xX::zeros(1)],
        limits_nm: vec![(-limit_nm, limit_nm)],
        gravity_nm: DVector::zeros(1),
    }
}

#[test]
fn torques_follow_the_forces_and_bind() {
    let problem = |limit| GripForceProblem::new(pinch(0.5), 0.2, Point3::origin(), down()).with_torques(lever(limit));
    let s = minimum_grip_force(&problem(0.2)).unwrap();
    assert!((s.joint_torques_nm[0] - 0.06 * 1.962).abs() < 1e-7);
    assert!((s.torque_margin - (1.0 - 0.06 * 1.962 / 0.2)).abs() < 1e-6);
    let refused = minimum_grip_force(&problem(0.1));
    assert!(
        matches!(refused, Err(GripForceError::Torque { joint: 0, needed_nm, limit_nm })
        if (needed_nm - 0.06 * 1.962).abs() < 1e-6 && limit_nm == 0.1),
        "{refused:?}"
    );
    // With two fingers on one side a weak joint hands its share to the other finger.
    let contacts = thumb_against(2, 0.5);
    let mut one = Matrix3xX::zeros(1);
    one[(0, 0)] = -0.06;
    let torques = TorqueLimits {
        jacobians: vec![Matrix3xX::zeros(1), one, Matrix3xX::zeros(1)],
        limits_nm: vec![(-0.03, 0.03)],
        gravity_nm: DVector::zeros(1),
    };
    let free = GripForceProblem::new(contacts, 0.2, Point3::origin(), down()).with_torsion_m(0.02);
    let s = minimum_grip_force(&free.clone().with_torques(torques)).unwrap();
    assert!(s.per_finger_n[0] <= 0.5 + 1e-6, "0.03 N m at 6 cm is 0.5 N: {:?}", s.per_finger_n);
    assert!((s.per_finger_n[0] + s.per_finger_n[1] - s.per_finger_n[3]).abs() < 1e-6);
}

#[test]
fn nothing_to_hold_with_says_so() {
    let one_sided = vec![pinch(0.5)[0].clone()];
    for contacts in [vec![], one_sided] {
        let refused = minimum_grip_force(&GripForceProblem::new(contacts, 0.2, Point3::origin(), down()));
        assert!(matches!(refused, Err(GripForceError::NoEquilibrium { .. })), "{refused:?}");
    }
    // Off-centre weight turns the pinched object: point contacts cannot, soft fingers can.
    let off = Point3::new(0.0, 0.01, 0.0);
    let problem = GripForceProblem::new(pinch(0.5), 0.2, off, down());
    assert!(matches!(minimum_grip_force(&problem), Err(GripForceError::NoEquilibrium { .. })));
    // Torque m g d about x, shared by two soft fingers: 2 t f_n >= m g d.
    let s = minimum_grip_force(&problem.with_torsion_m(0.002)).unwrap();
    assert!((s.normal_n[0] - 0.2 * G * 0.01 / (2.0 * 0.002)).abs() < 1e-5, "{:?}", s.normal_n);
}

#[test]
fn bad_input_is_refused_by_name() {
    let good = GripForceProblem::new(pinch(0.5), 0.2, Point3::origin(), down());
    let mut nan = good.clone();
    nan.mass_kg = f64::NAN;
    let mut long = good.clone();
    long.contacts[1].normal *= 2.0;
    let mut slippery = good.clone();
    slippery.contacts[0].friction = -0.1;
    let mut sizes = good.clone().with_torques(lever(1.0));
    sizes.torques.as_mut().unwrap().jacobians.pop();
    let mut limits = good.with_max_normal_n(1.0);
    limits.min_normal_n = 2.0;
    for (problem, word) in
        [(nan, "mass"), (long, "contact 1"), (slippery, "contact 0"), (sizes, "Jacobians"), (limits, "limits")]
    {
        let message = minimum_grip_force(&problem).unwrap_err().to_string();
        assert!(message.contains(word), "{message}");
    }
}

prop_compose! {
    fn pose()(axis in prop::array::uniform3(-1.0..1.0f64), angle in 0.0..3.0f64, t in prop::array::uniform3(-0.5..0.5f64)) -> Isometry3<f64> {
        let axis = nalgebra::Unit::new_normalize(Vector3::from(axis) + Vector3::new(0.0, 0.0, 1e-3));
        Isometry3::from_parts(Translation3::from(Vector3::from(t)), UnitQuaternion::from_axis_angle(&axis, angle))
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn the_frame_does_not_matter(contacts in grasp(), b_from_a in pose()) {
        let moved = contacts.iter().map(|c| {
            let mut m = c.clone();
            m.point = b_from_a * c.point;
            m.normal = b_from_a * c.normal;
            m
        }).collect();
        let a = minimum_grip_force(&GripForceProblem::new(contacts, 0.2, Point3::origin(), down()));
        let b = minimum_grip_force(&GripForceProblem::new(moved, 0.2, b_from_a * Point3::origin(), b_from_a * down()));
        match (a, b) {
            (Ok(a), Ok(b)) => prop_assert!((a.total_n - b.total_n).abs() < 1e-4 * a.total_n, "{} {}", a.total_n, b.total_n),
            (Err(a), Err(b)) => prop_assert_eq!(a, b),
            (a, b) => prop_assert!(false, "{:?} {:?}", a, b),
        }
    }

    #[test]
    fn the_grip_force_is_linear_in_the_mass_and_balances(contacts in grasp(), mass in 0.02..2.0f64) {
        let one = minimum_grip_force(&GripForceProblem::new(contacts.clone(), mass, Point3::origin(), down()));
        let two = minimum_grip_force(&GripForceProblem::new(contacts.clone(), 2.0 * mass, Point3::origin(), down()));
        if let (Ok(one), Ok(two)) = (one, two) {
            prop_assert!((two.total_n - 2.0 * one.total_n).abs() < 1e-5 * two.total_n);
            let mut wrench = Vector6::new(0.0, 0.0, -mass * G, 0.0, 0.0, 0.0);
            for ((c, f), normal) in contacts.iter().zip(&one.forces).zip(&one.normal_n) {
                let t = c.point.coords.cross(f);
                wrench += Vector6::new(f.x, f.y, f.z, t.x, t.y, t.z);
                let tangential = (f - c.normal * f.dot(&c.normal)).norm();
                prop_assert!(tangential <= c.friction * normal + 1e-6, "outside the cone");
            }
            prop_assert!(wrench.norm() < 1e-6, "{wrench}");
        }
    }

    #[test]
    fn more_friction_or_another_contact_never_costs_more(contacts in grasp()) {
        let base = minimum_grip_force(&GripForceProblem::new(contacts.clone(), 0.2, Point3::origin(), down()));
        let mut rough = contacts.clone();
        rough.iter_mut().for_each(|c| c.friction *= 1.3);
        let mut extra = contacts;
        extra.push(Contact::new(Point3::new(0.0, 0.0, -0.03), Vector3::z(), 0.5));
        if let Ok(base) = base {
            for better in [rough, extra] {
                let s = minimum_grip_force(&GripForceProblem::new(better, 0.2, Point3::origin(), down())).unwrap();
                prop_assert!(s.total_n <= base.total_n * (1.0 + 1e-5));
            }
        }
    }
}
