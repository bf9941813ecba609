//! From a human grasp to the robot's, over a whole sequence and aware of the object.
//!
//! Everything is in the object's frame. The plain `vector` result and the human wrist are what the solution stays close to; from
//! the recording follows when the object is held and with which fingers ([`phases`]); where on the object they belong is a line
//! through it that stands upright on the surface at both ends, near the human hand's ([`goals`]). Each frame is a nonlinear
//! least-squares problem in wrist and joints ([`terms`], [`crate::levenberg_marquardt`]); frames are solved in turn within what the joints' speeds
//! leave ([`sequence`]) and measured on the exact surface and the true shapes ([`evaluation`]).

mod evaluation;
mod goals;
mod hand;
mod phases;
mod sequence;
mod surface_points;
mod terms;

use drex_core::{Object, Pose};
use drex_demo::{Demonstration, FrameFlag};
use drex_grasp::EvaluationOptions;
use nalgebra::{Unit, Vector3};
use rayon::prelude::*;

use crate::levenberg_marquardt::HandState;
use crate::{Error, Result, RetargetOptions, Retargeting, TargetHand, retarget};
pub use evaluation::{FingerContact, GraspFrame};
pub(crate) use evaluation::{FrameContext, evaluate};
pub(crate) use hand::GraspHand;
pub(crate) use sequence::single;

/// Rules of an accepted grasp and effort of the search.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct GraspOptions {
    /// The plain retargeting that the grasp stays close to.
    pub vector: RetargetOptions,
    /// Hand frames in which a fingertip comes this near to the object begin a grasp phase, m.
    pub touch_m: f64,
    /// A grasp phase goes on while a fingertip is this near, m.
    pub release_m: f64,
    /// Speed of the object from which on it counts as held where a fingertip is within `reach_m`, m/s.
    pub carry_speed_m_s: f64,
    /// Largest distance of a fingertip from an object that moves and counts as held, m.
    pub reach_m: f64,
    /// Frames between two held ones at most this far apart are held, s.
    pub bridge_s: f64,
    /// Fewest frames of a grasp phase; shorter ones are noise.
    pub min_frames: usize,
    /// Fastest joint, rad/s (m/s).
    pub max_joint_speed: f64,
    /// What an accepted frame keeps: the limits of a demonstrated grasp, but fingers touch up to 5 mm off, since trackers know a fingertip no better and
    /// a hand that is closed by force goes on, and there is no table, since a recording does not say where it is.
    pub limits: EvaluationOptions,
    /// Largest distance of the wrist of an accepted frame from the human wrist, m.
    pub max_wrist_shift_m: f64,
    /// Largest mean joint distance to the plain vector result of an accepted frame, rad.
    pub max_joint_distance_rad: f64,
}

impl Default for GraspOptions {
    fn default() -> Self {
        let mut limits = EvaluationOptions::demonstrated();
        (limits.touch_gap_m, limits.min_table_clearance_m) = (0.005, f64::NEG_INFINITY);
        Self {
            limits,
            vector: RetargetOptions::default(),
            touch_m: 0.01,
            release_m: 0.025,
            carry_speed_m_s: 0.1,
            reach_m: 0.12,
            bridge_s: 1.0,
            min_frames: 3,
            max_joint_speed: 8.5,
            max_wrist_shift_m: 0.12,
            max_joint_distance_rad: 0.35,
        }
    }
}

/// A sequence, retargeted with contacts.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct GraspRetargeting {
    /// The plain vector result that the frames stay close to, with joint names and the scale of the human hand.
    pub plain: Retargeting,
    /// One per frame of the demonstration.
    pub frames: Vec<GraspFrame>,
}

/// Retargets a sequence: wrist and joints such that the hand holds the object in the frames in which the human hand does.
///
/// Frames in which the human hand does not hold it follow the `vector` result, slowed to the largest joint speed and kept out of the
/// object. The same bytes for the same input, on any number of threads.
///
/// # Errors
/// If no frame has a pose of the object, the hand has no thumb or no shapes, an option makes no sense, and as [`retarget`].
pub fn retarget_grasp(
    demo: &Demonstration,
    target: &TargetHand,
    object: &Object,
    options: &GraspOptions,
) -> Result<GraspRetargeting> {
    check(options)?;
    let mut flags = vec![Vec::new(); demo.frames.len()];
    let poses = object_poses(demo, &mut flags)?;
    let hand = GraspHand::new(target)?;
    let vector = retarget(demo, target, &options.vector)?;
    let references = references(&vector, &poses);
    let phases = phases::grasp_phases(demo, &poses, target, &*object.geometry, options);
    let planned = sequence::solve(&hand, object, demo, &poses, &references, &phases, options);
    let up: Vec<Option<Unit<Vector3<f64>>>> =
        poses.iter().map(|p| demo.up.map(|up| p.rotation.inverse() * up)).collect();
    let frames = (0..planned.len())
        .into_par_iter()
        .map(|t| {
            let before =
                t.checked_sub(1).map(|b| (planned[b].state.q.as_slice(), demo.frames[t].t_s - demo.frames[b].t_s));
            let context = FrameContext { reference: &references[t], t_s: demo.frames[t].t_s, before, up: up[t] };
            let mut frame = evaluate(&hand, object, &planned[t], &context, options)?;
            frame.flags.clone_from(&vector.frames[t].flags);
            frame.flags.extend_from_slice(&flags[t]);
            Ok(frame)
        })
        .collect::<Result<Vec<_>>>()?;
    Ok(GraspRetargeting { plain: vector, frames })
}

fn check(options: &GraspOptions) -> Result<()> {
    let lengths = [
        ("touch_m", options.touch_m),
        ("release_m", options.release_m),
        ("reach_m", options.reach_m),
        ("bridge_s", options.bridge_s),
    ];
    if let Some((name, value)) = lengths.iter().find(|(_, v)| !(*v >= 0.0)) {
        return Err(Error::value(format!("{name} is {value}"), "give zero or more"));
    }
    if !(options.max_joint_speed > 0.0) {
        return Err(Error::value(
            format!("max_joint_speed is {}", options.max_joint_speed),
            "give the speed of the slowest motor, rad/s",
        ));
    }
    Ok(())
}

/// The plain result in the object's frame. Frames before the first hand stand where that is.
fn references(vector: &Retargeting, poses: &[Pose]) -> Vec<HandState> {
    let first = vector.frames.iter().find_map(|f| f.source_from_base).unwrap_or_else(Pose::identity);
    let frames = vector.frames.iter().zip(poses);
    frames
        .map(|(f, pose)| HandState {
            object_from_base: pose.inv_mul(&f.source_from_base.unwrap_or(first)),
            q: f.q.clone(),
        })
        .collect()
}

/// The object's pose in every frame, `source_from_object`: where it was not seen, on the way between the frames around, which are
/// flagged.
fn object_poses(demo: &Demonstration, flags: &mut [Vec<FrameFlag>]) -> Result<Vec<Pose>> {
    let seen: Vec<(usize, Pose)> =
        demo.frames.iter().enumerate().filter_map(|(t, f)| Some((t, f.source_from_object?))).collect();
    let (Some(first), Some(last)) = (seen.first(), seen.last()) else {
        return Err(Error::value(
            format!("no frame of {} has a pose of the object", demo.source),
            "the grasp objective needs them: give object poses, or use the vector objective",
        ));
    };
    Ok((0..demo.frames.len())
        .map(|t| {
            let after = seen.partition_point(|(s, _)| *s < t);
            let (b, to) = seen.get(after).unwrap_or(last);
            if *b == t {
                return *to;
            }
            flags[t].push(FrameFlag::ObjectNotSeen);
            let (a, from) = if after > 0 { &seen[after - 1] } else { first };
            let share = if a < b { (t as f64 - *a as f64) / (*b as f64 - *a as f64) } else { 0.0 };
            // Half a turn apart there is no way between: stay.
            from.try_lerp_slerp(to, share.clamp(0.0, 1.0), 1e-9).unwrap_or(*from)
        })
        .collect())
}

impl GraspFrame {
    /// Whether the frame was held and kept all rules.
    pub fn is_accepted(&self) -> bool {
        self.held && self.reasons.is_empty()
    }
}
