//! Grasps that enclose: the palm is laid on the object, then the fingers close until their links touch.
//!
//! People hold heavy things so. A link near the knuckle presses harder than a fingertip with the same motor, and the palm presses back
//! without one. The closing is that of a simple gripper planner: every joint turns inwards until a link that it moves would enter
//! the object.

use std::f64::consts::TAU;

use anyhow::Result;
use drex_core::{Pose, SignedDistance, SurfacePoint};
use drex_grasp::{ContactOptions, HandSurface, LinkSurface};
use drex_mesh::sample_surface;
use drex_robot::{Finger, Robot};
use nalgebra::{Point3, Translation3, Unit, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::library::{Grasp, Kind};
use super::postures::sideways;
use super::thing::Thing;

/// What is asked of a grasp.
#[derive(Debug, Clone, PartialEq)]
pub struct WrapOptions {
    /// Friction of force closure.
    pub friction: f64,
    /// The hand stays this far above the table, metres.
    pub clearance_m: f64,
}

impl Default for WrapOptions {
    fn default() -> Self {
        Self { friction: 0.5, clearance_m: 0.002 }
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

/// Places of the hand that are looked at for each site.
const PLACES: usize = 40;
/// From how far the palm comes, metres, steps of its way, and how near it is laid, metres.
const FROM_M: f64 = 0.04;
const APPROACHES: usize = 8;
const LAID_M: f64 = 0.0003;
/// The palm is laid on at most so askew, per axis, and a point of it may be askew to the way it comes by this cosine.
const ASKEW: f64 = 0.15;
const PALM_FACES: f64 = 0.8;
/// Before they close the fingers are bent by at most this and spread to either side by at most this, rad.
const BENT_RAD: f64 = 0.6;
const SPREAD_RAD: f64 = 0.15;
/// By how much a variation of a grasp differs from it at most: each joint and the turn of the palm, rad, and its shift, metres.
const VARIED_RAD: f64 = 0.05;
const VARIED_M: f64 = 0.0025;
/// Set apart from each other and from the seeds of other draws.
const LAID_SEED: u64 = 0x6c61_6964;
const VARIED_SEED: u64 = 0x76_61_72_79;

/// A hand prepared for closing.
pub struct Closer<'a> {
    robot: &'a Robot,
    coarse: HandSurface,
    fine: HandSurface,
    /// Per finger of the model, the joints that bend it, from the palm on.
    bends: Vec<Vec<usize>>,
    /// Links of no finger.
    fixed: Vec<usize>,
    /// Where the hand has one.
    palm: Option<Palm>,
}

/// What is laid on an object, in the frame of its link.
struct Palm {
    link: usize,
    /// Out of the palm.
    facing: Vector3<f64>,
    /// On its surface, where that faces the same way.
    points: Vec<Point3<f64>>,
}

/// Grasps by so many hands that are laid on points all over the object. The same for any number of threads.
///
/// # Errors
/// If the hand has no shapes.
pub fn grasps(thing: &Thing, robot: &Robot, tries: usize, seed: u64, options: &WrapOptions) -> Result<Vec<Grasp>> {
    let closer = Closer::new(robot)?;
    let sites = sample_surface(&thing.asset.visual, tries, seed);
    let found: Vec<Option<Grasp>> = sites
        .par_iter()
        .enumerate()
        .map(|(i, site)| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed ^ LAID_SEED);
            rng.set_stream(i as u64);
            let laid = (0..PLACES).find_map(|_| closer.laid(thing, site, options, &mut rng));
            let Some((q, pose)) = laid else { return Ok(None) };
            let closed = closer.closed(thing, q, &pose, options)?;
            Ok(closed.map(|g| Grasp { kind: Kind::Wrapped, clip: i, ..g }))
        })
        .collect::<Result<_>>()?;
    let grasps: Vec<Grasp> = found.into_iter().flatten().collect();
    tracing::info!("{}: {} of {tries} wraps hold", thing.spec.name, grasps.len());
    Ok(grasps)
}

impl<'a> Closer<'a> {
    /// # Errors
    /// If the hand has no shapes.
    pub fn new(robot: &'a Robot) -> Result<Self> {
        let fine = HandSurface::new(robot, ContactOptions::default().spacing_m)?;
        let sideways = sideways(robot, &fine.fingers);
        let bends =
            fine.fingers.iter().map(|f| f.joints.iter().copied().filter(|&j| f.is_thumb || !sideways[j]).collect());
        let bends = bends.collect();
        let fixed = (0..fine.links.len()).filter(|&l| fine.finger_of_link[l].is_none()).collect();
        let coarse = HandSurface::new(robot, SPACING_M)?;
        let palm = robot.palm_link().zip(robot.palm_normal()).map(|(link, facing)| {
            let samples = coarse.links[link].samples().iter();
            Palm { link, facing, points: samples.filter(|s| s.1.dot(&facing) > PALM_FACES).map(|s| s.0).collect() }
        });
        Ok(Self { robot, coarse, fine, bends, fixed, palm })
    }

    /// The hand with its palm on the object near `site` and its fingers open, turned and shifted at random; `None` if it has no palm, or there is no
    /// room for it there.
    fn laid(
        &self,
        thing: &Thing,
        site: &SurfacePoint,
        options: &WrapOptions,
        rng: &mut ChaCha8Rng,
    ) -> Option<(Vec<f64>, Pose)> {
        let palm = self.palm.as_ref()?;
        let mut q = self.open(rng);
        let askew = Vector3::from_fn(|_, _| rng.random_range(-ASKEW..ASKEW));
        let along = Unit::new_normalize(askew - site.normal);
        let roll = UnitQuaternion::from_axis_angle(&along, rng.random_range(0.0..TAU));
        let rotation = roll * UnitQuaternion::rotation_between(&palm.facing, &along)?;
        let at = palm.points.get(rng.random_range(0..palm.points.len().max(1)))?;
        let origin = site.point - along.into_inner() * FROM_M - rotation * at.coords;
        let base_from_palm = self.robot.forward_kinematics(&q, &Pose::identity())[palm.link];
        let mut pose = Pose::from_parts(origin.coords.into(), rotation) * base_from_palm.inverse();
        // As far as what cannot bend is off the object it may come nearer.
        for _ in 0..APPROACHES {
            let links = self.robot.forward_kinematics(&q, &pose);
            let gap = |l: &usize| self.coarse.links[*l].nearest(&links[*l], &*thing.sdf, 2.0 * FROM_M).map(|n| n.1);
            let gap = self.fixed.iter().filter_map(gap).reduce(f64::min)?;
            if gap < LAID_M {
                break;
            }
            pose = Translation3::from(along.into_inner() * gap) * pose;
        }
        // What is in the way of the fingers opens them; what cannot move must be free.
        let clear = |q: &[f64]| self.lowest(thing, q, &pose) >= options.clearance_m;
        (clear(&q) && self.opened(thing, &mut q, &pose) && clear(&q)).then_some((q, pose))
    }

    /// Fingers nearly straight, the thumb anywhere.
    fn open(&self, rng: &mut ChaCha8Rng) -> Vec<f64> {
        let mut q = self.robot.reference_position();
        let bent = rng.random_range(0.0..BENT_RAD);
        for (finger, bends) in self.fine.fingers.iter().zip(&self.bends) {
            for &j in &finger.joints {
                let (lo, hi) = self.robot.joints[j].limits.unwrap_or((0.0, 0.0));
                let share: f64 = rng.random();
                q[j] = if finger.is_thumb {
                    lo + share * (hi - lo)
                } else if bends.contains(&j) {
                    bent * share
                } else {
                    SPREAD_RAD * (2.0 * share - 1.0)
                };
            }
        }
        self.robot.clamp_to_limits(&mut q);
        q
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
        Ok(closed.map(|g| Grasp { kind: grasp.kind.varied(), clip: grasp.clip, ..g }))
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
        !self.enters(thing, q, pose, &self.fixed)
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::super::objects;
    use super::*;

    /// What so many hands make of the ketchup bottle, the heaviest of the objects.
    fn bottle(tries: usize, seed: u64) -> (Thing, Robot, Vec<Grasp>) {
        let thing = Thing::new(&objects::named("ketchup_bottle").unwrap()).unwrap();
        let robot = Robot::bundled("leap_right").unwrap();
        let grasps = grasps(&thing, &robot, tries, seed, &WrapOptions::default()).unwrap();
        (thing, robot, grasps)
    }

    #[test]
    fn laid_hands_hold_with_the_palm_and_near_the_knuckles() {
        let (thing, robot, grasps) = bottle(60, 0);
        assert!(grasps.len() >= 5, "{} of 60", grasps.len());
        let closer = Closer::new(&robot).unwrap();
        let surface = HandSurface::new(&robot, ContactOptions::default().spacing_m).unwrap();
        let mut beside_the_tip = 0;
        for g in &grasps {
            assert!(g.contacts.last() > Some(&0), "no palm: {:?}", g.contacts);
            assert!(g.clearance_mm >= 2.0 && closer.keeps_off_itself(&g.joints_rad));
            let options = ContactOptions::with_friction(0.5);
            let pose = g.pose().unwrap();
            let contacts = surface.contacts(&robot, &g.joints_rad, &pose, thing.sdf.exact(), &options).unwrap();
            let tips: Vec<usize> = surface.fingers.iter().map(|f| f.tip_link).collect();
            beside_the_tip += usize::from(contacts.iter().any(|c| c.finger.is_some() && !tips.contains(&c.link)));
        }
        assert!(2 * beside_the_tip >= grasps.len(), "{beside_the_tip} of {} touch with more than tips", grasps.len());
    }

    #[test]
    fn wraps_depend_on_the_seed_alone() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let (_, _, many) = bottle(20, 0);
        let (_, _, one) = pool.install(|| bottle(20, 0));
        assert!(!many.is_empty() && many == one);
        assert_ne!(many, bottle(20, 1).2);
    }
}
