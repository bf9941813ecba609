//! Grasps that enclose: the hand is put deep over the object, then its fingers close until their links touch.
//!
//! People hold heavy things so. A link near the knuckle presses harder than a fingertip with the same motor, and the palm presses back
//! without one. The closing is that of a simple gripper planner: every joint turns inwards until a link that it moves would enter
//! the object.

use anyhow::Result;
use drex_core::{Pose, SignedDistance};
use drex_grasp::{ContactOptions, HandSurface, LinkSurface};
use drex_retarget::TargetHand;
use drex_robot::{Finger, Robot};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::library::{Grasp, Kind};
use super::people::{PeopleOptions, Pinch, pinches, placed};
use super::postures::{Postures, moves_sideways};
use super::thing::Thing;

/// What is tried and asked.
#[derive(Debug, Clone, PartialEq)]
pub struct WrapOptions {
    /// Hands that are tried.
    pub tries: usize,
    /// Grasps that are kept, those that need the least squeeze.
    pub keep: usize,
    /// Friction of force closure.
    pub friction: f64,
    /// The hand stays this far above the table, metres.
    pub clearance_m: f64,
    pub seed: u64,
}

impl Default for WrapOptions {
    fn default() -> Self {
        Self { tries: 1500, keep: 120, friction: 0.5, clearance_m: 0.002, seed: 0 }
    }
}

/// Turns of a joint at first and at last, rad.
const TURNS: [f64; 3] = [0.2, 0.06, 0.015];
/// Most turns of one size.
const MOST: usize = 14;
/// A link may enter the object by this while it closes, metres.
const ENTERS_M: f64 = 0.0005;
/// Deepest that links may be inside each other, metres.
const MAX_SELF_M: f64 = 0.001;
/// Spacing of points on the hand while it closes, metres.
const SPACING_M: f64 = 0.006;

/// Farthest that the hand is over the pinch, metres, and how much wider than it, metres.
const DEEPER_M: f64 = 0.06;
const WIDER_M: f64 = 0.03;
/// By how much a variation of a grasp differs from it at most: each joint and the turn of the palm, rad, and its shift, metres.
const VARIED_RAD: f64 = 0.05;
const VARIED_M: f64 = 0.0025;
/// Set apart from the seeds of tries.
const VARIED_SEED: u64 = 0x76_61_72_79;
/// Places of the hand that are looked at for each pinch.
const PLACES: usize = 40;

/// A hand prepared for closing.
pub struct Closer<'a> {
    robot: &'a Robot,
    coarse: HandSurface,
    fine: HandSurface,
    /// Per finger of the model, the joints that bend it, from the palm on.
    bends: Vec<Vec<usize>>,
}

/// The grasps that were found, those that need the least squeeze first. The same for any number of threads.
///
/// # Errors
/// If the hand has no shapes.
pub fn grasps(thing: &Thing, target: &TargetHand, postures: &Postures, options: &WrapOptions) -> Result<Vec<Grasp>> {
    let closer = Closer::new(&target.robot)?;
    let mut people = PeopleOptions::default();
    (people.seed, people.friction, people.widest_m) = (options.seed ^ 0x77, 1.0, 0.12);
    let sites = pinches(thing, &people);
    let found: Vec<Option<Grasp>> = (0..if sites.is_empty() { 0 } else { options.tries })
        .into_par_iter()
        .map(|i| {
            let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
            rng.set_stream(i as u64);
            closer.attempt(thing, &sites[i % sites.len()], postures, options, &mut rng)
        })
        .collect::<Result<_>>()?;
    let numbered = found.into_iter().enumerate();
    let mut grasps: Vec<Grasp> =
        numbered.filter_map(|(i, g)| g.map(|g| Grasp { kind: Kind::Wrapped, clip: i, ..g })).collect();
    tracing::info!("{}: {} of {} wraps hold", thing.spec.name, grasps.len(), options.tries);
    grasps.sort_by(|a, b| a.squeeze_per_weight.total_cmp(&b.squeeze_per_weight));
    grasps.truncate(options.keep);
    Ok(grasps)
}

impl<'a> Closer<'a> {
    /// # Errors
    /// If the hand has no shapes.
    pub fn new(robot: &'a Robot) -> Result<Self> {
        let fine = HandSurface::new(robot, ContactOptions::default().spacing_m)?;
        let bends = fine
            .fingers
            .iter()
            .map(|f| f.joints.iter().copied().filter(|&j| f.is_thumb || !moves_sideways(robot, f, j)).collect());
        let bends = bends.collect();
        Ok(Self { robot, coarse: HandSurface::new(robot, SPACING_M)?, fine, bends })
    }

    fn attempt(
        &self,
        thing: &Thing,
        pinch: &Pinch,
        postures: &Postures,
        options: &WrapOptions,
        rng: &mut ChaCha8Rng,
    ) -> Result<Option<Grasp>> {
        let width = (pinch.fingers - pinch.thumb).norm();
        let start = (0..PLACES).find_map(|_| {
            let posture = postures.any(width, WIDER_M, rng)?;
            let (roll, deeper) = (rng.random_range(-1.9..1.9), rng.random_range(0.0..DEEPER_M));
            let pose = placed(thing, pinch, posture, roll, deeper)?;
            // Fingers open before they close: what matters is that nothing that cannot move is in the way.
            let mut q = posture.q.clone();
            if self.lowest(thing, &q, &pose) < options.clearance_m || !self.opened(thing, &mut q, &pose) {
                return None;
            }
            (self.lowest(thing, &q, &pose) >= options.clearance_m).then_some((q, pose))
        });
        let Some((q, pose)) = start else { return Ok(None) };
        self.closed(thing, q, &pose, options)
    }

    /// A grasp whose joints and palm are moved by at most `size` times `VARIED_RAD` and `VARIED_M`, closed again; `None` if
    /// that holds nothing.
    ///
    /// # Errors
    /// If the grasp is none of this hand.
    pub fn varied(&self, thing: &Thing, grasp: &Grasp, size: f64, seed: u64, stream: u64) -> Result<Option<Grasp>> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ VARIED_SEED);
        rng.set_stream(stream);
        let mut error = |most: f64| size * rng.random_range(-most..=most);
        let mut q: Vec<f64> = grasp.joints_rad.iter().map(|q| q + error(VARIED_RAD)).collect();
        let shift = Vector3::from_fn(|_, _| error(VARIED_M));
        let turn = Vector3::from_fn(|_, _| error(VARIED_RAD));
        let pose = grasp.pose()? * Pose::new(shift, turn);
        self.robot.clamp_to_limits(&mut q);
        let options = WrapOptions::default();
        if !self.opened(thing, &mut q, &pose) || self.lowest(thing, &q, &pose) < options.clearance_m {
            return Ok(None);
        }
        let closed = self.closed(thing, q, &pose, &options)?;
        Ok(closed.map(|g| Grasp { kind: grasp.kind, clip: grasp.clip, ..g }))
    }

    /// The grasp that closing from here gives.
    fn closed(&self, thing: &Thing, mut q: Vec<f64>, pose: &Pose, options: &WrapOptions) -> Result<Option<Grasp>> {
        self.close(thing, pose, &mut q);
        let grasp = Grasp::measured(thing, self.robot, &self.fine, &q, pose, options.friction)?;
        Ok(grasp.filter(|g| g.clearance_mm >= 1e3 * options.clearance_m && self.self_depth(&q) <= MAX_SELF_M))
    }

    /// Opens fingers that are inside the object; `false` if the palm is, or a finger stays.
    fn opened(&self, thing: &Thing, q: &mut [f64], pose: &Pose) -> bool {
        for (finger, bends) in self.fine.fingers.iter().zip(&self.bends) {
            let mut steps = 0;
            while self.enters(thing, q, pose, &finger.links) {
                if steps == MOST {
                    return false;
                }
                steps += 1;
                for &j in bends {
                    let (lo, hi) = self.robot.joints[j].limits.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
                    // The thumb's first joints turn it about; the others bend.
                    let bent = !finger.is_thumb || bends.iter().rev().take(2).any(|b| *b == j);
                    if bent {
                        q[j] = (q[j] - 0.1).clamp(lo, hi);
                    }
                }
            }
        }
        let fixed = (0..self.coarse.links.len()).filter(|&l| self.coarse.finger_of_link[l].is_none());
        let fixed: Vec<usize> = fixed.collect();
        !self.enters(thing, q, pose, &fixed)
    }

    fn lowest(&self, thing: &Thing, q: &[f64], pose: &Pose) -> f64 {
        let links = self.robot.forward_kinematics(q, pose);
        let lowest = self.coarse.lowest(&links, &thing.table.up).into_iter().fold(f64::INFINITY, f64::min);
        lowest - thing.table.height_m
    }

    /// Turns every joint inwards until a link that it moves would enter the object or the table.
    pub fn close(&self, thing: &Thing, pose: &Pose, q: &mut [f64]) {
        for turn in TURNS {
            for (finger, bends) in self.fine.fingers.iter().zip(&self.bends) {
                let mut free = vec![true; bends.len()];
                for _ in 0..MOST {
                    for (k, &j) in bends.iter().enumerate() {
                        if !free[k] {
                            continue;
                        }
                        let before = q[j];
                        let (lo, hi) = self.robot.joints[j].limits.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
                        let sense = if finger.is_thumb { self.sense(thing, q, pose, finger, j) } else { 1.0 };
                        q[j] = (before + turn * sense).clamp(lo, hi);
                        if q[j] == before || self.enters(thing, q, pose, &finger.links) {
                            q[j] = before;
                            free[k] = false;
                        }
                    }
                    if free.iter().all(|f| !f) {
                        break;
                    }
                }
            }
        }
    }

    /// Which way a joint brings the fingertip nearer to the object; zero if it hardly does.
    fn sense(&self, thing: &Thing, q: &[f64], pose: &Pose, finger: &Finger, joint: usize) -> f64 {
        let links = self.robot.forward_kinematics(q, pose);
        let tip = links[finger.tip_link] * finger.tip_point;
        let (axis, at) = self.robot.joint_axis(&links, joint);
        let inwards: Vector3<f64> = -thing.sdf.signed_distance(&tip).gradient;
        let velocity = axis.cross(&(tip - at));
        let sense = velocity.dot(&inwards);
        if sense.abs() < 0.3 * velocity.norm() { 0.0 } else { sense.signum() }
    }

    /// Whether a link of the finger is inside the object.
    fn enters(&self, thing: &Thing, q: &[f64], pose: &Pose, links: &[usize]) -> bool {
        let poses = self.robot.forward_kinematics(q, pose);
        let inside = |l: &usize| {
            let surface: &LinkSurface = &self.coarse.links[*l];
            surface.nearest(&poses[*l], &*thing.sdf, -ENTERS_M).is_some()
        };
        links.iter().any(inside)
    }

    /// Whether the links are out of each other.
    pub fn keeps_off_itself(&self, q: &[f64]) -> bool {
        self.self_depth(q) <= MAX_SELF_M
    }

    /// How deep links are inside each other, metres; zero or more.
    fn self_depth(&self, q: &[f64]) -> f64 {
        let poses = self.robot.forward_kinematics(q, &Pose::identity());
        let mut deepest: f64 = 0.0;
        for (link, geom) in self.robot.collision_geoms() {
            let geom_from_base = (poses[link] * geom.link_from_geom).inverse();
            for (other, surface) in self.coarse.links.iter().enumerate() {
                if other == link || !self.robot.may_collide(link, other) {
                    continue;
                }
                let there = geom_from_base * poses[other];
                for (point, _) in surface.samples() {
                    deepest = deepest.max(-geom.shape.signed_distance(&(there * point)));
                }
            }
        }
        deepest
    }
}
