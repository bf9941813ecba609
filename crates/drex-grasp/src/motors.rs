//! What the robot's motors can give, as limits of the cone programme.

use drex_core::Pose;
use drex_robot::Robot;
use nalgebra::Vector3;

use crate::find::check_joints;
use crate::{Contact, Result, TorqueLimits};

impl TorqueLimits {
    /// Jacobians of the contacts, motor limits and the hand's own weight for the hand at `q` (model order, rad).
    ///
    /// `gravity` is in the object's frame, m/s². The limits are [`Robot::effort_ranges`]: a joint for which the model names none is
    /// unlimited.
    ///
    /// # Errors
    /// If `q` does not fit the robot.
    pub fn of_robot(
        robot: &Robot,
        q: &[f64],
        object_from_base: &Pose,
        contacts: &[Contact],
        gravity: &Vector3<f64>,
    ) -> Result<Self> {
        check_joints(robot, q)?;
        let poses = robot.forward_kinematics(q, object_from_base);
        let jacobians = contacts.iter().map(|c| robot.jacobian(&poses, c.link, &c.point).0).collect();
        let gravity_nm = robot.gravity_torque(q, &(object_from_base.rotation.inverse() * gravity));
        Ok(Self { jacobians, limits_nm: robot.effort_ranges(), gravity_nm })
    }
}
