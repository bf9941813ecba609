//! When does the human hand hold the object, and with which fingers?
//!
//! Hand and object come from separate estimators and do not fit together to better than centimetres, so that single distances decide
//! little: an object that moves is held, a hand that reached it and later carries it held it in between, and of the fingers those
//! that are about as near as the nearest ones take part.

use drex_core::{Pose, SignedDistance};
use drex_demo::{Demonstration, HumanFinger};

use super::GraspOptions;
use crate::TargetHand;

/// A run of frames in which the object is held.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct GraspPhase {
    pub(crate) frames: std::ops::Range<usize>,
    /// Per finger of the robot hand, whether it takes part.
    pub(crate) fingers: Vec<bool>,
    /// The frame in which hand and object fit best.
    pub(crate) best: usize,
}

/// Window over which the object's speed is taken, frames to each side.
const WINDOW: usize = 3;
/// A finger takes part if it is at most this much farther from the object than the nearest of its kind, m.
const FINGER_SPREAD_M: f64 = 0.03;

/// The grasp phases of a sequence; `poses` are the object's in the source frame.
pub(crate) fn grasp_phases(
    demo: &Demonstration,
    poses: &[Pose],
    target: &TargetHand,
    object: &dyn SignedDistance,
    options: &GraspOptions,
) -> Vec<GraspPhase> {
    let n = poses.len();
    // Distance of every human finger's last joint and tip.
    let distances: Vec<Vec<Option<f64>>> = (0..n)
        .map(|t| {
            let to_object = poses[t].inverse();
            let seen = |i: usize| demo.frames[t].points[i].filter(|p| p.iter().all(|v| v.is_finite()));
            let at = |i: usize| seen(i).map(|p| object.signed_distance(&(to_object * p)).distance_m);
            HumanFinger::ALL.iter().map(|f| at(f.tip())).collect()
        })
        .collect();
    let nearest = |t: usize| distances[t].iter().flatten().copied().fold(f64::INFINITY, f64::min);
    let speed = |t: usize| {
        let (a, b) = (t.saturating_sub(WINDOW), (t + WINDOW).min(n - 1));
        let dt = demo.frames[b].t_s - demo.frames[a].t_s;
        if dt > 0.0 { (poses[b].translation.vector - poses[a].translation.vector).norm() / dt } else { 0.0 }
    };
    let mut held: Vec<bool> = Vec::with_capacity(n);
    for t in 0..n {
        let before = t > 0 && held[t - 1];
        let touch_m = if before { options.release_m } else { options.touch_m };
        held.push(nearest(t) <= touch_m || (speed(t) >= options.carry_speed_m_s && nearest(t) <= options.reach_m));
    }
    // Occlusion: between two held frames the hand does not let go and come back within a second.
    let mut last: Option<usize> = None;
    for t in 0..n {
        if !held[t] {
            continue;
        }
        if let Some(l) = last
            && demo.frames[t].t_s - demo.frames[l].t_s <= options.bridge_s
            && (l..t).all(|k| nearest(k) <= 1.25 * options.reach_m)
        {
            held[l..t].fill(true);
        }
        last = Some(t);
    }
    let mut phases = Vec::new();
    let mut t = 0;
    while t < n {
        if !held[t] {
            t += 1;
            continue;
        }
        let start = t;
        while t < n && held[t] {
            t += 1;
        }
        if t - start < options.min_frames {
            continue;
        }
        let median = |f: HumanFinger| {
            let mut d: Vec<f64> = (start..t).filter_map(|k| distances[k][f as usize]).collect();
            d.sort_by(f64::total_cmp);
            d.get(d.len() / 2).copied().unwrap_or(f64::INFINITY)
        };
        let medians: Vec<f64> = target.fingers.iter().map(|f| median(f.human)).collect();
        let thumb = |k: usize| target.fingers[k].human == HumanFinger::Thumb;
        let closest = (0..medians.len()).filter(|&k| !thumb(k)).map(|k| medians[k]).fold(f64::INFINITY, f64::min);
        let fingers = (0..medians.len()).map(|k| thumb(k) || medians[k] <= closest + FINGER_SPREAD_M).collect();
        let misfit = |k: usize| distances[k].iter().flatten().map(|d| d.abs()).sum::<f64>();
        let best = (start..t).min_by(|&a, &b| misfit(a).total_cmp(&misfit(b))).unwrap_or(start);
        phases.push(GraspPhase { frames: start..t, fingers, best });
    }
    phases
}
