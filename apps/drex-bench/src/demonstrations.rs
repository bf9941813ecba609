//! Synthetic demonstrations: where a human would take an object between thumb and fingers, and what the robot hand makes of it.
//!
//! A pinch is a pair of opposite points within the cone of friction. A hand in a configuration of that width is put there, its wrist above or
//! beside the object and no link in the table; its key points are the demonstration, which is retargeted as a recorded one is.
//! Noise that is solved again makes more of it. The human hands have the robot's proportions but for their size: what
//! differing proportions do is the business of recorded demonstrations.

use anyhow::{Context, Result};
use drex_core::{Pose, Surface};
use drex_demo::{Demonstration, HandFrame};
use drex_grasp::{ContactOptions, EvaluationOptions, Grasp, GraspOrigin, HandSurface};
use drex_mesh::MeshSdf;
use drex_retarget::{AugmentOptions, GraspFrame, GraspOptions, TargetHand, augment, retarget_grasp};
use nalgebra::{Point3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::configurations::{Configuration, Configurations, frame, human};
use crate::object::BenchObject;

/// What is asked of the grasps.
#[derive(Debug, Clone, PartialEq)]
pub struct DemonstrationOptions {
    /// Demonstrations that are wanted, and tried at most for each of them.
    pub clips: usize,
    pub tries: usize,
    /// Grasps that are made of each demonstration that holds.
    pub per_clip: usize,
    /// Friction of the pinch's cone and of force closure.
    pub friction: f64,
    /// The hand stays this far above the table, metres.
    pub clearance_m: f64,
    /// Largest width of a pinch, metres.
    pub widest_m: f64,
    pub seed: u64,
}

impl Default for DemonstrationOptions {
    fn default() -> Self {
        Self { clips: 40, tries: 6, per_clip: 6, friction: 0.5, clearance_m: 0.002, widest_m: 0.11, seed: 0 }
    }
}

/// Frames in which the person holds the object: the least that counts as a hold.
const FRAMES: usize = 3;
/// Points on the object from which pinches are sought.
const SITES: usize = 6000;
/// Pinches farther from the centre of mass than this become rare, metres.
const NEAR_M: f64 = 0.035;
/// Configurations that are tried for a pinch.
const POSTURES: usize = 60;
/// Configurations are wider than the pinch by up to this, metres: pads are in front of the tips.
const WIDER_M: f64 = 0.012;
/// A hand deeper in the object than this is no place for a demonstration, metres.
const DEEPEST_M: f64 = 0.006;
/// Demonstrations that are tried at once.
const BATCH: usize = 16;

/// Two opposite points: the thumb's and the fingers'.
#[derive(Debug, Clone, Copy)]
struct Pinch {
    thumb: Point3<f64>,
    fingers: Point3<f64>,
}

/// Grasps from made-up demonstrations, in the order of the demonstrations. The same for any number of threads.
///
/// # Errors
/// If the hand cannot be retargeted to.
pub fn grasps(
    object: &BenchObject,
    target: &TargetHand,
    configurations: &Configurations,
    options: &DemonstrationOptions,
) -> Result<Vec<Grasp>> {
    let surface = HandSurface::new(&target.robot, ContactOptions::default().spacing_m)?;
    let pinches = pinches(object, options)?;
    let mut out: Vec<Vec<Grasp>> = Vec::new();
    let most = (options.clips * options.tries).min(pinches.len());
    let mut tried = 0;
    while out.len() < options.clips && tried < most {
        let batch: Vec<usize> = (tried..(tried + BATCH).min(most)).collect();
        tried += batch.len();
        let made: Vec<Vec<Grasp>> = batch
            .into_par_iter()
            .map(|i| {
                let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
                rng.set_stream(1 + i as u64);
                match demonstration(object, target, &surface, configurations, &pinches[i], options, &mut rng) {
                    Some(demo) => of_demonstration(object, target, &surface, &demo, i, options),
                    None => Ok(Vec::new()),
                }
            })
            .collect::<Result<_>>()?;
        out.extend(made.into_iter().filter(|g| !g.is_empty()));
    }
    out.truncate(options.clips);
    tracing::info!("{}: {} of {tried} demonstrations hold", object.spec.name, out.len());
    let numbered = out.into_iter().enumerate();
    Ok(numbered
        .flat_map(|(source, g)| g.into_iter().map(move |g| Grasp { source, origin: GraspOrigin::Retargeted, ..g }))
        .collect())
}

/// The grasp of a demonstration, if it holds, and those made of it.
fn of_demonstration(
    object: &BenchObject,
    target: &TargetHand,
    surface: &HandSurface,
    demo: &Demonstration,
    number: usize,
    options: &DemonstrationOptions,
) -> Result<Vec<Grasp>> {
    // What a hand assumes of the friction, whatever it is.
    let mut held = object.object.clone();
    held.friction = options.friction;
    let rules = GraspOptions::default();
    let found = retarget_grasp(demo, target, &held, &rules).with_context(|| demo.source.clone())?;
    let mut limits = EvaluationOptions::candidate();
    limits.min_table_clearance_m = options.clearance_m;
    let screened = |f: &GraspFrame| f.grasp.clone().screened(surface, &held, &target.robot, &limits);
    let Some(own) = found.frames.iter().find(|f| f.is_accepted() && f.evaluation.force_closure) else {
        return Ok(Vec::new());
    };
    let Some(own) = screened(own)? else { return Ok(Vec::new()) };
    let mut vary = AugmentOptions::default();
    (vary.grasp, vary.seed) = (rules, options.seed.wrapping_add(number as u64));
    // The object's symmetries come with other demonstrations; looking for them here takes longer than solving.
    (vary.symmetry_tolerance_m, vary.attempts_per_grasp) = (0.0, 3);
    let more = augment(&found, target, &held, &vary, options.per_clip)?;
    let mut grasps = vec![own];
    for grasp in &more.grasps {
        grasps.extend(screened(&grasp.grasp)?);
    }
    Ok(grasps)
}

/// Opposite points over the table, nearer to the centre of mass more often, in random order.
fn pinches(object: &BenchObject, options: &DemonstrationOptions) -> Result<Vec<Pinch>> {
    let surface = MeshSdf::new(&object.object.mesh)?;
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let cosine = 1.0 / options.friction.hypot(1.0);
    let up = object.object.table().up.into_inner();
    let mut out = Vec::new();
    for site in object.object.surface_points(SITES, options.seed) {
        let (p, n) = (site.point, site.normal);
        let wobble = Vector3::from_fn(|_, _| rng.random_range(-0.2..0.2));
        let keep: f64 = rng.random();
        let along = (wobble - n).normalize();
        let Some(hit) = surface.ray_cast(&(p - n * 1e-4), &along, options.widest_m) else { continue };
        let Some(axis) = (hit.point - p).try_normalize(0.006) else { continue };
        if axis.dot(&-n) < cosine || axis.dot(&hit.normal) < cosine || axis.dot(&up).abs() > 0.45 {
            continue;
        }
        let middle = nalgebra::center(&p, &hit.point);
        let off = (middle - object.object.center_of_mass()).norm() / NEAR_M;
        if keep < 1.0 / (1.0 + off * off) {
            out.push(Pinch { thumb: p, fingers: hit.point });
        }
    }
    // Sites come in an even order; this one does not favour a face.
    for i in (1..out.len()).rev() {
        out.swap(i, rng.random_range(0..=i));
    }
    Ok(out)
}

/// A person that pinches there for a moment; `None` if there is no room for the hand.
fn demonstration(
    object: &BenchObject,
    target: &TargetHand,
    surface: &HandSurface,
    configurations: &Configurations,
    pinch: &Pinch,
    options: &DemonstrationOptions,
    rng: &mut ChaCha8Rng,
) -> Option<Demonstration> {
    let (configuration, object_from_base) = (0..POSTURES).find_map(|_| {
        let width = (pinch.fingers - pinch.thumb).norm();
        let configuration = configurations.any(width, WIDER_M, rng)?;
        let pose = placed(object, pinch, configuration, rng.random_range(-1.8..1.8))?;
        let links = target.robot.forward_kinematics(&configuration.q, &pose);
        let lowest = surface.lowest(&links, &object.object.table().up).into_iter().fold(f64::INFINITY, f64::min);
        if lowest - object.object.table().height_m < 2.0 * options.clearance_m {
            return None;
        }
        let depth = surface.depths(&links, &*object.object.geometry, 0.0).into_iter().fold(0.0, f64::max);
        (depth <= DEEPEST_M).then_some((configuration, pose))
    })?;
    let points = human(target, &configuration.q, rng.random_range(0.95..1.0), &object_from_base);
    let frames = (0..FRAMES)
        .map(|t| {
            let mut frame = HandFrame::new(t as f64 / 10.0, points);
            (frame.index, frame.source_from_object) = (t, Some(Pose::identity()));
            frame
        })
        .collect();
    let mut demo = Demonstration::new("a synthetic demonstration", target.side, frames);
    demo.up = Some(object.object.table().up);
    Some(demo)
}

/// The base of a hand whose pinch is at `pinch`: at a `roll` of zero from above, at a quarter turn from a side.
/// `None` for a pinch that stands upright.
fn placed(object: &BenchObject, pinch: &Pinch, configuration: &Configuration, roll: f64) -> Option<Pose> {
    let up = object.object.table().up.into_inner();
    let axis = (pinch.fingers - pinch.thumb).try_normalize(1e-6)?;
    let down = (axis * axis.dot(&up) - up).try_normalize(1e-6)?;
    let approach = Rotation3::new(axis * roll) * down;
    let middle = nalgebra::center(&pinch.thumb, &pinch.fingers);
    Some(frame(&middle, &axis, &approach)? * configuration.base_from_pinch.inverse())
}
