//! Vectors from the wrist to the fingertips.

use drex_core::Pose;
use drex_demo::{HumanFinger, KeyPoints};
use nalgebra::{Point3, Vector3};

use super::{Loss, Term};

/// Where Huber's function turns, m.
pub(crate) const LOSS: Loss = Loss { delta: 0.02, per_coordinate: false };

/// Terms of the objective `vector` of dex-retargeting: mean over the fingers of Huber(|p_tip − p_wrist − scale · v|).
///
/// `points` are in the operator frame; point i of the chains is the tip of `fingers[i]`, in the robot's base frame.
pub(crate) fn vector_terms(
    terms: &mut Vec<Term>,
    fingers: &[HumanFinger],
    points: &KeyPoints,
    base_from_operator: &Pose,
    scale: f64,
) {
    terms.clear();
    for (i, finger) in fingers.iter().enumerate() {
        if let Some(tip) = points[finger.tip()] {
            let target = tip_target(&tip.coords, base_from_operator, scale);
            terms.push(Term { task: i, origin: None, target, weight: 1.0 });
        }
    }
    let n = terms.len().max(1) as f64;
    for term in terms {
        term.weight /= n;
    }
}

/// Where a fingertip at `tip` (operator frame) should be, base frame.
pub(crate) fn tip_target(tip: &Vector3<f64>, base_from_operator: &Pose, scale: f64) -> Vector3<f64> {
    (base_from_operator * Point3::from(tip * scale)).coords
}
