//! The result of a search, evaluated by the rules.

use drex_grasp::{grip_force_per_weight, holds_any_load};

use super::residuals::{Problem, pushed_away};
use super::{FingerGap, Rejection, Verdict, WristFit};
use crate::Result;
use crate::levenberg_marquardt::HandState;

/// An evaluated candidate.
pub(crate) struct Candidate {
    pub(crate) fit: WristFit,
    /// Sum of what the rules are broken by, mm.
    broken_mm: f64,
    /// Among the accepted: root mean square correction in units of the largest allowed, plus the grip force in units of that of a
    /// plain pinch (one over friction), plus how much the pads push the object out of the hand; the grip force at [`COMPARED_FRICTION_SHARE`] friction. A hook or a tray that needs less than a pinch is not rewarded for it.
    score: f64,
}

/// Ends are compared at this fraction of the friction, so that those at the edge of slipping lose.
const COMPARED_FRICTION_SHARE: f64 = 0.7;
/// Score of a grasp that cannot carry the object at that friction.
const SLIPPING_SCORE: f64 = 10.0;

impl Candidate {
    /// Accepted before rejected; of the rejected the one that misses by least; of the accepted those in force closure that can
    /// carry the object, then the least of deviation from the record and grip force.
    pub(crate) fn better_than(&self, other: &Self) -> bool {
        let rank = |e: &Self| {
            let held = e.fit.grip_force_per_weight.is_some();
            (!e.fit.verdict.is_accepted(), e.broken_mm, !(held && e.fit.force_closure), !held, e.score)
        };
        let (a, b) = (rank(self), rank(other));
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then((a.2, a.3).cmp(&(b.2, b.3))).then(a.4.total_cmp(&b.4)).is_lt()
    }
}

/// Measures an end on the exact surface.
pub(crate) fn evaluate(problem: &Problem<'_>, state: HandState) -> Result<Candidate> {
    let (hand, options) = (problem.hand, problem.options);
    let poses = hand.robot.forward_kinematics(&state.q, &state.object_from_base);
    let sdf = problem.object.exact;
    let fingers: Vec<FingerGap> = hand.pads[1]
        .iter()
        .zip(&hand.fine.fingers)
        .map(|(pad, finger)| {
            let gap = pad.nearest(&poses, sdf).map_or(f64::INFINITY, |n| n.2);
            FingerGap { finger: finger.name.clone(), gap_mm: 1e3 * gap, touches: gap <= options.contact_gap_m }
        })
        .collect();
    let depths = hand.fine.depths(&poses, sdf, 0.05);
    let (deepest, depth) = largest(&depths);
    let lowest = hand.fine.lowest(&poses, &problem.table.up);
    let (low_link, below) = largest(&lowest.iter().map(|h| problem.table.height_m - h).collect::<Vec<_>>());

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
        reasons.push(Rejection::BelowTable {
            link: link(low_link),
            depth_mm: 1e3 * (below + options.min_table_clearance_m),
        });
        broken_mm += 1e3 * (below + options.min_table_clearance_m);
    }
    let accepted = reasons.is_empty();
    let touching_set = fingers.iter().enumerate().filter(|(_, g)| g.touches).fold(0, |set, (f, _)| set | 1 << f);
    let force = if accepted { Force::of(problem, &state)? } else { Force::default() };
    let correction_rad: Vec<f64> = state.q.iter().zip(&problem.recorded.joints).map(|(q, r)| q - r).collect();
    let mean_square = correction_rad.iter().map(|c| c * c).sum::<f64>() / correction_rad.len().max(1) as f64;
    let pushed_out = pushed_away(problem, &state, touching_set);
    let pinch = 1.0 / (COMPARED_FRICTION_SHARE * options.friction).max(1e-9);
    let score = mean_square.sqrt() / options.max_finger_correction_rad.max(1e-9)
        + pushed_out
        + force.slippery.map_or(SLIPPING_SCORE, |s| (s / pinch).max(1.0));
    let fit = WristFit {
        object_from_base: state.object_from_base,
        joints: state.q,
        clipped_rad: problem.recorded.clipped_rad.clone(),
        correction_rad,
        fingers,
        penetration_mm: 1e3 * depth,
        table_clearance_mm: -1e3 * below,
        pushed_out,
        force_closure: force.closed,
        grip_force_per_weight: force.grip_force,
        verdict: if accepted { Verdict::Accepted } else { Verdict::Rejected(reasons) },
    };
    Ok(Candidate { fit, broken_mm, score })
}

/// What the contacts can do.
#[derive(Default)]
struct Force {
    closed: bool,
    /// Grip force per weight, at the friction of the options and at a fraction of it.
    grip_force: Option<f64>,
    slippery: Option<f64>,
}

impl Force {
    fn of(problem: &Problem<'_>, state: &HandState) -> Result<Self> {
        let hand = problem.hand;
        let mut contacts =
            hand.fine.contacts(hand.robot, &state.q, &state.object_from_base, problem.object.exact, &hand.contact)?;
        let com = problem.object.center_of_mass;
        let closed = holds_any_load(&contacts, &com)?;
        let grip_force = grip_force_per_weight(&contacts, com, problem.table.up)?;
        contacts.iter_mut().for_each(|c| c.friction *= COMPARED_FRICTION_SHARE);
        let slippery = grip_force_per_weight(&contacts, com, problem.table.up)?;
        Ok(Self { closed, grip_force, slippery })
    }
}

/// Index and value of the largest entry.
fn largest(values: &[f64]) -> (usize, f64) {
    values.iter().copied().enumerate().fold((0, f64::NEG_INFINITY), |best, v| if v.1 > best.1 { v } else { best })
}
