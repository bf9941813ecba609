//! Loads a grasp must survive, and the grip force that survives all of them.

use nalgebra::{Vector3, Vector6};

use crate::balance::{Goal, Limits, Outcome, balance};
use crate::distribute::largest;
use crate::grip_force::{describe, friction_margin, torques};
use crate::{GraspError, GripForceError, GripForceProblem, GripForceSolution, smallest_forces};

/// The loads of an object of `mass_kg` at rest and shaken: m (g − a) for a = 0 and for an acceleration of
/// `acceleration_m_s2` along six directions. Force (N) and torque about the centre of mass (N m, zero), in the frame of
/// `gravity` (m/s²).
///
/// Order: rest, then up, down, and four horizontal directions (±, ±), up being against gravity. Any frame will do: the
/// horizontal axes are right-angled to gravity and to each other, their heading follows from gravity alone. Without gravity
/// the directions are ± x, y, z of the frame.
pub fn shake_loads(mass_kg: f64, acceleration_m_s2: f64, gravity: &Vector3<f64>) -> Vec<Vector6<f64>> {
    let axes = match (-gravity).try_normalize(1e-12) {
        Some(up) => {
            let helper = Vector3::ith(up.iamin(), 1.0);
            let x = up.cross(&helper).normalize();
            [up, x, up.cross(&x)]
        }
        None => [Vector3::x(), Vector3::y(), Vector3::z()],
    };
    let load = |a: Vector3<f64>| {
        let f = (gravity - a) * mass_kg;
        Vector6::new(f.x, f.y, f.z, 0.0, 0.0, 0.0)
    };
    let mut loads = vec![load(Vector3::zeros())];
    for axis in axes {
        loads.push(load(axis * acceleration_m_s2));
        loads.push(load(-axis * acceleration_m_s2));
    }
    loads
}

/// The smallest sum of normal forces with which the contacts can carry every load of the list, each by forces of its own:
/// the largest of the minimum grip forces. [`GripForceSolution::binding_load`] names the load that asks for it, the forces and the friction
/// margin are those under that load.
///
/// A load is a wrench on the object: force (N) and torque about the centre of mass (N m), object frame. The loads stand for
/// the problem's weight and extra wrench, which are not added; its limits and floors hold.
///
/// # Errors
/// [`GripForceError::Load`] with the first load that cannot be carried and the reason, or with a load whose maximum grip force
/// within the limits is below what another needs; [`GripForceError::Input`] for an empty list and as
/// [`crate::minimum_grip_force`].
pub fn required_grip_force(
    problem: &GripForceProblem,
    loads: &[Vector6<f64>],
) -> Result<GripForceSolution, GripForceError> {
    let Required { binding, forces, .. } = required(problem, loads)?;
    let under = problem.under(&loads[binding]);
    let mut grip_force = describe(&under, &forces[binding]);
    grip_force.friction_margin = friction_margin(&under)?;
    grip_force.binding_load = Some(binding);
    Ok(grip_force)
}

/// What [`required_grip_force`] finds before it is described.
pub(crate) struct Required {
    pub(crate) binding: usize,
    pub(crate) total_n: f64,
    /// The smallest forces under each load, contact axes.
    pub(crate) forces: Vec<Vec<Vector3<f64>>>,
}

pub(crate) fn required(problem: &GripForceProblem, loads: &[Vector6<f64>]) -> Result<Required, GripForceError> {
    problem.check()?;
    if loads.is_empty() || loads.iter().any(|l| l.iter().any(|v| !v.is_finite())) {
        let remedy = "give at least one wrench of finite numbers, such as those of shake_loads";
        return Err(GraspError::value(format!("{} loads, or one that is not finite", loads.len()), remedy).into());
    }
    let mut required = Required { binding: 0, total_n: f64::NEG_INFINITY, forces: Vec::with_capacity(loads.len()) };
    for (index, load) in loads.iter().enumerate() {
        let forces = match balance(problem, load, 1.0, Limits::ALL, Goal::Smallest)? {
            Outcome::Forces { forces, .. } => forces,
            // Once more, to find the limit in the way.
            _ => smallest_forces(&problem.under(load)).map_err(|reason| at_load(index, load, reason))?,
        };
        if total(&forces) > required.total_n {
            (required.total_n, required.binding) = (total(&forces), index);
        }
        required.forces.push(forces);
    }
    let total_n = required.total_n;
    if let Some((index, largest_n)) = bounded(problem, loads, &required, total_n * (1.0 - 1e-6))? {
        let reason = GripForceError::Total { total_n, smallest_n: total(&required.forces[index]), largest_n };
        return Err(at_load(index, &loads[index], reason));
    }
    Ok(required)
}

/// The load that can be carried with the least sum of normal forces, and that sum, if it is below `total_n`.
pub(crate) fn bounded(
    problem: &GripForceProblem,
    loads: &[Vector6<f64>],
    required: &Required,
    total_n: f64,
) -> Result<Option<(usize, f64)>, GripForceError> {
    if problem.torques.is_none() && problem.max_normal_n.is_none() {
        return Ok(None);
    }
    let inner = inner_forces(problem);
    let mut least: Option<(usize, f64)> = None;
    for (index, load) in loads.iter().enumerate() {
        // Balanced forces plus forces that balance among themselves are balanced and in the cones: most often they are
        // within the limits as well, and no programme has to be solved.
        let more = total_n - total(&required.forces[index]);
        let within = more <= 0.0
            || inner.as_ref().is_some_and(|inner| {
                let sum: Vec<_> = required.forces[index].iter().zip(inner).map(|(f, z)| f + z * more).collect();
                within_limits(problem, &sum)
            });
        if !within {
            let largest_n = largest(&problem.under(load)).map_err(|reason| at_load(index, load, reason))?;
            if largest_n < total_n && least.is_none_or(|(_, l)| largest_n < l) {
                least = Some((index, largest_n));
            }
        }
    }
    Ok(least)
}

fn total(forces: &[Vector3<f64>]) -> f64 {
    forces.iter().map(|f| f.x).sum()
}

/// Forces in the cones that balance among themselves, one newton in all; `None` if there are none or at the solver's edge.
fn inner_forces(problem: &GripForceProblem) -> Option<Vec<Vector3<f64>>> {
    let free = Limits { normal: false, torque: false };
    match balance(problem, &Vector6::zeros(), 1.0, free, Goal::Slack { total_n: 1.0 }) {
        Ok(Outcome::Forces { forces, slack_n }) if slack_n >= 0.0 => Some(forces),
        _ => None,
    }
}

fn within_limits(problem: &GripForceProblem, forces: &[Vector3<f64>]) -> bool {
    let normal = problem.max_normal_n.is_none_or(|most| forces.iter().all(|f| f.x <= most));
    let limits = problem.torques.iter().flat_map(|t| &t.limits_nm);
    normal && limits.zip(torques(problem, forces)).all(|(&(lower, upper), t)| (lower..=upper).contains(&t))
}

fn at_load(load: usize, wrench: &Vector6<f64>, reason: GripForceError) -> GripForceError {
    match reason {
        GripForceError::Input(_) => reason,
        _ => GripForceError::Load {
            load,
            force_n: wrench.fixed_rows::<3>(0).norm(),
            torque_nm: wrench.fixed_rows::<3>(3).norm(),
            reason: Box::new(reason),
        },
    }
}

impl GripForceProblem {
    /// The same contacts and limits under another load in place of the weight and the extra wrench: force (N) and torque about the centre of
    /// mass (N m), as in [`shake_loads`].
    pub fn under(&self, load: &Vector6<f64>) -> Self {
        Self { gamma: 0.0, extra_wrench: *load, ..self.clone() }
    }
}
