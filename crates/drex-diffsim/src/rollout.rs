//! Many steps: motions recorded at chosen times.

use drex_core::Pose;
use nalgebra::{Translation3, Vector3};
use rayon::prelude::*;

use crate::math::exp;
use crate::{Body, BodyState, Error, Method, Model, Result, Scalar, Scene, State, Workspace, step};

/// The motion of everything at chosen times.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Record<T: Scalar> {
    /// The times asked for, seconds.
    pub times_s: Vec<f64>,
    /// One track per body of the model.
    pub bodies: Vec<Track<T>>,
    /// One table per articulation: joint coordinates per time.
    pub joints: Vec<Vec<Vec<T>>>,
    /// The state after the last time.
    pub last: State<T>,
    /// Steps whose contact equations were not solved to full precision, or whose derivatives were lost.
    pub unconverged_steps: usize,
}

/// The motion of a body's frame.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Track<T: Scalar> {
    /// Poses in the world, one per time.
    pub poses: Vec<Pose<T>>,
    /// Velocity of the frame's origin in the world, m/s.
    pub velocities: Vec<Vector3<T>>,
    /// Angular velocity in the world, rad/s.
    pub angular_velocities: Vec<Vector3<T>>,
}

/// Steps from `start` and records everything at `times_s` (increasing, seconds of the state's clock; times before the
/// start give the start). Between two steps everything moves at a constant velocity.
///
/// # Errors
/// For a model, scene or start that cannot be simulated, times that decrease, and motion that diverges.
pub fn rollout<T: Scalar>(model: &Model<T>, scene: &Scene<T>, start: &State<T>, times_s: &[f64]) -> Result<Record<T>> {
    let mut work = Workspace::default();
    work.forgets_forces = true;
    check_with(model, scene, start, &mut work)?;
    let mut out = record(model, start, times_s, model.dt_s, |state| step(model, scene, state, &mut work))?;
    out.unconverged_steps = work.unconverged_steps();
    Ok(out)
}

/// Records the motion that `step` makes of `start` by `dt_s` seconds per call, at `times_s` as [`rollout`] does: for
/// another simulator of the same model. No step counts as unconverged.
///
/// # Errors
/// [`Error::Series`] for times that decrease or are not finite, and the errors of `step`.
pub fn record<T: Scalar, E: From<Error>>(
    model: &Model<T>,
    start: &State<T>,
    times_s: &[f64],
    dt_s: f64,
    mut step: impl FnMut(&mut State<T>) -> Result<(), E>,
) -> Result<Record<T>, E> {
    check_times(times_s)?;
    let mut state = start.clone();
    let n = times_s.len();
    let track = || Track {
        poses: Vec::with_capacity(n),
        velocities: Vec::with_capacity(n),
        angular_velocities: Vec::with_capacity(n),
    };
    let mut bodies: Vec<Track<T>> = model.bodies.iter().map(|_| track()).collect();
    let mut joints: Vec<Vec<Vec<T>>> = model.articulations.iter().map(|_| Vec::with_capacity(n)).collect();
    let mut previous = state.clone();
    // Step times are counted, not summed, so that they do not drift against the times of the samples.
    let mut steps = 0_u64;
    for &t in times_s {
        while state.time_s < t - 1e-12 {
            previous.clone_from(&state);
            step(&mut state)?;
            steps += 1;
            state.time_s = start.time_s + steps as f64 * dt_s;
        }
        let since = T::lift(if steps == 0 { 0.0 } else { (t - previous.time_s).clamp(0.0, dt_s) });
        for ((track, body), (a, b)) in
            bodies.iter_mut().zip(&model.bodies).zip(previous.bodies.iter().zip(&state.bodies))
        {
            let moved = match model.method {
                Method::SemiImplicit => between(body, a, b, since),
                #[cfg(feature = "ablation")]
                Method::Penalty { .. } | Method::PositionBased { .. } => {
                    crate::step::ablation::on_the_way(body, a, b, since / T::lift(model.dt_s))
                }
            };
            let arm = moved.rotation * body.center_of_mass.coords;
            track.poses.push(moved);
            track.velocities.push(b.velocity - b.angular_velocity.cross(&arm));
            track.angular_velocities.push(b.angular_velocity);
        }
        for (table, (a, b)) in joints.iter_mut().zip(previous.articulations.iter().zip(&state.articulations)) {
            table.push(a.q.iter().zip(&b.velocities).map(|(q, u)| *q + *u * since).collect());
        }
    }
    Ok(Record { times_s: times_s.to_vec(), bodies, joints, last: state, unconverged_steps: 0 })
}

/// One rollout to be done.
#[derive(Debug, Clone)]
pub struct Job<T: Scalar> {
    /// What is simulated.
    pub model: Model<T>,
    /// Where.
    pub scene: Scene<T>,
    /// From where.
    pub start: State<T>,
}

/// Rollouts side by side on all threads of the current rayon pool; results in the order of the jobs, the same bytes
/// with any number of threads.
pub fn rollout_batch<T: Scalar + Send + Sync>(jobs: &[Job<T>], times_s: &[f64]) -> Vec<Result<Record<T>>> {
    jobs.par_iter().map(|job| rollout(&job.model, &job.scene, &job.start, times_s)).collect()
}

/// The pose `since` seconds after `a` on the way to `b`, at the velocity of the step between.
fn between<T: Scalar>(body: &Body<T>, a: &BodyState<T>, b: &BodyState<T>, since: T) -> Pose<T> {
    let rotation = exp(&(b.angular_velocity * since)) * a.world_from_body.rotation;
    let com = a.world_from_body * body.center_of_mass + b.velocity * since;
    Pose::from_parts(Translation3::from(com.coords - rotation * body.center_of_mass.coords), rotation)
}

fn check_times(times_s: &[f64]) -> Result<()> {
    match (0..times_s.len()).find(|&i| !times_s[i].is_finite() || (i > 0 && times_s[i] < times_s[i - 1])) {
        Some(i) => Err(Error::Series {
            what: format!("record time {i} ({} s) is not finite or before its predecessor", times_s[i]),
            remedy: "sort the times".into(),
        }),
        None => Ok(()),
    }
}

/// Checks that a model, a scene and a start can be simulated together.
///
/// # Errors
/// Those of [`rollout`] that show before the first step.
pub fn check<T: Scalar>(model: &Model<T>, scene: &Scene<T>, start: &State<T>) -> Result<()> {
    check_with(model, scene, start, &mut Workspace::default())
}

fn check_with<T: Scalar>(model: &Model<T>, scene: &Scene<T>, start: &State<T>, work: &mut Workspace<T>) -> Result<()> {
    model.check()?;
    scene.check()?;
    start.check(model)?;
    for (i, force) in scene.forces.iter().enumerate() {
        crate::step::pairs::check_part(model, force.on, || format!("force {i}"))?;
    }
    crate::step::begin(model, scene, start, work, model.dt_s)?;
    crate::step::pairs::check_shapes(model, scene, work)?;
    crate::step::pairs::check_start(model, scene, work)
}
