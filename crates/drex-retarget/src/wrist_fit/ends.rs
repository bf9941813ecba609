//! Where a search ended, judged by the rules.

use drex_grasp::{SqueezeError, SqueezeProblem, smallest_forces};

use super::residuals::{Scene, State};
use super::{FingerGap, Rejection, Verdict, WristFit};
use crate::Result;

/// A judged end.
pub(crate) struct End {
    pub(crate) fit: WristFit,
    /// Sum of what the rules are broken by, mm.
    broken_mm: f64,
}

impl End {
    /// Accepted before rejected; of the accepted those that can carry the object, with the smallest squeeze plus a little for
    /// corrections; of the rejected the one that misses by least.
    pub(crate) fn better_than(&self, other: &Self) -> bool {
        let rank = |e: &Self| {
            let held = e.fit.squeeze_per_weight;
            let correction: f64 = e.fit.correction_rad.iter().map(|c| c * c).sum();
            (!e.fit.verdict.is_accepted(), e.broken_mm, held.is_none(), held.unwrap_or(0.0) + correction)
        };
        let (a, b) = (rank(self), rank(other));
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)).then(a.3.total_cmp(&b.3)).is_lt()
    }
}

/// Measures an end on the exact surface.
pub(crate) fn judge(scene: &Scene<'_>, state: State) -> Result<End> {
    let (hand, options) = (scene.hand, scene.options);
    let poses = hand.robot.forward_kinematics(&state.joints, &state.object_from_base);
    let sdf = scene.object.judge;
    let fingers: Vec<FingerGap> = hand.pads[1]
        .iter()
        .zip(&hand.fine.fingers)
        .map(|(pad, finger)| {
            let gap = pad
                .points
                .iter()
                .map(|&(link, i)| sdf.signed_distance(&(poses[link] * hand.fine.links[link].samples[i].0)).distance_m)
                .fold(f64::INFINITY, f64::min);
            FingerGap { finger: finger.name.clone(), gap_mm: 1e3 * gap, touches: gap <= options.contact_gap_m }
        })
        .collect();
    let depths = hand.fine.depths(&poses, sdf, options.contact_gap_m);
    let (deepest, depth) = largest(&depths);
    let lowest = hand.fine.lowest(&poses, &scene.table.up);
    let (low_link, below) = largest(&lowest.iter().map(|h| scene.table.height_m - h).collect::<Vec<_>>());

    let mut reasons = Vec::new();
    let mut broken_mm = 0.0;
    let gap_limit_mm = 1e3 * options.contact_gap_m;
    let thumb = &fingers[hand.thumb];
    if !thumb.touches {
        reasons.push(Rejection::ThumbMisses { gap_mm: thumb.gap_mm });
        broken_mm += thumb.gap_mm - gap_limit_mm;
    }
    let mut missing: Vec<&FingerGap> =
        fingers.iter().enumerate().filter(|(f, g)| *f != hand.thumb && !g.touches).map(|(_, g)| g).collect();
    let touching = fingers.len() - 1 - missing.len();
    if touching < options.min_fingers {
        missing.sort_by(|a, b| a.gap_mm.total_cmp(&b.gap_mm));
        broken_mm += missing.iter().take(options.min_fingers - touching).map(|g| g.gap_mm - gap_limit_mm).sum::<f64>();
        let missing = missing.iter().map(|g| (g.finger.clone(), g.gap_mm)).collect();
        reasons.push(Rejection::FingersMiss { missing, touching, needed: options.min_fingers });
    }
    let link = |i: usize| hand.robot.links[i].name.clone();
    if depth > options.max_penetration_m {
        reasons.push(Rejection::Penetrates { link: link(deepest), depth_mm: 1e3 * depth });
        broken_mm += 1e3 * (depth - options.max_penetration_m);
    }
    if below > -options.min_table_clearance_m {
        reasons.push(Rejection::BelowTable { link: link(low_link), depth_mm: 1e3 * (below + options.min_table_clearance_m) });
        broken_mm += 1e3 * (below + options.min_table_clearance_m);
    }
    let squeeze_per_weight = if reasons.is_empty() { squeeze_per_weight(scene, &state)? } else { None };
    let correction_rad = state.joints.iter().zip(&scene.recorded.joints).map(|(q, r)| q - r).collect();
    let fit = WristFit {
        object_from_base: state.object_from_base,
        joints: state.joints,
        clipped_rad: scene.recorded.clipped_rad.clone(),
        correction_rad,
        fingers,
        penetration_mm: 1e3 * depth,
        table_clearance_mm: -1e3 * below,
        squeeze_per_weight,
        verdict: if reasons.is_empty() { Verdict::Accepted } else { Verdict::Rejected(reasons) },
    };
    Ok(End { fit, broken_mm })
}

/// The squeeze for a unit weight; `None` if the contacts cannot carry it.
fn squeeze_per_weight(scene: &Scene<'_>, state: &State) -> Result<Option<f64>> {
    let hand = scene.hand;
    let contacts =
        hand.fine.contacts(hand.robot, &state.joints, &state.object_from_base, scene.object.judge, &hand.contact)?;
    let down = -scene.table.up.into_inner();
    match smallest_forces(&SqueezeProblem::new(contacts, 1.0, scene.object.center_of_mass, down)) {
        Ok(forces) => Ok(Some(forces.iter().map(|f| f.x).sum())),
        // At the edge of closure the solver may stop without an answer: such a grasp is not worth choosing.
        Err(SqueezeError::Input(drex_grasp::GraspError::Solver { .. })) => Ok(None),
        Err(SqueezeError::Input(error)) => Err(error.into()),
        Err(_) => Ok(None),
    }
}

/// Index and value of the largest entry.
fn largest(values: &[f64]) -> (usize, f64) {
    values.iter().copied().enumerate().fold((0, f64::NEG_INFINITY), |best, v| if v.1 > best.1 { v } else { best })
}
