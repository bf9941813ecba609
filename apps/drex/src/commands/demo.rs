//! `drex demo`: the whole path on bundled data.

use std::path::Path;

use anyhow::{Context, Result};
use drex_core::fsutil;
use serde_json::{Value, json};

use crate::cli::DemoArgs;
use crate::twin::{Stage, Twin};
use crate::ui::Ui;

/// The bundled twin folder, file by file.
const FILES: [(&str, &str); 7] = [
    ("README.md", include_str!("../../data/demo/README.md")),
    ("scan/tin.obj", include_str!("../../data/demo/scan/tin.obj")),
    ("push/tilt/push.toml", include_str!("../../data/demo/push/tilt/push.toml")),
    ("push/tilt/poses.csv", include_str!("../../data/demo/push/tilt/poses.csv")),
    ("push/tilt/force.csv", include_str!("../../data/demo/push/tilt/force.csv")),
    ("demos/grasps.json", include_str!("../../data/demo/demos/grasps.json")),
    // Last: a folder with a manifest has all that it names.
    ("twin.toml", include_str!("../../data/demo/twin.toml")),
];
/// What was simulated. Only printed at the end, beside the estimate; never written into the twin folder.
const TRUTH: &str = include_str!("../../data/demo/truth.json");

/// Writes the bundled twin to the folder, runs it, and prints the estimate beside what was simulated.
pub fn run(args: &DemoArgs, seed: Option<u64>, ui: &Ui) -> Result<()> {
    for (name, content) in FILES {
        write_if_changed(&args.out.join(name), content)?;
    }
    let mut twin = Twin::open(&args.out, seed)?;
    let summary = twin.run_until(Stage::Report, false, ui)?;
    let findings = crate::report::findings(&twin, Stage::Report)?;
    let truth: Value = serde_json::from_str(TRUTH).context("the bundled truth.json is damaged")?;
    let mut answer = json!(summary);
    if let Some(object) = answer.as_object_mut() {
        object.extend(findings.json);
        object.insert("simulated_mass_kg".into(), truth["mass_kg"].clone());
    }
    let simulated_g = 1e3 * truth["mass_kg"].as_f64().context("the bundled truth.json has no mass")?;
    ui.answer(&answer, format!("{}\n  simulated  with {simulated_g:.0} g, which no stage was told", findings.text))
}

/// Leaves a file alone that already has this content, so that a second run finds its inputs unchanged.
fn write_if_changed(path: &Path, content: &str) -> Result<()> {
    if std::fs::read(path).is_ok_and(|old| old == content.as_bytes()) {
        return Ok(());
    }
    Ok(fsutil::write_atomic(path, content.as_bytes())?)
}
