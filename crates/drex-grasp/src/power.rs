//! Power grasps: the palm is placed on the object, then the fingers close until their links touch.
//!
//! A link near the knuckle presses harder than a fingertip with the same motor, and the palm presses back without one. The
//! closing is that of a simple gripper planner: every joint turns inwards until a link that it moves would penetrate the object.

use std::f64::consts::TAU;

use drex_core::{Object, Pose, SurfacePoint};
use drex_robot::{Finger, Robot};
use nalgebra::{Point3, Translation3, Unit, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::pinch::Search;
use crate::{ContactOptions, EvaluationOptions, Grasp, GraspOrigin, HandSurface, LinkSurface, Result};

/// Turns of a joint at first and at last, rad.
const CLOSING_STEPS_RAD: [f64; 3] = [0.2, 0.06, 0.015];
/// Most turns of one size.
const MAX_STEPS: usize = 14;
/// A link may enter the object by this while it closes, metres.
const MAX_CLOSING_PENETRATION_M: f64 = 0.0005;
/// Spacing of points on the hand while it closes, metres.
const SPACING_M: f64 = 0.006;

/// Places of the hand that are looked at for each site.
const PLACEMENTS: usize = 40;
/// From how far the palm comes, metres, steps of its way, and how near it is laid, metres.
const APPROACH_M: f64 = 0.04;
const APPROACHES: usize = 8;
const PALM_GAP_M: f64 = 0.0003;
/// The palm is laid on at most so misaligned, per axis, and a point of it may be misaligned to the way it comes by this cosine.
const MAX_MISALIGNMENT: f64 = 0.15;
const PALM_FACES: f64 = 0.8;
/// Before they close the fingers are bent by at most this and spread to either side by at most this, rad.
const BENT_RAD: f64 = 0.6;
const SPREAD_RAD: f64 = 0.15;
/// By how much a variation of a grasp differs from it at most: each joint and the turn of the palm, rad, and its shift, metres.
const PERTURBATION_RAD: f64 = 0.05;
const PERTURBATION_M: f64 = 0.0025;
/// Relative size of the largest perturbation of a grasp that is to be placed.
const MOST_NEAR: f64 = 2.0;
/// A finger that would turn by more to touch has no part in a demonstrated grasp, rad.
const MOST_CLOSED_RAD: f64 = 0.3;
/// Set apart from each other and from the seeds of other draws.
const PLACEMENT_SEED: u64 = 0x6c61_6964;
const PERTURBATION_SEED: u64 = 0x76_61_72_79;

/// A hand prepared for closing its fingers on objects.
pub struct FingerClosing<'a> {
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

/// Power grasps from `tries` points all over the object's surface. The same for any number of threads.
///
/// # Errors
/// If the hand has no collision shapes.
pub fn power_grasps(object: &Object, robot: &Robot, tries: usize, seed: u64) -> Result<Vec<Grasp>> {
    let closing = FingerClosing::new(robot)?;
    let limits = EvaluationOptions::synthesised();
    let sites = object.surface_points(tries, seed);
    let found: Vec<Option<Grasp>> = sites
        .par_iter()
        .enumerate()
        .map(|(i, site)| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed ^ PLACEMENT_SEED);
            rng.set_stream(i as u64);
            let placed = (0..PLACEMENTS).find_map(|_| closing.place_palm(object, site, &limits, &mut rng));
            let Some((q, pose)) = placed else { return Ok(None) };
            let closed = closing.closed(object, q, &pose, &limits)?;
            Ok(closed.map(|g| Grasp { origin: GraspOrigin::Power, source: i, ..g }))
        })
        .collect::<Result<_>>()?;
    let grasps: Vec<Grasp> = found.into_iter().flatten().collect();
    tracing::info!("{}: {} of {tries} power grasps hold", object.name, grasps.len());
    Ok(grasps)
}

impl Grasp {
    /// The grasp with its joints and base moved at random, by at most `size` times `PERTURBATION_RAD` and `PERTURBATION_M`, within the limits of
    /// the joints; what it touches there nobody has looked at.
    #[must_use]
    pub fn moved(&self, robot: &Robot, size: f64, seed: u64, stream: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ PERTURBATION_SEED);
        rng.set_stream(stream);
        let mut error = |most: f64| size * rng.random_range(-most..=most);
        let mut joints_rad: Vec<f64> = self.joints_rad.iter().map(|q| q + error(PERTURBATION_RAD)).collect();
        let shift = Vector3::from_fn(|_, _| error(PERTURBATION_M));
        let turn = Vector3::from_fn(|_, _| error(PERTURBATION_RAD));
        robot.clamp_to_limits(&mut joints_rad);
        Self {
            joints_rad,
            object_from_base: self.object_from_base * Pose::new(shift, turn),
            contacts: Vec::new(),
            grip_force_n: None,
            origin: self.origin.perturbed(),
            ..self.clone()
        }
    }
}

impl<'a> FingerClosing<'a> {
    /// Prepares a hand.
    ///
    /// # Errors
    /// If the hand has no collision shapes.
    pub fn new(robot: &'a Robot) -> Result<Self> {
        let fine = HandSurface::new(robot, ContactOptions::default().spacing_m)?;
        let sideways = abduction_joints(robot, &fine.fingers);
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

    /// The hand.
    pub fn robot(&self) -> &'a Robot {
        self.robot
    }

    /// The hand with its palm on the object near `site` and its fingers open, turned and shifted at random; `None` if it has no palm, or there is no
    /// room for it there.
    fn place_palm(
        &self,
        object: &Object,
        site: &SurfacePoint,
        limits: &EvaluationOptions,
        rng: &mut ChaCha8Rng,
    ) -> Option<(Vec<f64>, Pose)> {
        let palm = self.palm.as_ref()?;
        let mut q = self.open(rng);
        let misaligned = Vector3::from_fn(|_, _| rng.random_range(-MAX_MISALIGNMENT..MAX_MISALIGNMENT));
        let along = Unit::new_normalize(misaligned - site.normal);
        let roll = UnitQuaternion::from_axis_angle(&along, rng.random_range(0.0..TAU));
        let rotation = roll * UnitQuaternion::rotation_between(&palm.facing, &along)?;
        let at = palm.points.get(rng.random_range(0..palm.points.len().max(1)))?;
        let origin = site.point - along.into_inner() * APPROACH_M - rotation * at.coords;
        let base_from_palm = self.robot.forward_kinematics(&q, &Pose::identity())[palm.link];
        let mut pose = Pose::from_parts(origin.coords.into(), rotation) * base_from_palm.inverse();
        // As far as what cannot bend is off the object it may come nearer.
        for _ in 0..APPROACHES {
            let links = self.robot.forward_kinematics(&q, &pose);
            let gap =
                |l: &usize| self.coarse.links[*l].nearest(&links[*l], &*object.geometry, 2.0 * APPROACH_M).map(|n| n.1);
            let gap = self.fixed.iter().filter_map(gap).reduce(f64::min)?;
            if gap < PALM_GAP_M {
                break;
            }
            pose = Translation3::from(along.into_inner() * gap) * pose;
        }
        // What is in the way of the fingers opens them; what cannot move must be free.
        let clear = |q: &[f64]| self.lowest(object, q, &pose) >= limits.min_table_clearance_m;
        (clear(&q) && self.open_fingers(object, &mut q, &pose) && clear(&q)).then_some((q, pose))
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

    /// A grasp whose joints and palm are moved by at most `size` times `PERTURBATION_RAD` and `PERTURBATION_M`, closed again; `None` if
    /// that holds nothing.
    ///
    /// # Errors
    /// If the grasp is none of this hand.
    pub fn perturbed(
        &self,
        object: &Object,
        grasp: &Grasp,
        size: f64,
        seed: u64,
        stream: u64,
    ) -> Result<Option<Grasp>> {
        self.enclosing(object, &grasp.moved(self.robot, size, seed, stream))
    }

    /// The grasp with fingers that are in the object opened, then all closed until they touch; `None` if that holds nothing.
    fn enclosing(&self, object: &Object, grasp: &Grasp) -> Result<Option<Grasp>> {
        let (mut q, pose) = (grasp.joints_of(self.robot)?, grasp.object_from_base);
        let limits = EvaluationOptions::synthesised();
        if !self.open_fingers(object, &mut q, &pose) || self.lowest(object, &q, &pose) < limits.min_table_clearance_m {
            return Ok(None);
        }
        let closed = self.closed(object, q, &pose, &limits)?;
        Ok(closed.map(|g| Grasp { origin: grasp.origin, source: grasp.source, ..g }))
    }

    /// The grasp with the fingers that are near the surface moved onto it, else with all of them closed around the object; `None` if neither holds
    /// anything.
    ///
    /// # Errors
    /// If the grasp is none of this hand.
    pub fn placed(&self, object: &Object, grasp: &Grasp) -> Result<Option<Grasp>> {
        let limits = EvaluationOptions::synthesised();
        let search = Search { robot: self.robot, hand: &self.fine, object, limits: &limits };
        match search.touching(grasp.joints_of(self.robot)?, grasp.object_from_base)? {
            Some(g) => Ok(Some(Grasp { origin: grasp.origin, source: grasp.source, ..g })),
            None => self.enclosing(object, grasp),
        }
    }

    /// The grasp placed, else the first of `tries` neighbours of it that can be, the nearest ones first: up to twice as far as those of
    /// [`FingerClosing::perturbed`]. `None` if none holds anything.
    ///
    /// # Errors
    /// If the grasp is none of this hand.
    pub fn placed_near(
        &self,
        object: &Object,
        grasp: &Grasp,
        tries: usize,
        seed: u64,
        stream: u64,
    ) -> Result<Option<Grasp>> {
        let mut placed = self.placed(object, grasp)?;
        for i in 0..tries {
            if placed.is_some() {
                break;
            }
            let size = MOST_NEAR * (i + 1) as f64 / tries as f64;
            let moved = grasp.moved(self.robot, size, seed, stream.wrapping_mul(tries as u64).wrapping_add(i as u64));
            placed = self.placed(object, &Grasp { origin: grasp.origin, ..moved })?;
        }
        Ok(placed)
    }

    /// A demonstrated grasp that is [moved](Grasp::moved), with the fingers at the object that were near it; what it holds nobody has looked at. `None` if
    /// it is none that a hand can have there.
    ///
    /// # Errors
    /// If the grasp is none of this hand.
    pub fn refined(&self, object: &Object, grasp: &Grasp, size: f64, seed: u64, stream: u64) -> Result<Option<Grasp>> {
        let mut moved = grasp.moved(self.robot, size, seed, stream);
        let pose = moved.object_from_base;
        let mut q = moved.joints_rad.clone();
        if !self.open_fingers(object, &mut q, &pose) {
            return Ok(None);
        }
        moved.joints_rad.clone_from(&q);
        self.close(object, &pose, &mut q);
        for finger in &self.fine.fingers {
            if finger.joints.iter().all(|&j| (q[j] - moved.joints_rad[j]).abs() <= MOST_CLOSED_RAD) {
                finger.joints.iter().for_each(|&j| moved.joints_rad[j] = q[j]);
            }
        }
        moved.screened(&self.fine, object, self.robot, &EvaluationOptions::demonstrated())
    }

    /// The grasp that closing from here gives.
    fn closed(
        &self,
        object: &Object,
        mut q: Vec<f64>,
        pose: &Pose,
        limits: &EvaluationOptions,
    ) -> Result<Option<Grasp>> {
        self.close(object, pose, &mut q);
        Grasp::new(self.robot, q, *pose).screened(&self.fine, object, self.robot, limits)
    }

    /// Opens fingers that are inside the object; `false` if the palm is, or a finger stays.
    fn open_fingers(&self, object: &Object, q: &mut [f64], pose: &Pose) -> bool {
        for (finger, bends) in self.fine.fingers.iter().zip(&self.bends) {
            let mut steps = 0;
            while self.penetrates(object, q, pose, &finger.links) {
                if steps == MAX_STEPS {
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
        !self.penetrates(object, q, pose, &self.fixed)
    }

    fn lowest(&self, object: &Object, q: &[f64], pose: &Pose) -> f64 {
        let links = self.robot.forward_kinematics(q, pose);
        let lowest = self.coarse.lowest(&links, &object.table().up).into_iter().fold(f64::INFINITY, f64::min);
        lowest - object.table().height_m
    }

    /// Turns every joint inwards until a link that it moves would enter the object or the table.
    pub fn close(&self, object: &Object, pose: &Pose, q: &mut [f64]) {
        for turn in CLOSING_STEPS_RAD {
            for (finger, bends) in self.fine.fingers.iter().zip(&self.bends) {
                let mut free = vec![true; bends.len()];
                for _ in 0..MAX_STEPS {
                    for (k, &j) in bends.iter().enumerate() {
                        if !free[k] {
                            continue;
                        }
                        let before = q[j];
                        let (lo, hi) = self.robot.joints[j].limits.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
                        let sense = if finger.is_thumb { self.sense(object, q, pose, finger, j) } else { 1.0 };
                        q[j] = (before + turn * sense).clamp(lo, hi);
                        if q[j] == before || self.penetrates(object, q, pose, &finger.links) {
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
    fn sense(&self, object: &Object, q: &[f64], pose: &Pose, finger: &Finger, joint: usize) -> f64 {
        let links = self.robot.forward_kinematics(q, pose);
        let tip = links[finger.tip_link] * finger.tip_point;
        let (axis, at) = self.robot.joint_axis(&links, joint);
        let inwards: Vector3<f64> = -object.geometry.signed_distance(&tip).gradient;
        let velocity = axis.cross(&(tip - at));
        let sense = velocity.dot(&inwards);
        if sense.abs() < 0.3 * velocity.norm() { 0.0 } else { sense.signum() }
    }

    /// Whether a link of the finger is inside the object.
    fn penetrates(&self, object: &Object, q: &[f64], pose: &Pose, links: &[usize]) -> bool {
        let poses = self.robot.forward_kinematics(q, pose);
        let inside = |l: &usize| {
            let surface: &LinkSurface = &self.coarse.links[*l];
            surface.nearest(&poses[*l], &*object.geometry, -MAX_CLOSING_PENETRATION_M).is_some()
        };
        links.iter().any(inside)
    }
}

/// For each joint in the model's order whether it abducts: whether it swings a straight finger along the row of knuckles rather
/// than towards the palm. None does of a hand without a palm.
pub fn abduction_joints(robot: &Robot, fingers: &[Finger]) -> Vec<bool> {
    let mut out = vec![false; robot.joints.len()];
    let (Some(normal), Some(palm)) = (robot.palm_normal(), robot.palm_link()) else { return out };
    let poses = robot.forward_kinematics(&robot.reference_position(), &Pose::identity());
    let normal = poses[palm].rotation * normal;
    for finger in fingers {
        for &joint in &finger.joints {
            let (axis, at) = robot.joint_axis(&poses, joint);
            let velocity = axis.cross(&(poses[finger.tip_link] * finger.tip_point - at));
            out[joint] = velocity.norm() < 0.01 || velocity.normalize().dot(&normal).abs() < 0.35;
        }
    }
    out
}
