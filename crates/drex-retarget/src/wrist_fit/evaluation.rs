//! The result of a search, evaluated.

use drex_grasp::{Grasp, GraspEvaluation, GripForceProblem, evaluate_with, smallest_forces};

use super::WristFit;
use super::residuals::{Problem, pushed_away};
use crate::Result;
use crate::levenberg_marquardt::HandState;

/// An evaluated candidate.
pub(crate) struct Candidate {
    pub(crate) fit: WristFit,
    /// Sum of what the limits of place are missed by, mm.
    missed_mm: f64,
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
            let evaluation = &e.fit.evaluation;
            let held = evaluation.grip_force_n.is_some();
            (!evaluation.passed, e.missed_mm, !(held && evaluation.force_closure), !held, e.score)
        };
        let (a, b) = (rank(self), rank(other));
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then((a.2, a.3).cmp(&(b.2, b.3))).then(a.4.total_cmp(&b.4)).is_lt()
    }
}

/// Measures an end on the exact surface.
pub(crate) fn evaluate(problem: &Problem<'_>, state: HandState) -> Result<Candidate> {
    let (hand, options) = (problem.hand, problem.options);
    let correction_rad: Vec<f64> = state.q.iter().zip(&problem.recorded.joints).map(|(q, r)| q - r).collect();
    let grasp = Grasp::new(hand.robot, state.q.clone(), state.object_from_base);
    let evaluation = evaluate_with(&hand.fine, &grasp, problem.object, hand.robot, &options.limits)?;
    let fingers = evaluation.fingers.iter().enumerate();
    let touching_set = fingers.filter(|(_, f)| f.touches).fold(0, |set, (f, _)| set | 1 << f);
    let mean_square = correction_rad.iter().map(|c| c * c).sum::<f64>() / correction_rad.len().max(1) as f64;
    let pushed_out = pushed_away(problem, &state, touching_set);
    let pinch = 1.0 / (COMPARED_FRICTION_SHARE * problem.object.friction).max(1e-9);
    let score = mean_square.sqrt() / options.max_finger_correction_rad.max(1e-9)
        + pushed_out
        + slippery_grip_force(problem, &evaluation).map_or(SLIPPING_SCORE, |s| (s / pinch).max(1.0));
    let missed_mm = if evaluation.passed { 0.0 } else { missed_mm(problem, &state, &evaluation) };
    let fit = WristFit {
        grasp: grasp.with_contacts(&evaluation, hand.robot),
        clipped_rad: problem.recorded.clipped_rad.clone(),
        correction_rad,
        pushed_out,
        evaluation,
    };
    Ok(Candidate { fit, missed_mm, score })
}

/// Grip force of an accepted grasp in units of the weight, at a fraction of the friction; `None` if the object slips.
fn slippery_grip_force(problem: &Problem<'_>, evaluation: &GraspEvaluation) -> Option<f64> {
    let mut contacts = evaluation.contacts.clone();
    contacts.iter_mut().for_each(|c| c.friction *= COMPARED_FRICTION_SHARE);
    let down = -problem.table.up.into_inner();
    let load = GripForceProblem::new(contacts, 1.0, problem.object.center_of_mass(), down);
    let forces = if evaluation.passed { smallest_forces(&load).ok()? } else { return None };
    Some(forces.iter().map(|f| f.x).sum())
}

/// By how much in all a rejected end misses the limits of place, mm; a finger by its pad.
fn missed_mm(problem: &Problem<'_>, state: &HandState, evaluation: &GraspEvaluation) -> f64 {
    let (hand, limits) = (problem.hand, &problem.options.limits);
    let poses = hand.robot.forward_kinematics(&state.q, &state.object_from_base);
    let exact = problem.object.geometry.exact();
    let gap_m = |finger: usize| match evaluation.fingers[finger].touches {
        true => 0.0,
        false => hand.pads[1][finger].nearest(&poses, exact).map_or(f64::INFINITY, |n| n.2),
    };
    let mut others: Vec<f64> = (0..hand.fine.fingers.len()).filter(|&f| f != hand.thumb).map(gap_m).collect();
    others.sort_by(f64::total_cmp);
    let over = |value: f64, limit: f64| (value - limit).max(0.0);
    let needed = others.into_iter().take(limits.min_fingers).chain([gap_m(hand.thumb)]);
    1e3 * needed.map(|gap| over(gap, limits.touch_gap_m)).sum::<f64>()
        + over(evaluation.penetration_mm, 1e3 * limits.max_penetration_m)
        + over(1e3 * limits.min_table_clearance_m, evaluation.table_clearance_mm)
        + over(evaluation.self_collision.as_ref().map_or(0.0, |c| c.depth_mm), 1e3 * limits.max_self_collision_m)
}
