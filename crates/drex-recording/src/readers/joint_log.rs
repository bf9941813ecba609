//! Joint logs: `timestamp, position_*, velocity_*, effort_*`.

use std::path::Path;

use super::{Table, check_angle};
use crate::series::JointLog;
use drex_core::{Error, Result, fsutil};

/// Reads a joint log: one time column (`timestamp` or `t`, s) and per joint `position_*` (rad) and, if logged,
/// `velocity_*` (rad/s) and `effort_*` (N m). Other columns are ignored.
///
/// `*` is the joint's name, or its number 0, 1, … when `names` gives the joints in the order of the columns.
///
/// # Errors
/// If the file cannot be read; a column is missing; the columns are numbered but no `names` are given, or not as many;
/// with the line if a number is not finite or an angle cannot be in radians.
pub fn read_joint_log_csv(path: &Path, names: Option<&[String]>) -> Result<JointLog> {
    parse_joint_log_csv(path, &fsutil::read_bytes(path)?, names)
}

/// As [`read_joint_log_csv`], from memory.
///
/// # Errors
/// As [`read_joint_log_csv`].
pub fn parse_joint_log_csv(path: &Path, bytes: &[u8], names: Option<&[String]>) -> Result<JointLog> {
    let table = Table::parse(path, bytes)?;
    let time = match table.find("timestamp").or_else(|| table.find("t")) {
        Some(column) => column,
        None => table.columns(&["timestamp"])?[0],
    };
    let keys: Vec<String> =
        table.header().iter().filter_map(|h| h.strip_prefix("position_")).map(str::to_owned).collect();
    if keys.is_empty() {
        table.columns(&["position_0"])?;
    }
    let numbered = keys.iter().all(|k| k.parse::<usize>().is_ok());
    let (names, keys): (Vec<String>, Vec<String>) = match names {
        Some(names) if numbered => {
            if names.len() != keys.len() {
                return Err(Error::content(
                    path,
                    1,
                    format!("{} joint columns but {} joint names", keys.len(), names.len()),
                    "give one joint name per position_i column, in column order",
                ));
            }
            (names.to_vec(), (0..names.len()).map(|i| i.to_string()).collect())
        }
        Some(names) => (names.to_vec(), names.to_vec()),
        None if numbered => {
            return Err(Error::content(
                path,
                1,
                "the joint columns are numbered, so the joints are unknown",
                "give the joint names in column order, or name the columns position_<joint>",
            ));
        }
        None => (keys.clone(), keys),
    };
    let columns = |prefix: &str| table.columns(&keys.iter().map(|k| format!("{prefix}{k}")).collect::<Vec<_>>());
    let logged = |prefix: &str| table.header().iter().any(|h| h.starts_with(prefix));
    let positions = columns("position_")?;
    let velocities = if logged("velocity_") { columns("velocity_")? } else { Vec::new() };
    let efforts = if logged("effort_") { columns("effort_")? } else { Vec::new() };

    let mut log = JointLog { names, ..JointLog::default() };
    let row_of =
        |row: usize, columns: &[usize]| columns.iter().map(|&c| table.number(row, c)).collect::<Result<Vec<_>>>();
    for (row, t) in table.rows_by_time(time)? {
        let q = row_of(row, &positions)?;
        for (joint, &angle) in log.names.iter().zip(&q) {
            check_angle(path, table.line(row), joint, angle)?;
        }
        log.times_s.push(t);
        log.positions.push(q);
        if !velocities.is_empty() {
            log.velocities.push(row_of(row, &velocities)?);
        }
        if !efforts.is_empty() {
            log.efforts.push(row_of(row, &efforts)?);
        }
    }
    Ok(log)
}
