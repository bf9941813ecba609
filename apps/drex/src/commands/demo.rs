//! `drex demo`: the whole path on bundled data.

use std::path::Path;

use anyhow::{Context, Result};
use drex_core::fsutil;
use serde_json::{Value, json};

use crate::cli::DemoArgs;
use crate::ui::Ui;
use drex_twin::{RunOptions, Stage, Twin};

/// A bundled file.
macro_rules! bundled {
    ($name:expr) => {
        ($name, include_bytes!(concat!("../../data/demo/", $name)).as_slice())
    };
}

/// Bundled photos by their names.
macro_rules! photos {
    ($($name:literal)*) => { [$(bundled!(concat!("scan/images/", $name, ".jpg")),)*] };
}

/// The bundled twin folder, file by file.
const FILES: [(&str, &[u8]); 9] = [
    bundled!("README.md"),
    bundled!("push/tilt/push.toml"),
    bundled!("push/tilt/poses.csv"),
    bundled!("push/tilt/force.csv"),
    bundled!("demos/clip_0.json"),
    bundled!("demos/clip_1.json"),
    bundled!("demos/clip_2.json"),
    bundled!("demos/clip_3.json"),
    // Last: a folder with a manifest has all that it names.
    bundled!("twin.toml"),
];
const PHOTOS: [(&str, &[u8]); 40] = photos!(
    "00" "01" "02" "03" "04" "05" "06" "07" "08" "09" "10" "11" "12" "13" "14" "15" "16" "17"
    "18" "19" "20" "21" "22" "23" "24" "25" "26" "27" "28" "29" "30" "31" "32" "33" "34" "35"
    "36" "37" "38" "39"
);
/// What was simulated. Only printed at the end, beside the estimate; never written into the twin folder.
const TRUTH: &str = include_str!("../../data/demo/truth.json");

/// Writes the bundled twin to the folder, runs it, and prints the estimate beside what was simulated.
pub fn run(args: &DemoArgs, seed: Option<u64>, ui: &Ui) -> Result<()> {
    for (name, content) in PHOTOS.into_iter().chain(FILES) {
        write_if_changed(&args.out.join(name), content)?;
    }
    let mut twin = Twin::open(&args.out)?.with_seed(seed);
    let options = RunOptions::default().with_picture(drex_report::write_picture).with_report(drex_report::write);
    let summary = twin.run(&options, ui)?;
    let findings = drex_report::findings(&twin, Stage::Report)?;
    let truth: Value = serde_json::from_str(TRUTH).context("the bundled truth.json is damaged")?;
    let mut answer = json!(summary);
    if let Some(object) = answer.as_object_mut() {
        object.extend(serde_json::from_str::<serde_json::Map<_, _>>(&findings.json)?);
        object.insert("simulated_mass_kg".into(), truth["mass_kg"].clone());
        object.insert("true_volume_cm3".into(), truth["volume_cm3"].clone());
    }
    let number = |name: &str| truth[name].as_f64().with_context(|| format!("the bundled truth.json has no {name}"));
    let (mass_g, volume_cm3) = (1e3 * number("mass_kg")?, number("volume_cm3")?);
    let simulated = format!("  truth      {mass_g:.0} g and {volume_cm3:.0} cm3 were simulated; no stage was told");
    ui.answer(&answer, format!("{}\n{simulated}", findings.text))
}

/// Leaves a file alone that already has this content, so that a second run finds its inputs unchanged.
fn write_if_changed(path: &Path, content: &[u8]) -> Result<()> {
    if std::fs::read(path).is_ok_and(|old| old == content) {
        return Ok(());
    }
    Ok(fsutil::write_atomic(path, content)?)
}
