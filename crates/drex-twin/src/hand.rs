//! The hand that will grasp.

use drex_robot::Robot;

use crate::Result;

/// The hand with the largest torque of each joint capped at `cap_nm`, N m, if there is a cap.
///
/// # Errors
/// If its model does not say what its motors give, and there is no cap.
pub fn with_torque_cap(robot: Robot, cap_nm: Option<f64>) -> Result<Robot> {
    let robot = match cap_nm {
        Some(cap) => robot.with_effort_cap(cap)?,
        None => robot,
    };
    robot.effort_limits()?;
    Ok(robot)
}
