//! Loads a grasp must survive, and the squeeze that survives all of them.

use nalgebra::{Vector3, Vector6};

use crate::balance::{Goal, Limits, Outcome, balance};
use crate::distribute::largest;
use crate::squeeze::{check, describe, friction_margin};
use crate::{GraspError, Squeeze, SqueezeError, SqueezeProblem, smallest_forces};

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
/// the largest of the smallest squeezes. [`Squeeze::binding_load`] names the load that asks for it, the forces and the friction
/// margin are those under that load.
///
/// A load is a wrench on the object: force (N) and torque about the centre of mass (N m), object frame. The loads stand for
/// the problem's weight and extra wrench, which are not added; its limits and floors hold.
///
/// # Errors
/// [`SqueezeError::Load`] with the first load that cannot be carried and the reason, or with a load whose largest squeeze
/// within the limits is below what another needs; [`SqueezeError::Input`] for an empty list and as
/// [`crate::smallest_squeeze`].
pub fn required_squeeze(problem: &SqueezeProblem, loads: &[Vector6<f64>]) -> Result<Squeeze, SqueezeError> {
    let Required { binding, forces, .. } = required(problem, loads)?;
    let under = problem.under(&loads[binding]);
    let mut squeeze = describe(&under, &forces);
    squeeze.friction_margin = friction_margin(&under)?;
    squeeze.binding_load = Some(binding);
    Ok(squeeze)
}

/// What [`required_squeeze`] finds before it is described.
pub(crate) struct Required {
    pub(crate) binding: usize,
    /// In contact axes, under the binding load.
    pub(crate) forces: Vec<Vector3<f64>>,
    pub(crate) total_n: f64,
    /// The largest sum with which every load can be carried; infinite without limits.
    pub(crate) largest_n: f64,
}

pub(crate) fn required(problem: &SqueezeProblem, loads: &[Vector6<f64>]) -> Result<Required, SqueezeError> {
    check(problem)?;
    if loads.is_empty() || loads.iter().any(|l| l.iter().any(|v| !v.is_finite())) {
        let remedy = "give at least one wrench of finite numbers, such as those of shake_loads";
        return Err(GraspError::value(format!("{} loads, or one that is not finite", loads.len()), remedy).into());
    }
    let total = |f: &[Vector3<f64>]| f.iter().map(|f| f.x).sum::<f64>();
    let mut most = Required { binding: 0, forces: Vec::new(), total_n: f64::NEG_INFINITY, largest_n: f64::INFINITY };
    for (index, load) in loads.iter().enumerate() {
        let forces = match balance(problem, load, 1.0, Limits::ALL, Goal::Smallest)? {
            Outcome::Forces { forces, .. } => forces,
            // Once more, to find the limit in the way.
            _ => smallest_forces(&problem.under(load)).map_err(|reason| at_load(index, load, reason))?,
        };
        if total(&forces) > most.total_n {
            (most.total_n, most.binding, most.forces) = (total(&forces), index, forces);
        }
    }
    if problem.torques.is_some() || problem.max_normal_n.is_some() {
        for (index, load) in loads.iter().enumerate() {
            let under = problem.under(load);
            let largest_n = largest(&under).map_err(|reason| at_load(index, load, reason))?;
            if index != most.binding && most.total_n > largest_n * (1.0 + 1e-6) {
                let smallest_n = total(&smallest_forces(&under)?);
                let reason = SqueezeError::Total { total_n: most.total_n, smallest_n, largest_n };
                return Err(at_load(index, load, reason));
            }
            most.largest_n = most.largest_n.min(largest_n);
        }
    }
    Ok(most)
}

fn at_load(load: usize, wrench: &Vector6<f64>, reason: SqueezeError) -> SqueezeError {
    match reason {
        SqueezeError::Input(_) => reason,
        _ => SqueezeError::Load {
            load,
            force_n: wrench.fixed_rows::<3>(0).norm(),
            torque_nm: wrench.fixed_rows::<3>(3).norm(),
            reason: Box::new(reason),
        },
    }
}

impl SqueezeProblem {
    /// The same contacts and limits under another load in place of the weight and the extra wrench.
    pub(crate) fn under(&self, load: &Vector6<f64>) -> Self {
        Self { gamma: 0.0, extra_wrench: *load, ..self.clone() }
    }
}
