//! The grasp carried out by the hand's own control loop: where the joints went and how hard they pressed.

use std::path::Path;

use crate::{Error, Result};
use drex_core::fsutil;
use drex_recording::readers::Table;

use super::page::Page;
use crate::picture::plot::{COLORS, Plot, Series};
use drex_twin::records::ExecutionFile;
use drex_twin::{Twin, records as files};

/// Most samples of a line: a plot has no more pixels.
const SAMPLES: usize = 300;

/// The section on the hand.
pub fn section(page: &mut Page, twin: &Twin, execution: &ExecutionFile) -> Result<()> {
    page.section("Hand");
    if let Some(reason) = &execution.not_driven {
        page.paragraph(&format!("{} was not driven: {reason}.", execution.hand));
        return Ok(());
    }
    page.paragraph(&format!(
        "The grasp of drex deploy, sent to an emulated {} through the drivers and the control loop of a real one. Where the object would be, \
         each joint meets a stop; no motor turned. {}",
        execution.hand,
        if execution.held { "The fingers touched and held." } else { "The grasp did not hold." }
    ));
    page.plots(&plots(&twin.path(files::EXECUTION_LOG), execution)?);
    contacts(page, execution);
    joints(page, execution);
    Ok(())
}

fn effort(value: f64, unit: &str) -> String {
    if unit == "mA" { format!("{value:.0}") } else { format!("{value:.3}") }
}

fn contacts(page: &mut Page, execution: &ExecutionFile) {
    let unit = &execution.unit;
    let rows: Vec<Vec<String>> = execution
        .contacts
        .iter()
        .map(|c| {
            vec![
                c.joint.clone(),
                format!("{:.2}", c.time_s),
                format!("{:.3}", c.position_rad),
                effort(c.effort_limit, unit),
                c.held_effort.map_or("-".to_owned(), |v| effort(v, unit)),
            ]
        })
        .collect();
    if rows.is_empty() {
        page.paragraph("No joint met anything.");
        return;
    }
    let (limit, held) = (format!("effort limit, {unit}"), format!("effort held, {unit}"));
    page.table(&["joint that met the object", "at, s", "angle, rad", &limit, &held], &rows);
}

/// What was sent.
fn joints(page: &mut Page, execution: &ExecutionFile) {
    let unit = &execution.unit;
    let angle = |all: &[f64], i: usize| all.get(i).map_or("-".to_owned(), |v| format!("{v:.3}"));
    let limit = |all: &[f64], i: usize| all.get(i).map_or("-".to_owned(), |v| effort(*v, unit));
    let rows: Vec<Vec<String>> = execution
        .joint_names
        .iter()
        .enumerate()
        .map(|(i, name)| {
            vec![
                name.clone(),
                angle(&execution.open_rad, i),
                angle(&execution.closed_rad, i),
                limit(&execution.closing_limits, i),
                limit(&execution.force_limits, i),
            ]
        })
        .collect();
    let (closing, force) = (format!("limit while closing, {unit}"), format!("limit under force, {unit}"));
    page.table(&["joint", "open, rad", "closed, rad", &closing, &force], &rows);
}

/// Angles, efforts and their limits over time.
fn plots(path: &Path, execution: &ExecutionFile) -> Result<Vec<String>> {
    let table = Table::parse(path, &fsutil::read_bytes(path)?)?;
    let time = match table.find("timestamp") {
        Some(column) => column,
        None => table.columns(&["t"])?[0],
    };
    let rows = table.rows_by_time(time)?;
    let step = rows.len().div_ceil(SAMPLES).max(1);
    let mut rows: Vec<(usize, f64)> = rows.into_iter().step_by(step).collect();
    let begun = rows.first().ok_or_else(|| Error::Refused("the joint log is empty".into()))?.1;
    rows.iter_mut().for_each(|r| r.1 -= begun);
    let times: Vec<f64> = rows.iter().map(|r| r.1).collect();
    let column = |prefix: &str, name: &str| -> Option<Vec<f64>> {
        let column = table.find(&format!("{prefix}_{name}"))?;
        Some(rows.iter().map(|(row, _)| table.number(*row, column).unwrap_or(f64::NAN)).collect())
    };
    // The joints that met the object are told apart, the others are one colour.
    let met: Vec<&str> = execution.contacts.iter().map(|c| c.joint.as_str()).collect();
    let color = |name: &str| met.iter().position(|m| *m == name).map_or("#9aa0a8", |i| COLORS[i % COLORS.len()]);
    let measured = if table.header().iter().any(|h| h.starts_with("current_ma_")) { "current_ma" } else { "effort" };
    let what = if execution.unit == "mA" { "current" } else { "torque" };
    let legend = if met.is_empty() { "" } else { "; coloured: joints that met the object" };
    let mut plots = Vec::new();
    for (prefix, title, y_label) in [
        ("position", format!("Joint angles{legend}"), "rad".to_owned()),
        (measured, format!("Joint {what}s{legend}"), execution.unit.clone()),
        ("limit", format!("Limits of the {what}{legend}"), execution.unit.clone()),
    ] {
        let names = execution.joint_names.iter();
        let mut lines: Vec<(&String, Vec<f64>)> = names.filter_map(|n| Some((n, column(prefix, n)?))).collect();
        // Those that met the object lie on top.
        lines.sort_by_key(|(name, _)| met.contains(&name.as_str()));
        if lines.is_empty() {
            continue;
        }
        let series =
            lines.iter().map(|(name, y)| Series { label: "", x: &times, y, color: color(name), dots: false }).collect();
        let plot = Plot { title: &title, x_label: "time, s", y_label: &y_label, series, ..Plot::default() };
        plots.push(plot.to_svg());
    }
    Ok(plots)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"{"schema":1,"hand":"leap_right","emulated":true,"unit":"mA","joint_names":["a","b"],
        "open_rad":[0.1,0.2],"closed_rad":[0.9,1.0],"closing_limits":[150,150],"force_limits":[310,150],"held":true,
        "contacts":[{"joint":"a","time_s":1.2,"position_rad":0.7,"effort_limit":310,"held_effort":303.6}]}"#;

    #[test]
    fn joints_have_their_limits_and_what_they_held() {
        let execution: ExecutionFile = serde_json::from_str(TEXT).unwrap();
        let mut page = Page::new("hand");
        contacts(&mut page, &execution);
        joints(&mut page, &execution);
        let html = page.to_html();
        assert!(html.contains("<td>a</td><td>1.20</td><td>0.700</td><td>310</td><td>304</td>"), "{html}");
        assert!(html.contains("<td>b</td><td>0.200</td><td>1.000</td><td>150</td><td>150</td>"));
    }

    #[test]
    fn the_log_becomes_three_plots() {
        let execution: ExecutionFile = serde_json::from_str(TEXT).unwrap();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("log.csv");
        let mut log = "timestamp,position_a,position_b,current_ma_a,current_ma_b,limit_a,limit_b,phase\n".to_owned();
        for i in 0..1000 {
            log += &format!("{},{},0.2,{},4,310,150,2\n", 5.0 + 0.01 * f64::from(i), 1e-3 * f64::from(i), i % 300);
        }
        std::fs::write(&path, log).unwrap();
        let all = plots(&path, &execution).unwrap();
        assert_eq!(all.len(), 3);
        assert!(all[1].contains("Joint currents") && all[1].contains(">mA<"));
        // From the first sample on, and no more points than can be seen.
        assert!(all[0].contains("data-range=\"0.000000 9.9"));
        assert!(all[0].matches('L').count() < 2 * SAMPLES + 10);
        std::fs::write(&path, "timestamp,position_a\n").unwrap();
        assert!(plots(&path, &execution).is_err(), "a log without rows is refused");
    }
}
