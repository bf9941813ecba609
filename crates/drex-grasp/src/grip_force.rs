//! The minimum grip force that carries a load: a second-order cone programme.
//!
//! minimise Σ f_n  subject to  G f = −w,  |f_t| <= μ f_n,  floor <= f_n <= ceiling,  τ_min <= Jᵀ f + τ_gravity <= τ_max.

use nalgebra::Vector3;

use crate::balance::{Goal, Limits, Outcome, balance};
use crate::{Contact, GraspError, GripForceProblem};

/// The minimum grip force.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct GripForceSolution {
    /// Sum of the normal forces, N.
    pub total_n: f64,
    /// Force of each contact on the object, N, object frame.
    pub forces: Vec<Vector3<f64>>,
    /// Normal force of each contact, N.
    pub normal_n: Vec<f64>,
    /// Sum of the normal forces of each finger, N; index = finger. Fingers beyond the last that touches are not listed.
    pub per_finger_n: Vec<f64>,
    /// Sum of the normal forces of the palm, N.
    pub palm_n: f64,
    /// Torque of each joint, N m; empty if the problem has no [`TorqueLimits`](crate::TorqueLimits).
    pub joint_torques_nm: Vec<f64>,
    /// Least 1 − |τ| / |limit| over the joints: 0 at a limit. One if there are no limits.
    pub torque_margin: f64,
    /// By which fraction all friction coefficients can fall before no grip force within the limits carries the load:
    /// 0 at the edge, 1 if no friction is needed.
    pub friction_margin: f64,
    /// Which load of the list asks for this grip force; `None` from [`minimum_grip_force`], which has one load.
    pub binding_load: Option<usize>,
}

/// Why there is no grip force.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GripForceError {
    /// No contact forces inside the friction cones balance the load, however hard the hand grips.
    #[error(
        "{contacts} contacts cannot carry the load however hard they grip: no forces inside the friction cones balance it; add an opposing contact"
    )]
    NoEquilibrium {
        /// Number of contacts.
        contacts: usize,
    },
    /// The load could be carried, but not within the normal-force limits.
    #[error(
        "the load needs up to {needed_n:.2} N at one contact (contact {contact}), the limits are {min_n:.2} to {max_n:.2} N; spread the load over more contacts"
    )]
    NormalForce {
        /// The contact that carries most in the unlimited solution.
        contact: usize,
        /// Its normal force there, N.
        needed_n: f64,
        /// Lower limit, N.
        min_n: f64,
        /// Upper limit, N.
        max_n: f64,
    },
    /// The load could be carried, but not with these motors.
    #[error(
        "joint {joint} would need {needed_nm:.3} N m and has {limit_nm:.3} N m; no other distribution stays within the limits: grasp closer to the palm or lower the load"
    )]
    Torque {
        /// The joint furthest over its limit in the solution without torque limits.
        joint: usize,
        /// Its torque there, N m.
        needed_nm: f64,
        /// The limit it breaks, N m.
        limit_nm: f64,
    },
    /// One load of several cannot be carried.
    #[error("load {load} ({force_n:.2} N, {torque_nm:.4} N m about the centre of mass): {reason}")]
    Load {
        /// Index into the list of loads.
        load: usize,
        /// Size of its force, N.
        force_n: f64,
        /// Size of its torque, N m.
        torque_nm: f64,
        /// Why.
        reason: Box<GripForceError>,
    },
    /// The load can be carried, but not with this sum of normal forces.
    #[error(
        "a total grip force of {total_n:.2} N does not carry the load within the limits: it has to be {smallest_n:.2} to {largest_n:.2} N"
    )]
    Total {
        /// The sum asked for, N.
        total_n: f64,
        /// The smallest that carries the load, N.
        smallest_n: f64,
        /// The largest within torque and damage limits, N; infinite if nothing limits it.
        largest_n: f64,
    },
    /// The problem is no problem: sizes or numbers.
    #[error(transparent)]
    Input(#[from] GraspError),
}

/// Solves the cone programme and, if it cannot be solved, says which limit is in the way.
///
/// # Errors
/// [`GripForceError::NoEquilibrium`], [`GripForceError::NormalForce`] or [`GripForceError::Torque`] if the load cannot be carried;
/// [`GripForceError::Input`] for sizes that do not fit or numbers that are not finite.
pub fn minimum_grip_force(problem: &GripForceProblem) -> Result<GripForceSolution, GripForceError> {
    let f = smallest_forces(problem)?;
    let mut grip_force = describe(problem, &f);
    grip_force.friction_margin = friction_margin(problem)?;
    Ok(grip_force)
}

/// Only the forces of [`minimum_grip_force`]: normal and two tangential components per contact in [`Contact::axes`], N.
/// One cone programme instead of the dozen that the friction margin takes.
///
/// # Errors
/// As [`minimum_grip_force`].
pub fn smallest_forces(problem: &GripForceProblem) -> Result<Vec<Vector3<f64>>, GripForceError> {
    problem.check()?;
    if let Some(f) = solve(problem, 1.0, Limits::ALL)? {
        return Ok(f);
    }
    // Drop the limits one by one to find the one in the way.
    let Some(free) = solve(problem, 1.0, Limits { normal: false, torque: false })? else {
        return Err(GripForceError::NoEquilibrium { contacts: problem.contacts.len() });
    };
    if let Some(without_torque) = solve(problem, 1.0, Limits { normal: true, torque: false })? {
        return Err(worst_joint(problem, &without_torque));
    }
    let contact = (0..free.len()).max_by(|&a, &b| free[a].x.total_cmp(&free[b].x)).unwrap_or(0);
    Err(GripForceError::NormalForce {
        contact,
        needed_n: free[contact].x,
        min_n: problem.min_normal_n,
        max_n: problem.max_normal_n.unwrap_or(f64::INFINITY),
    })
}

/// The forces of the minimum grip force with all friction coefficients times `friction_scale`; `None` if there is none.
fn solve(
    problem: &GripForceProblem,
    friction_scale: f64,
    limits: Limits,
) -> Result<Option<Vec<Vector3<f64>>>, GraspError> {
    Ok(match balance(problem, &problem.load(), friction_scale, limits, Goal::Smallest)? {
        Outcome::Forces { forces, .. } => Some(forces),
        Outcome::Infeasible | Outcome::Unbounded => None,
    })
}

/// Forces as the reader wants them.
pub(crate) fn describe(problem: &GripForceProblem, f: &[Vector3<f64>]) -> GripForceSolution {
    let normal_n: Vec<f64> = f.iter().map(|f| f.x).collect();
    let (per_finger_n, palm_n) = by_finger(&problem.contacts, &normal_n);
    let joint_torques_nm = torques(problem, f);
    let torque_margin = torque_margin(problem, &joint_torques_nm);
    GripForceSolution {
        total_n: normal_n.iter().sum(),
        forces: problem.contacts.iter().zip(f).map(|(c, f)| c.axes() * f).collect(),
        normal_n,
        per_finger_n,
        palm_n,
        joint_torques_nm,
        torque_margin,
        friction_margin: 0.0,
        binding_load: None,
    }
}

/// Sums of normal forces: per finger, and the palm.
pub(crate) fn by_finger(contacts: &[Contact], normal_n: &[f64]) -> (Vec<f64>, f64) {
    let fingers = contacts.iter().filter_map(|c| c.finger).max().map_or(0, |m| m + 1);
    let mut per_finger_n = vec![0.0; fingers];
    let mut palm_n = 0.0;
    for (contact, normal) in contacts.iter().zip(normal_n) {
        match contact.finger {
            Some(finger) => per_finger_n[finger] += normal,
            None => palm_n += normal,
        }
    }
    (per_finger_n, palm_n)
}

/// Least 1 − |τ| / |limit| over the joints; one without limits.
pub(crate) fn torque_margin(problem: &GripForceProblem, joint_torques_nm: &[f64]) -> f64 {
    problem.torques.iter().flat_map(|t| &t.limits_nm).zip(joint_torques_nm).fold(1.0, |m, (l, t)| {
        f64::min(m, 1.0 - t / if *t >= 0.0 { l.1.max(f64::MIN_POSITIVE) } else { l.0.min(-f64::MIN_POSITIVE) })
    })
}

/// τ = Jᵀ f + τ_gravity for forces in contact axes; empty without motors.
pub(crate) fn torques(problem: &GripForceProblem, f: &[Vector3<f64>]) -> Vec<f64> {
    problem
        .torques
        .iter()
        .flat_map(|t| {
            let mut tau = t.gravity_nm.clone();
            for ((contact, jacobian), f) in problem.contacts.iter().zip(&t.jacobians).zip(f) {
                tau += jacobian.tr_mul(&(contact.axes() * f));
            }
            tau.iter().copied().collect::<Vec<_>>()
        })
        .collect()
}

/// Bisection on a common factor of the friction coefficients; the feasible factors form an interval that ends at 1.
pub(crate) fn friction_margin(problem: &GripForceProblem) -> Result<f64, GraspError> {
    let feasible = |scale: f64| -> Result<bool, GraspError> {
        match solve(problem, scale, Limits::ALL) {
            Ok(answer) => Ok(answer.is_some()),
            // Close to the edge the interior is thin and the solver may stop half-way: count it as the edge.
            Err(GraspError::Solver { .. }) => Ok(false),
            Err(other) => Err(other),
        }
    };
    if feasible(0.0)? {
        return Ok(1.0);
    }
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..10 {
        let middle = 0.5 * (low + high);
        if feasible(middle)? { high = middle } else { low = middle }
    }
    Ok(1.0 - high)
}

/// The joint that is furthest beyond its limit, in units of the limit.
fn worst_joint(problem: &GripForceProblem, f: &[Vector3<f64>]) -> GripForceError {
    let limits = problem.torques.as_ref().map(|t| t.limits_nm.as_slice()).unwrap_or_default();
    let mut worst = (f64::NEG_INFINITY, GripForceError::NoEquilibrium { contacts: problem.contacts.len() });
    for (joint, (&tau, &(lower, upper))) in torques(problem, f).iter().zip(limits).enumerate() {
        let limit = if tau > upper { upper } else { lower };
        let excess = (tau - upper).max(lower - tau) / limit.abs().max(1e-9);
        if excess > worst.0 {
            worst = (excess, GripForceError::Torque { joint, needed_nm: tau, limit_nm: limit });
        }
    }
    worst.1
}
