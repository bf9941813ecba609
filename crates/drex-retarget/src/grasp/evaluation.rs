//! A solved frame, measured on the exact surface and the true shapes.

use drex_core::pose::upright;
use drex_core::{Object, Pose};
use drex_demo::{FrameFlag, HumanFinger};
use drex_grasp::{Grasp, GraspEvaluation, evaluate_with};
use nalgebra::{Translation3, Unit, Vector3};
use serde::Serialize;

use super::GraspOptions;
use super::hand::GraspHand;
use super::sequence::SolvedFrame;
use crate::Result;
use crate::levenberg_marquardt::HandState;

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
    /// Whether a point of the finger is at most 5 mm off the surface.
    pub touches: bool,
}

/// One frame, retargeted with contacts.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct GraspFrame {
    /// Seconds.
    pub t_s: f64,
    /// Where joints and wrist are, and what the hand touches. The object has its own mass, whatever it is in the recording.
    pub grasp: Grasp,
    /// Whether the human hand holds the object.
    pub held: bool,
    /// The fingers, thumb first.
    pub fingers: Vec<FingerContact>,
    /// The grasp by the limits of the options; a frame that is not held may touch nothing.
    pub evaluation: GraspEvaluation,
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
    /// Smallest sum of normal forces that carries the object, in units of its weight; `None` where it cannot be carried, the frame is not held or
    /// breaks a limit, or up is not known.
    pub grip_force_per_weight: Option<f64>,
    /// What is wrong with the human hand in the frame.
    pub flags: Vec<FrameFlag>,
    /// What is wrong with the grasp, one sentence each.
    pub reasons: Vec<String>,
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
    object: &Object,
    planned: &SolvedFrame,
    context: &FrameContext<'_>,
    options: &GraspOptions,
) -> Result<GraspFrame> {
    let &FrameContext { reference, t_s, before, up } = context;
    let HandState { object_from_base, q } = &planned.state;
    let robot = &hand.target.robot;
    let grasp = Grasp::new(robot, q.clone(), *object_from_base);
    let mut limits = options.limits.clone();
    if !planned.held {
        // Before and after the hold nothing has to touch.
        (limits.thumb, limits.min_fingers) = (false, 0);
    }
    // Only the way of its weight: there is no table.
    let lifted = match up {
        Some(up) => object.clone().with_rest_pose(Pose::from_parts(Translation3::identity(), upright(&up))),
        None => object.clone(),
    };
    let evaluation = evaluate_with(&hand.fine, &grasp, &lifted, robot, &limits)?;

    let posed = hand.posed(q, object_from_base);
    let reference_posed = hand.posed(&reference.q, &reference.object_from_base);
    let exact = object.geometry.exact();
    let fingers: Vec<FingerContact> = (0..hand.fingers.len())
        .map(|f| {
            let (pad, tip) = (&hand.fingers[f], hand.fingers[f].tip(&posed));
            let nearest = pad.fine.nearest(&posed.links, &*object.geometry);
            let gap_m = nearest.map_or(f64::INFINITY, |(_, point, _)| exact.signed_distance(&point).distance_m);
            FingerContact {
                finger: hand.target.fingers[f].human,
                takes_part: planned.target_weights[f] > 0.0,
                gap_mm: 1e3 * gap_m,
                tip_gap_mm: 1e3 * exact.signed_distance(&tip).distance_m,
                residual_mm: 1e3 * (tip - pad.tip(&reference_posed)).norm(),
                touches: evaluation.fingers[f].touches,
            }
        })
        .collect();
    let apart: Vec<f64> = q.iter().zip(&reference.q).map(|(a, b)| (a - b).abs()).collect();
    let mean_joint_distance_rad = apart.iter().sum::<f64>() / apart.len().max(1) as f64;
    let shift = object_from_base.translation.vector - reference.object_from_base.translation.vector;
    let joint_speed_rad_s = before.map_or(0.0, |(b, dt)| {
        let most = q.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        if dt > 0.0 { most / dt } else { 0.0 }
    });
    let mut reasons = evaluation.failures.clone();
    if mean_joint_distance_rad > options.max_joint_distance_rad {
        reasons
            .push(format!("the joints are {mean_joint_distance_rad:.2} rad on average from the plain retargeting's"));
    }
    if shift.norm() > options.max_wrist_shift_m {
        reasons.push(format!("the wrist is {:.0} mm from the human wrist", 1e3 * shift.norm()));
    }
    let known = planned.held && up.is_some();
    Ok(GraspFrame {
        t_s,
        grasp: grasp.with_contacts(&evaluation, robot),
        held: planned.held,
        fingers,
        mean_joint_distance_rad,
        largest_joint_distance_rad: apart.iter().copied().fold(0.0, f64::max),
        wrist_shift_mm: 1e3 * shift.norm(),
        wrist_turn_rad: object_from_base.rotation.angle_to(&reference.object_from_base.rotation),
        joint_speed_rad_s,
        grip_force_per_weight: evaluation.grip_force_n.filter(|_| known).map(|n| n / object.weight_n()),
        evaluation,
        flags: Vec::new(),
        reasons,
    })
}
