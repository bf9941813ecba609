//! Where a robot is and how it moves.

use drex_core::Pose;
use nalgebra::Vector3;

use crate::Scalar;

/// Motion of the base of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct BaseState<T: Scalar> {
    /// Pose of the base link's frame in the world.
    pub world_from_base: Pose<T>,
    /// Velocity of that frame's origin in the world, m/s.
    pub velocity: Vector3<T>,
    /// Angular velocity in the world, rad/s.
    pub angular_velocity: Vector3<T>,
}

/// State of one robot; the joint vectors have the order of [`drex_robot::Robot::joints`].
#[derive(Debug, Clone, PartialEq)]
pub struct ArticulationState<T: Scalar> {
    /// The base. It is state for a free base only; for the others it repeats what the model prescribes.
    pub base: BaseState<T>,
    /// Joint coordinates, rad (m).
    pub q: Vec<T>,
    /// Joint velocities, rad/s (m/s).
    pub velocities: Vec<T>,
    /// How far the spring of each joint's dry friction is stretched, rad (m).
    pub friction: Vec<T>,
}

impl<T: Scalar> BaseState<T> {
    /// At rest at a pose.
    pub fn at_rest(world_from_base: Pose<T>) -> Self {
        Self { world_from_base, velocity: Vector3::zeros(), angular_velocity: Vector3::zeros() }
    }
}
