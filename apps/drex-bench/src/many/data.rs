//! Verified grasps of an object for a network that is trained on many.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use drex_core::mesh::farthest_points;
use drex_core::{Object, Pose, SurfacePoint, fsutil};
use drex_grasp::{FingerClosing, Grasp, pinch_grasps, power_grasps};
use drex_mesh::asset_from_mesh;
use drex_policy::proposal::{GraspedObject, LABELLED_KG, LabelledGrasp};
use drex_robot::Robot;
use drex_trial::{
    Assumed, ClosingPlan, ConditionSpread, Engine, Evaluator as _, GripForce, TrialEvaluator, TrialOptions,
};
use nalgebra::{Point3, Vector3};
use rand::seq::SliceRandom as _;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::objects::ObjectSpec;

/// Frictions at which grasps are labelled.
const FRICTIONS: [f64; 9] = [0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0];
/// Friction while the hand closes.
const CLOSING_FRICTION: f64 = 0.5;
/// Points of a cloud, of how many each, and cameras that see some of them.
const POINTS: usize = 1024;
const OF_EACH: usize = 4;
const VIEWS: usize = 12;
/// How far cameras are, and how high they stand, rad.
const DISTANCE_M: f64 = 0.6;
const ELEVATION_RAD: [f64; 2] = [0.25, 1.1];
/// A point is hidden if the way from it to the camera is inside the object by this, metres.
const HIDDEN_M: f64 = 5e-4;
/// Generations of the climbing, and neighbours that are looked at in each.
const GENERATIONS: usize = 6;
const NEIGHBOURS: usize = 4;
/// Distinguishes the seeds of rest pose, cloud, choice and rollouts.
const REST_SEED: u64 = 0x7265_7374;
const CLOUD_SEED: u64 = 0x636c_6f75;
const CHOICE_SEED: u64 = 0x6368_6f69;
const ROLLOUT_SEED: u64 = 0x726f_6c6c;

/// The effort for one object.
#[derive(Debug, Clone)]
pub struct DataOptions {
    /// Pinches that the search looks at, and power grasps that it tries.
    pub pinches: usize,
    pub powers: usize,
    /// Grasps that are closed at most.
    pub closed: usize,
    /// Of these, how many are climbed from, to neighbours that carry more.
    pub climbed: usize,
    /// How many of all are simulated.
    pub simulated: usize,
}

/// An object at rest in a pose drawn by its probability, turned about the vertical at random.
///
/// # Errors
/// If the mesh is none of a solid.
pub fn at_rest(spec: &ObjectSpec, seed: u64) -> Result<Object> {
    let at = || format!("object \"{}\"", spec.name);
    let asset = asset_from_mesh(&spec.mesh, &spec.asset_options()).with_context(at)?;
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ REST_SEED);
    let mut left: f64 = random.random_range(0.0..1.0);
    let yaw = Pose::rotation(Vector3::z() * random.random_range(0.0..std::f64::consts::TAU));
    let poses = &asset.stable_poses;
    let drawn = poses.iter().find(|p| {
        left -= p.probability;
        left <= 0.0
    });
    let mut object = asset.to_object(&spec.name).with_context(at)?;
    object.max_finger_n = spec.max_force_n;
    if let Some(rest) = drawn.or(poses.first()) {
        object = object.with_rest_pose(yaw * rest.world_from_mesh);
    }
    Ok(object.at_world_origin())
}

/// Points of the surface in the world, spread evenly, with what each camera sees of them.
pub fn cloud(object: &Object, seed: u64) -> (Vec<Point3<f64>>, Vec<Vec<u16>>) {
    let dense = object.surface_points(OF_EACH * POINTS, seed ^ CLOUD_SEED);
    let positions: Vec<Point3<f64>> = dense.iter().map(|s| s.point).collect();
    let chosen: Vec<&SurfacePoint> = farthest_points(&positions, POINTS).into_iter().map(|i| &dense[i]).collect();
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ CLOUD_SEED);
    let object_from_world = object.world_from_object.inverse();
    let views = (0..VIEWS).map(|_| {
        let azimuth = random.random_range(0.0..std::f64::consts::TAU);
        let elevation: f64 = random.random_range(ELEVATION_RAD[0]..ELEVATION_RAD[1]);
        let level = elevation.cos();
        let eye =
            Point3::from(DISTANCE_M * Vector3::new(level * azimuth.cos(), level * azimuth.sin(), elevation.sin()));
        let eye = object_from_world * eye;
        (0..POINTS as u16).filter(|i| chosen.get(usize::from(*i)).is_some_and(|p| sees(object, &eye, p))).collect()
    });
    let views = views.collect();
    (chosen.into_iter().map(|s| object.world_from_object * s.point).collect(), views)
}

/// Whether nothing of the object is between a point of its surface and the eye, object frame.
fn sees(object: &Object, eye: &Point3<f64>, point: &SurfacePoint) -> bool {
    let way = eye - point.point;
    let (length, direction) = (way.norm(), way.normalize());
    if direction.dot(&point.normal) <= 0.05 {
        return false;
    }
    let mut at = 2e-3;
    while at < length.min(0.4) {
        let distance = object.geometry.signed_distance(&(point.point + direction * at)).distance_m;
        if distance < -HIDDEN_M {
            return false;
        }
        at += distance.max(1e-3);
    }
    true
}

/// Points of the hand that tell grasps apart: three of the palm's frame, then the fingertips, world.
fn key_points(robot: &Robot, joints: &[f64], world_from_base: &Pose) -> Vec<[f32; 3]> {
    let poses = robot.forward_kinematics(joints, world_from_base);
    let palm = poses[robot.palm_link().unwrap_or(0)];
    let corners = [Point3::origin(), Point3::new(0.05, 0.0, 0.0), Point3::new(0.0, 0.05, 0.0)];
    let tips = robot.fingers().into_iter().map(|f| poses[f.tip_link] * f.tip_point);
    corners.into_iter().map(|c| palm * c).chain(tips).map(narrow).collect()
}

fn narrow(point: Point3<f64>) -> [f32; 3] {
    point.coords.map(|v| v as f32).into()
}

/// What the search finds for an object, closed, labelled and tried once each. The same for any number of threads.
///
/// # Errors
/// If the object cannot be simulated, or is none for the hand.
pub fn grasped_object(object: &Object, robot: &Arc<Robot>, options: &DataOptions, seed: u64) -> Result<GraspedObject> {
    let (points, views) = cloud(object, seed);
    let mut found = power_grasps(object, robot, options.powers, seed)?;
    found.extend(pinch_grasps(object, robot, options.pinches, seed)?);
    let all = found.len();
    found.shuffle(&mut ChaCha8Rng::seed_from_u64(seed ^ CHOICE_SEED));
    found.truncate(options.closed);
    let stands_for = all as f32 / found.len().max(1) as f32;
    let evaluator = TrialEvaluator::new(object, robot, &TrialOptions::default(), Engine::Diffsim)?;
    let task = Task { evaluator: &evaluator, robot, object, closing: FingerClosing::new(robot)?, stands_for };
    let labelled: Vec<Option<Labelled>> = found.into_par_iter().map(|g| task.labelled(g)).collect::<Result<_>>()?;
    let mut labelled: Vec<Labelled> = labelled.into_iter().flatten().collect();
    labelled.sort_by(|a, b| a.label.demand().total_cmp(&b.label.demand()));
    let starts = labelled.par_iter().enumerate().take(options.climbed);
    let better: Vec<Option<Labelled>> = starts.map(|(i, start)| task.climb(start, seed, i)).collect::<Result<_>>()?;
    labelled.extend(better.into_iter().flatten());
    labelled.shuffle(&mut ChaCha8Rng::seed_from_u64(seed ^ CHOICE_SEED));
    let tried = labelled.par_iter_mut().enumerate().take(options.simulated);
    tried.try_for_each(|(i, g)| -> Result<()> {
        g.label.held = Some(holds(&evaluator, &g.closed, &g.label, seed, i as u64)?);
        Ok(())
    })?;
    let grasps = labelled.into_iter().map(|g| g.label).collect();
    Ok(GraspedObject { name: object.name.clone(), points: points.into_iter().map(narrow).collect(), views, grasps })
}

/// A grasp, the hand closed, and what it carries then.
struct Labelled {
    grasp: Grasp,
    closed: ClosingPlan,
    label: LabelledGrasp,
}

/// What grasps are labelled for.
struct Task<'a> {
    evaluator: &'a TrialEvaluator,
    robot: &'a Robot,
    object: &'a Object,
    closing: FingerClosing<'a>,
    stands_for: f32,
}

impl Task<'_> {
    /// The grasp with what it carries; `None` if that is nothing.
    fn labelled(&self, grasp: Grasp) -> Result<Option<Labelled>> {
        let assumed = Assumed { mass_kg: self.object.mass_kg(), friction: CLOSING_FRICTION };
        let closed = self.evaluator.close(&grasp, &assumed)?;
        let (mut least_friction, mut grip_force_n) = (Vec::new(), Vec::new());
        let mut from = 0;
        // What is heavier needs no less friction.
        for mass_kg in LABELLED_KG {
            let found = if from < FRICTIONS.len() { least(self.evaluator, &closed, mass_kg, from)? } else { None };
            from = found.map_or(FRICTIONS.len(), |f| f.0);
            least_friction.push(found.map(|f| FRICTIONS[f.0] as f32));
            grip_force_n.push(found.map(|f| f.1 as f32));
        }
        if least_friction.iter().all(Option::is_none) {
            return Ok(None);
        }
        let world_from_base = self.object.world_from_object * grasp.object_from_base;
        let label = LabelledGrasp {
            joints_rad: grasp.joints_rad.iter().map(|q| *q as f32).collect(),
            key_points: key_points(self.robot, &grasp.joints_rad, &world_from_base),
            world_from_base,
            contacts: closed.contacts().iter().map(|c| narrow(c.point)).collect(),
            least_friction,
            grip_force_n,
            stands_for: self.stands_for,
            held: None,
        };
        Ok(Some(Labelled { grasp, closed, label }))
    }

    /// Where climbing from a grasp leads, over neighbours that carry more; `None` if it has no better one.
    fn climb(&self, start: &Labelled, seed: u64, number: usize) -> Result<Option<Labelled>> {
        let mut best: Option<Labelled> = None;
        for generation in 0..GENERATIONS {
            let size = 1.0 - generation as f64 / GENERATIONS as f64;
            let mut found = None;
            for i in 0..NEIGHBOURS {
                let from = best.as_ref().unwrap_or(start);
                let stream = ((number * GENERATIONS + generation) * NEIGHBOURS + i) as u64;
                let Some(near) = self.closing.perturbed(self.object, &from.grasp, size, seed, stream)? else {
                    continue;
                };
                let least = found.as_ref().unwrap_or(from).label.demand();
                found = self.labelled(near)?.filter(|n| n.label.demand() < least).or(found);
            }
            best = found.or(best);
        }
        Ok(best)
    }
}

/// Whether the object stays in the hand in one rollout at the heaviest mass that the grasp carries, at a friction that is enough, and where the object
/// is nearly where the hand believes it.
fn holds(
    evaluator: &TrialEvaluator,
    closed: &ClosingPlan,
    grasp: &LabelledGrasp,
    seed: u64,
    number: u64,
) -> Result<bool> {
    let mut carried = LABELLED_KG.into_iter().zip(&grasp.least_friction).filter_map(|(m, f)| Some((m, (*f)?)));
    let Some((mass_kg, least)) = carried.next_back() else { return Ok(false) };
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ ROLLOUT_SEED);
    random.set_stream(number);
    let friction = random.random_range(f64::from(least)..=FRICTIONS[FRICTIONS.len() - 1]);
    let Ok(command) = evaluator.command(closed, &Assumed { mass_kg, friction }, GripForce::Required)? else {
        return Ok(false);
    };
    let spread = ConditionSpread { friction: (friction, friction), ..ConditionSpread::default() };
    let condition = spread.conditions(1, random.random())[0];
    Ok(evaluator.validate_until_failure(&command, &condition.truth(mass_kg))?.held())
}

/// Place of the least friction from `from` on at which there is a grip force, and that force, N.
fn least(evaluator: &TrialEvaluator, closed: &ClosingPlan, mass_kg: f64, from: usize) -> Result<Option<(usize, f64)>> {
    let needed = |at: usize| -> Result<Option<f64>> {
        let assumed = Assumed { mass_kg, friction: FRICTIONS[at] };
        Ok(evaluator.grip_force_n(closed, &assumed, GripForce::Required)?.ok())
    };
    let (mut at, mut low) = (FRICTIONS.len() - 1, from);
    let Some(mut force_n) = needed(at)? else { return Ok(None) };
    while low < at {
        let middle = (low + at) / 2;
        match needed(middle)? {
            Some(n) => (at, force_n) = (middle, n),
            None => low = middle + 1,
        }
    }
    Ok(Some((at, force_n)))
}

/// The grasps of a file, else new ones, which are written there.
///
/// # Errors
/// If they cannot be made, or the file cannot be read or written.
pub fn kept(file: &Path, make: impl FnOnce() -> Result<GraspedObject>) -> Result<GraspedObject> {
    if file.exists() {
        return serde_json::from_str(&fsutil::read_text(file)?).with_context(|| format!("{}", file.display()));
    }
    let made = make()?;
    fsutil::write_atomic(file, &serde_json::to_vec(&made)?)?;
    Ok(made)
}
