//! Which of the grasps that a policy proposes is tried first.

use std::cmp::Ordering;

use drex_grasp::Grasp;
use drex_policy::{GraspPolicy, PredictedGrasp, Query};
use drex_trial::{Assumed, Evaluator, GripForce, NoCommand};

use crate::Result;
use crate::error::Context;

/// A grasp at least this many times as probable as the most probable one is as good as that: what a network thinks of grasps that all held
/// differs by less.
const AS_GOOD: f64 = 0.5;

/// What the policy proposes, in the order of [`sort`].
///
/// # Errors
/// If the policy is not defined for what is asked.
pub fn proposals(policy: &GraspPolicy, query: &Query<'_>) -> Result<Vec<PredictedGrasp>> {
    let mut grasps = policy.predict(query)?;
    sort(&mut grasps, |g| g.weight, |g| g.grip_force_n);
    Ok(grasps)
}

/// Sorts proposals: those as good as the most probable one by how little they grip, `grip_force_n`, then the others by how probable they are,
/// `weight`. What needs less force leaves more of the motors, and presses less on the object.
pub fn sort<T>(proposals: &mut [T], weight: impl Fn(&T) -> f64, grip_force_n: impl Fn(&T) -> f64) {
    let most = proposals.iter().map(&weight).fold(0.0, f64::max);
    let good = |p: &T| weight(p) >= AS_GOOD * most;
    proposals.sort_by(|a, b| match (good(a), good(b)) {
        (true, true) => grip_force_n(a).total_cmp(&grip_force_n(b)),
        (false, false) => weight(b).total_cmp(&weight(a)),
        (true, false) => Ordering::Less,
        (false, true) => Ordering::Greater,
    });
}

/// A grasp that was chosen.
pub(crate) struct Chosen<E: Evaluator> {
    /// Its place among the grasps, from 1.
    pub place: usize,
    /// The hand, closed.
    pub closed: E::Closed,
    /// Its command; else why none of the grasps has one: the reason of the first.
    pub command: std::result::Result<E::Command, NoCommand>,
}

/// Closes the hand in a dry run, grasp by grasp, until it has a command with the grip force that is needed.
pub(crate) fn first_commanded<E: Evaluator>(evaluator: &E, grasps: &[Grasp], assumed: &Assumed) -> Result<Chosen<E>> {
    let mut first = None;
    for (i, grasp) in grasps.iter().enumerate() {
        let closed = evaluator.close(grasp, assumed)?;
        let command = evaluator.command(&closed, assumed, GripForce::Required)?;
        let holds = command.is_ok();
        if holds || first.is_none() {
            first = Some(Chosen { place: i + 1, closed, command });
        }
        if holds {
            break;
        }
    }
    first.context("the policy proposes no grasp")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use drex_core::Pose;
    use drex_grasp::Grasp;
    use drex_robot::Robot;
    use drex_trial::{Assumed, NoCommand};

    use super::{first_commanded, sort};
    use crate::formula::PinchByFirstJoint;

    #[test]
    fn the_first_that_has_a_command_is_chosen_else_the_first_one_says_why() {
        let hand = Robot::bundled("leap_right").unwrap();
        // As strong, N, as the first joint says: 100 g at friction 0.5 take 3.6 N.
        let grasps = |strongest_n: &[f64]| -> Vec<Grasp> {
            let grasp = |n: &f64| Grasp { joints_rad: vec![*n], ..Grasp::new(&hand, Vec::new(), Pose::identity()) };
            strongest_n.iter().map(grasp).collect()
        };
        let assumed = Assumed { mass_kg: 0.1, friction: 0.5 };
        let chosen = first_commanded(&PinchByFirstJoint, &grasps(&[3.0, 2.0, 50.0, 60.0]), &assumed).unwrap();
        assert!((chosen.place, chosen.closed) == (3, 50.0) && (chosen.command.unwrap() - 3.597).abs() < 1e-3);
        let none = first_commanded(&PinchByFirstJoint, &grasps(&[3.0, 2.0]), &assumed).unwrap();
        assert_eq!((none.place, none.closed), (1, 3.0));
        assert!(matches!(none.command, Err(NoCommand::TorqueLimit(_))));
        assert!(first_commanded(&PinchByFirstJoint, &[], &assumed).is_err());
    }

    #[test]
    fn of_what_is_as_probable_the_gentlest_comes_first() {
        // Weight and newtons.
        let mut proposals = [(0.1, 1.0), (0.3, 5.0), (0.4, 9.0), (0.15, 0.5), (0.25, 6.0)];
        sort(&mut proposals, |p| p.0, |p| p.1);
        assert_eq!(proposals, [(0.3, 5.0), (0.25, 6.0), (0.4, 9.0), (0.15, 0.5), (0.1, 1.0)]);
    }
}
