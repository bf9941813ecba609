//! What is simulated: bodies and articulations with mass and shape, and how.

use std::sync::Arc;

use drex_core::MassProperties;
use nalgebra::{Matrix3, Point3, SymmetricEigen};

use crate::articulation::Articulation;
use crate::collider::Collider;
use crate::contact_options::ContactOptions;
use crate::material::{Material, check_friction};
use crate::{Error, Result, Scalar};

/// Steps beyond this are refused: contact would be found centimetres late.
const LONGEST_STEP_S: f64 = 0.02;

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
            return Err(Error::Mass { body, mass_kg });
        }
        if self.center_of_mass.iter().chain(self.unit_inertia.iter()).any(|x| !x.value().is_finite()) {
            return Err(Error::NotFinite { what: format!("body {body}: centre of mass or inertia") });
        }
        let e = SymmetricEigen::new(self.unit_inertia.map(|x| x.value())).eigenvalues;
        let mut moments = [e[0], e[1], e[2]];
        moments.sort_by(f64::total_cmp);
        if !(moments[0] > 0.0 && moments[0] + moments[1] >= moments[2] * (1.0 - 1e-6)) {
            return Err(Error::Inertia { body, moments });
        }
        check_friction(&self.material, || format!("body {body}"))
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
        scheme: Scheme,
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

/// Which velocity moves the poses of a penalty method.
#[cfg(feature = "ablation")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scheme {
    /// The new velocity.
    SemiImplicit,
    /// The old velocity.
    Explicit,
}

/// Bodies, articulations, contact constants and the time step.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Model<T: Scalar> {
    /// Free rigid bodies.
    pub bodies: Vec<Body<T>>,
    /// Robots.
    pub articulations: Vec<Articulation<T>>,
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
        Self {
            bodies,
            articulations: Vec::new(),
            contact: ContactOptions::default(),
            dt_s: 5e-4,
            method: Method::default(),
        }
    }

    /// The model with one more articulation.
    pub fn with_articulation(mut self, arm: Articulation<T>) -> Self {
        self.articulations.push(arm);
        self
    }

    /// Checks bodies, articulations, constants and step.
    ///
    /// # Errors
    /// For a mass or inertia that no body has, for constants out of range, and for a step that contact cannot be
    /// integrated with.
    pub fn check(&self) -> Result<()> {
        self.bodies.iter().enumerate().try_for_each(|(i, b)| b.check(i))?;
        self.articulations.iter().try_for_each(Articulation::check)?;
        self.contact.check()?;
        self.check_step()
    }

    /// Checks the time step and the method.
    pub(crate) fn check_step(&self) -> Result<()> {
        #[cfg(feature = "ablation")]
        if self.method != Method::SemiImplicit && !self.articulations.is_empty() {
            return Err(Error::Method);
        }
        if !(self.dt_s > 0.0 && self.dt_s <= LONGEST_STEP_S) {
            return Err(Error::TimeStep { dt_s: self.dt_s, limit_s: LONGEST_STEP_S });
        }
        Ok(())
    }
}
