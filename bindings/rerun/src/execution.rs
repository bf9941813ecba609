//! What the joints of the hand did: angles, goals, currents or torques, and their limits.

use anyhow::{Context, Result};
use drex_core::fsutil;
use drex_recording::readers::Table;
use drex_twin::records::{EXECUTION, EXECUTION_LOG, ExecutionFile};

use crate::recorder::{Recorder, Times};
use crate::twin::Twin;

/// Records the log of the joints on the timeline `execution`, seconds from its first row.
pub fn record(recorder: &Recorder, twin: &mut Twin) -> Result<()> {
    if twin.folder.manifest.grasps.is_none() {
        return Ok(());
    }
    let Some(done) = twin.record::<ExecutionFile>(EXECUTION, "no hand was driven")? else { return Ok(()) };
    if let Some(reason) = done.not_driven {
        twin.missing.push(format!("joints: {} was not driven: {reason}", done.hand));
        return Ok(());
    }
    let Some(path) = twin.made(EXECUTION_LOG, "the joints are not shown") else { return Ok(()) };
    let table = Table::parse(&path, &fsutil::read_bytes(&path)?)?;
    let time = table.columns(&["timestamp"])?[0];
    let rows = table.rows_by_time(time)?;
    let begun = rows.first().with_context(|| format!("{} holds no row; run drex run again", path.display()))?.1;
    let times_s: Vec<f64> = rows.iter().map(|r| r.1 - begun).collect();
    let times = Times::Seconds("execution", &times_s);
    let milliampere = table.header().iter().any(|h| h.starts_with("current_ma_"));
    let limit = if milliampere { "limit_ma" } else { "limit_nm" };
    // Prefix of the columns, and the name with its unit.
    let quantities = [
        ("position_", "position_rad"),
        ("goal_", "goal_rad"),
        ("velocity_", "velocity_rad_s"),
        ("current_ma_", "current_ma"),
        ("effort_", "effort_nm"),
        ("limit_", limit),
    ];
    for (column, header) in table.header().iter().enumerate() {
        let found = quantities.iter().find_map(|(prefix, name)| Some((header.strip_prefix(prefix)?, *name)));
        let Some((joint, quantity)) = found else { continue };
        let values: Vec<f64> = rows.iter().map(|(row, _)| table.number(*row, column)).collect::<Result<_, _>>()?;
        recorder.series(&["hand", "joints", joint, quantity], times, &values)?;
    }
    Ok(())
}
