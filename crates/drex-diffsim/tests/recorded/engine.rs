//! Every call of the simulator that the recordings need.

use std::sync::Arc;

use drex_core::{MassProperties, Pose};
use drex_diffsim::{
    AppliedForce, Articulation, ArticulationState, Base, Body, BodyState, Collider, ContactOptions, Control,
    ForcePoint, Geom, Model, Part, Result, Scene, SoftContact, State, StaticBody, rollout,
};
use drex_recording::{Drive, FingerImpedance, FingerPush};
use drex_robot::Robot;
use nalgebra::{Point3, Vector3};

use super::Push;

/// Constants of a simulation: one set for all recordings.
#[derive(Debug, Clone, Copy)]
pub struct Constants {
    pub contact: ContactOptions,
    pub dt_s: f64,
}

impl Default for Constants {
    fn default() -> Self {
        Self { contact: ContactOptions::default(), dt_s: 5e-4 }
    }
}

impl Constants {
    /// The contact that the pushes of MuJoCo were made with, as their description states it.
    pub fn mujoco() -> Self {
        let mut soft = SoftContact::default();
        soft.time_constant_s = 0.004;
        soft.impedance = [0.95, 0.99];
        soft.width_m = 5e-4;
        soft.friction_ratio = 10.0;
        let mut constants = Self::default();
        constants.contact.soft = Some(soft);
        constants
    }

    /// Contact that rebounds: a spring of 1000 rad/s, so that some ten steps resolve an impact.
    pub fn damped(damping_ratio: f64) -> Self {
        let mut constants = Self::default();
        constants.contact.frequency_rad_s = 1e3;
        constants.contact.relaxation_s = 2.0 * damping_ratio / constants.contact.frequency_rad_s;
        constants
    }
}

/// Start of a free body.
#[derive(Debug, Clone, Copy)]
pub struct Start {
    pub pose: Pose,
    /// Of the centre of mass, world, m/s.
    pub velocity: Vector3<f64>,
    /// World, rad/s.
    pub spin: Vector3<f64>,
}

/// Poses of the object at the times of the recording, with its true parameters, as `shapes`.
pub fn replay(push: &Push, shapes: &[Geom], constants: &Constants) -> Result<Vec<Pose>> {
    let mut scene = Scene::on_table(push.friction);
    for b in &push.boxes {
        scene.static_bodies.push(StaticBody::cuboid(b.center_m.into(), b.half_m.into(), push.friction)?);
    }
    let mut finger = None;
    match &push.drive {
        Drive::Force(f) => {
            let point = ForcePoint::Body(f.point_in_object);
            scene.forces.push(AppliedForce::new(Part::Body(0), &f.times_s, &f.forces_n, point)?);
        }
        Drive::Finger(f) => finger = Some(add_finger(f, &mut scene)?),
        _ => {}
    }
    let start = Start { pose: push.start, velocity: push.velocity, spin: push.spin };
    let collider = Arc::new(Collider::new(shapes)?);
    run(&push.properties, &collider, &scene, &start, finger, &push.times_s, constants)
}

/// The compliant fingertip of a recording: a ball on three slides, each driven to its command. Its weight is carried.
fn add_finger(finger: &FingerPush, scene: &mut Scene<f64>) -> Result<(Articulation<f64>, ArticulationState<f64>)> {
    let FingerImpedance { radius_m, mass_kg, armature_kg, damping_ns_m, kp_n_m, kv_ns_m, friction, home_m: [x, y, z] } =
        finger.impedance;
    let slide = |name: &str, axis: &str| {
        format!(
            r#"<joint name="{name}" type="slide" axis="{axis}" damping="{damping_ns_m}" armature="{armature_kg}"/>"#
        )
    };
    let drive = |name: &str| format!(r#"<position name="a{name}" joint="{name}" kp="{kp_n_m}" kv="{kv_ns_m}"/>"#);
    let mjcf = format!(
        r#"<mujoco model="finger"><worldbody><body name="tip" pos="{x} {y} {z}">{}{}{}
        <geom type="sphere" size="{radius_m}" mass="{mass_kg}" friction="{friction}"/></body></worldbody>
        <actuator>{}{}{}</actuator></mujoco>"#,
        slide("x", "1 0 0"),
        slide("y", "0 1 0"),
        slide("z", "0 0 1"),
        drive("x"),
        drive("y"),
        drive("z")
    );
    let robot = Arc::new(Robot::from_mjcf_str(&mjcf, None).unwrap());
    let arm = Articulation::new(Arc::clone(&robot), Base::Fixed(robot.file_world_from_base))?;
    let tip = Part::Link { articulation: 0, link: (robot.links.len() - 1) as u32 };
    let hold = [Vector3::z() * (mass_kg * 9.81), Vector3::zeros()];
    scene.forces.push(AppliedForce::new(tip, &[-1.0, 1e3], &hold, ForcePoint::Body(Point3::origin()))?);
    let rows = finger.commands.iter().map(|c| vec![c.x - x, c.y - y, c.z - z]).collect();
    scene.controls.push(Control::sampled(&finger.command_times_s, rows)?);
    let state = arm.at_rest(&[0.0; 3], 0.0)?;
    Ok((arm, state))
}

/// A body thrown onto a table.
pub fn toss(
    properties: &MassProperties,
    collider: &Arc<Collider>,
    friction: f64,
    start: &Start,
    times_s: &[f64],
    constants: &Constants,
) -> Result<Vec<Pose>> {
    run(properties, collider, &Scene::on_table(friction), start, None, times_s, constants)
}

/// A body at rest on a table, pushed by a constant force at a point of its frame between two times.
pub fn push(
    properties: &MassProperties,
    collider: &Arc<Collider>,
    friction: f64,
    start: Pose,
    force: (Vector3<f64>, Point3<f64>, [f64; 2]),
    times_s: &[f64],
) -> Result<Vec<Pose>> {
    let mut scene = Scene::on_table(friction);
    let (f, at, span) = force;
    scene.forces.push(AppliedForce::new(Part::Body(0), &span, &[f, Vector3::zeros()], ForcePoint::Body(at))?);
    let start = Start { pose: start, velocity: Vector3::zeros(), spin: Vector3::zeros() };
    run(properties, collider, &scene, &start, None, times_s, &Constants::default())
}

fn run(
    properties: &MassProperties,
    collider: &Arc<Collider>,
    scene: &Scene<f64>,
    start: &Start,
    finger: Option<(Articulation<f64>, ArticulationState<f64>)>,
    times_s: &[f64],
    constants: &Constants,
) -> Result<Vec<Pose>> {
    let mut model = Model::new(vec![Body::new(properties, properties.mass_kg, Arc::clone(collider))]);
    model.contact = constants.contact;
    model.dt_s = constants.dt_s;
    let mut body = BodyState::at_rest(start.pose);
    body.velocity = start.velocity;
    body.angular_velocity = start.spin;
    let mut state = State::new(vec![body], Vec::new());
    if let Some((arm, at_rest)) = finger {
        model = model.with_articulation(arm);
        state.articulations.push(at_rest);
    }
    Ok(rollout(&model, scene, &state, times_s)?.bodies.swap_remove(0).poses)
}
