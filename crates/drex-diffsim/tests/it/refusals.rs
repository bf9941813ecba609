//! Bad input is an error that says what, where and which value; never a panic, never a number.

use drex_core::Pose;
use drex_diffsim::{
    AppliedForce, Articulation, Base, Body, Control, ForcePoint, Geom, KinematicBody, Model, Part, Path, Result, Scene,
    Shape, State, StaticBody, Workspace, rollout, step,
};
use drex_robot::Robot;
use nalgebra::{Matrix3, Point3, Vector3};
use std::sync::Arc;

use crate::common::{at, ball, body, cuboid, resting, robot};

/// The message of a refusal, which must hold all of `parts`.
#[track_caller]
fn refused<T>(outcome: Result<T>, parts: &[&str]) {
    let Err(error) = outcome else { panic!("accepted; should say {parts:?}") };
    let message = error.to_string();
    assert!(parts.iter().all(|p| message.contains(p)), "\"{message}\" should say {parts:?}");
}

fn cubes(count: usize) -> (Model<f64>, State<f64>) {
    let bodies: Vec<Body<f64>> = (0..count).map(|_| cuboid(Vector3::repeat(0.03), 0.2)).collect();
    let poses: Vec<Pose> = (0..count).map(|i| at(0.1 * i as f64, 0.0, 0.03)).collect();
    (Model::new(bodies), resting(&poses))
}

fn run(model: &Model<f64>, state: &State<f64>) -> Result<()> {
    rollout(model, &Scene::on_table(0.5), state, &[0.01]).map(|_| ())
}

/// A slide with a hinge on it, a ball at the end; one drive each.
fn two_joints() -> Arc<Robot> {
    robot(
        r#"<body name="base"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <body name="rail"><joint name="lift" type="slide" axis="0 0 1"/><inertial pos="0 0 0" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>
        <body name="tip"><joint name="swing" axis="0 1 0"/><inertial pos="0.1 0 0" mass="0.1" diaginertia="1e-5 1e-5 1e-5"/>
        <geom type="sphere" size="0.02" pos="0.1 0 0"/></body></body></body>"#,
        r#"<motor name="hoist" joint="lift"/><motor joint="swing"/>"#,
    )
}

fn arm() -> Articulation<f64> {
    Articulation::new(two_joints(), Base::Fixed(at(0.0, 0.0, 0.5))).unwrap()
}

fn with_articulation() -> (Model<f64>, Scene<f64>, State<f64>) {
    let (model, mut state) = cubes(1);
    let model = model.with_articulation(arm());
    state.articulations.push(model.articulations[0].at_rest(&[0.0, 0.0], 0.0).unwrap());
    let mut scene = Scene::on_table(0.5);
    scene.controls.push(Control::constant(&[0.0, 0.0]).unwrap());
    (model, scene, state)
}

#[test]
fn masses_name_the_body_and_the_value() {
    for (mass, said) in
        [(0.0, "mass 0 kg"), (-0.3, "mass -0.3 kg"), (f64::NAN, "mass NaN kg"), (f64::INFINITY, "mass inf kg")]
    {
        let (mut model, state) = cubes(3);
        model.bodies[2].mass_kg = mass;
        refused(run(&model, &state), &["body 2", said]);
        let mut arm = arm();
        arm.links[2].mass_kg = mass;
        if mass != 0.0 {
            refused(arm.check(), &["link tip", said]);
        }
    }
}

#[test]
fn inertia_that_breaks_the_triangle_inequality_names_the_body_and_the_moments() {
    for moments in [Vector3::new(1e-3, 1e-3, 2.1e-3), Vector3::new(-1e-3, 1e-3, 1e-3), Vector3::new(5e-3, 1e-3, 1e-3)] {
        let (mut model, state) = cubes(2);
        model.bodies[1] = body(&[], moments, 1.0);
        refused(run(&model, &state), &["body 1", "principal moments", "0.001"]);
        let mut arm = arm();
        arm.links[1].inertia = Matrix3::from_diagonal(&moments);
        refused(arm.check(), &["link rail", "0.001"]);
    }
    let (mut model, state) = cubes(1);
    model.bodies[0].unit_inertia[(0, 1)] = f64::NAN;
    refused(run(&model, &state), &["body 0", "inertia", "not finite"]);
    // A plate of no thickness is the limit that exists.
    let (mut model, state) = cubes(1);
    model.bodies[0] = body(&[], Vector3::new(1e-3, 2e-3, 3e-3), 1.0);
    run(&model, &state).unwrap();
}

#[test]
fn controls_name_the_drive_and_the_value() {
    refused(Control::constant(&[0.0, f64::NAN]), &["control 1 of row 0"]);
    refused(Control::sampled(&[0.0, 0.5], vec![vec![0.0], vec![f64::INFINITY]]), &["control 0 of row 1", "0.5 s"]);
    refused(Control::sampled(&[0.0, 0.5], vec![vec![0.0], vec![0.0, 1.0]]), &["row 1", "2 values"]);
    refused(Control::sampled(&[0.5, 0.5], vec![vec![0.0], vec![0.0]]), &["time 1"]);
    refused(arm().control([("hoist", f64::NAN)], 0.0), &["test", "hoist", "NaN"]);
    refused(arm().control([("swing", f64::NEG_INFINITY)], 0.0), &["test", "swing", "-inf"]);
    refused(arm().control([("gripper", 1.0)], 0.0), &["no drive \"gripper\"", "hoist", "swing"]);
    let (model, mut scene, state) = with_articulation();
    scene.controls = vec![Control::constant(&[0.0]).unwrap()];
    refused(rollout(&model, &scene, &state, &[0.01]), &["2 drives but 1 control"]);
    scene.controls.clear();
    refused(rollout(&model, &scene, &state, &[0.01]), &["2 drives but 0 controls"]);
}

#[test]
fn joints_are_named() {
    refused(arm().joint_index("elbow"), &["joint \"elbow\"", "there is no such joint", "lift, swing"]);
    refused(arm().at_rest(&[0.0], 0.0), &["2 joints but 1 values"]);
    refused(arm().at_rest(&[0.0, f64::NAN], 0.0), &["joint \"swing\"", "position is NaN"]);
    let (model, scene, mut state) = with_articulation();
    state.articulations[0].velocities[0] = f64::INFINITY;
    refused(rollout(&model, &scene, &state, &[0.01]), &["joint \"lift\"", "velocity is inf"]);
    let mut arm = arm();
    arm.joints[1].damping = -0.1;
    refused(arm.check(), &["joint \"swing\"", "damping is -0.1"]);
    arm.joints[1].damping = 0.1;
    arm.actuators[0].joint = 7;
    refused(arm.check(), &["hoist", "no joint 7"]);
}

#[test]
fn starts_inside_each_other_name_the_pair_and_the_depth() {
    // Body and table, body and body, body and something fixed.
    let (model, mut state) = cubes(2);
    state.bodies[1].world_from_body = at(0.2, 0.0, -0.2);
    refused(run(&model, &state), &["body 1", "0.2300 m inside static body 0"]);
    state.bodies[1].world_from_body = at(0.002, 0.0, 0.03);
    refused(run(&model, &state), &["body 0", "inside body 1", "0.058"]);
    let (model, state) = cubes(1);
    let mut scene = Scene::on_table(0.5);
    scene.static_bodies.push(StaticBody::cuboid(Point3::new(0.0, 0.0, 0.05), Vector3::repeat(0.2), 0.5).unwrap());
    refused(rollout(&model, &scene, &state, &[0.01]), &["body 0", "static body 1"]);
    // A body in a mover, a ball in the middle of a box, boxes in each other's middle.
    let mut scene = Scene::on_table(0.5);
    scene.kinematic_bodies.push(KinematicBody::sphere(0.1, 0.5, &[0.0], &[Point3::new(0.0, 0.0, 0.1)]).unwrap());
    refused(rollout(&model, &scene, &state, &[0.01]), &["body 0", "kinematic body 0"]);
    for inner in [ball(0.02, 0.1), cuboid(Vector3::repeat(0.02), 0.1), cuboid(Vector3::repeat(0.1), 0.1)] {
        let model = Model::new(vec![cuboid(Vector3::repeat(0.1), 1.0), inner]);
        refused(run(&model, &resting(&[at(0.0, 0.0, 0.1), at(0.0, 0.0, 0.1)])), &["body 0", "body 1"]);
    }
    // A link in a body and in the table.
    let (model, scene, mut state) = with_articulation();
    state.bodies[0].world_from_body = at(0.1, 0.0, 0.5);
    refused(rollout(&model, &scene, &state, &[0.01]), &["body 0", "link \"tip\"", "articulation 0"]);
    state.bodies[0].world_from_body = at(0.0, 0.0, 0.03);
    state.articulations[0].q[0] = -0.6;
    refused(rollout(&model, &scene, &state, &[0.01]), &["link \"tip\"", "static body 0"]);
}

#[test]
fn time_steps_name_the_step_and_the_limit() {
    let (mut model, state) = cubes(1);
    for (dt, said) in
        [(0.0, "time step 0 s"), (-1e-3, "time step -0.001 s"), (f64::NAN, "time step NaN s"), (0.1, "time step 0.1 s")]
    {
        model.dt_s = dt;
        refused(run(&model, &state), &[said, "0.02"]);
        let mut stepped = state.clone();
        refused(step(&model, &Scene::on_table(0.5), &mut stepped, &mut Workspace::default()), &[said, "0.02"]);
    }
}

#[cfg(feature = "ablation")]
#[test]
fn penalty_forces_are_stable_for_short_steps_only() {
    use drex_diffsim::{Method, Scheme};
    let (mut model, state) = cubes(1);
    model.dt_s = 1e-3;
    model.method = Method::Penalty { scheme: Scheme::Explicit, substeps: Some(1) };
    refused(run(&model, &state), &["0.001 s", "substeps"]);
    model.contact.stiffness_n_m = Some(1e14);
    model.method = Method::Penalty { scheme: Scheme::SemiImplicit, substeps: None };
    refused(run(&model, &state), &["0.001 s", "substeps"]);
}

#[test]
fn states_that_do_not_fit_are_refused_by_steps_too() {
    let (model, scene, state) = with_articulation();
    let attempt = |change: &dyn Fn(&mut State<f64>)| {
        let mut state = state.clone();
        change(&mut state);
        step(&model, &scene, &mut state, &mut Workspace::default())
    };
    refused(attempt(&|s| s.bodies.clear()), &["1 bodies", "0"]);
    refused(attempt(&|s| s.articulations.clear()), &["1 articulations", "0"]);
    refused(attempt(&|s| s.articulations[0].q.truncate(1)), &["test", "2 joints but 1 values of position"]);
    refused(attempt(&|s| s.articulations[0].friction.clear()), &["test", "2 joints but 0 values"]);
    refused(attempt(&|s| s.bodies[0].velocity.x = f64::NAN), &["body 0"]);
    refused(attempt(&|s| s.articulations[0].velocities[1] = f64::NAN), &["test", "swing", "velocity is NaN"]);
    refused(attempt(&|s| s.time_s = f64::NAN), &["time"]);
    assert!(attempt(&|_| {}).is_ok());
}

#[test]
fn whatever_else_is_wrong_is_named() {
    let (model, state) = cubes(2);
    let scene = |change: &dyn Fn(&mut Scene<f64>)| {
        let mut scene = Scene::on_table(0.5);
        change(&mut scene);
        rollout(&model, &scene, &state, &[0.01]).map(|_| ())
    };
    refused(scene(&|s| s.gravity.x = f64::NAN), &["gravity"]);
    refused(scene(&|s| s.static_bodies[0].material.friction = -0.1), &["static body 0", "friction -0.1"]);
    refused(scene(&|s| s.static_bodies[0].world_from_body.translation.z = f64::NAN), &["static body 0"]);
    let push = |on: Part| AppliedForce::<f64>::new(on, &[0.0], &[Vector3::x()], ForcePoint::Couple);
    refused(scene(&|s| s.forces.push(push(Part::Body(7)).unwrap())), &["force 0", "Body(7)"]);
    refused(scene(&|s| s.forces.push(push(Part::Link { articulation: 0, link: 1 }).unwrap())), &["force 0", "Link"]);
    refused(
        AppliedForce::<f64>::new(Part::Body(0), &[0.0], &[Vector3::x() * f64::NAN], ForcePoint::Couple),
        &["force"],
    );
    refused(
        AppliedForce::<f64>::new(Part::Body(0), &[0.0, 1.0], &[Vector3::x()], ForcePoint::Couple),
        &["2 times but 1 values"],
    );
    refused(Path::linear(&[0.0, f64::NAN], &[at(0.0, 0.0, 0.0); 2]), &["time 1"]);
    refused(Path::smooth(&[0.0, 0.0], &[at(0.0, 0.0, 0.0); 2]), &["time 1"]);
    let shape = |s: Shape| drex_diffsim::Collider::new(&[Geom::new(s)]);
    refused(shape(Shape::Sphere { radius_m: -0.1 }), &["radius of a sphere", "-0.1"]);
    let (mut model, state) = cubes(2);
    model.bodies[1].material.friction = f64::NAN;
    refused(run(&model, &state), &["body 1", "friction NaN"]);
    model.bodies[1].material.friction = 0.0;
    model.contact.relaxation_s = -1.0;
    refused(run(&model, &state), &["relaxation_s", "-1"]);
    model.contact.relaxation_s = 4e-3;
    let mut state = state;
    state.bodies[1].world_from_body.translation.x = f64::NAN;
    refused(run(&model, &state), &["body 1"]);
    refused(run(&model, &resting(&[])), &["2 bodies but the state 0"]);
}
