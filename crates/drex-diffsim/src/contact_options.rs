//! Constants of contact, of the default model and of MuJoCo's.

use crate::{Error, Result, Scalar};

/// Constants of compliant contact. By default all are per unit mass: contact never makes the mass of a body visible.
///
/// A patch between two parts carries f_n = k (depth + τ rate), never pulling, with k = m ω². m is the mass of the free
/// body (of two free bodies m₁m₂/(m₁+m₂)), or of the link where there is no free body.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ContactOptions<T = f64> {
    /// Natural frequency ω of a body resting flat on its support, rad/s. It sinks in by g/ω².
    pub frequency_rad_s: T,
    /// Damping over stiffness τ, seconds: a depth fades with this time constant, and the smaller it is against 2/ω the
    /// more a contact rebounds.
    pub relaxation_s: T,
    /// Tangential stiffness over normal stiffness.
    pub tangential_ratio: T,
    /// Damping over stiffness of the tangential springs, seconds.
    pub tangential_relaxation_s: T,
    /// Stiffness k of a patch, N/m, in place of m ω².
    pub stiffness_n_m: Option<T>,
    /// Contact as MuJoCo has it, in place of all the above. Penalty forces do not have it.
    pub soft: Option<SoftContact>,
}

impl<T: Scalar> Default for ContactOptions<T> {
    fn default() -> Self {
        Self {
            frequency_rad_s: T::lift(1e4),
            relaxation_s: T::lift(4e-3),
            tangential_ratio: T::one(),
            tangential_relaxation_s: T::lift(1e-3),
            stiffness_n_m: None,
            soft: None,
        }
    }
}

impl ContactOptions {
    /// The same constants without derivatives.
    pub fn lift<T: Scalar>(&self) -> ContactOptions<T> {
        ContactOptions {
            frequency_rad_s: T::lift(self.frequency_rad_s),
            relaxation_s: T::lift(self.relaxation_s),
            tangential_ratio: T::lift(self.tangential_ratio),
            tangential_relaxation_s: T::lift(self.tangential_relaxation_s),
            stiffness_n_m: self.stiffness_n_m.map(T::lift),
            soft: self.soft,
        }
    }
}

impl<T: Scalar> ContactOptions<T> {
    /// Stiffness of a patch per `unit` of mass, where `mass` is what it carries in the same unit of mass.
    pub(crate) fn patch_stiffness(&self, mass: T, unit: T) -> T {
        match self.stiffness_n_m {
            Some(k) => k / unit,
            None => self.frequency_rad_s * self.frequency_rad_s * mass,
        }
    }

    pub(crate) fn check(&self) -> Result<()> {
        let all = [
            ("frequency_rad_s", Some(self.frequency_rad_s), 0.0),
            ("relaxation_s", Some(self.relaxation_s), -f64::MIN_POSITIVE),
            ("tangential_ratio", Some(self.tangential_ratio), 0.0),
            ("tangential_relaxation_s", Some(self.tangential_relaxation_s), -f64::MIN_POSITIVE),
            ("stiffness_n_m", self.stiffness_n_m, 0.0),
        ];
        for (name, value, above) in all {
            if let Some(x) = value.map(|x| x.value())
                && !(x.is_finite() && x > above)
            {
                return Err(Error::Option { name, value: x });
            }
        }
        self.soft.as_ref().map_or(Ok(()), SoftContact::check)
    }
}

/// Constants of MuJoCo's soft contact.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct SoftContact {
    /// Time constant of the spring, seconds (first number of `solref`).
    pub time_constant_s: f64,
    /// Damping ratio (second number of `solref`).
    pub damping_ratio: f64,
    /// Impedance at the surface and from the depth `width_m` on, between 0 and 1 (first numbers of `solimp`). Between the
    /// two it follows a parabola to half the width and from there another (midpoint 0.5, power 2).
    pub impedance: [f64; 2],
    /// Depth at which the impedance is at its end, metres (third number of `solimp`).
    pub width_m: f64,
    /// Impedance of friction over that of the normal direction (`impratio`).
    pub friction_ratio: f64,
}

impl Default for SoftContact {
    /// What MuJoCo takes when a model says nothing.
    fn default() -> Self {
        Self { time_constant_s: 0.02, damping_ratio: 1.0, impedance: [0.9, 0.95], width_m: 1e-3, friction_ratio: 1.0 }
    }
}

impl SoftContact {
    pub(crate) fn check(&self) -> Result<()> {
        let [d0, d1] = self.impedance;
        let positive = |x: f64| x > 0.0 && x.is_finite();
        for (name, value, good) in [
            ("soft.time_constant_s", self.time_constant_s, positive(self.time_constant_s)),
            ("soft.damping_ratio", self.damping_ratio, positive(self.damping_ratio)),
            ("soft.impedance[0]", d0, positive(d0) && d0 < 1.0),
            ("soft.impedance[1]", d1, positive(d1) && d1 < 1.0),
            ("soft.width_m", self.width_m, positive(self.width_m)),
            ("soft.friction_ratio", self.friction_ratio, positive(self.friction_ratio)),
        ] {
            if !good {
                return Err(Error::Option { name, value });
            }
        }
        Ok(())
    }
}
