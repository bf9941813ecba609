//! What is simulated: bodies and articulations with mass and shape, and how.

use std::sync::Arc;

use drex_core::MassProperties;
use nalgebra::{Matrix3, Point3, SymmetricEigen};

use crate::articulation::Articulation;
use crate::collider::Collider;
use crate::{Result, Scalar, SimError, SoftContact};

/// Steps beyond this are refused: contact would be found centimetres late.
const LONGEST_STEP_S: f64 = 0.02;

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

/// A free rigid body. Everything but the mass is per kilogram, so that what does not depend on the mass carries no
/// derivative by it, not even rounding.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Body<T: Scalar> {
    /// Mass, kg.
    pub mass_kg: T,
    /// Centre of mass in the body's frame, metres.
    pub center_of_mass: Point3<T>,
    /// Inertia about the centre of mass along the body's axes, divided by the mass, m².
    pub unit_inertia: Matrix3<T>,
    /// Shapes that touch, in the body's frame.
    pub collider: Arc<Collider>,
    /// Friction of its own; what it touches may have more.
    pub material: Material<T>,
}

impl<T: Scalar> Body<T> {
    /// A body with the centre of mass and the inertia-to-mass ratio of `properties`, but the mass `mass_kg`; its own
    /// friction is zero, so that of what it touches counts.
    pub fn new(properties: &MassProperties, mass_kg: T, collider: Arc<Collider>) -> Self {
        let unit = properties.inertia / properties.mass_kg;
        Self {
            mass_kg,
            center_of_mass: properties.center_of_mass.map(T::lift),
            unit_inertia: unit.map(T::lift),
            collider,
            material: Material::new(T::zero()),
        }
    }

    /// Bound on the distance of a point of the body from its centre of mass, metres.
    pub(crate) fn reach(&self) -> f64 {
        self.collider.reach_from(&self.center_of_mass.map(|x| x.value()))
    }

    fn check(&self, body: usize) -> Result<()> {
        let mass_kg = self.mass_kg.value();
        if !(mass_kg.is_finite() && mass_kg > 0.0) {
            return Err(SimError::Mass { body, mass_kg });
        }
        if self.center_of_mass.iter().chain(self.unit_inertia.iter()).any(|x| !x.value().is_finite()) {
            return Err(SimError::NotFinite { what: format!("body {body}: centre of mass or inertia") });
        }
        let e = SymmetricEigen::new(self.unit_inertia.map(|x| x.value())).eigenvalues;
        let mut moments = [e[0], e[1], e[2]];
        moments.sort_by(f64::total_cmp);
        if !(moments[0] > 0.0 && moments[0] + moments[1] >= moments[2] * (1.0 - 1e-6)) {
            return Err(SimError::Inertia { body, moments });
        }
        check_friction(&self.material, || format!("body {body}"))
    }
}

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

    fn check(&self) -> Result<()> {
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
                return Err(SimError::Option { name, value: x });
            }
        }
        self.soft.as_ref().map_or(Ok(()), SoftContact::check)
    }
}

/// How time is stepped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Method {
    /// Semi-implicit Euler: new velocities first, then poses with these; contact forces, friction, joint damping and
    /// actuators are taken at the end of the step. Stable at any stiffness.
    #[default]
    SemiImplicit,
    #[cfg(feature = "ablation")]
    /// Penalty forces at the old state, as in the D-REX paper and its ablation. Free bodies only.
    Penalty {
        /// Which velocity moves the poses.
        scheme: crate::Scheme,
        /// Substeps per step; `None`: as many as the contact stiffness needs to be stable.
        substeps: Option<u32>,
    },
    #[cfg(feature = "ablation")]
    /// Position-based dynamics (rigid XPBD): contacts move poses, and velocities follow from the poses. Stable at any
    /// stiffness; the shorter the substeps, the smaller its damping. Free bodies only.
    PositionBased {
        /// Substeps per step.
        substeps: u32,
    },
}

/// Bodies, articulations, contact constants and the time step.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Model<T: Scalar> {
    /// Free rigid bodies.
    pub bodies: Vec<Body<T>>,
    /// Robots.
    pub arms: Vec<Articulation<T>>,
    /// Constants of contact.
    pub contact: ContactOptions<T>,
    /// Time step, seconds.
    pub dt_s: f64,
    /// How time is stepped.
    pub method: Method,
}

impl<T: Scalar> Model<T> {
    /// A model with default contact and a step of 0.5 ms.
    pub fn new(bodies: Vec<Body<T>>) -> Self {
        Self { bodies, arms: Vec::new(), contact: ContactOptions::default(), dt_s: 5e-4, method: Method::default() }
    }

    /// The model with one more articulation.
    pub fn with_arm(mut self, arm: Articulation<T>) -> Self {
        self.arms.push(arm);
        self
    }

    /// Checks bodies, articulations, constants and step.
    ///
    /// # Errors
    /// For a mass or inertia that no body has, for constants out of range, and for a step that contact cannot be
    /// integrated with.
    pub fn check(&self) -> Result<()> {
        self.bodies.iter().enumerate().try_for_each(|(i, b)| b.check(i))?;
        self.arms.iter().try_for_each(Articulation::check)?;
        self.contact.check()?;
        self.check_step()
    }

    /// Checks the time step and the method.
    pub(crate) fn check_step(&self) -> Result<()> {
        #[cfg(feature = "ablation")]
        crate::ablation::check(self)?;
        if !(self.dt_s > 0.0 && self.dt_s <= LONGEST_STEP_S) {
            return Err(SimError::TimeStep { dt_s: self.dt_s, limit_s: LONGEST_STEP_S });
        }
        Ok(())
    }
}

/// Friction is a finite number, zero or more.
pub(crate) fn check_friction<T: Scalar>(material: &Material<T>, what: impl Fn() -> String) -> Result<()> {
    let mu = material.friction.value();
    if !(mu >= 0.0 && mu.is_finite() && material.torsion_radius_m >= 0.0 && material.torsion_radius_m.is_finite()) {
        return Err(SimError::Friction { what: what(), friction: mu });
    }
    Ok(())
}
