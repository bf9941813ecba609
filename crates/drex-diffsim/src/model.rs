//! What is simulated: bodies with mass and shape, and the constants of contact.

use std::sync::Arc;

use drex_core::{MassProperties, Pose};
use nalgebra::{Matrix3, Point3, SymmetricEigen, Vector3};

use crate::{ConvexPiece, Result, Scalar, SimError};

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
    /// Convex pieces that touch the support, in the body's frame.
    pub shape: Arc<Vec<ConvexPiece>>,
}

impl<T: Scalar> Body<T> {
    /// A body with the centre of mass and the inertia-to-mass ratio of `properties`, but the mass `mass_kg`.
    pub fn new(properties: &MassProperties, mass_kg: T, shape: Arc<Vec<ConvexPiece>>) -> Self {
        let unit = properties.inertia / properties.mass_kg;
        Self { mass_kg, center_of_mass: properties.center_of_mass.map(T::lift), unit_inertia: unit.map(T::lift), shape }
    }

    /// Bound on the distance of a point of the body from its centre of mass, metres.
    pub(crate) fn reach(&self) -> f64 {
        let c = self.center_of_mass.map(|x| x.value());
        self.shape.iter().map(|p| p.farthest_from(&c)).fold(0.0, f64::max)
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
        Ok(())
    }
}

/// Constants of compliant contact, all per unit mass: contact never makes the mass of a body visible.
///
/// A face carries f_n = k (depth + τ rate) with k = ω² per kilogram, never pulling.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ContactOptions {
    /// Natural frequency ω of a body resting flat on its support, rad/s. It sinks in by g/ω².
    pub frequency_rad_s: f64,
    /// Damping over stiffness τ, seconds: a depth fades with this time constant, and the smaller it is against 2/ω the
    /// more a contact rebounds.
    pub relaxation_s: f64,
    /// Tangential stiffness over normal stiffness.
    pub tangential_ratio: f64,
    /// Damping over stiffness of the tangential springs, seconds.
    pub tangential_relaxation_s: f64,
}

impl Default for ContactOptions {
    fn default() -> Self {
        Self { frequency_rad_s: 1e4, relaxation_s: 4e-3, tangential_ratio: 1.0, tangential_relaxation_s: 1e-3 }
    }
}

/// Bodies, contact constants and the time step.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Model<T: Scalar> {
    /// The bodies. They touch the support of the scene, not each other.
    pub bodies: Vec<Body<T>>,
    /// Constants of contact.
    pub contact: ContactOptions,
    /// Time step, seconds.
    pub dt_s: f64,
}

impl<T: Scalar> Model<T> {
    /// A model with default contact and a step of 0.5 ms.
    pub fn new(bodies: Vec<Body<T>>) -> Self {
        Self { bodies, contact: ContactOptions::default(), dt_s: 5e-4 }
    }

    /// Checks bodies and step.
    ///
    /// # Errors
    /// For a mass or inertia that no body has, and for a step that contact cannot be integrated with.
    pub fn check(&self) -> Result<()> {
        self.bodies.iter().enumerate().try_for_each(|(i, b)| b.check(i))?;
        if !(self.dt_s > 0.0 && self.dt_s <= LONGEST_STEP_S) {
            return Err(SimError::TimeStep { dt_s: self.dt_s, limit_s: LONGEST_STEP_S });
        }
        Ok(())
    }
}

/// State of one body.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyState<T: Scalar> {
    /// Pose of the body's frame in the world.
    pub world_from_body: Pose<T>,
    /// Velocity of the centre of mass in the world, m/s.
    pub velocity: Vector3<T>,
    /// Angular velocity in the world, rad/s.
    pub angular_velocity: Vector3<T>,
    /// Friction springs of the contacts that are closed, by increasing `site`.
    pub anchors: Vec<Anchor<T>>,
}

/// A friction spring: how far the contact has been dragged from where it stuck.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchor<T: Scalar> {
    /// Which contact: counts the vertices of the body against the table, then the sites of each box.
    pub site: u32,
    /// Stretch in the world, metres; tangential to the support.
    pub stretch: Vector3<T>,
}

/// State of all bodies and the time. Cloning it saves everything that the future depends on.
#[derive(Debug, Clone, PartialEq)]
pub struct State<T: Scalar> {
    /// Simulated time, seconds.
    pub time_s: f64,
    /// One per body of the model.
    pub bodies: Vec<BodyState<T>>,
}

impl<T: Scalar> BodyState<T> {
    /// At rest at a pose.
    pub fn at_rest(world_from_body: Pose<T>) -> Self {
        Self { world_from_body, velocity: Vector3::zeros(), angular_velocity: Vector3::zeros(), anchors: Vec::new() }
    }
}

impl<T: Scalar> State<T> {
    /// One body at rest, time zero.
    pub fn at_rest(world_from_body: Pose<T>) -> Self {
        Self { time_s: 0.0, bodies: vec![BodyState::at_rest(world_from_body)] }
    }
}
