//! Positions of fingertips and middle joints with a floating base.

use drex_demo::{HumanFinger, KeyPoints};
use nalgebra::{Point3, Vector3};

use super::{Loss, Term};

/// Where Huber's function turns, m.
pub(crate) const LOSS: Loss = Loss { delta: 0.02, per_coordinate: true };

/// Terms of the objective `position` of dex-retargeting: mean over the coordinates of Huber(p − target).
///
/// `points` are in the source frame, drawn apart from the `wrist` by `scale`; point i of the chains is the tip of `fingers[i]`,
/// point `fingers.len() + i` its middle. Each coordinate has a Huber function of its own: turning the source frame changes the
/// objective where a difference is longer than 2 cm.
pub(crate) fn position_terms(
    terms: &mut Vec<Term>,
    fingers: &[HumanFinger],
    points: &KeyPoints,
    wrist: &Vector3<f64>,
    scale: f64,
) {
    terms.clear();
    let ends = fingers.iter().map(|f| f.tip()).chain(fingers.iter().map(|f| f.middle()));
    for (task, key_point) in ends.enumerate() {
        if let Some(p) = points[key_point] {
            let target = position_target(&p, wrist, scale).coords;
            terms.push(Term { task, origin: None, target, weight: 1.0 });
        }
    }
    let coordinates = (3 * terms.len()).max(1) as f64;
    for term in terms {
        term.weight /= coordinates;
    }
}

/// Where the key point `p` of a hand with this wrist should be, source frame.
pub(crate) fn position_target(p: &Point3<f64>, wrist: &Vector3<f64>, scale: f64) -> Point3<f64> {
    Point3::from(wrist + (p.coords - wrist) * scale)
}
