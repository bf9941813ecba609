//! A given squeeze, shared among the contacts so that they are furthest from slipping.

use nalgebra::Vector3;

use crate::balance::{Goal, Limits, Outcome, balance};
use crate::squeeze::{by_finger, check, torque_margin, torques};
use crate::{GraspError, SqueezeError, SqueezeProblem, smallest_forces};

/// How a squeeze is shared.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Distribution {
    /// Force of each contact on the object, N, object frame.
    pub forces: Vec<Vector3<f64>>,
    /// Normal force of each contact, N; they add up to the squeeze asked for.
    pub normal_n: Vec<f64>,
    /// Sum of the normal forces of each finger, N; index = finger. Fingers beyond the last that touches are not listed.
    pub per_finger_n: Vec<f64>,
    /// Sum of the normal forces of the palm, N.
    pub palm_n: f64,
    /// Torque of each joint for the contact forces alone, Jᵀ f, N m; empty if the problem has no
    /// [`TorqueLimits`](crate::TorqueLimits).
    pub contact_torques_nm: Vec<f64>,
    /// The same with what holds the hand's own weight, N m: what the limits apply to.
    pub joint_torques_nm: Vec<f64>,
    /// The normal force, N, that every patch (contacts of one link that push about the same way) could lose at once, its
    /// contacts in equal parts, before one of them slips under unchanged tangential force. Zero at the smallest squeeze.
    pub slack_n: f64,
    /// Least 1 − |τ| / |limit| over the joints: 0 at a limit. One if there are no limits.
    pub torque_margin: f64,
}

/// Shares the sum of normal forces `total_n` (N) among the contacts so that it balances the problem's load and keeps them
/// furthest from slipping: maximise s subject to |f_t| <= μ (f_n − s / k), k the number of contacts of a patch, and the
/// problem's floors, ceilings and motors. The slack is common to all and in newtons, so that an error of some newtons in any
/// finger's force (friction in the joints, say) is survived best; among equals the most even forces are taken, which makes the
/// answer unique and smooth in the load.
///
/// # Errors
/// [`SqueezeError::Total`] with the smallest and largest possible sum if this one is not; otherwise as
/// [`crate::smallest_squeeze`].
pub fn distribute(problem: &SqueezeProblem, total_n: f64) -> Result<Distribution, SqueezeError> {
    check(problem)?;
    if !(total_n >= 0.0 && total_n.is_finite()) {
        return Err(GraspError::value(format!("a total squeeze of {total_n} N"), "give newtons, zero or more").into());
    }
    let outcome = balance(problem, &problem.load(), 1.0, Limits::ALL, Goal::Slack { total_n });
    match outcome {
        Ok(Outcome::Forces { forces, slack_n }) if slack_n >= -1e-6 * total_n => {
            Ok(described(problem, &forces, slack_n.max(0.0)))
        }
        Err(error @ GraspError::Solver { .. }) => Err(out_of_range(problem, total_n, Some(error))),
        Err(error) => Err(error.into()),
        Ok(_) => Err(out_of_range(problem, total_n, None)),
    }
}

/// The largest sum of normal forces, N, with which the contacts carry the problem's load within torque and damage limits:
/// infinite if neither bounds it.
///
/// # Errors
/// As [`crate::smallest_squeeze`], if no squeeze at all carries the load.
pub fn largest_squeeze(problem: &SqueezeProblem) -> Result<f64, SqueezeError> {
    check(problem)?;
    largest(problem)
}

/// [`largest_squeeze`] of a checked problem.
pub(crate) fn largest(problem: &SqueezeProblem) -> Result<f64, SqueezeError> {
    match balance(problem, &problem.load(), 1.0, Limits::ALL, Goal::Largest)? {
        Outcome::Forces { forces, .. } => Ok(forces.iter().map(|f| f.x).sum()),
        Outcome::Unbounded => Ok(f64::INFINITY),
        // The smallest squeeze says what is in the way; where it just exists after all, it is the largest too.
        Outcome::Infeasible => Ok(smallest_forces(problem)?.iter().map(|f| f.x).sum()),
    }
}

/// Why the total cannot be had.
fn out_of_range(problem: &SqueezeProblem, total_n: f64, solver: Option<GraspError>) -> SqueezeError {
    let range = smallest_forces(problem)
        .map(|f| f.iter().map(|f| f.x).sum::<f64>())
        .and_then(|smallest| Ok((smallest, largest(problem)?)));
    match (range, solver) {
        (Ok((smallest_n, largest_n)), None) => SqueezeError::Total { total_n, smallest_n, largest_n },
        (Ok((smallest_n, largest_n)), Some(_)) if !(smallest_n..=largest_n).contains(&total_n) => {
            SqueezeError::Total { total_n, smallest_n, largest_n }
        }
        (Ok(_), Some(error)) => error.into(),
        (Err(error), _) => error,
    }
}

fn described(problem: &SqueezeProblem, f: &[Vector3<f64>], slack_n: f64) -> Distribution {
    let normal_n: Vec<f64> = f.iter().map(|f| f.x).collect();
    let (per_finger_n, palm_n) = by_finger(&problem.contacts, &normal_n);
    let joint_torques_nm = torques(problem, f);
    let own = problem.torques.iter().flat_map(|t| t.gravity_nm.iter());
    Distribution {
        forces: problem.contacts.iter().zip(f).map(|(c, f)| c.axes() * f).collect(),
        normal_n,
        per_finger_n,
        palm_n,
        contact_torques_nm: joint_torques_nm.iter().zip(own).map(|(t, own)| t - own).collect(),
        slack_n,
        torque_margin: torque_margin(problem, &joint_torques_nm),
        joint_torques_nm,
    }
}
