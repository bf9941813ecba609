//! Contact parameters of an object.

use serde::{Deserialize, Serialize};

use drex_core::{Error, Result};

/// Contact parameters in MuJoCo's terms; what is left out keeps its default.
///
/// MuJoCo's contacts are springs and dampers on accelerations, scaled by the masses that meet, so that one set serves
/// objects of 10 g as well as of 5 kg. The time constant must be at least two time steps (2 ms in the assets) to be stable;
/// the smaller, the less an object sinks in: with 4 ms and an impedance from 0.95 a box put on a table sinks in by less
/// than 0.1 mm at first and 2 µm at rest, where MuJoCo's own 20 ms and 0.9 give 0.15 mm and 11 µm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ContactConfig {
    /// Time constant of the contact, seconds (`solref`, first).
    pub time_constant_s: f64,
    /// Damping ratio: 1 is critical, nothing bounces (`solref`, second).
    pub damping_ratio: f64,
    /// Share of the force that a rigid contact would have, at no depth and at `width_m` (`solimp`, first and second).
    pub impedance: [f64; 2],
    /// Depth at which the contact is as stiff as it gets, metres (`solimp`, third).
    pub width_m: f64,
    /// Torsional friction, metres: coefficient times the radius of the patch of contact.
    pub torsional_friction_m: f64,
}

impl Default for ContactConfig {
    fn default() -> Self {
        Self {
            time_constant_s: 0.004,
            damping_ratio: 1.0,
            impedance: [0.95, 0.99],
            width_m: 0.001,
            torsional_friction_m: 0.005,
        }
    }
}

impl ContactConfig {
    /// Checks what the types cannot.
    ///
    /// # Errors
    /// With the entry that is wrong.
    pub fn check(&self) -> Result<()> {
        for (entry, value) in [
            ("time_constant_s", self.time_constant_s),
            ("damping_ratio", self.damping_ratio),
            ("width_m", self.width_m),
            ("torsional_friction_m", self.torsional_friction_m),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::value(format!("[object.contact] {entry} = {value}"), "give a positive number"));
            }
        }
        let [lo, hi] = self.impedance;
        if !(lo > 0.0 && lo <= hi && hi < 1.0) {
            return Err(Error::value(
                format!("[object.contact] impedance = [{lo}, {hi}]"),
                "give two numbers between 0 and 1, the smaller first",
            ));
        }
        Ok(())
    }
}
