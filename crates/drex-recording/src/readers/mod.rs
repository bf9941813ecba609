//! Readers of recorded data. Each `read_*` takes a path; its `parse_*` takes bytes and a path for messages only.
//!
//! They refuse what they cannot understand with file and line, never guess a unit, and never panic, whatever the bytes.

mod bop;
mod foundation_pose;
mod grasps;
mod joint_log;
mod pose_csv;
mod samples;
mod table;

pub use bop::{BopSelection, parse_bop_csv, read_bop_csv};
pub use foundation_pose::{
    FrameTimes, parse_foundation_pose_log, read_foundation_pose_folder, read_foundation_pose_log,
};
pub use grasps::{
    GraspFile, parse_grasp_file, parse_grasps_json, parse_grasps_npy, read_grasp_file, read_grasps, read_grasps_json,
    read_grasps_npy, write_grasps_json,
};
pub use joint_log::{parse_joint_log_csv, read_joint_log_csv};
pub use pose_csv::{parse_pose_csv, read_pose_csv};
pub use samples::{
    parse_action_csv, parse_force_csv, parse_proprio_csv, read_action_csv, read_force_csv, read_proprio_csv,
};
pub use table::Table;

use std::path::Path;

use drex_core::{Error, Result};

/// No hand joint turns this far, radians (two turns): such numbers are degrees.
pub const LARGEST_ANGLE_RAD: f64 = 4.0 * std::f64::consts::PI;

/// Refuses a joint angle that must be in another unit.
fn check_angle(path: &Path, line: impl Into<Option<usize>>, joint: &str, angle: f64) -> Result<()> {
    if angle.abs() > LARGEST_ANGLE_RAD {
        return Err(Error::content(
            path,
            line,
            format!("joint {joint} at {angle:.3} rad, more than two turns"),
            "angles are radians; if these are degrees, multiply them by pi/180",
        ));
    }
    Ok(())
}
