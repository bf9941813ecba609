//! Drives, friction, limits; what is refused.

use super::*;
use crate::{Dual, Error, parameter, tangents};

/// An arm of 1 kg whose centre of mass is 0.1 m out, turning about a vertical or a horizontal axis: inertia 0.012.
fn arm_with(joint: &str, actuator: &str, horizontal: bool) -> Articulation<f64> {
    let axis = if horizontal { "0 -1 0" } else { "0 0 1" };
    let text = format!(
        r#"<mujoco model="bench"><compiler angle="radian" autolimits="true"/><worldbody><body name="base">
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><body name="arm"><joint name="hinge" axis="{axis}" {joint}/>
        <inertial pos="0.1 0 0" mass="1" diaginertia="0.002 0.002 0.002"/></body></body></worldbody>
        <actuator>{actuator}</actuator></mujoco>"#
    );
    fixed(Arc::new(Robot::from_mjcf_str(&text, None).unwrap()), Pose::identity())
}

const H: f64 = 5e-4;
const INERTIA: f64 = 0.012;

fn run(
    arm: &Articulation<f64>,
    state: &mut ArticulationState<f64>,
    control: &[f64],
    time: f64,
) -> Vec<(JointForce<f64>, f64)> {
    let (mut work, mut last) = (TreeWork::default(), Vec::new());
    for k in 0..(time / H).round() as usize {
        last = step(arm, state, (k as f64 * H, H), &GRAVITY, control, &mut work);
    }
    last
}

/// Where it settles, the drive carries the weight: kp (c - g q) g = 0.1 m g0 cos q.
#[test]
fn a_position_drive_settles_where_it_carries_the_load() {
    for gear in [1.0, -3.0] {
        let arm = arm_with("", &format!(r#"<position joint="hinge" kp="20" kv="1" gear="{gear}"/>"#), true);
        let mut state = arm.at_rest(&[0.0], 0.0).unwrap();
        run(&arm, &mut state, &[0.4 * gear], 6.0);
        let q = state.q[0];
        let effort = gear * 20.0 * (0.4 * gear - gear * q);
        assert!((effort - 0.981 * q.cos()).abs() < 1e-7, "{q} {effort}");
    }
}

/// A stalled or a far drive gives its cap, no more; the arm accelerates by cap / inertia.
#[test]
fn the_torque_cap_holds() {
    let arm = arm_with("", r#"<position joint="hinge" kp="200" kv="1" gear="2" forcerange="-0.3 0.2"/>"#, false);
    for (control, cap) in [(50.0, 0.4), (-50.0, -0.6)] {
        let mut state = arm.at_rest(&[0.0], 0.0).unwrap();
        let joint_forces = run(&arm, &mut state, &[control], 0.1);
        assert_eq!(
            joint_forces.iter().map(|(force, f)| (force.kind, *f)).collect::<Vec<_>>(),
            [(JointForceKind::Actuator(0), cap)]
        );
        assert!((state.velocities[0] - cap / INERTIA * 0.1).abs() < 1e-9);
    }
}

#[test]
fn the_other_drives_follow_their_formulas() {
    let kinds = [
        (r#"<motor joint="hinge" gear="0.5"/>"#, 0.5 * 0.8),
        (r#"<velocity joint="hinge" kv="0.3" gear="2"/>"#, 2.0 * 0.3 * (0.8 - 2.0 * 0.7)),
        (
            r#"<general joint="hinge" gainprm="2" biastype="affine" biasprm="0.1 -3 -0.2"/>"#,
            2.0 * 0.8 + 0.1 - 3.0 * 0.4 - 0.2 * 0.7,
        ),
        // What feeds its own motion is taken at the old velocity.
        (
            r#"<general joint="hinge" gainprm="2" biastype="affine" biasprm="0.1 3 0.2"/>"#,
            2.0 * 0.8 + 0.1 + 3.0 * 0.4 + 0.2 * 0.7,
        ),
    ];
    for (xml, effort) in kinds {
        let arm = arm_with("", xml, false);
        let mut state = arm.at_rest(&[0.4], 0.0).unwrap();
        state.velocities[0] = 0.7;
        let (_, _, work) = equations(&arm, &state, 0.0);
        let mut joint_forces = Vec::new();
        arm.joint_forces(&state, &work, &[0.8], 1e-12, &mut joint_forces);
        assert!((joint_forces[0].force(0.7) - effort).abs() < 1e-9 && joint_forces[0].kappa >= 0.0, "{xml}");
    }
    let arm = arm_with("", r#"<motor joint="hinge" ctrlrange="-1 1"/>"#, false);
    let mut state = arm.at_rest(&[0.0], 0.0).unwrap();
    assert_eq!(run(&arm, &mut state, &[7.0], H)[0].1, 1.0);
}

/// A drive much stiffer than the step can follow comes to rest instead of blowing up.
#[test]
fn stiff_drives_are_stable() {
    let arm = arm_with(r#"damping="0.1""#, r#"<position joint="hinge" kp="1e7"/>"#, true);
    let mut state = arm.at_rest(&[0.0], 0.0).unwrap();
    run(&arm, &mut state, &[1.0], 1.0);
    assert!((state.q[0] - 1.0).abs() < 1e-6 && state.velocities[0].abs() < 1e-9, "{state:?}");
}

/// Weight 0.981 N m on 1.2 N m of friction: it gives a little, then stands still for good.
#[test]
fn dry_friction_holds_without_creep() {
    let arm = arm_with(r#"frictionloss="1.2""#, "", true);
    let mut state = arm.at_rest(&[0.0], 0.0).unwrap();
    run(&arm, &mut state, &[], 1.0);
    let early = state.clone();
    run(&arm, &mut state, &[], 10.0);
    assert!((state.q[0] - early.q[0]).abs() < 1e-12, "{}", state.q[0] - early.q[0]);
    assert!((state.q[0] + 0.981 / 1.2 * 1e-5).abs() < 1e-9, "{}", state.q[0]);
    // Too little: it falls with what is left.
    let arm = arm_with(r#"frictionloss="0.9""#, "", true);
    let mut state = arm.at_rest(&[0.0], 0.0).unwrap();
    run(&arm, &mut state, &[], 0.02);
    let early = state.velocities[0];
    run(&arm, &mut state, &[], 0.02);
    let fall = (state.velocities[0] - early) / 0.02;
    assert!((fall / (-0.081 / INERTIA) - 1.0).abs() < 1e-3, "{fall}");
}

/// u = u0 - F t / I, then rest: the way is I u0² / 2 F.
#[test]
fn dry_friction_stops_a_joint() {
    let arm = arm_with(r#"frictionloss="0.06""#, "", false);
    let mut state = arm.at_rest(&[0.0], 0.0).unwrap();
    state.velocities[0] = 2.0;
    run(&arm, &mut state, &[], 0.2);
    assert!((state.velocities[0] - 1.0).abs() < 1e-9);
    run(&arm, &mut state, &[], 0.6);
    assert!(state.velocities[0].abs() < 1e-6 && (state.q[0] - 0.4).abs() < 1e-3, "{state:?}");
}

/// Pressed against a stop it gives by torque / (inertia ω²), on either side; it hits without bouncing, and comes off.
#[test]
fn limits_hold_and_let_go() {
    let arm = arm_with(r#"range="-0.3 0.5""#, r#"<motor joint="hinge"/>"#, false);
    for (effort, stop) in [(0.5, 0.5), (-0.5, -0.3)] {
        let mut state = arm.at_rest(&[0.0], 0.0).unwrap();
        let mut work = TreeWork::default();
        let (mut back, mut fastest): (f64, f64) = (0.0, 0.0);
        for k in 0..2000 {
            step(&arm, &mut state, (f64::from(k) * H, H), &GRAVITY, &[effort], &mut work);
            // Moving off against the effort would be a bounce.
            back = back.max(-state.velocities[0] * effort.signum());
            fastest = fastest.max(state.velocities[0].abs());
        }
        let give = 0.5 / (INERTIA * 9e6);
        assert!((state.q[0] - stop - effort.signum() * give).abs() < 1e-7, "{} {stop}", state.q[0]);
        assert!(back < 0.01 * fastest, "hit at {fastest}, bounced at {back}");
        run(&arm, &mut state, &[-0.1 * effort], 0.2);
        assert!((state.q[0] - stop).abs() > 0.01 && (state.q[0] - stop) * effort < 0.0);
    }
}

/// LEAP with its friction, stops and capped drives, told to make a fist while a path lifts and turns it: every step can
/// be solved, it stays within its limits and comes to rest where the drives, the weight and at most the dry friction
/// balance.
#[test]
fn a_hand_goes_where_it_is_told() {
    let robot = Arc::new(Robot::bundled("leap_right").unwrap());
    let turned = Pose::from_parts(Vector3::z().into(), UnitQuaternion::from_scaled_axis(Vector3::new(0.3, 1.2, -0.4)));
    let path = Path::smooth(&[0.2, 0.8], &[Pose::identity(), turned]).unwrap();
    let arm = Articulation::new(robot.clone(), Base::Path(path)).unwrap();
    let mut state = arm.at_rest(&robot.mid_range(), 0.0).unwrap();
    let control: Vec<_> = robot.joints.iter().map(|j| j.limits.unwrap().1 - 0.1).collect();
    let (mut work, mut t) = (TreeWork::default(), 0.0);
    for k in 0..4000 {
        t = f64::from(k) * H;
        step(&arm, &mut state, (t, H), &GRAVITY, &control, &mut work);
        for (j, q) in robot.joints.iter().zip(&state.q) {
            let (lo, hi) = j.limits.unwrap();
            assert!((lo - 2e-3..hi + 2e-3).contains(q), "{} at {q}", j.name);
        }
    }
    assert!(state.velocities.iter().all(|u| u.abs() < 1e-6));
    let (_, weight, _) = equations(&arm, &state, t);
    for j in 0..arm.dof() {
        let balance = 0.79 * (control[j] - state.q[j]) - weight[j];
        assert!(balance.abs() < 0.029 + 1e-6, "{}: {balance}", robot.joints[j].name);
    }
}

/// d(velocity)/d(friction) = -t/I while it slides; the force of a capped drive passes the derivative of its cap.
#[test]
fn laws_pass_derivatives() {
    let mut arm: Articulation<Dual<2>> =
        arm_with(r#"frictionloss="0.06""#, r#"<position joint="hinge" kp="200" forcerange="-0.3 0.2"/>"#, false).lift();
    arm.joints[0].friction_loss = parameter(0.06, 0);
    let Some((_, cap)) = &mut arm.actuators[0].force_range else { panic!("no cap") };
    *cap = parameter(0.2, 1);
    let mut state = arm.at_rest(&[Dual::<2>::lift(0.0)], 0.0).unwrap();
    state.velocities[0] = Dual::<2>::lift(1.0);
    let mut work = TreeWork::default();
    arm.kinematics(&state, 0.0, H, &mut work);
    let mut joint_forces = Vec::new();
    arm.joint_forces(&state, &work, &[9.0], H, &mut joint_forces);
    let forces: Vec<_> = joint_forces.iter().map(|force| force.force(state.velocities[0])).collect();
    assert_eq!(
        forces.iter().map(|f| (f.value(), tangents(f)[0], tangents(f)[1])).collect::<Vec<_>>(),
        [(-0.06, -1.0, 0.0), (0.2, 0.0, 1.0)]
    );
    arm.advance(&mut state, &[Dual::<2>::lift(1.0)], (0.0, H), &joint_forces, &mut work);
    // The spring at its bound: stretched by the presliding way whatever the bound is.
    assert!((state.friction[0].value() - 1e-5).abs() < 1e-18 && tangents(&state.friction[0])[0].abs() < 1e-15);
}

#[test]
fn what_cannot_be_simulated_is_refused_by_name() {
    let leap = Arc::new(Robot::bundled("leap_right").unwrap());
    let good = fixed(leap.clone(), Pose::identity());
    let refused = |change: &dyn Fn(&mut Articulation<f64>), parts: &[&str]| {
        let mut arm = good.clone();
        change(&mut arm);
        let message = arm.check().unwrap_err().to_string();
        assert!(parts.iter().all(|p| message.contains(p)), "{message}");
    };
    refused(&|a| a.joints[2].damping = -1.0, &["leap_right", "if_pip", "damping is -1"]);
    refused(&|a| a.joints[2].armature = f64::NAN, &["if_pip", "armature is NaN"]);
    refused(&|a| a.joints[0].limits = Some((1.0, -1.0)), &["if_mcp", "limits 1 to -1"]);
    refused(&|a| a.links[3].mass_kg = -0.1, &["link", "mass -0.1"]);
    refused(&|a| a.actuators[1].gear = f64::INFINITY, &["if_rot", "gear"]);
    refused(&|a| a.actuators[1].force_range = Some((1.0, f64::NAN)), &["if_rot", "efforts 1 to NaN"]);
    refused(&|a| a.actuators[1].joint = 99, &["no joint 99"]);
    let weightless = |a: &mut Articulation<f64>| {
        a.joints[3].armature = 0.0;
        let tip = a.robot.joints[3].link;
        for l in tip..a.links.len() {
            if a.robot.path_to(l).contains(&tip) {
                a.links[l] = LinkInertia {
                    mass_kg: 0.0,
                    center_of_mass: nalgebra::Point3::origin(),
                    inertia: nalgebra::Matrix3::zeros(),
                };
            }
        }
    };
    refused(&weightless, &["if_dip", "moves no inertia", "armature"]);
    // The middle joint turns about the axis of the last one, with nothing between them.
    let arm = mjcf(
        r#"<body name="base"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <body name="first"><joint name="first" axis="0 0 1"/><inertial pos="0.1 0 0" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/>
        <body name="middle" pos="0.2 0 0"><joint name="middle" axis="0 1 0"/><inertial pos="0 0 0" mass="0.1" diaginertia="1e-9 1e-9 1e-9"/>
        <body name="last"><joint name="last" axis="0 1 0"/><inertial pos="0.1 0 0" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>
        </body></body></body></body>"#,
    );
    let mut arm = fixed(arm, Pose::identity());
    arm.check().unwrap();
    arm.links[2].mass_kg = 0.0;
    arm.links[2].inertia = nalgebra::Matrix3::zeros();
    let message = arm.check().unwrap_err().to_string();
    assert!(message.contains("middle") && message.contains("moves no inertia"), "{message}");

    let mut state = good.at_rest(&leap.mid_range(), 0.0).unwrap();
    state.velocities[4] = f64::NAN;
    assert!(good.check_state(&state).unwrap_err().to_string().contains("mf_mcp"));
    assert!(matches!(good.at_rest(&[0.0; 3], 0.0), Err(Error::Series { .. })));
    let message = |r: crate::Result<Vec<f64>>| r.unwrap_err().to_string();
    assert!(message(good.control([("no_such", 0.0)], 0.0)).contains("no drive \"no_such\""));
    assert!(message(good.control([("if_rot", f64::NAN)], 0.0)).contains("drive 1 (\"if_rot\") is NaN"));
    assert!(good.check_control(&[0.0; 3]).unwrap_err().to_string().contains("16 drives but 3 controls"));
    assert!(good.joint_index("thumb").unwrap_err().to_string().contains("if_mcp"));
    assert_eq!(good.control([("th_cmc", 0.5)], 0.1).unwrap().iter().sum::<f64>(), 0.5 + 15.0 * 0.1);
}
