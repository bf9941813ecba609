//! Plain pose tracks: `t,x,y,z,qw,qx,qy,qz`.

use std::path::Path;

use nalgebra::Vector3;

use super::Table;
use drex_core::pose::{check_position, pose_from_wxyz};
use drex_core::{Error, Result, Trajectory, fsutil};

/// Reads a csv of poses `a_from_b` with the columns `t,x,y,z,qw,qx,qy,qz` (s, m, unit quaternion); other columns are ignored.
///
/// # Errors
/// If the file cannot be read; if a column is missing; with the line if a number is not finite, a quaternion is not of
/// unit norm, or a position cannot be in metres.
pub fn read_pose_csv(path: &Path) -> Result<Trajectory> {
    parse_pose_csv(path, &fsutil::read_bytes(path)?)
}

/// As [`read_pose_csv`], from memory.
///
/// # Errors
/// As [`read_pose_csv`].
pub fn parse_pose_csv(path: &Path, bytes: &[u8]) -> Result<Trajectory> {
    let table = Table::parse(path, bytes)?;
    let columns = table.columns(&["t", "x", "y", "z", "qw", "qx", "qy", "qz"])?;
    let (mut times_s, mut poses) = (Vec::with_capacity(table.len()), Vec::with_capacity(table.len()));
    for row in 0..table.len() {
        let [t, x, y, z, qw, qx, qy, qz] = table.numbers(row, &columns)?;
        check_position(path, table.line(row), &Vector3::new(x, y, z))?;
        times_s.push(t);
        poses.push(pose_from_wxyz([x, y, z], [qw, qx, qy, qz]).map_err(|e| Error::at(path, table.line(row), e))?);
    }
    Trajectory::from_samples(&times_s, &poses)
}
