//! What the hand assumes of an object, and what is true.

use crate::{Error, Result};

/// What the hand assumes of the object before it grasps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Assumed {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Friction between hand and object.
    pub friction: f64,
}

/// What is true in a trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Friction between hand and object, and of the object on the table.
    pub friction: f64,
    /// Where the object is against where the hand assumes it: the true resting pose is
    /// `shift * Object::world_from_object` with a shift in the plane and a turn about the vertical through the object.
    pub shift_m: [f64; 2],
    /// Turn about the vertical, rad.
    pub turn_rad: f64,
    /// Seed of the directions in which the hand is shaken.
    pub seed: u64,
}

impl Truth {
    /// What is assumed is true.
    pub fn as_assumed(assumed: &Assumed, seed: u64) -> Self {
        Self { mass_kg: assumed.mass_kg, friction: assumed.friction, shift_m: [0.0; 2], turn_rad: 0.0, seed }
    }

    pub(crate) fn check(&self) -> Result<()> {
        check_mass_and_friction(self.mass_kg, self.friction)?;
        if !(self.shift_m.iter().all(|x| x.abs() < 1.0) && self.turn_rad.is_finite()) {
            return Err(Error::value(
                format!(
                    "the object is {:?} m and {} rad away from where it is assumed to be",
                    self.shift_m, self.turn_rad
                ),
                "give metres and radians",
            ));
        }
        Ok(())
    }
}

/// The lightest mass, kg, and the highest friction that there are.
pub(crate) const LEAST_KG: f64 = 1e-3;
pub(crate) const HIGHEST_FRICTION: f64 = 5.0;

/// Masses from a gram to a hundred kilograms, frictions from nearly nothing to five.
pub(crate) fn check_mass_and_friction(mass_kg: f64, friction: f64) -> Result<()> {
    if !(LEAST_KG..=100.0).contains(&mass_kg) {
        return Err(Error::value(format!("a mass of {mass_kg} kg"), "give kilograms, 0.001 to 100"));
    }
    if !(1e-3..=HIGHEST_FRICTION).contains(&friction) {
        return Err(Error::value(format!("a friction of {friction}"), "give a Coulomb coefficient, 0.001 to 5"));
    }
    Ok(())
}
