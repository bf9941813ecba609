//! How large the human hand is against the robot's.

use drex_demo::HumanFinger;
use nalgebra::Vector3;

use crate::hand::TargetHand;
use crate::kinematics::Chains;
use crate::objective::{FrameProblem, Loss, Term};
use crate::solve::{EXACT, Newton, Problem, State, Unknowns};

/// Hand length to which a human hand is brought before `dexpilot` measures its pinches, where the scale is automatic, m: about that
/// of an adult, so that its thresholds keep their meaning whatever the unit and size of the recording.
pub(crate) const NOMINAL_LENGTH_M: f64 = 0.185;

/// Largest distance of a fingertip from the wrist, thumb left out, m.
pub(crate) fn hand_reach_m(hand: &TargetHand, chains: &Chains, unknowns: &Unknowns, start: &State) -> f64 {
    let wrist = hand.base_from_operator.translation.vector;
    let loss = Loss { delta: 1e-3, per_coordinate: false };
    let mut problem = FrameProblem::new(chains.clone(), unknowns.clone(), loss, 0.0, start.clone());
    let mut solver = Newton::default();
    let mut reach = 0.0_f64;
    for (task, finger) in hand.fingers.iter().enumerate() {
        if finger.human == HumanFinger::Thumb && hand.fingers.len() > 1 {
            continue;
        }
        let mut state = start.clone();
        // The farthest point in a direction; the next direction is where that point is.
        let mut direction = hand.base_from_operator.rotation * Vector3::z();
        for _ in 0..FARTHEST_ROUNDS {
            let target = wrist + direction * FAR_M;
            problem.terms = vec![Term { task, origin: None, target, weight: 1.0 }];
            problem.previous = state.clone();
            problem.norm_delta = 1e-6;
            solver.minimise(&mut problem, &mut state, EXACT, 100);
            problem.value(&state);
            let arm = problem.error(&problem.terms[0]) + target - wrist;
            reach = reach.max(arm.norm());
            match arm.try_normalize(1e-9) {
                Some(next) => direction = next,
                None => break,
            }
        }
    }
    reach
}

/// A target that no hand reaches.
const FAR_M: f64 = 10.0;
const FARTHEST_ROUNDS: usize = 8;
