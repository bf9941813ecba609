//! From forces to current limits and back, against closed forms.

use drex_hw::torque_current::{
    ContactDirection, ContactForce, LimitMode, LimitOptions, LimitRamp, Nominal, RampOptions, TorqueCurrentModel,
    contact_torques, estimate_forces, torque_limits_nm,
};
use drex_robot::Robot;
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;

/// Two hinges about y, 0.1 m and 0.05 m long, and a third joint off to the side that no finger force reaches.
const PLANAR: &str = r#"<mujoco model="planar"><compiler angle="radian"/><worldbody><body name="palm"><geom size="0.01" mass="1"/>
<body name="upper"><joint name="a" axis="0 1 0" range="-2 2"/><geom size="0.01" mass="0.1"/>
<body name="lower" pos="0 0 0.1"><joint name="b" axis="0 1 0" range="-2 2"/><geom size="0.01" mass="0.1"/></body></body>
<body name="side" pos="0 0.1 0"><joint name="c" axis="0 1 0" range="-2 2"/><geom size="0.01" mass="0.1"/></body>
</body></worldbody></mujoco>"#;

fn planar() -> Robot {
    Robot::from_mjcf_str(PLANAR, None).unwrap()
}

fn models(n: usize, which: Nominal) -> Vec<TorqueCurrentModel> {
    vec![TorqueCurrentModel::nominal(which).unwrap(); n]
}

fn press(robot: &Robot, force_n: f64) -> ContactForce {
    let link = robot.link_index("lower").unwrap();
    ContactForce { link, point: Point3::new(0.0, 0.0, 0.05), force: Vector3::new(force_n, 0.0, 0.0) }
}

#[test]
fn a_straight_finger_is_a_lever() {
    let robot = planar();
    let q = vec![0.0; 3];
    let torques = contact_torques(&robot, &q, &[press(&robot, 2.0)]).unwrap();
    let joint = |name| robot.joint_index(name).unwrap();
    assert!((torques[joint("a")] - 0.3).abs() < 1e-12 && (torques[joint("b")] - 0.1).abs() < 1e-12);
    assert_eq!(torques[joint("c")], 0.0);

    let models = models(3, Nominal::LeapSimulation);
    let options = LimitOptions::default().with_range_ma(20.0, 400.0).with_friction_ma(15.0);
    let limits = options.limits_ma(&models, &torques).unwrap();
    assert_eq!(limits[joint("a")], 400.0);
    assert!((limits[joint("b")] - (0.1 / 0.53 * 1e3 + 15.0)).abs() < 1e-9);
    assert_eq!(limits[joint("c")], 20.0);
    let short = options.short_nm(&models, &torques, &limits).unwrap();
    assert!((short[joint("a")] - (0.3 - 0.385 * 0.53)).abs() < 1e-12 && short[joint("b")] == 0.0);

    let uniform = options.with_mode(LimitMode::Uniform).limits_ma(&models, &torques).unwrap();
    assert_eq!(uniform, vec![400.0; 3]);
}

#[test]
fn the_papers_number_goes_from_floor_to_cap() {
    let options = LimitOptions::default().with_range_ma(20.0, 420.0);
    let at = |f| options.uniform_ma(f);
    assert_eq!((at(0.0).unwrap(), at(0.5).unwrap(), at(1.0).unwrap()), (20.0, 220.0, 420.0));
    for bad in [-0.1, 1.1, f64::NAN] {
        assert!(at(bad).is_err());
    }
}

#[test]
fn nonsense_is_refused() {
    let robot = planar();
    let mut c = press(&robot, f64::NAN);
    assert!(contact_torques(&robot, &[0.0; 3], &[c]).is_err());
    c = press(&robot, 1.0);
    assert!(contact_torques(&robot, &[0.0; 2], &[c]).is_err());
    assert!(contact_torques(&robot, &[0.0, f64::INFINITY, 0.0], &[c]).is_err());
    c.link = 99;
    assert!(contact_torques(&robot, &[0.0; 3], &[c]).is_err());
    let models = models(3, Nominal::Xc330Sqrt);
    let o = LimitOptions::default();
    assert!(o.limits_ma(&models, &[0.1, f64::NAN, 0.0]).is_err());
    assert!(o.limits_ma(&models[..2], &[0.1, 0.0, 0.0]).is_err());
    for bad in [o.clone().with_range_ma(20.0, 10.0), o.clone().with_range_ma(f64::NAN, 10.0), o.with_friction_ma(-1.0)]
    {
        assert!(bad.limits_ma(&models, &[0.0; 3]).is_err());
    }
}

proptest! {
    /// Limits never leave floor and cap, whatever is asked.
    #[test]
    fn limits_stay_in_their_range(torques in prop::collection::vec(-1e3..1e3_f64, 3), floor in 0.0..50.0_f64, cap in 50.0..600.0_f64) {
        let options = LimitOptions::default().with_range_ma(floor, cap).with_friction_ma(10.0);
        for which in [Nominal::Xc330Linear, Nominal::Xc330Affine, Nominal::Xc330Sqrt] {
            for mode in [LimitMode::Jacobian, LimitMode::Uniform] {
                let limits = options.clone().with_mode(mode).limits_ma(&models(3, which), &torques).unwrap();
                prop_assert!(limits.iter().all(|i| (floor..=cap).contains(i)), "{:?}", limits);
            }
        }
    }

    /// Forces of four finger tips of a LEAP hand come back from the limits that they asked for.
    #[test]
    fn forces_come_back_from_their_currents(forces in prop::collection::vec(0.1..2.0_f64, 4), curl in 0.3..0.9_f64) {
        let robot = Robot::bundled("leap_right").unwrap();
        let mut q = vec![curl; robot.dof()];
        robot.clamp_to_limits(&mut q);
        let poses = robot.forward_kinematics(&q, &nalgebra::Isometry3::identity());
        let mut asked = Vec::new();
        let mut known = Vec::new();
        for (finger, force) in robot.fingers().iter().zip(&forces) {
            let direction = poses[finger.tip_link].rotation * Vector3::new(0.3, -0.5, 0.8).normalize();
            asked.push(ContactForce { link: finger.tip_link, point: finger.tip_point, force: *force * direction });
            known.push(ContactDirection { link: finger.tip_link, point: finger.tip_point, direction: 3.0 * direction });
        }
        let torques = contact_torques(&robot, &q, &asked).unwrap();
        let models = models(robot.dof(), Nominal::Xc330Affine);
        let options = LimitOptions::default().with_range_ma(0.0, 5000.0).with_friction_ma(12.0);
        let limits = options.limits_ma(&models, &torques).unwrap();
        let signed: Vec<f64> = limits.iter().zip(&torques).map(|(i, t)| i.copysign(*t)).collect();
        let estimate = estimate_forces(&robot, &q, &known, &models, &signed, 12.0).unwrap();
        prop_assert!(estimate.unique && estimate.residual_nm < 1e-9, "{:?}", estimate);
        for (found, force) in estimate.forces_n.iter().zip(&forces) {
            prop_assert!((found - force).abs() < 1e-7 * force, "{} instead of {} N", found, force);
        }
    }
}

#[test]
fn an_estimate_never_pulls_and_says_when_it_is_not_unique() {
    let robot = planar();
    let link = robot.link_index("lower").unwrap();
    let at = |z| ContactDirection { link, point: Point3::new(0.0, 0.0, z), direction: Vector3::x() };
    let models = models(3, Nominal::LeapSimulation);
    let pulled = estimate_forces(&robot, &[0.0; 3], &[at(0.05)], &models, &[-200.0, -100.0, 0.0], 0.0).unwrap();
    assert_eq!(pulled.forces_n, vec![0.0]);
    assert!(pulled.residual_nm > 0.01);
    let three = [at(0.02), at(0.035), at(0.05)];
    let shared = estimate_forces(&robot, &[0.0; 3], &three, &models, &[200.0, 60.0, 0.0], 0.0).unwrap();
    assert!(!shared.unique && shared.forces_n.iter().all(|f| *f >= 0.0));
    assert!(estimate_forces(&robot, &[0.0; 3], &[], &models, &[0.0; 3], 0.0).unwrap().forces_n.is_empty());
    let nowhere = ContactDirection { direction: Vector3::zeros(), ..at(0.05) };
    assert!(estimate_forces(&robot, &[0.0; 3], &[nowhere], &models, &[0.0; 3], 0.0).is_err());
    assert!(estimate_forces(&robot, &[0.0; 3], &three, &models, &[f64::NAN; 3], 0.0).is_err());
}

#[test]
fn limits_move_without_steps_and_heat_takes_them_back() {
    let mut options = RampOptions::default();
    options.cap_ma = 320.0;
    let mut ramp = LimitRamp::new(2, options).unwrap();
    let cool = [30.0, 30.0];
    assert_eq!(ramp.limits_ma(), [20.0, 20.0]);
    assert_eq!(ramp.step(&[300.0, 25.0], &cool, 0.1).unwrap(), [120.0, 25.0]);
    assert_eq!(ramp.step(&[1e9, 0.0], &cool, 1.0).unwrap(), [320.0, 0.0]);
    assert_eq!(ramp.step(&[0.0, 0.0], &cool, 0.01).unwrap(), [300.0, 0.0]);
    // Half-way between 55 and 68 °C half of what is above the floor is left; from 68 °C on the floor.
    assert_eq!(ramp.step(&[300.0, 300.0], &[61.5, 90.0], 1.0).unwrap(), [170.0, 20.0]);
    let before = ramp.limits_ma().to_vec();
    for (targets, celsius, dt) in [
        ([f64::NAN, 0.0], cool, 0.1),
        ([0.0, -1.0], cool, 0.1),
        ([0.0; 2], [f64::NAN, 0.0], 0.1),
        ([0.0; 2], cool, -0.1),
    ] {
        assert!(ramp.step(&targets, &celsius, dt).is_err());
    }
    assert!(ramp.step(&[0.0], &cool, 0.1).is_err());
    assert_eq!(ramp.limits_ma(), before);
}

#[test]
fn hands_that_are_told_torques_get_their_magnitudes() {
    let limits = torque_limits_nm(&[0.1, -0.2, 0.0, 9.0], 0.03, &[0.3, 0.3, 0.3, 0.25]).unwrap();
    assert_eq!(limits, [0.1, 0.2, 0.03, 0.25]);
    for (torques, floor, caps) in
        [([0.1, f64::NAN], 0.0, [0.3; 2]), ([0.1; 2], -0.1, [0.3; 2]), ([0.1; 2], 0.0, [0.3, f64::NAN])]
    {
        assert!(torque_limits_nm(&torques, floor, &caps).is_err());
    }
    assert!(torque_limits_nm(&[0.1], 0.0, &[]).is_err());
}
