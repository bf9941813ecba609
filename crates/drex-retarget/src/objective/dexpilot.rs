//! Vectors from the wrist to the fingertips and between fingertips, drawn together where the human hand pinches.

use drex_core::Pose;
use drex_demo::{HumanFinger, KeyPoints};
use nalgebra::Vector3;

use super::vector::tip_target;
use super::{Loss, Term};

/// Where Huber's function turns, m; dex-retargeting does not read it from its configuration.
pub(crate) const LOSS: Loss = Loss { delta: 0.03, per_coordinate: false };

/// A pair with the thumb is drawn together below this distance of the human fingertips, m,
const PINCH_ON: f64 = 0.03;
/// and let go above this one.
const PINCH_OFF: f64 = 0.05;
/// Two fingers that both pinch with the thumb are drawn together up to this distance, m.
const FINGERS_ON: f64 = 0.03;
/// How far apart the robot's fingertips shall be then (η₁, η₂), m: thumb and finger, finger and finger.
const ETA: (f64, f64) = (1e-4, 3e-2);
/// Weights of drawn pairs: thumb and finger, finger and finger. Other pairs have 1.
const DRAWN: (f64, f64) = (200.0, 400.0);

/// Which pairs of fingertips are drawn together; remembered from frame to frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct Projection {
    /// Per pair, in the order of [`pairs`].
    drawn: Vec<bool>,
}

/// Pairs (nearer to the thumb, farther from it) of `n` fingers, the thumb's first.
fn pairs(n: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..n).flat_map(move |task| (task + 1..n).map(move |origin| (task, origin)))
}

impl Projection {
    /// Brings the pairs up to date with the distances of the human fingertips; pairs with a missing one stay.
    fn update(&mut self, tips: &[Option<Vector3<f64>>]) {
        let n = tips.len();
        self.drawn.resize(pairs(n).count(), false);
        for (k, (task, origin)) in pairs(n).enumerate() {
            let (Some(a), Some(b)) = (tips[task], tips[origin]) else { continue };
            let distance = (a - b).norm();
            if task == 0 {
                self.drawn[k] = distance < PINCH_ON || (self.drawn[k] && distance <= PINCH_OFF);
            } else {
                // Pairs of the thumb come first, in the order of the fingers.
                self.drawn[k] = self.drawn[task - 1] && self.drawn[origin - 1] && distance <= FINGERS_ON;
            }
        }
    }
}

/// Terms of the objective `dexpilot` of dex-retargeting 0.5.0: mean over the n (n − 1) / 2 + n vectors of w · Huber(|e|).
///
/// `points` are in the operator frame; point i of the chains is the tip of `fingers[i]`, the thumb first. Vectors from the wrist
/// weigh n (n − 1) / 2 + n. A drawn pair has its direction and the length η as target, which is not scaled; thresholds are on
/// the human distances as `points` have them.
pub(crate) fn dexpilot_terms(
    terms: &mut Vec<Term>,
    projection: &mut Projection,
    fingers: &[HumanFinger],
    points: &KeyPoints,
    base_from_operator: &Pose,
    scale: f64,
) {
    terms.clear();
    let mut tips = [None; HumanFinger::ALL.len()];
    let tips = &mut tips[..fingers.len()];
    for (tip, finger) in tips.iter_mut().zip(fingers) {
        *tip = points[finger.tip()].map(|p| p.coords);
    }
    projection.update(tips);
    for (k, (task, origin)) in pairs(tips.len()).enumerate() {
        let (Some(a), Some(b)) = (tips[task], tips[origin]) else { continue };
        let v = base_from_operator.rotation * (a - b);
        let (eta, drawn) = if task == 0 { (ETA.0, DRAWN.0) } else { (ETA.1, DRAWN.1) };
        let (target, weight) = match projection.drawn[k] {
            true => (v / (v.norm() + 1e-6) * eta, drawn),
            false => (v * scale, 1.0),
        };
        terms.push(Term { task, origin: Some(origin), target, weight });
    }
    let n = tips.len();
    let wrist_weight = (n * n.saturating_sub(1) / 2 + n) as f64;
    for (task, tip) in tips.iter().enumerate() {
        if let Some(tip) = tip {
            let target = tip_target(tip, base_from_operator, scale);
            terms.push(Term { task, origin: None, target, weight: wrist_weight });
        }
    }
    let count = terms.len().max(1) as f64;
    for term in terms {
        term.weight /= count;
    }
}

#[cfg(test)]
#[path = "dexpilot_tests.rs"]
mod tests;
