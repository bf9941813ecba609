//! Stepping in time.

use drex_core::Pose;
use nalgebra::{Translation3, Vector3};

use crate::contact::{self, Contact};
use crate::math::{exp, renormalized, skew, solve3};
use crate::model::BodyState;
use crate::response;
use crate::{ForcePoint, Model, Result, Scalar, Scene, SimError, State};

/// Speed beyond which a rollout is called diverged, m/s.
const SPEED_LIMIT: f64 = 1e4;

/// Buffers that a step reuses; they hold nothing between steps.
#[derive(Debug)]
pub struct Workspace<T: Scalar> {
    contacts: Vec<Contact<T>>,
    response: response::Buffers<T>,
}

impl<T: Scalar> Default for Workspace<T> {
    fn default() -> Self {
        Self { contacts: Vec::new(), response: response::Buffers::default() }
    }
}

/// One step of semi-implicit Euler: forces at the old pose, new velocities, and with these the new pose.
/// Contact forces and the velocities they lead to are found together (implicit in the velocity). The gyroscopic moment is taken at the new angular velocity (one Newton step in the body's frame), orientation moves
/// by the exponential map.
///
/// # Errors
/// If the motion diverges.
pub fn step<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &mut State<T>,
    work: &mut Workspace<T>,
) -> Result<()> {
    let dt = model.dt_s;
    let t = state.time_s;
    for (index, (body, s)) in model.bodies.iter().zip(&mut state.bodies).enumerate() {
        let q = s.world_from_body.rotation;
        let com = s.world_from_body.translation.vector + q * body.center_of_mass.coords;
        // How far a point of the body can get in this step.
        let reach = s.velocity.map(|x| x.value()).norm() + s.angular_velocity.map(|x| x.value()).norm() * body.reach();
        contact::find(body, s, scene, &com, (t, reach * dt + 1e-6), &mut work.contacts);
        let (mut linear, mut moment) = (scene.gravity, Vector3::zeros());
        for force in scene.forces.iter().filter(|f| f.body == index) {
            let f = force.mean(t, dt);
            if f == Vector3::zeros() {
                continue;
            }
            let f = f.map(T::lift) * (force.gain / body.mass_kg);
            let arm = match force.point() {
                ForcePoint::Body(p) => q * (p.coords.map(T::lift) - body.center_of_mass.coords),
                ForcePoint::World(_) => match force.world_point(t + 0.5 * dt) {
                    Some(p) => p.coords.map(T::lift) - com,
                    None => Vector3::zeros(),
                },
            };
            linear += f;
            moment += arm.cross(&f);
        }
        let h = T::lift(dt);
        let free = (s.velocity + linear * h, spin(&body.unit_inertia, &q, &s.angular_velocity, &moment, h));
        let r = q.to_rotation_matrix().into_inner();
        let inertia = r * body.unit_inertia * r.transpose();
        (s.velocity, s.angular_velocity) =
            response::solve(&work.contacts, &model.contact, dt, &inertia, free, s, &mut work.response);
        let rotation = renormalized(exp(&(s.angular_velocity * h)) * q);
        let com = com + s.velocity * h;
        s.world_from_body = Pose::from_parts(Translation3::from(com - rotation * body.center_of_mass.coords), rotation);
        let speed = s.velocity.map(|x| x.value()).norm() + s.angular_velocity.map(|x| x.value()).norm();
        if speed.is_nan() || speed >= SPEED_LIMIT {
            return Err(SimError::Diverged { body: index, time_s: t, speed });
        }
    }
    state.time_s = t + dt;
    Ok(())
}

/// The new angular velocity in the world: one Newton step on J (w' - w) + h w' x J w' = h tau in the body's frame.
fn spin<T: Scalar>(
    inertia: &nalgebra::Matrix3<T>,
    q: &nalgebra::UnitQuaternion<T>,
    w: &Vector3<T>,
    moment: &Vector3<T>,
    h: T,
) -> Vector3<T> {
    let (w, tau) = (q.inverse_transform_vector(w), q.inverse_transform_vector(moment));
    let momentum = inertia * w;
    let residual = (w.cross(&momentum) - tau) * h;
    let jacobian = inertia + (skew(&w) * inertia - skew(&momentum)) * h;
    q * (w - solve3(&jacobian, &residual))
}

/// Poses of all bodies at chosen times.
#[derive(Debug, Clone, PartialEq)]
pub struct Record<T: Scalar> {
    /// The times asked for, seconds.
    pub times_s: Vec<f64>,
    /// Poses of the first body's frame, one per time.
    pub poses: Vec<Pose<T>>,
    /// Velocity of that frame's origin in the world, m/s.
    pub velocities: Vec<Vector3<T>>,
    /// Angular velocity in the world, rad/s.
    pub angular_velocities: Vec<Vector3<T>>,
    /// The state after the last time.
    pub last: State<T>,
}

/// Steps from `start` and records the first body at `times_s` (increasing, seconds of the state's clock; times before
/// the start give the start). Between two steps the pose moves at the constant velocity of that step.
///
/// # Errors
/// For a model or scene that cannot be simulated, times that decrease, and motion that diverges.
pub fn rollout<T: Scalar>(model: &Model<T>, scene: &Scene<T>, start: &State<T>, times_s: &[f64]) -> Result<Record<T>> {
    model.check()?;
    check_start(model, scene, start)?;
    if let Some(i) = (0..times_s.len()).find(|&i| !times_s[i].is_finite() || (i > 0 && times_s[i] < times_s[i - 1])) {
        return Err(SimError::Series {
            what: format!("record time {i} ({} s) is not finite or before its predecessor", times_s[i]),
            remedy: "sort the times".into(),
        });
    }
    let mut work = Workspace::default();
    let mut state = start.clone();
    let n = times_s.len();
    let (mut poses, mut velocities, mut angular_velocities) =
        (Vec::with_capacity(n), Vec::with_capacity(n), Vec::with_capacity(n));
    let mut previous = state.clone();
    // Step times are counted, not summed, so that they do not drift against the times of the samples.
    let mut steps = 0_u64;
    for &t in times_s {
        while state.time_s < t - 1e-12 {
            previous.clone_from(&state);
            step(model, scene, &mut state, &mut work)?;
            steps += 1;
            state.time_s = start.time_s + steps as f64 * model.dt_s;
        }
        let (Some(body), Some(a), Some(b)) = (model.bodies.first(), previous.bodies.first(), state.bodies.first())
        else {
            return Err(SimError::Series { what: "the model has no body".into(), remedy: "add one".into() });
        };
        let back = if steps == 0 { 0.0 } else { (t - previous.time_s).clamp(0.0, model.dt_s) };
        let from = if steps == 0 { b } else { a };
        let turn = exp(&(b.angular_velocity * T::lift(back)));
        let rotation = turn * from.world_from_body.rotation;
        let arm = from.world_from_body.rotation * body.center_of_mass.coords;
        let com = from.world_from_body.translation.vector + arm + b.velocity * T::lift(back);
        let arm = rotation * body.center_of_mass.coords;
        poses.push(Pose::from_parts(Translation3::from(com - arm), rotation));
        velocities.push(b.velocity - b.angular_velocity.cross(&arm));
        angular_velocities.push(b.angular_velocity);
    }
    Ok(Record { times_s: times_s.to_vec(), poses, velocities, angular_velocities, last: state })
}

fn check_start<T: Scalar>(model: &Model<T>, scene: &Scene<T>, start: &State<T>) -> Result<()> {
    if model.bodies.len() != start.bodies.len() {
        return Err(SimError::Series {
            what: format!("the model has {} bodies but the state {}", model.bodies.len(), start.bodies.len()),
            remedy: "give one state per body".into(),
        });
    }
    for (i, (body, s)) in model.bodies.iter().zip(&start.bodies).enumerate() {
        if !finite(s) {
            return Err(SimError::NotFinite { what: format!("body {i}: the start state") });
        }
        let points = || body.shape.iter().flat_map(|p| p.vertices());
        let center = points().map(|p| p.coords).sum::<Vector3<f64>>() / points().count().max(1) as f64;
        let size = 2.0 * points().map(|p| (p.coords - center).norm()).fold(0.0, f64::max);
        if let Some((depth_m, support)) = contact::start_depth(body, s, scene).filter(|d| d.0 > 0.25 * size) {
            return Err(SimError::StartsInside { body: i, depth_m, support });
        }
    }
    Ok(())
}

fn finite<T: Scalar>(s: &BodyState<T>) -> bool {
    let q = s.world_from_body.rotation.quaternion();
    s.world_from_body
        .translation
        .vector
        .iter()
        .chain(q.coords.iter())
        .chain(s.velocity.iter())
        .chain(s.angular_velocity.iter())
        .all(|x| x.value().is_finite())
}
