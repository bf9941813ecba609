//! `drex masks`: the object's mask in each photo, as files that a person can correct.

use std::path::Path;
use std::time::Instant;

use anyhow::Result;
use drex_core::capture::CaptureOptions;
use drex_twin::masks::{MaskReport, object_masks};
use drex_twin::reconstruct::ScanInput;
use drex_twin::scan::FrameOptions;
use nalgebra::Vector3;
use serde::Serialize;

use crate::cli::MasksArgs;
use crate::ui::Ui;

/// The answer of `drex masks --json`.
#[derive(Serialize)]
struct Answer<'a> {
    out: &'a Path,
    seconds: f64,
    #[serde(flatten)]
    report: &'a MaskReport,
}

/// Finds the cameras where they are not given, makes the masks, answers with what is doubtful.
pub fn run(args: &MasksArgs, seed: Option<u64>, ui: &Ui) -> Result<()> {
    let begun = Instant::now();
    let seed = seed.unwrap_or(0);
    let input = ScanInput {
        scan: &args.scan,
        out: &args.out,
        within: CaptureOptions::default(),
        marker: None,
        seed,
        colmap: args.programs.colmap.as_deref(),
        ffmpeg: &args.programs.ffmpeg,
        limit: args.programs.tools.limit(),
    };
    let cameras = input.cameras(ui)?.capture;
    let frame = FrameOptions {
        up: args.up.map(Vector3::from),
        region: args.region,
        object: args.object.clone(),
        seed,
        ..FrameOptions::default()
    };
    let masks = object_masks(&cameras, &frame, &args.out, ui)?;
    let text = describe(&masks.report, &args.out.join("masks"));
    ui.answer(&Answer { out: &args.out, seconds: begun.elapsed().as_secs_f64(), report: &masks.report }, text)
}

fn describe(report: &MaskReport, folder: &Path) -> String {
    let size = |k: usize| report.object_box[1][k] - report.object_box[0][k];
    let mut text = format!(
        "{} masks, {} of them doubtful\n  object   in a box of {:.3} x {:.3} x {:.3} units of the scan, from {}",
        report.photos.len(),
        report.doubtful().len(),
        size(0),
        size(1),
        size(2),
        report.object_from
    );
    text += &match report.others_on_table {
        0 => "\n".to_owned(),
        n => format!("; {n} more on the table\n"),
    };
    let doubts = report.photos.iter().filter_map(|p| p.doubt.as_ref());
    text += &report.doubts.iter().chain(doubts).map(|d| format!("  doubt    {d}\n")).collect::<String>();
    text + &format!(
        "  written  {}: white is the object; correct what is wrong, and drex asset with the same --out uses it\n",
        folder.display()
    )
}
