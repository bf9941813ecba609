//! A finger under position control presses against a wall.

use std::sync::Arc;

use drex_core::Pose;
use drex_diffsim::{ActuatorKind, Control, Model, Part, Scene, State, StaticBody, Workspace, step};
use drex_robot::Robot;
use nalgebra::{DVector, Point3, Vector3};

use crate::common::{fixed_arm, robot, within};

/// By how much drives, weight and tip are out of balance after 6 s, as a part of the torques, and the force at the tip.
fn press(robot: Arc<Robot>, q: &[f64], command: &[f64], wall: StaticBody<f64>, gravity: f64) -> (f64, f64) {
    let arm = fixed_arm(robot).with_friction(0.0);
    let mut model = Model::new(Vec::new()).with_articulation(arm);
    model.dt_s = 1e-3;
    let mut scene = Scene::empty();
    scene.gravity.z = -gravity;
    scene.static_bodies.push(wall);
    scene.controls.push(Control::constant(command).unwrap());
    let mut state = State::new(Vec::new(), vec![model.articulations[0].at_rest(q, 0.0).unwrap()]);
    let mut work = Workspace::default();
    while state.time_s < 6.0 {
        step(&model, &scene, &mut state, &mut work).unwrap();
    }
    let (arm, q) = (&model.articulations[0], &state.articulations[0].q);
    let poses = arm.robot.forward_kinematics(q, &Pose::identity());
    let (mut tip, mut force) = (DVector::zeros(q.len()), 0.0);
    for c in work.contacts() {
        let Part::Link { link, .. } = c.key.a else { panic!("a link touches the wall") };
        let (linear, _) = arm.robot.jacobian(&poses, link as usize, &Point3::from(c.point));
        tip += linear.transpose() * c.force;
        force += c.force.norm();
    }
    let drive = arm.actuators.iter().map(|a| match a.kind {
        ActuatorKind::Position { kp, .. } => kp * (command[a.joint] - q[a.joint]),
        _ => f64::NAN,
    });
    let drive = DVector::from_iterator(q.len(), drive);
    let off = &drive + tip - arm.robot.gravity_torque(q, &scene.gravity);
    (off.norm() / drive.norm(), force)
}

/// (18) At rest the drives hold the weight and the force at the tip: tau = g(q) - Jᵀ f.
#[test]
fn drives_carry_what_the_tip_presses() {
    let two = robot(
        r#"<body name="base"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <body name="near"><joint name="near" axis="0 -1 0" damping="0.02"/><inertial pos="0.025 0 0" mass="0.05" diaginertia="1e-5 1e-5 1e-5"/>
        <body name="far" pos="0.05 0 0"><joint name="far" axis="0 -1 0" damping="0.02"/><inertial pos="0.02 0 0" mass="0.03" diaginertia="5e-6 5e-6 5e-6"/>
        <geom type="sphere" size="0.008" pos="0.04 0 0"/></body></body></body>"#,
        r#"<position joint="near" kp="3" kv="0.05"/><position joint="far" kp="2" kv="0.05"/>"#,
    );
    let wall = |mu: f64| StaticBody::cuboid(Point3::new(0.096, 0.0, 0.0), Vector3::new(0.02, 0.1, 0.2), mu).unwrap();
    for (gravity, mu) in [(0.0, 0.0), (0.0, 0.6), (9.81, 0.6)] {
        let (off, force) = press(two.clone(), &[0.8, -1.4], &[0.6, -1.0], wall(mu), gravity);
        assert!(force > 0.5, "it presses: {force}");
        within(&format!("18 finger against a wall, mu {mu}, g {gravity}"), "tau = g(q) - Jᵀ f", off, 1e-6);
    }
}
