//! Can contacts carry the object?

use drex_grasp::{Contact, GraspError, SqueezeError, SqueezeProblem, smallest_forces};
use nalgebra::{Point3, Unit, Vector3};

use crate::Result;

/// Smallest sum of normal forces that carries the object, in units of its weight; `None` if the contacts cannot carry it.
pub(crate) fn squeeze_per_weight(
    contacts: &[Contact],
    center_of_mass: Point3<f64>,
    up: Unit<Vector3<f64>>,
) -> Result<Option<f64>> {
    let problem = SqueezeProblem::new(contacts.to_vec(), 1.0, center_of_mass, -up.into_inner());
    Ok(solved(smallest_forces(&problem))?.map(|forces| forces.iter().map(|f| f.x).sum()))
}

/// `None` for a load that cannot be carried and for a solver that stops half-way (the edge of closure): neither is worth choosing.
pub(crate) fn solved<T>(answer: Result<T, SqueezeError>) -> Result<Option<T>> {
    match answer {
        Ok(value) => Ok(Some(value)),
        Err(SqueezeError::Input(GraspError::Solver { .. })) => Ok(None),
        Err(SqueezeError::Input(error)) => Err(error.into()),
        Err(_) => Ok(None),
    }
}
