//! Readers of recorded data. Each `read_*` takes a path; its `parse_*` takes bytes and a path for messages only.
//!
//! They refuse what they cannot understand with file and line, never guess a unit, and never panic, whatever the bytes.

mod bop;
mod foundation_pose;
mod grasps;
mod joint_log;
mod npy;
mod pose_csv;
mod samples;
mod table;

pub use bop::{BopSelection, parse_bop_csv, read_bop_csv};
pub use foundation_pose::{
    FrameTimes, parse_foundation_pose_log, parse_matrix_text, read_foundation_pose_folder, read_foundation_pose_log,
};
pub use grasps::{
    GraspFile, parse_grasp_file, parse_grasps_json, parse_grasps_npy, read_grasp_file, read_grasps, read_grasps_json,
    read_grasps_npy, write_grasps_json,
};
pub use joint_log::{parse_joint_log_csv, read_joint_log_csv};
pub use npy::{NpyArray, NpyValues, parse_npy};
pub use pose_csv::{parse_pose_csv, read_pose_csv};
pub use samples::{
    PointSeries, parse_action_csv, parse_force_csv, parse_proprio_csv, read_action_csv, read_force_csv,
    read_proprio_csv,
};
pub use table::Table;

use nalgebra::Vector3;

use crate::{Error, Result};

/// No tabletop recording is this far from its origin, metres: such numbers are millimetres.
pub const FARTHEST_M: f64 = 20.0;

/// No hand joint turns this far, radians (two turns): such numbers are degrees.
pub const LARGEST_ANGLE_RAD: f64 = 4.0 * std::f64::consts::PI;

/// Refuses a position that must be in another unit.
fn check_position(path: &std::path::Path, line: usize, position: &Vector3<f64>) -> Result<()> {
    if position.amax() > FARTHEST_M {
        return Err(Error::content(
            path,
            line,
            format!("a position of {:.3} m, farther than {FARTHEST_M} m from the origin", position.amax()),
            "positions are metres; if these are millimetres, divide them by 1000",
        ));
    }
    Ok(())
}

/// Refuses a joint angle that must be in another unit.
fn check_angle(path: &std::path::Path, line: impl Into<Option<usize>>, joint: &str, angle: f64) -> Result<()> {
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
