//! What the robot's motors can give, as limits of the cone programme.

use drex_core::Pose;
use drex_robot::{ActuatorKind, Robot};
use nalgebra::Vector3;

use crate::find::check_joints;
use crate::{Contact, Result, TorqueLimits};

impl TorqueLimits {
    /// Jacobians of the contacts, motor limits and the hand's own weight for the hand at `q` (model order, rad).
    ///
    /// `gravity` is in the object's frame, m/s². A joint's limit is the smallest that the model names: the joint's effort limit
    /// and the force range of its actuator times the gear; a joint with neither is unlimited.
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
        Ok(Self { jacobians, limits_nm: motor_limits(robot), gravity_nm })
    }
}

/// Lower and upper effort per joint, N m.
fn motor_limits(robot: &Robot) -> Vec<(f64, f64)> {
    let mut limits: Vec<(f64, f64)> =
        robot.joints.iter().map(|j| j.effort_limit.map_or((f64::NEG_INFINITY, f64::INFINITY), |e| (-e, e))).collect();
    for actuator in &robot.actuators {
        let range = actuator.force_range.or(match actuator.kind {
            // A motor without a force range is limited by its control.
            ActuatorKind::Motor { gain } => actuator.ctrl_range.map(|(lo, hi)| (gain * lo, gain * hi)),
            _ => None,
        });
        if let Some((lo, hi)) = range {
            let (a, b) = (lo * actuator.gear, hi * actuator.gear);
            let limit = &mut limits[actuator.joint];
            *limit = (limit.0.max(a.min(b)), limit.1.min(a.max(b)));
        }
    }
    limits
}
