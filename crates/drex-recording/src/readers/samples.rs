//! Forces, commands and encoders of a push over time.

use std::path::Path;

use nalgebra::{Point3, Vector3};

use super::Table;
use crate::series::{EncoderTrack, ForceProfile, PointSeries};
use drex_core::pose::check_position;
use drex_core::{Error, Result, fsutil};

/// No robot finger pushes a tabletop object harder, newtons.
const LARGEST_FORCE_N: f64 = 1e4;

/// Reads `t,fx,fy,fz` (s, N, world frame), a force that acts at `point_in_object` (m, mesh frame); with the columns `tx,ty,tz`
/// (N m, world frame) a wrench, its torque about that point.
///
/// # Errors
/// If the file cannot be read, a column is missing, or (with the line) a number is not finite or no force of a finger.
pub fn read_force_csv(path: &Path, point_in_object: Point3<f64>) -> Result<ForceProfile> {
    parse_force_csv(path, &fsutil::read_bytes(path)?, point_in_object)
}

/// As [`read_force_csv`], from memory.
///
/// # Errors
/// As [`read_force_csv`].
pub fn parse_force_csv(path: &Path, bytes: &[u8], point_in_object: Point3<f64>) -> Result<ForceProfile> {
    let table = Table::parse(path, bytes)?;
    let columns = table.columns(&["t", "fx", "fy", "fz"])?;
    let torque = ["tx", "ty", "tz"];
    let torque =
        if torque.iter().any(|name| table.find(name).is_some()) { table.columns(&torque)? } else { Vec::new() };
    let mut profile =
        ForceProfile { times_s: Vec::new(), forces_n: Vec::new(), torques_nm: Vec::new(), point_in_object };
    for (row, t) in table.rows_by_time(columns[0])? {
        let force = Vector3::from(table.numbers::<3>(row, &columns[1..])?);
        if force.amax() > LARGEST_FORCE_N {
            return Err(Error::content(
                path,
                table.line(row),
                format!("a force of {:.3e} N", force.amax()),
                "forces are newtons; check the unit of the sensor",
            ));
        }
        profile.times_s.push(t);
        profile.forces_n.push(force);
        if !torque.is_empty() {
            profile.torques_nm.push(Vector3::from(table.numbers::<3>(row, &torque)?));
        }
    }
    Ok(profile)
}

/// Reads `t,x_cmd,y_cmd,z_cmd` (s, m, world frame): commanded fingertip positions.
///
/// # Errors
/// If the file cannot be read, a column is missing, or (with the line) a number is not finite or cannot be in metres.
pub fn read_action_csv(path: &Path) -> Result<PointSeries> {
    parse_action_csv(path, &fsutil::read_bytes(path)?)
}

/// As [`read_action_csv`], from memory.
///
/// # Errors
/// As [`read_action_csv`].
pub fn parse_action_csv(path: &Path, bytes: &[u8]) -> Result<PointSeries> {
    let table = Table::parse(path, bytes)?;
    let columns = table.columns(&["t", "x_cmd", "y_cmd", "z_cmd"])?;
    let mut series = PointSeries { times_s: Vec::new(), points: Vec::new() };
    for (row, t) in table.rows_by_time(columns[0])? {
        let point = Vector3::from(table.numbers::<3>(row, &columns[1..])?);
        check_position(path, table.line(row), &point)?;
        series.times_s.push(t);
        series.points.push(point.into());
    }
    Ok(series)
}

/// Reads `t,x,y,z,vx,vy,vz` (s, m, m/s, world frame): measured fingertip motion.
///
/// # Errors
/// If the file cannot be read, a column is missing, or (with the line) a number is not finite or cannot be in metres.
pub fn read_proprio_csv(path: &Path) -> Result<EncoderTrack> {
    parse_proprio_csv(path, &fsutil::read_bytes(path)?)
}

/// As [`read_proprio_csv`], from memory.
///
/// # Errors
/// As [`read_proprio_csv`].
pub fn parse_proprio_csv(path: &Path, bytes: &[u8]) -> Result<EncoderTrack> {
    let table = Table::parse(path, bytes)?;
    let columns = table.columns(&["t", "x", "y", "z", "vx", "vy", "vz"])?;
    let mut track = EncoderTrack { times_s: Vec::new(), positions: Vec::new(), velocities: Vec::new() };
    for (row, t) in table.rows_by_time(columns[0])? {
        let [x, y, z, vx, vy, vz] = table.numbers(row, &columns[1..])?;
        check_position(path, table.line(row), &Vector3::new(x, y, z))?;
        track.times_s.push(t);
        track.positions.push(Point3::new(x, y, z));
        track.velocities.push(Vector3::new(vx, vy, vz));
    }
    Ok(track)
}
