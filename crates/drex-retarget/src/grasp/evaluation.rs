//! A solved frame, measured on the exact surface and the true shapes.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use drex_core::{Pose, SdfSample, SignedDistance};
use drex_demo::{FrameFlag, HumanFinger};
use drex_grasp::{grip_force_per_weight, holds_any_load};
use nalgebra::{Point3, Unit, Vector3};
use serde::Serialize;

use super::GraspOptions;
use super::hand::GraspHand;
use super::sequence::SolvedFrame;
use crate::levenberg_marquardt::HandState;
use crate::{ObjectSurface, Rejection, Result, Verdict};

/// One finger of a frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct FingerContact {
    /// The finger.
    pub finger: HumanFinger,
    /// Whether the human finger takes part in the grasp.
    #[serde(rename = "wanted")]
    pub takes_part: bool,
    /// Distance of its pad from the surface, mm; negative inside.
    pub gap_mm: f64,
    /// Distance of the point of the fingertip from the surface, mm.
    pub tip_gap_mm: f64,
    /// Distance of the point of the fingertip from where the plain vector result has it, mm.
    pub residual_mm: f64,
    /// Whether the pad is within the contact gap.
    pub touches: bool,
}

/// Two links inside each other.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SelfCollision {
    /// Names of the links.
    pub links: (String, String),
    /// Depth, mm.
    pub depth_mm: f64,
}

/// One frame, retargeted with contacts.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct GraspFrame {
    /// Seconds.
    pub t_s: f64,
    /// Joint vector in the model's order, rad, within the limits.
    pub q: Vec<f64>,
    /// Pose of the robot's base in the object's frame.
    #[serde(skip)]
    pub object_from_base: Pose,
    /// Whether the human hand holds the object.
    pub held: bool,
    /// The fingers, thumb first.
    pub fingers: Vec<FingerContact>,
    /// Deepest point inside the object, mm; zero or more.
    pub penetration_mm: f64,
    /// The link with the deepest point.
    pub deepest_link: Option<String>,
    /// The deepest pair of links inside each other.
    pub self_collision: Option<SelfCollision>,
    /// Mean distance of a joint to the plain vector result, rad.
    pub mean_joint_distance_rad: f64,
    /// Largest distance of a joint to the plain vector result, rad.
    pub largest_joint_distance_rad: f64,
    /// Distance of the wrist from the human wrist, mm.
    pub wrist_shift_mm: f64,
    /// Angle between the wrist and the human wrist, rad.
    pub wrist_turn_rad: f64,
    /// Fastest joint since the frame before, rad/s.
    pub joint_speed_rad_s: f64,
    /// Whether the contacts are in force closure.
    pub force_closure: bool,
    /// Smallest sum of normal forces that carries the object, in units of its weight; `None` where it cannot be carried or up is not
    /// known.
    #[serde(rename = "squeeze_per_weight")]
    pub grip_force_per_weight: Option<f64>,
    /// What is wrong with the human hand in the frame.
    pub flags: Vec<FrameFlag>,
    /// Whether the frame keeps the rules.
    pub verdict: Verdict,
}

/// What a frame is evaluated against.
pub(crate) struct FrameContext<'a> {
    /// The human hand.
    pub(crate) reference: &'a HandState,
    pub(crate) t_s: f64,
    /// Joints of the frame before and the time since.
    pub(crate) before: Option<(&'a [f64], f64)>,
    /// Up in the object's frame.
    pub(crate) up: Option<Unit<Vector3<f64>>>,
}

pub(crate) fn evaluate(
    hand: &GraspHand<'_>,
    object: &ObjectSurface<'_>,
    planned: &SolvedFrame,
    context: &FrameContext<'_>,
    options: &GraspOptions,
) -> Result<GraspFrame> {
    let &FrameContext { reference, t_s, before, up } = context;
    let HandState { object_from_base, q } = &planned.state;
    let posed = hand.posed(q, object_from_base);
    let reference_posed = hand.posed(&reference.q, &reference.object_from_base);
    let near = Near { search: object.search, exact: object.exact, known: Mutex::default() };
    let robot = &hand.target.robot;
    let fingers: Vec<FingerContact> = hand
        .fingers
        .iter()
        .zip(&hand.target.fingers)
        .zip(&planned.target_weights)
        .map(|((pad, finger), target_weight)| {
            let gap = object.exact.signed_distance(&pad.nearest_fine(&posed, object.search).1).distance_m;
            let tip = pad.tip(&posed);
            let tip_gap = object.exact.signed_distance(&tip).distance_m;
            FingerContact {
                finger: finger.human,
                takes_part: *target_weight > 0.0,
                gap_mm: 1e3 * gap,
                tip_gap_mm: 1e3 * tip_gap,
                residual_mm: 1e3 * (tip - pad.tip(&reference_posed)).norm(),
                touches: gap <= options.contact_gap_m,
            }
        })
        .collect();
    let depths = hand.fine.depths(&posed.links, &near, 0.0);
    let deepest = (0..depths.len()).max_by(|&a, &b| depths[a].total_cmp(&depths[b])).filter(|&l| depths[l] > 0.0);
    let mut close = Vec::new();
    hand.shapes.proximities(&posed.links, 0.0, &mut close);
    let self_collision = close.iter().min_by(|a, b| a.distance_m.total_cmp(&b.distance_m)).map(|c| SelfCollision {
        links: (robot.links[c.links.0].name.clone(), robot.links[c.links.1].name.clone()),
        depth_mm: -1e3 * c.distance_m,
    });
    let apart: Vec<f64> = q.iter().zip(&reference.q).map(|(a, b)| (a - b).abs()).collect();
    let shift = object_from_base.translation.vector - reference.object_from_base.translation.vector;
    let turn = object_from_base.rotation.angle_to(&reference.object_from_base.rotation);
    let joint_speed_rad_s = before.map_or(0.0, |(b, dt)| {
        let most = q.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        if dt > 0.0 { most / dt } else { 0.0 }
    });
    let (mut force_closure, mut grip_force) = (false, None);
    if planned.held {
        let contacts = hand.fine.contacts(robot, q, object_from_base, &near, &hand.contact)?;
        force_closure = holds_any_load(&contacts, &object.center_of_mass)?;
        if let Some(up) = up {
            grip_force = grip_force_per_weight(&contacts, object.center_of_mass, up)?;
        }
    }
    let mut reasons = Vec::new();
    let penetration_mm = deepest.map_or(0.0, |l| 1e3 * depths[l]);
    if let Some(l) = deepest
        && depths[l] > options.max_penetration_m
    {
        reasons.push(Rejection::Penetrates { link: robot.links[l].name.clone(), depth_mm: penetration_mm });
    }
    if planned.held {
        if !fingers[hand.thumb].touches {
            reasons.push(Rejection::ThumbMisses { gap_mm: fingers[hand.thumb].gap_mm });
        }
        let missing: Vec<(String, f64)> = fingers
            .iter()
            .filter(|f| f.finger != HumanFinger::Thumb && !f.touches)
            .map(|f| (f.finger.name().to_owned(), f.gap_mm))
            .collect();
        let touching = fingers.len() - 1 - missing.len();
        if touching < options.min_fingers {
            reasons.push(Rejection::FingersMiss { missing, touching, needed: options.min_fingers });
        }
    }
    let n = apart.len().max(1) as f64;
    let mean_joint_distance_rad = apart.iter().sum::<f64>() / n;
    if let Some(c) = &self_collision
        && c.depth_mm > 1e3 * options.max_self_collision_m
    {
        reasons.push(Rejection::SelfCollision { links: c.links.clone(), depth_mm: c.depth_mm });
    }
    if mean_joint_distance_rad > options.max_joint_distance_rad {
        reasons.push(Rejection::FarFromReference { mean_joint_rad: mean_joint_distance_rad });
    }
    if shift.norm() > options.max_wrist_shift_m {
        reasons.push(Rejection::WristMoved { distance_mm: 1e3 * shift.norm() });
    }
    Ok(GraspFrame {
        t_s,
        q: q.clone(),
        object_from_base: *object_from_base,
        held: planned.held,
        fingers,
        penetration_mm,
        deepest_link: deepest.map(|l| robot.links[l].name.clone()),
        self_collision,
        mean_joint_distance_rad,
        largest_joint_distance_rad: apart.iter().copied().fold(0.0, f64::max),
        wrist_shift_mm: 1e3 * shift.norm(),
        wrist_turn_rad: turn,
        joint_speed_rad_s,
        force_closure,
        grip_force_per_weight: grip_force,
        flags: Vec::new(),
        verdict: if reasons.is_empty() { Verdict::Accepted } else { Verdict::Rejected(reasons) },
    })
}

/// The exact distance near the surface; farther out the fast one.
struct Near<'a> {
    search: &'a dyn SignedDistance,
    exact: &'a dyn SignedDistance,
    /// Exact answers so far: penetration and contacts ask for the same points.
    known: Mutex<HashMap<[u64; 3], SdfSample>>,
}

/// Farther out than this the fast distance is good enough, m.
const NEAR_M: f64 = 0.001;

impl SignedDistance for Near<'_> {
    fn signed_distance(&self, point: &Point3<f64>) -> SdfSample {
        let fast = self.search.signed_distance(point);
        if fast.distance_m > NEAR_M {
            return fast;
        }
        let exact = || self.exact.signed_distance(point);
        // A thread that panicked while it looked something up has spoilt nothing.
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        *known.entry([0, 1, 2].map(|k| point[k].to_bits())).or_insert_with(exact)
    }
}
