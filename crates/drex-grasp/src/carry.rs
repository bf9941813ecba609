//! Can contacts carry the object at all? For choosing among many grasps, where the reason why not is of no interest.

use nalgebra::{Point3, Unit, Vector3};

use crate::{Contact, GraspError, GripForceError, GripForceProblem, Result, is_force_closed, smallest_forces};

/// Smallest sum of normal forces that carries an object, in units of its weight, with gravity against `up` (both in the object's
/// frame) and no limits. `None` if the contacts cannot carry it, and at the very edge of that, where the solver stops half-way.
///
/// # Errors
/// If a number is not finite or a friction negative.
pub fn grip_force_per_weight(
    contacts: &[Contact],
    center_of_mass: Point3<f64>,
    up: Unit<Vector3<f64>>,
) -> Result<Option<f64>> {
    match smallest_forces(&GripForceProblem::new(contacts.to_vec(), 1.0, center_of_mass, -up.into_inner())) {
        Ok(forces) => Ok(Some(forces.iter().map(|f| f.x).sum())),
        Err(GripForceError::Input(GraspError::Solver { .. })) => Ok(None),
        Err(GripForceError::Input(error)) => Err(error),
        Err(_) => Ok(None),
    }
}

/// [`is_force_closed`] for point contacts, false at the very edge, where the solver stops half-way.
///
/// # Errors
/// As [`grip_force_per_weight`].
pub fn holds_any_load(contacts: &[Contact], center_of_mass: &Point3<f64>) -> Result<bool> {
    match is_force_closed(contacts, center_of_mass, None) {
        Err(GraspError::Solver { .. }) => Ok(false),
        answer => answer,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn pinch(friction: f64) -> [Contact; 2] {
        [-1.0, 1.0].map(|side| Contact::new(Point3::new(0.03 * side, 0.0, 0.0), -Vector3::x() * side, friction))
    }

    #[test]
    fn a_pinch_carries_by_friction() {
        // m g / (2 μ) from each side: one weight in all per unit of friction.
        let grip_force = grip_force_per_weight(&pinch(0.5), Point3::origin(), Vector3::z_axis()).unwrap().unwrap();
        assert!((grip_force - 2.0).abs() < 1e-5, "{grip_force}");
        assert_eq!(grip_force_per_weight(&pinch(0.0), Point3::origin(), Vector3::z_axis()).unwrap(), None);
        assert_eq!(grip_force_per_weight(&[], Point3::origin(), Vector3::z_axis()).unwrap(), None);
        assert!(grip_force_per_weight(&pinch(f64::NAN), Point3::origin(), Vector3::z_axis()).is_err());
    }

    #[test]
    fn two_points_do_not_hold_a_torque_about_their_line_and_four_do() {
        assert!(!holds_any_load(&pinch(0.5), &Point3::origin()).unwrap());
        let four = [[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]]
            .map(|[side, up]| Contact::new(Point3::new(0.03 * side, 0.0, 0.02 * up), -Vector3::x() * side, 0.5));
        assert!(holds_any_load(&four, &Point3::origin()).unwrap());
    }
}
