//! Everything that the future of a simulation depends on.

use drex_core::Pose;
use nalgebra::Vector3;

use crate::articulation::ArticulationState;
use crate::contact::{Contact, ContactKey};
use crate::{Error, Model, Result, Scalar};

/// State of one free body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyState<T: Scalar> {
    /// Pose of the body's frame in the world.
    pub world_from_body: Pose<T>,
    /// Velocity of the centre of mass in the world, m/s.
    pub velocity: Vector3<T>,
    /// Angular velocity in the world, rad/s.
    pub angular_velocity: Vector3<T>,
}

/// A friction spring: how far the contact has been dragged from where it stuck.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchor<T: Scalar> {
    /// Which contact.
    pub key: ContactKey,
    /// Stretch in the frame of `key.b` (of the world for what is fixed), metres; tangential.
    pub stretch: Vector3<T>,
    /// Angle about the normal, rad.
    pub twist: T,
}

/// State of all bodies and articulations, and the time. Cloning it saves everything that the future depends on.
#[derive(Debug, Clone, PartialEq)]
pub struct State<T: Scalar> {
    /// Simulated time, seconds.
    pub time_s: f64,
    /// One per body of the model.
    pub bodies: Vec<BodyState<T>>,
    /// One per articulation of the model.
    pub articulations: Vec<ArticulationState<T>>,
    /// Friction springs of the contacts that are closed, by increasing key.
    pub anchors: Vec<Anchor<T>>,
}

impl<T: Scalar> Anchor<T> {
    /// The springs of a contact that has not been dragged.
    pub(crate) fn slack(contact: &Contact<T>) -> Self {
        Self { key: contact.key, stretch: Vector3::zeros(), twist: T::zero() }
    }
}

impl<T: Scalar> BodyState<T> {
    /// At rest at a pose.
    pub fn at_rest(world_from_body: Pose<T>) -> Self {
        Self { world_from_body, velocity: Vector3::zeros(), angular_velocity: Vector3::zeros() }
    }
}

impl<T: Scalar> State<T> {
    /// One body at rest, time zero.
    pub fn at_rest(world_from_body: Pose<T>) -> Self {
        Self::new(vec![BodyState::at_rest(world_from_body)], Vec::new())
    }

    /// Bodies and articulations, nothing touching yet, time zero.
    pub fn new(bodies: Vec<BodyState<T>>, articulations: Vec<ArticulationState<T>>) -> Self {
        Self { time_s: 0.0, bodies, articulations, anchors: Vec::new() }
    }

    /// Checks that there is one state per body and articulation of the model, and that all of it is finite.
    ///
    /// # Errors
    /// Names the body, or the robot and the joint.
    pub fn check(&self, model: &Model<T>) -> Result<()> {
        if !self.time_s.is_finite() {
            return Err(Error::NotFinite { what: format!("the time of the state, {} s,", self.time_s) });
        }
        for (what, given, needed) in [
            ("bodies", self.bodies.len(), model.bodies.len()),
            ("articulations", self.articulations.len(), model.articulations.len()),
        ] {
            if given != needed {
                return Err(Error::Series {
                    what: format!("the model has {needed} {what} but the state {given}"),
                    remedy: "give one state each".into(),
                });
            }
        }
        for (i, s) in self.bodies.iter().enumerate() {
            let pose = s.world_from_body.translation.vector.iter().chain(s.world_from_body.rotation.coords.iter());
            if pose.chain(s.velocity.iter()).chain(s.angular_velocity.iter()).any(|x| !x.value().is_finite()) {
                return Err(Error::NotFinite { what: format!("body {i}: pose or velocity") });
            }
        }
        model.articulations.iter().zip(&self.articulations).try_for_each(|(arm, s)| arm.check_state(s))
    }
}
