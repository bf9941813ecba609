//! The numbers that matter, for the head of the page and for the terminal.

use anyhow::Result;
use drex_mesh::Asset;
use serde_json::{Map, Value, json};

use super::page::Page;
use super::push::verdict_text;
use crate::twin::{Evaluation, FitFile, JudgedGrasp, MassFile, MassSource, Stage, Twin, files};

/// What a run found, as text and as JSON.
pub struct Findings {
    /// For the terminal.
    pub text: String,
    /// For `--json`.
    pub json: Map<String, Value>,
}

/// Reads back what the stages up to `last` wrote.
pub fn findings(twin: &Twin, last: Stage) -> Result<Findings> {
    let mut text = format!("{}\n", twin.manifest.name);
    let mut found = Map::new();
    if last >= Stage::Identify {
        let mass: MassFile = files::read_json(&twin.path(files::MASS))?;
        text += &format!("  mass       {}\n", mass_line(&mass));
        if let Some(result) = &mass.identification {
            text += &format!("  pushes     {}\n", verdict_text(result).lines().next().unwrap_or_default());
        }
        found.insert(
            "mass".into(),
            json!({ "mass_kg": mass.mass_kg, "source": mass.source, "ci95_kg": mass.ci95_kg,
                    "verdict": mass.identification.as_ref().map(|i| i.verdict) }),
        );
    }
    let has_grasps = twin.manifest.grasps.is_some();
    if has_grasps && last >= Stage::Grasps {
        let fits: FitFile = files::read_json(&twin.path(files::FITS))?;
        let what = if fits.clips.is_empty() { "demonstrations" } else { "grasps of people" };
        text += &format!("  grasps     {} of {} {what} fit the object\n", fits.accepted, fits.demonstrations);
        found.insert("grasps".into(), json!({ "demonstrations": fits.demonstrations, "accepted": fits.accepted }));
    }
    if has_grasps && last >= Stage::Evaluate {
        let e: Evaluation = files::read_json(&twin.path(files::EVALUATION))?;
        text += &format!(
            "  check      static check at {:.0} g: {} predicted grasps pass, {} after refinement, {} demonstrations\n",
            1e3 * e.mass_kg,
            passed(&e.predicted),
            passed(&e.refined),
            passed(&e.demonstrations)
        );
        found.insert(
            "static_check".into(),
            json!({ "mass_kg": e.mass_kg, "friction": e.friction, "predicted": tally(&e.predicted),
                    "refined": tally(&e.refined), "demonstrations": tally(&e.demonstrations) }),
        );
    }
    if last >= Stage::Report {
        let path = twin.path("report.html");
        text += &format!("  report     {}", path.display());
        found.insert("report".into(), json!(path));
    }
    Ok(Findings { text, json: found })
}

/// "3 of 8".
pub fn passed(grasps: &[JudgedGrasp]) -> String {
    format!("{} of {}", grasps.iter().filter(|g| g.check.passed).count(), grasps.len())
}

fn tally(grasps: &[JudgedGrasp]) -> Value {
    json!({ "passed": grasps.iter().filter(|g| g.check.passed).count(), "of": grasps.len() })
}

fn mass_line(mass: &MassFile) -> String {
    let interval = mass.ci95_kg.map(|[lo, hi]| format!(" (95 %: {:.1} to {:.1} g)", 1e3 * lo, 1e3 * hi));
    format!("{:.1} g{}, {}", 1e3 * mass.mass_kg, interval.unwrap_or_default(), mass.source.text())
}

/// The row of figures at the head of the page.
pub fn figures(page: &mut Page, asset: &Asset, mass: &MassFile, learned: Option<(&FitFile, &Evaluation)>) {
    let remark = match (mass.source, mass.ci95_kg) {
        (MassSource::Identified, Some([lo, hi])) => {
            format!("identified; 95 % interval {:.1} to {:.1} g", 1e3 * lo, 1e3 * hi)
        }
        (source, _) => source.text().to_owned(),
    };
    let mut all = vec![
        (format!("{:.1} g", 1e3 * mass.mass_kg), "mass".to_owned(), remark),
        (
            format!("{:.1} cm³", 1e6 * asset.report.volume_m3),
            "volume".to_owned(),
            format!("{}; {}", super::closing_text(&asset.report), super::pieces_text(asset)),
        ),
    ];
    if let Some((fits, evaluation)) = learned {
        let squeeze: Vec<f64> = evaluation.demonstrations.iter().filter_map(|g| g.check.squeeze_n).collect();
        all.push((
            format!("{} / {}", fits.accepted, fits.demonstrations),
            if fits.clips.is_empty() { "demonstrations" } else { "grasps" }.to_owned() + " that fit the object",
            "thumb and two fingers on the surface".to_owned(),
        ));
        all.push((
            median(squeeze).map_or("-".to_owned(), |n| format!("{n:.2} N")),
            "smallest squeeze (median)".to_owned(),
            format!("sum of normal forces, friction {}", evaluation.friction),
        ));
        all.push((
            passed(&evaluation.refined),
            "predicted grasps pass the static check".to_owned(),
            format!("{} before refinement", passed(&evaluation.predicted)),
        ));
    }
    page.figures(&all);
}

/// The middle value, or the mean of the two in the middle.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    if n == 0 { None } else { Some(0.5 * (values[(n - 1) / 2] + values[n / 2])) }
}
