//! Robots in reduced coordinates: a tree of rigid links on a fixed, prescribed or free base, every number of which may
//! carry derivatives.
//!
//! The generalised velocity of a tree is, for a free base, the velocity of the base frame's origin and the angular
//! velocity of the base (world axes), then one number per joint in the order of the robot. With it
//! M(q) u' + bias(q, u) = tau; [`TreeWork`] holds what one configuration needs for that.
//!
//! - `model`: what a robot is to the simulator, `state`: where it is and how it moves, `path`: prescribed bases;
//! - `kinematics`: poses and velocities, Jacobian columns; `dynamics`: mass matrix and bias;
//! - `joints`: drives, damping, dry friction and limits as forces that are taken at the end of the step;
//! - `advance`: from the velocity found to the next state.

mod advance;
mod check;
mod dynamics;
mod joints;
mod kinematics;
mod model;
mod spatial;
mod state;
mod surface;

#[cfg(test)]
mod tests;

pub(crate) use dynamics::LinkForce;
pub(crate) use joints::{JointForce, JointForceKind};
pub(crate) use kinematics::{Column, TreeWork};
pub use model::{ActuatorKind, ActuatorParams, Articulation, Base, JointParams, LinkInertia};
pub use state::{ArticulationState, BaseState};

use drex_robot::Robot;

use crate::Error;

/// An error about a joint.
fn joint_error(robot: &Robot, joint: &str, what: String, remedy: &str) -> Error {
    Error::Joint { robot: robot.name.clone(), joint: joint.into(), what, remedy: remedy.into() }
}
