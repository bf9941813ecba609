//! Surfaces: friction and the size of a point of contact.

use crate::{Error, Result, Scalar};

/// What a surface does to another one that it touches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material<T = f64> {
    /// Coulomb friction. Between two surfaces the larger one counts.
    pub friction: T,
    /// Radius of the ring on which a single point of contact spreads, metres: it resists turning about the normal with
    /// up to friction · radius · normal force. Between two surfaces the larger one counts. Zero for hard surfaces.
    pub torsion_radius_m: f64,
}

impl<T: Scalar> Material<T> {
    /// A hard surface.
    pub fn new(friction: T) -> Self {
        Self { friction, torsion_radius_m: 0.0 }
    }

    /// What counts between two surfaces.
    pub(crate) fn paired(&self, other: &Self) -> Self {
        let friction = if other.friction.value() > self.friction.value() { other.friction } else { self.friction };
        Self { friction, torsion_radius_m: self.torsion_radius_m.max(other.torsion_radius_m) }
    }
}

/// Friction is a finite number, zero or more.
pub(crate) fn check_friction<T: Scalar>(material: &Material<T>, what: impl Fn() -> String) -> Result<()> {
    let mu = material.friction.value();
    if !(mu >= 0.0 && mu.is_finite() && material.torsion_radius_m >= 0.0 && material.torsion_radius_m.is_finite()) {
        return Err(Error::Friction { what: what(), friction: mu });
    }
    Ok(())
}
