//! From measured currents back to the forces at the contacts.

use drex_robot::Robot;
use nalgebra::{DMatrix, DVector, Point3, Vector3};

use super::TorqueCurrentModel;
use super::limits::{column, poses, pressing_nm, same_length};
use super::model::finite;
use super::nnls::nnls;
use crate::{Error, Result};

/// Where a link presses on the object, and which way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactDirection {
    /// Index of the link.
    pub link: usize,
    /// Where, link frame, m.
    pub point: Point3<f64>,
    /// Direction of the force on the object, frame of the hand's base; its length does not matter.
    pub direction: Vector3<f64>,
}

/// What the currents say about the contacts.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ForceEstimate {
    /// Force of each contact along its direction, zero or more, N.
    pub forces_n: Vec<f64>,
    /// Root mean square of the torque that these forces leave unexplained, N m.
    pub residual_nm: f64,
    /// Whether no other forces explain the torques as well: false if contacts share joints in a way that hides who presses.
    pub unique: bool,
}

/// Forces at contacts from signed currents, mA: the non-negative forces whose Jᵀ f is closest to the torques that the models read from
/// the currents less `friction_ma`. Joint angles in rad; the hand's own weight is not taken out.
///
/// # Errors
/// [`Error::Value`] for numbers that are not finite, a direction without length, a link that is not there, or lists of wrong length.
pub fn estimate_forces(
    robot: &Robot,
    q: &[f64],
    contacts: &[ContactDirection],
    models: &[TorqueCurrentModel],
    currents_ma: &[f64],
    friction_ma: f64,
) -> Result<ForceEstimate> {
    same_length("models", models.len(), "joints", robot.dof())?;
    same_length("currents", currents_ma.len(), "joints", robot.dof())?;
    if !(friction_ma >= 0.0 && friction_ma.is_finite()) {
        return Err(Error::value(format!("a friction of {friction_ma} mA"), "give zero or more"));
    }
    let poses = poses(robot, q)?;
    let mut a = DMatrix::zeros(robot.dof(), contacts.len());
    for (k, c) in contacts.iter().enumerate() {
        let length = c.direction.norm();
        finite(length, "as length of a direction")?;
        if !(length > 0.0) {
            return Err(Error::value(format!("contact {k} has a direction without length"), "give the way it presses"));
        }
        let torques = column(robot, &poses, c.link, &c.point, &(c.direction / length))?;
        a.column_mut(k).copy_from_slice(&torques);
    }
    let torques = models.iter().zip(currents_ma).map(|(model, i)| pressing_nm(model, *i, friction_ma));
    let b = DVector::from_vec(torques.collect::<Result<Vec<_>>>()?);
    if a.is_empty() {
        let residual_nm = b.norm() / (robot.dof().max(1) as f64).sqrt();
        return Ok(ForceEstimate { forces_n: vec![0.0; contacts.len()], residual_nm, unique: contacts.is_empty() });
    }
    let forces = nnls(&a, &b);
    let residual_nm = (&b - &a * &forces).norm() / (robot.dof() as f64).sqrt();
    let singular = a.singular_values();
    let unique = contacts.len() <= robot.dof()
        && singular.iter().all(|s| *s > 1e-6 * singular.iter().copied().fold(0.0, f64::max));
    Ok(ForceEstimate { forces_n: forces.as_slice().to_vec(), residual_nm, unique })
}
