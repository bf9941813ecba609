//! A given grip force, shared among the contacts so that they are furthest from slipping.

use nalgebra::Vector3;

use crate::balance::{Goal, Limits, Outcome, balance};
use crate::grip_force::{by_finger, torque_margin, torques};
use crate::{GraspError, GripForceError, GripForceProblem, smallest_forces};

/// How a grip force is shared.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Distribution {
    /// Force of each contact on the object, N, object frame.
    pub forces: Vec<Vector3<f64>>,
    /// Normal force of each contact, N; they add up to the grip force asked for.
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
    /// contacts in equal parts, before one of them slips under unchanged tangential force. Zero at the minimum grip force.
    pub slack_n: f64,
    /// Least 1 − |τ| / |limit| over the joints: 0 at a limit. One if there are no limits.
    pub torque_margin: f64,
}

/// Shares the sum of normal forces `total_n` (N) among the contacts so that it balances the problem's load and keeps them
/// furthest from slipping: maximise s subject to |f_t| <= μ (f_n − s / k), k the number of contacts of a patch, and the
/// problem's floors, ceilings and motors. The slack is common to all and in newtons, so that an error of some newtons in any
/// finger's force (friction in the joints, say) is survived best; among equals the most even forces are taken, which makes the
/// answer unique and smooth in the load. Within 0.001 % of the edge of what is possible, the sum may be off by as much.
///
/// # Errors
/// [`GripForceError::Total`] with the smallest and largest possible sum if this one is not; otherwise as
/// [`crate::minimum_grip_force`].
pub fn distribute(problem: &GripForceProblem, total_n: f64) -> Result<Distribution, GripForceError> {
    problem.check()?;
    if !(total_n >= 0.0 && total_n.is_finite()) {
        return Err(
            GraspError::value(format!("a total grip force of {total_n} N"), "give newtons, zero or more").into()
        );
    }
    if let Some(shared) = share(problem, total_n)? {
        return Ok(shared);
    }
    let smallest_n = smallest_forces(problem)?.iter().map(|f| f.x).sum::<f64>();
    let largest_n = largest(problem)?;
    // At the very edge the programme has no room: a hair inside it has.
    let inside = total_n.clamp(smallest_n * (1.0 + EDGE), (largest_n * (1.0 - EDGE)).max(smallest_n * (1.0 + EDGE)));
    if (inside - total_n).abs() <= 2.0 * EDGE * total_n
        && let Some(shared) = share(problem, inside)?
    {
        return Ok(shared);
    }
    Err(GripForceError::Total { total_n, smallest_n, largest_n })
}

/// Relative distance from the edge of what is possible at which the programme solves.
const EDGE: f64 = 1e-5;

/// The programme of [`distribute`]; `None` if it has no answer.
fn share(problem: &GripForceProblem, total_n: f64) -> Result<Option<Distribution>, GripForceError> {
    match balance(problem, &problem.load(), 1.0, Limits::ALL, Goal::Slack { total_n }) {
        Ok(Outcome::Forces { forces, slack_n }) if slack_n >= -1e-6 * total_n => {
            Ok(Some(described(problem, &forces, slack_n.max(0.0))))
        }
        Ok(_) | Err(GraspError::Solver { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

/// The largest sum of normal forces, N, with which the contacts carry the problem's load within torque and damage limits:
/// infinite if neither bounds it.
///
/// # Errors
/// As [`crate::minimum_grip_force`], if no grip force at all carries the load.
pub fn maximum_grip_force(problem: &GripForceProblem) -> Result<f64, GripForceError> {
    problem.check()?;
    largest(problem)
}

/// [`maximum_grip_force`] of a checked problem.
pub(crate) fn largest(problem: &GripForceProblem) -> Result<f64, GripForceError> {
    match balance(problem, &problem.load(), 1.0, Limits::ALL, Goal::Largest)? {
        Outcome::Forces { forces, .. } => Ok(forces.iter().map(|f| f.x).sum()),
        Outcome::Unbounded => Ok(f64::INFINITY),
        // The minimum grip force says what is in the way; where it just exists after all, it is the largest too.
        Outcome::Infeasible => Ok(smallest_forces(problem)?.iter().map(|f| f.x).sum()),
    }
}

fn described(problem: &GripForceProblem, f: &[Vector3<f64>], slack_n: f64) -> Distribution {
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
