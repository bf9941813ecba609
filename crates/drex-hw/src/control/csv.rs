//! Telemetry as a joint log.

use std::io::{self, Write};
use std::time::Duration;

use super::{Sample, Telemetry};
use crate::EffortUnit;

/// How long to wait for a cycle before looking again whether the loop has ended.
const WAIT: Duration = Duration::from_millis(200);

/// Writes cycles as CSV until the loop has ended, and returns how many; for a thread of its own.
///
/// The layout is that of `drex_recording::readers::read_joint_log_csv`: `timestamp` (s), then per joint `position_*` (rad), `velocity_*`
/// (rad/s) and, of hands that count in N m, `effort_*`; currents are `current_ma_*`. Columns that the reader leaves alone follow:
/// `goal_*` (rad), `limit_*` (unit of the effort), `age_*` (cycles), `temperature_c_*` (empty where not known), `late_s`, `phase`.
///
/// # Errors
/// As `out` says.
pub fn write_csv(
    telemetry: &mut Telemetry,
    names: &[String],
    unit: EffortUnit,
    out: &mut impl Write,
) -> io::Result<u64> {
    let effort = match unit {
        EffortUnit::NewtonMetre => "effort",
        EffortUnit::Milliampere => "current_ma",
    };
    write!(out, "timestamp")?;
    for column in ["position", "velocity", effort, "goal", "limit", "age", "temperature_c"] {
        for name in names {
            write!(out, ",{column}_{name}")?;
        }
    }
    writeln!(out, ",late_s,phase")?;
    let mut rows = 0;
    loop {
        match telemetry.next(WAIT, |sample| row(sample, out)) {
            Ok(Some(written)) => {
                written?;
                rows += 1;
            }
            Ok(None) => {}
            Err(_) => {
                out.flush()?;
                return Ok(rows);
            }
        }
    }
}

fn row(sample: &Sample, out: &mut impl Write) -> io::Result<()> {
    let Sample { time_s, late_s, phase, command, state } = sample;
    write!(out, "{time_s}")?;
    let lists = [&state.position, &state.velocity, &state.effort, &command.position, &command.effort_limit];
    for value in lists.into_iter().flatten() {
        write!(out, ",{value}")?;
    }
    for age in &state.age {
        write!(out, ",{age}")?;
    }
    for celsius in &state.temperature_c {
        match celsius {
            Some(c) => write!(out, ",{c}")?,
            None => write!(out, ",")?,
        }
    }
    writeln!(out, ",{late_s},{phase}")
}
