//! Rollouts of one object and one robot on a table, with derivatives.

use std::sync::Arc;

use drex_core::Pose;
use drex_diffsim::{
    ActuatorKind, AppliedForce, Articulation, Base, Body, BodyState, Collider, Control, Dual, ForcePoint, Model, Part,
    Path, Record, Scalar, Scene, State, StaticBody, parameter, rollout,
};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::arrays::{Numbers, Poses, column, one_pose_or_several, out1, out2, pose, table, vector, vectors};
use crate::failure::{Result, refused};
use crate::mesh::Asset;
use crate::robot::Robot;
use crate::watch::watched;

/// What is simulated, without derivatives.
struct Setup {
    times_s: Vec<f64>,
    dt_s: f64,
    gravity: Vector3<f64>,
    table: Option<(f64, f64)>,
    object: Option<Object>,
    arm: Option<Arm>,
}

struct Object {
    asset: Arc<drex_mesh::Asset>,
    mass_kg: f64,
    start: Pose,
    velocity: Vector3<f64>,
    angular_velocity: Vector3<f64>,
    force: Option<Force>,
}

/// A force in the world at a point of the object's mesh frame.
struct Force {
    times_s: Vec<f64>,
    forces_n: Vec<Vector3<f64>>,
    point: Point3<f64>,
}

struct Arm {
    articulation: Articulation<f64>,
    q: Vec<f64>,
    control: Option<Control>,
}

/// A pose as a constant of the scalar `T`.
fn lifted<T: Scalar>(pose: &Pose) -> Pose<T> {
    let rotation = UnitQuaternion::new_unchecked(pose.rotation.coords.map(T::lift).into());
    Pose::from_parts(pose.translation.vector.map(T::lift).into(), rotation)
}

impl Setup {
    /// Runs it with this mass of the object and this friction of the table.
    fn run<T: Scalar>(&self, mass_kg: T, friction: T) -> Result<Record<T>> {
        let mut scene = Scene::empty();
        scene.gravity = self.gravity.map(T::lift);
        scene.static_bodies.extend(self.table.map(|(height_m, _)| StaticBody::table(height_m, friction)));
        let mut bodies = Vec::new();
        let mut states = Vec::new();
        if let Some(object) = &self.object {
            let collider = Collider::of_parts(&object.asset.convex_parts)?;
            bodies.push(Body::new(&object.asset.properties, mass_kg, Arc::new(collider)));
            states.push(BodyState {
                world_from_body: lifted(&object.start),
                velocity: object.velocity.map(T::lift),
                angular_velocity: object.angular_velocity.map(T::lift),
            });
            if let Some(force) = &object.force {
                let at = ForcePoint::Body(force.point);
                scene.forces.push(AppliedForce::new(Part::Body(0), &force.times_s, &force.forces_n, at)?);
            }
        }
        let mut model = Model::new(bodies);
        model.dt_s = self.dt_s;
        let mut arms = Vec::new();
        if let Some(arm) = &self.arm {
            let articulation = arm.articulation.lift::<T>();
            let q: Vec<T> = arm.q.iter().map(|x| T::lift(*x)).collect();
            arms.push(articulation.at_rest(&q, 0.0)?);
            scene.controls.extend(arm.control.clone());
            model = model.with_articulation(articulation);
        }
        Ok(rollout(&model, &scene, &State::new(states, arms), &self.times_s)?)
    }
}

/// The numbers of a record: values, and derivatives by each parameter.
struct Numbered {
    poses: Vec<[f64; 7]>,
    velocities: Vec<[f64; 3]>,
    rates: Vec<[f64; 3]>,
    joints: Vec<f64>,
    /// One per parameter.
    d_poses: Vec<Vec<[f64; 7]>>,
    d_joints: Vec<Vec<f64>>,
}

/// x, y, z, w, i, j, k with w not negative, and every derivative with the same sign.
fn entries<T: Scalar>(pose: &Pose<T>) -> [T; 7] {
    let (p, q) = (&pose.translation.vector, pose.rotation.quaternion());
    let sign = if q.w.value() < 0.0 { -1.0 } else { 1.0 };
    [p.x, p.y, p.z, q.w.scaled(sign), q.i.scaled(sign), q.j.scaled(sign), q.k.scaled(sign)]
}

fn numbered<T: Scalar>(record: &Record<T>) -> Numbered {
    let body = record.bodies.first();
    let rows: Vec<[T; 7]> = body.map_or_else(Vec::new, |b| b.poses.iter().map(entries).collect());
    let joints: Vec<T> = record.joints.first().map_or_else(Vec::new, |t| t.iter().flatten().copied().collect());
    let three = |v: &Vector3<T>| [v.x.value(), v.y.value(), v.z.value()];
    Numbered {
        poses: rows.iter().map(|r| r.map(|x| x.value())).collect(),
        velocities: body.map_or_else(Vec::new, |b| b.velocities.iter().map(three).collect()),
        rates: body.map_or_else(Vec::new, |b| b.angular_velocities.iter().map(three).collect()),
        joints: joints.iter().map(Scalar::value).collect(),
        d_poses: (0..T::TANGENTS).map(|i| rows.iter().map(|r| r.map(|x| x.tangent(i))).collect()).collect(),
        d_joints: (0..T::TANGENTS).map(|i| joints.iter().map(|x| x.tangent(i)).collect()).collect(),
    }
}

/// A simulated motion. What was not simulated is None.
#[pyclass(module = "drex", frozen, get_all)]
pub(crate) struct Motion {
    /// Times, shape (T,), seconds.
    times_s: Py<PyArray1<f64>>,
    /// Poses of the object's mesh frame in the world, shape (T, 7): x, y, z, qw, qx, qy, qz.
    poses: Option<Py<PyArray2<f64>>>,
    /// Velocity of the frame's origin in the world, shape (T, 3), m/s.
    velocities_m_s: Option<Py<PyArray2<f64>>>,
    /// Angular velocity in the world, shape (T, 3), rad/s.
    angular_velocities_rad_s: Option<Py<PyArray2<f64>>>,
    /// Joint coordinates of the robot, shape (T, dof), rad (m).
    joints: Option<Py<PyArray2<f64>>>,
    /// Derivative of `poses` by the logarithm of the object's mass, shape (T, 7).
    d_poses_d_log_mass: Option<Py<PyArray2<f64>>>,
    /// Derivative of `poses` by the logarithm of the table's friction, shape (T, 7).
    d_poses_d_log_friction: Option<Py<PyArray2<f64>>>,
    /// Derivative of `joints` by the logarithm of the object's mass, shape (T, dof).
    d_joints_d_log_mass: Option<Py<PyArray2<f64>>>,
    /// Derivative of `joints` by the logarithm of the table's friction, shape (T, dof).
    d_joints_d_log_friction: Option<Py<PyArray2<f64>>>,
}

#[pymethods]
impl Motion {
    fn __len__(&self, py: Python<'_>) -> Result<usize> {
        Ok(self.times_s.bind(py).len()?)
    }

    fn __repr__(&self, py: Python<'_>) -> Result<String> {
        let object = if self.poses.is_some() { ", object" } else { "" };
        let robot = if self.joints.is_some() { ", robot" } else { "" };
        let derivatives = if self.d_poses_d_log_mass.is_some() { ", derivatives" } else { "" };
        Ok(format!("Motion({} times{object}{robot}{derivatives})", self.times_s.bind(py).len()?))
    }
}

/// Simulates an object, a robot, or both on a table.
///
/// The world has z up; the motion starts at time zero and is recorded at `times_s` (T,). The object is an `Asset`: its convex pieces
/// touch, it starts at `pose` (its rest pose if left out) with `velocity_m_s` of its centre of mass and `angular_velocity_rad_s`, and
/// weighs `mass_kg` (the asset's if left out). `friction` is that of the table, at height `table_height_m`; without a table
/// (`table_height_m=None`) only gravity acts. A force `forces_n` (K, 3) in the world at `point_in_object_m` of the mesh's frame is held
/// from each of `force_times_s` (K,) to the next and ends with the last. The robot starts at `robot_q`, stands at `robot_base` or
/// follows several of them, (N, 7) at `robot_base_times_s`, smoothly and at rest at both ends; `robot_controls` are held for all time (A,), or
/// each from `robot_control_times_s` on (K, A). Position drives hold `robot_q` without them. `robot_friction` is that of its skin.
/// `derivatives` adds those by the logarithms of mass and friction, exact but for rounding where no contact opens or closes.
#[pyfunction]
#[pyo3(signature = (asset=None, *, times_s, pose=None, velocity_m_s=None, angular_velocity_rad_s=None, mass_kg=None, friction=None,
    table_height_m=0.0, gravity_m_s2=None, force_times_s=None, forces_n=None, point_in_object_m=None, robot=None, robot_q=None,
    robot_base=None, robot_base_times_s=None, robot_controls=None, robot_control_times_s=None, robot_friction=None, dt_s=5e-4,
    derivatives=false))]
pub(crate) fn simulate(
    py: Python<'_>,
    asset: Option<PyRef<'_, Asset>>,
    times_s: &Bound<'_, PyAny>,
    pose: Option<&Bound<'_, PyAny>>,
    velocity_m_s: Option<&Bound<'_, PyAny>>,
    angular_velocity_rad_s: Option<&Bound<'_, PyAny>>,
    mass_kg: Option<f64>,
    friction: Option<f64>,
    table_height_m: Option<f64>,
    gravity_m_s2: Option<&Bound<'_, PyAny>>,
    force_times_s: Option<&Bound<'_, PyAny>>,
    forces_n: Option<&Bound<'_, PyAny>>,
    point_in_object_m: Option<&Bound<'_, PyAny>>,
    robot: Option<PyRef<'_, Robot>>,
    robot_q: Option<&Bound<'_, PyAny>>,
    robot_base: Option<&Bound<'_, PyAny>>,
    robot_base_times_s: Option<&Bound<'_, PyAny>>,
    robot_controls: Option<&Bound<'_, PyAny>>,
    robot_control_times_s: Option<&Bound<'_, PyAny>>,
    robot_friction: Option<f64>,
    dt_s: f64,
    derivatives: bool,
) -> Result<Motion> {
    if asset.is_none() && robot.is_none() {
        return refused("there is neither an asset nor a robot; give what is to be simulated");
    }
    let times_s = column("times_s", times_s)?;
    if let Some(t) = times_s.first().filter(|t| **t < 0.0) {
        return refused(format!("times_s begins at {t} s, but the motion starts at 0; shift the times"));
    }
    let friction = friction.or(asset.as_ref().map(|a| a.inner.friction)).unwrap_or(0.5);
    let object = match &asset {
        Some(asset) => Some(object_of(
            asset,
            pose,
            (velocity_m_s, angular_velocity_rad_s),
            mass_kg,
            table_height_m.unwrap_or(0.0),
            (force_times_s, forces_n, point_in_object_m),
        )?),
        None => {
            let given = [pose, velocity_m_s, angular_velocity_rad_s, force_times_s, forces_n, point_in_object_m];
            if given.iter().any(Option::is_some) || mass_kg.is_some() {
                return refused(
                    "pose, velocities, mass and force are those of an object; give an asset, or leave them out",
                );
            }
            None
        }
    };
    let arm = match &robot {
        Some(robot) => {
            let base = base_of(robot_base, robot_base_times_s)?;
            Some(arm_of(robot, robot_q, base, robot_controls, robot_control_times_s, robot_friction)?)
        }
        None => {
            let given = [robot_q, robot_base, robot_base_times_s, robot_controls, robot_control_times_s];
            if given.iter().any(Option::is_some) || robot_friction.is_some() {
                return refused("there are settings of a robot but no robot; give robot=");
            }
            None
        }
    };
    if derivatives && !(friction > 0.0 && friction.is_finite()) {
        return refused(format!(
            "friction is {friction}, which has no logarithm; give a positive number or no derivatives"
        ));
    }
    let dof = arm.as_ref().map(|a| a.q.len());
    let moves = object.is_some();
    let setup = Setup {
        times_s,
        dt_s,
        gravity: gravity_m_s2.map_or(Ok(Vector3::new(0.0, 0.0, -9.81)), |g| vector("gravity_m_s2", g))?,
        table: table_height_m.map(|height| (height, friction)),
        object,
        arm,
    };
    let times = setup.times_s.clone();
    let numbers = watched(py, None, move |_| {
        let mass_kg = setup.object.as_ref().map_or(1.0, |o| o.mass_kg);
        let friction = setup.table.map_or(1.0, |t| t.1);
        if derivatives {
            let log = |x: f64, i: usize| -> Dual<2> { parameter::<2>(x.ln(), i).exp() };
            Ok(numbered(&setup.run(log(mass_kg, 0), log(friction, 1))?))
        } else {
            Ok(numbered(&setup.run(mass_kg, friction)?))
        }
    })?;
    let of_object = |rows: Option<&Vec<[f64; 7]>>| -> Result<Option<Py<PyArray2<f64>>>> {
        rows.filter(|_| moves).map(|rows| Ok(out2(py, rows.iter().copied())?.unbind())).transpose()
    };
    let of_robot = |data: Option<&Vec<f64>>| -> Result<Option<Py<PyArray2<f64>>>> {
        data.zip(dof).map(|(data, dof)| Ok(table(py, data.clone(), dof)?.unbind())).transpose()
    };
    let threes = |rows: &[[f64; 3]]| -> Result<Option<Py<PyArray2<f64>>>> {
        if moves { Ok(Some(out2(py, rows.iter().copied())?.unbind())) } else { Ok(None) }
    };
    Ok(Motion {
        times_s: out1(py, times).unbind(),
        poses: of_object(Some(&numbers.poses))?,
        velocities_m_s: threes(&numbers.velocities)?,
        angular_velocities_rad_s: threes(&numbers.rates)?,
        joints: of_robot(Some(&numbers.joints))?,
        d_poses_d_log_mass: of_object(numbers.d_poses.first())?,
        d_poses_d_log_friction: of_object(numbers.d_poses.get(1))?,
        d_joints_d_log_mass: of_robot(numbers.d_joints.first())?,
        d_joints_d_log_friction: of_robot(numbers.d_joints.get(1))?,
    })
}

/// An argument that may be left out.
type Given<'a, 'py> = Option<&'a Bound<'py, PyAny>>;

fn object_of(
    asset: &Asset,
    start: Given<'_, '_>,
    (velocity, angular_velocity): (Given<'_, '_>, Given<'_, '_>),
    mass_kg: Option<f64>,
    table_height_m: f64,
    force: (Given<'_, '_>, Given<'_, '_>, Given<'_, '_>),
) -> Result<Object> {
    let asset = Arc::clone(&asset.inner);
    let mass_kg = mass_kg.unwrap_or(asset.properties.mass_kg);
    if !(mass_kg > 0.0 && mass_kg.is_finite()) {
        return refused(format!("mass_kg is {mass_kg}; give a positive number of kilograms"));
    }
    let at_rest = || Pose::translation(0.0, 0.0, table_height_m) * asset.world_from_mesh_at_rest;
    let force = match force {
        (None, None, None) => None,
        (Some(times_s), Some(forces_n), Some(point)) => Some(Force {
            times_s: column("force_times_s", times_s)?,
            forces_n: vectors("forces_n", forces_n)?,
            point: vector("point_in_object_m", point)?.into(),
        }),
        _ => return refused("a force needs force_times_s, forces_n and point_in_object_m; give all three or none"),
    };
    let zero = |what, v: Given<'_, '_>| v.map_or(Ok(Vector3::zeros()), |v| vector(what, v));
    Ok(Object {
        mass_kg,
        start: start.map_or_else(|| Ok(at_rest()), |p| pose("pose", p))?,
        velocity: zero("velocity_m_s", velocity)?,
        angular_velocity: zero("angular_velocity_rad_s", angular_velocity)?,
        force,
        asset,
    })
}

fn base_of(base: Given<'_, '_>, times_s: Given<'_, '_>) -> Result<Base<f64>> {
    let poses = base.map_or(Ok(Poses::One(Pose::identity())), |b| one_pose_or_several("robot_base", b))?;
    match (poses, times_s) {
        (Poses::One(pose), None) => Ok(Base::Fixed(pose)),
        (Poses::Several(poses), Some(times_s)) => {
            Ok(Base::Path(Path::smooth(&column("robot_base_times_s", times_s)?, &poses)?))
        }
        (Poses::One(_), Some(_)) => refused("robot_base_times_s is given for one pose; give one pose per time"),
        (Poses::Several(_), None) => refused("robot_base has several poses; give robot_base_times_s, one per pose"),
    }
}

fn arm_of(
    robot: &Robot,
    q: Given<'_, '_>,
    base: Base<f64>,
    controls: Given<'_, '_>,
    control_times_s: Given<'_, '_>,
    friction: Option<f64>,
) -> Result<Arm> {
    let q = q.map_or_else(|| Ok(robot.model.reference_position()), |q| robot.joints("robot_q", q))?;
    let mut articulation = Articulation::new(Arc::clone(&robot.model), base)?;
    if let Some(friction) = friction {
        articulation = articulation.with_friction(friction);
    }
    let drives = articulation.actuators.len();
    let control = match (controls, control_times_s) {
        (None, None) if drives == 0 => None,
        (None, None) => Some(Control::constant(&holding(&articulation, &q)?)?),
        (None, Some(_)) => return refused("robot_control_times_s is given without robot_controls; give both"),
        (Some(controls), None) => {
            let wanted = format!("one control per drive, shape ({drives},); several rows need robot_control_times_s");
            Some(Control::constant(&Numbers::of("robot_controls", controls)?.finite()?.column(&wanted)?)?)
        }
        (Some(controls), Some(times_s)) => {
            let wanted = format!("one row per time and one column per drive, shape (K, {drives})");
            let rows = Numbers::of("robot_controls", controls)?.finite()?.table(&wanted)?;
            Some(Control::sampled(&column("robot_control_times_s", times_s)?, rows)?)
        }
    };
    Ok(Arm { articulation, q, control })
}

/// Controls with which position drives hold the joints where they are.
fn holding(articulation: &Articulation<f64>, q: &[f64]) -> Result<Vec<f64>> {
    let mut out = Vec::new();
    for drive in &articulation.actuators {
        match (drive.kind, q.get(drive.joint)) {
            (ActuatorKind::Position { .. }, Some(q)) => out.push(drive.gear * q),
            _ => {
                return refused(format!(
                    "robot \"{}\" has drives that do not hold a position; give robot_controls",
                    articulation.robot.name
                ));
            }
        }
    }
    Ok(out)
}
