//! Derivatives against finite differences and dual numbers; the equations of motion against energy.
#![allow(clippy::unwrap_used, missing_docs, reason = "a test that fails by panic is what tests are")]

use drex_robot::Robot;
use nalgebra::{DVector, Isometry3, Point3, UnitQuaternion, Vector3};
use num_dual::Dual64;
use proptest::prelude::*;

/// Every kind of joint, orientation and primitive; compared with MuJoCo in `golden_kinematics.rs`.
const ODD: &str = include_str!("golden/odd.xml");

fn models() -> [Robot; 3] {
    [
        Robot::from_mjcf_str(ODD, None).unwrap(),
        Robot::bundled("leap_right").unwrap(),
        Robot::bundled("allegro_right").unwrap(),
    ]
}

/// Joint vector at fractions of the range.
fn within(robot: &Robot, fractions: &[f64]) -> Vec<f64> {
    robot
        .joints
        .iter()
        .zip(fractions)
        .map(|(j, s)| j.limits.map_or(2.0 * s - 1.0, |(lo, hi)| lo + s * (hi - lo)))
        .collect()
}

fn base() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(0.3, -0.2, 0.5), Vector3::new(0.4, -1.1, 0.7))
}

#[test]
fn a_body_with_three_joints_becomes_a_chain() {
    let robot = &models()[0];
    let names: Vec<&str> = robot.links.iter().map(|l| l.name.as_str()).collect();
    assert_eq!(names, ["base", "arm:a", "arm:b", "arm", "hand", "finger", "other", "weighed", "unbalanced"]);
    assert!(robot.links.iter().all(|l| l.joints.len() <= 1));
    assert!(robot.links.iter().enumerate().all(|(i, l)| l.parent.is_none_or(|p| p < i)));
    assert!((robot.joints[0].reference - 25f64.to_radians()).abs() < 1e-15);
    assert_eq!(robot.joints[1].reference, 0.1);
    // The chain inside one body is one body for collisions.
    let (base, arm, hand) = (0, 3, 4);
    assert!(!robot.may_collide(base, arm) && !robot.may_collide(arm, hand) && robot.may_collide(base, hand));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn jacobian_equals_dual_and_finite_differences(fractions in prop::collection::vec(0.05..0.95f64, 16), which in 0..3usize) {
        let robot = &models()[which];
        let q = within(robot, &fractions);
        let poses = robot.forward_kinematics(&q, &base());
        let local = Point3::new(0.01, -0.02, 0.03);
        for link in 0..robot.links.len() {
            let point = poses[link] * local;
            let (linear, angular) = robot.jacobian(&poses, link, &point);
            for j in 0..robot.dof() {
                // Dual numbers: exact.
                let dual: Vec<Dual64> = q.iter().enumerate().map(|(i, &v)| Dual64::new(v, f64::from(u8::from(i == j)))).collect();
                let at = robot.forward_kinematics(&dual, &base().cast())[link];
                let moved = at * local.cast::<Dual64>();
                let derivative = moved.coords.map(|c| c.eps);
                prop_assert!((derivative - linear.column(j)).abs().max() < 1e-12, "link {link} joint {j}");
                let m = at.rotation.to_rotation_matrix();
                let spin = m.matrix().map(|c| c.eps) * poses[link].rotation.to_rotation_matrix().matrix().transpose();
                let omega = Vector3::new(spin[(2, 1)], spin[(0, 2)], spin[(1, 0)]);
                prop_assert!((omega - angular.column(j)).abs().max() < 1e-12, "link {link} joint {j}");

                // Central differences: second order.
                let h = 1e-5;
                let shifted = |s: f64| { let mut p = q.clone(); p[j] += s * h; robot.forward_kinematics(&p, &base())[link] };
                let (plus, minus) = (shifted(1.0), shifted(-1.0));
                let velocity = ((plus * local) - (minus * local)) / (2.0 * h);
                prop_assert!((velocity - linear.column(j)).abs().max() < 1e-8);
                let turn: UnitQuaternion<f64> = plus.rotation * minus.rotation.inverse();
                prop_assert!((turn.scaled_axis() / (2.0 * h) - angular.column(j)).abs().max() < 1e-8);
            }
        }
    }

    /// M is symmetric and positive, half q̇ᵀ M q̇ is the kinetic energy of the links, gravity torque is the slope of the
    /// potential energy, and the Coriolis part is Ṁ q̇ − ½ ∂(q̇ᵀ M q̇)/∂q (Lagrange), derivatives by dual numbers.
    #[test]
    fn mass_matrix_and_bias_force_follow_from_the_energies(
        fractions in prop::collection::vec(0.05..0.95f64, 16),
        rates in prop::collection::vec(-2.0..2.0f64, 16),
        which in 0..3usize,
    ) {
        let robot = &models()[which];
        let n = robot.dof();
        let q = within(robot, &fractions);
        let qd = DVector::from_column_slice(&rates[..n]);
        let m = robot.mass_matrix(&q);
        prop_assert!((&m - m.transpose()).abs().max() < 1e-14);
        prop_assert!(m.clone().cholesky().is_some());

        let poses = robot.forward_kinematics(&q, &Isometry3::identity());
        let mut energy = 0.5 * robot.joints.iter().zip(qd.iter()).map(|(j, v)| j.armature * v * v).sum::<f64>();
        for (i, link) in robot.links.iter().enumerate() {
            let Some(body) = &link.inertial else { continue };
            let (linear, angular) = robot.jacobian(&poses, i, &(poses[i] * body.center_of_mass));
            let (v, w) = (linear * &qd, poses[i].rotation.inverse() * (angular * &qd));
            energy += 0.5 * (body.mass_kg * v.norm_squared() + w.dot(&(body.inertia * w)));
        }
        let quadratic = 0.5 * qd.dot(&(&m * &qd));
        prop_assert!((energy - quadratic).abs() < 1e-12 * energy.max(1.0));

        let gravity = Vector3::new(1.0, -2.0, -9.0);
        let seed = |j: usize| -> Vec<Dual64> { q.iter().enumerate().map(|(i, &v)| Dual64::new(v, f64::from(u8::from(i == j)))).collect() };
        let mut m_dot_qd = DVector::zeros(n);
        let mut energy_slope = DVector::zeros(n);
        let mut potential_slope = DVector::zeros(n);
        for j in 0..n {
            let dm = robot.mass_matrix(&seed(j)).map(|c| c.eps);
            m_dot_qd += &dm * &qd * qd[j];
            energy_slope[j] = 0.5 * qd.dot(&(&dm * &qd));
            let poses = robot.forward_kinematics(&seed(j), &Isometry3::identity());
            potential_slope[j] = robot.links.iter().zip(&poses).filter_map(|(l, p)| {
                let body = l.inertial.as_ref()?;
                Some(-body.mass_kg * gravity.dot(&(p * body.center_of_mass.cast::<Dual64>()).coords.map(|c| c.eps)))
            }).sum();
        }
        let bias = robot.bias_force(&q, qd.as_slice(), &gravity);
        let lagrange = m_dot_qd - energy_slope + &potential_slope;
        prop_assert!((&bias - &lagrange).abs().max() < 1e-10 * lagrange.abs().max().max(1.0));
        prop_assert!((robot.gravity_torque(&q, &gravity) - potential_slope).abs().max() < 1e-11);
    }
}

#[test]
fn short_and_long_vectors_do_not_panic() {
    for robot in models() {
        let at_reference = robot.forward_kinematics(&robot.reference_position(), &base());
        assert_eq!(robot.forward_kinematics::<f64>(&[], &base()), at_reference);
        assert_eq!(
            robot.forward_kinematics(&[robot.reference_position(), vec![1.0; 9]].concat(), &base()),
            at_reference
        );
        assert_eq!(robot.bias_force::<f64>(&[], &[], &Vector3::zeros()).abs().max(), 0.0);
    }
}

#[test]
fn names_that_are_not_there_are_listed() {
    let robot = Robot::bundled("leap_right").unwrap();
    for message in [
        robot.joint_vector([("if_mpc", 0.1)]).unwrap_err().to_string(),
        robot.require_joint("if_mpc").unwrap_err().to_string(),
    ] {
        for part in ["leap_right", "\"if_mpc\"", "if_mcp", "th_ipl"] {
            assert!(message.contains(part), "{message}");
        }
    }
    assert!(robot.joint_vector([("if_mcp", 0.1), ("if_mcp", 0.2)]).unwrap_err().to_string().contains("twice"));
    assert!(robot.joint_vector([("if_mcp", f64::NAN)]).is_err());
    assert!(robot.joint_vector_full(&["if_mcp"], &[0.1]).unwrap_err().to_string().contains("\"if_rot\""));
    assert!(robot.require_link("wrist").unwrap_err().to_string().contains("palm, index_base"));
    let missing = Robot::resolve("shadow", std::path::Path::new("/nowhere")).unwrap_err().to_string();
    assert!(missing.contains("leap_right, allegro_right") && missing.contains("/nowhere/shadow"), "{missing}");
}

#[test]
fn clamping_and_following() {
    let robot = Robot::bundled("allegro_right").unwrap();
    let mut q = vec![5.0; robot.dof()];
    assert_eq!(robot.clamp_to_limits(&mut q), 16);
    assert_eq!(robot.clamp_to_limits(&mut q), 0);
    assert_eq!(q[robot.joint_index("thj0").unwrap()], 1.396);
}
