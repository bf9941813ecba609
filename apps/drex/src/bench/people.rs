//! Made-up people: where a person would take an object between thumb and fingers, and what the robot hand makes of it.
//!
//! A pinch is a pair of opposite points within the cone of friction. A hand in a posture of that width is put there, its wrist above or
//! beside the object and no link in the table; its key points are the demonstration, which is retargeted as a recorded one is.
//! Noise that is solved again makes more of it. The people have hands of the robot's proportions but for their size: what
//! differing proportions do is the business of recorded demonstrations.

use anyhow::{Context, Result};
use drex_core::{Pose, Surface};
use drex_demo::{Demonstration, HandFrame};
use drex_grasp::{ContactOptions, HandSurface};
use drex_mesh::sample_surface;
use drex_retarget::{AugmentOptions, GraspFrame, GraspOptions, TargetHand, augment, retarget_grasp};
use nalgebra::{Point3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::library::{Grasp, Kind};
use super::postures::{Posture, Postures, frame, person};
use super::thing::Thing;

/// What is asked of the grasps.
#[derive(Debug, Clone, PartialEq)]
pub struct PeopleOptions {
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

impl Default for PeopleOptions {
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
/// Postures that are tried for a pinch.
const POSTURES: usize = 60;
/// Postures are wider than the pinch by up to this, metres: pads are in front of the tips.
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
pub fn grasps(thing: &Thing, target: &TargetHand, postures: &Postures, options: &PeopleOptions) -> Result<Vec<Grasp>> {
    let surface = HandSurface::new(&target.robot, ContactOptions::default().spacing_m)?;
    let pinches = pinches(thing, options);
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
                match demonstration(thing, target, &surface, postures, &pinches[i], options, &mut rng) {
                    Some(demo) => of_demonstration(thing, target, &surface, &demo, i, options),
                    None => Ok(Vec::new()),
                }
            })
            .collect::<Result<_>>()?;
        out.extend(made.into_iter().filter(|g| !g.is_empty()));
    }
    out.truncate(options.clips);
    tracing::info!("{}: {} of {tried} demonstrations hold", thing.spec.name, out.len());
    let numbered = out.into_iter().enumerate();
    Ok(numbered.flat_map(|(clip, g)| g.into_iter().map(move |g| Grasp { clip, kind: Kind::Retargeted, ..g })).collect())
}

/// The grasp of a demonstration, if it holds, and those made of it.
fn of_demonstration(
    thing: &Thing,
    target: &TargetHand,
    surface: &HandSurface,
    demo: &Demonstration,
    number: usize,
    options: &PeopleOptions,
) -> Result<Vec<Grasp>> {
    let mut rules = GraspOptions::default();
    rules.friction = options.friction;
    let object = thing.surface();
    let found = retarget_grasp(demo, target, &object, &rules).with_context(|| demo.source.clone())?;
    let measured = |f: &GraspFrame| -> Result<Option<Grasp>> {
        let grasp = Grasp::measured(thing, &target.robot, surface, &f.q, &f.object_from_base, options.friction)?;
        Ok(grasp.filter(|g| g.clearance_mm >= 1e3 * options.clearance_m))
    };
    let Some(own) = found.frames.iter().find(|f| f.is_accepted() && f.force_closure) else { return Ok(Vec::new()) };
    let Some(own) = measured(own)? else { return Ok(Vec::new()) };
    let mut vary = AugmentOptions::default();
    (vary.grasp, vary.seed) = (rules, options.seed.wrapping_add(number as u64));
    // The object's symmetries come with other demonstrations; looking for them here takes longer than solving.
    (vary.symmetry_tolerance_m, vary.attempts_per_grasp) = (0.0, 3);
    let more = augment(&found, target, &object, &vary, options.per_clip)?;
    let mut grasps = vec![own];
    for grasp in &more.grasps {
        grasps.extend(measured(&grasp.grasp)?);
    }
    Ok(grasps)
}

/// Opposite points over the table, nearer to the centre of mass more often, in random order.
fn pinches(thing: &Thing, options: &PeopleOptions) -> Vec<Pinch> {
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let cosine = 1.0 / options.friction.hypot(1.0);
    let up = thing.table.up.into_inner();
    let mut out = Vec::new();
    for site in sample_surface(&thing.asset.visual, SITES, options.seed) {
        let (p, n) = (site.point, site.normal);
        let wobble = Vector3::from_fn(|_, _| rng.random_range(-0.2..0.2));
        let keep: f64 = rng.random();
        let along = (wobble - n).normalize();
        let Some(hit) = thing.sdf.ray_cast(&(p - n * 1e-4), &along, options.widest_m) else { continue };
        let Some(axis) = (hit.point - p).try_normalize(0.006) else { continue };
        if axis.dot(&-n) < cosine || axis.dot(&hit.normal) < cosine || axis.dot(&up).abs() > 0.45 {
            continue;
        }
        let middle = nalgebra::center(&p, &hit.point);
        let off = (middle - thing.center_of_mass()).norm() / NEAR_M;
        if keep < 1.0 / (1.0 + off * off) {
            out.push(Pinch { thumb: p, fingers: hit.point });
        }
    }
    // Sites come in an even order; this one does not favour a face.
    for i in (1..out.len()).rev() {
        out.swap(i, rng.random_range(0..=i));
    }
    out
}

/// A person that pinches there for a moment; `None` if there is no room for the hand.
fn demonstration(
    thing: &Thing,
    target: &TargetHand,
    surface: &HandSurface,
    postures: &Postures,
    pinch: &Pinch,
    options: &PeopleOptions,
    rng: &mut ChaCha8Rng,
) -> Option<Demonstration> {
    let (posture, object_from_base) = (0..POSTURES).find_map(|_| {
        let width = (pinch.fingers - pinch.thumb).norm();
        let posture = postures.any(width, WIDER_M, rng)?;
        let pose = placed(thing, pinch, posture, rng.random_range(-1.8..1.8))?;
        let links = target.robot.forward_kinematics(&posture.q, &pose);
        let lowest = surface.lowest(&links, &thing.table.up).into_iter().fold(f64::INFINITY, f64::min);
        if lowest - thing.table.height_m < 2.0 * options.clearance_m {
            return None;
        }
        let depth = surface.depths(&links, &*thing.sdf, 0.0).into_iter().fold(0.0, f64::max);
        (depth <= DEEPEST_M).then_some((posture, pose))
    })?;
    let points = person(target, &posture.q, rng.random_range(0.95..1.0), &object_from_base);
    let frames = (0..FRAMES)
        .map(|t| {
            let mut frame = HandFrame::new(t as f64 / 10.0, points);
            (frame.index, frame.source_from_object) = (t, Some(Pose::identity()));
            frame
        })
        .collect();
    let mut demo = Demonstration::new("a made-up person", target.side, frames);
    demo.up = Some(thing.table.up);
    Some(demo)
}

/// The base of a hand whose pinch is at `pinch`: at a `roll` of zero from above, at a quarter turn from a side.
/// `None` for a pinch that stands upright.
fn placed(thing: &Thing, pinch: &Pinch, posture: &Posture, roll: f64) -> Option<Pose> {
    let up = thing.table.up.into_inner();
    let axis = (pinch.fingers - pinch.thumb).try_normalize(1e-6)?;
    let down = (axis * axis.dot(&up) - up).try_normalize(1e-6)?;
    let approach = Rotation3::new(axis * roll) * down;
    let middle = nalgebra::center(&pinch.thumb, &pinch.fingers);
    Some(frame(&middle, &axis, &approach)? * posture.base_from_pinch.inverse())
}
