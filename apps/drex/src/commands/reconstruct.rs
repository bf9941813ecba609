//! `drex reconstruct`: photos become Gaussians.

use std::path::Path;
use std::time::Instant;

use anyhow::Result;
use drex_core::capture::{CaptureOptions, CaptureReport};
use drex_splat::io::{read_gaussians, write_gaussians};
use drex_splat::metrics::Table;
use drex_splat::reconstruct::{Reconstruction, SetSummary};
use drex_splat::{Kind, ReconstructOptions};
use drex_twin::born::points_on_asset;
use drex_twin::reconstruct::{Cameras, ScanInput, gpu_is_there, train_gaussians};
use drex_twin::timings::{self, Timing};
use serde::Serialize;

use crate::cli::{ReconstructArgs, SplatFormat};
use crate::ui::Ui;

/// The answer of `drex reconstruct --json`.
#[derive(Serialize)]
struct Answer<'a> {
    capture: &'a CaptureReport,
    #[serde(flatten)]
    reconstruction: Reconstruction,
}

/// Finds the cameras where they are not given, trains Gaussians, writes them, answers with their scores.
pub fn run(args: &ReconstructArgs, seed: Option<u64>, ui: &Ui) -> Result<()> {
    if args.gpu {
        gpu_is_there()?;
    }
    let mut within = CaptureOptions::default();
    within.masks.clone_from(&args.masks);
    let begun = Instant::now();
    let input = ScanInput {
        scan: &args.scan,
        out: &args.out,
        within,
        marker: None,
        seed: seed.unwrap_or(0),
        colmap: args.programs.colmap.as_deref(),
        ffmpeg: &args.programs.ffmpeg,
        limit: args.programs.tools.limit(),
    };
    let Cameras { mut capture, found_now, .. } = input.cameras(ui)?;
    let mut options = ReconstructOptions::default();
    options.preset = args.preset.into();
    options.density = args.density.into();
    options.hold_out = args.hold_out;
    options.use_masks = !args.whole_scene;
    options.seed = seed.unwrap_or(0);
    options.max_side = args.max_side;
    options.iterations = args.iterations;
    options.max_gaussians = args.max_gaussians;
    options.exposure = args.exposure;
    options.refine_poses = args.refine_poses;
    options.checkpoint_every = args.checkpoint_every;
    options.resume = args.resume;
    options.memory_bytes = args.memory_mb << 20;
    if !args.whole_scene && !found_now {
        options.born = points_on_asset(&args.out, &mut capture, ui)?;
    }
    if !options.born.is_empty() {
        let judged = if args.hold_out.is_some() {
            "; if that was made of the photos held out, too, their scores are no forecast for new photos"
        } else {
            ""
        };
        ui.note(format!("Gaussians are born on the mesh in {}{judged}", args.out.join("mesh").display()));
    }
    let (report, reconstruction) = train_gaussians(&capture, &args.out, &options, args.gpu, ui)?;
    for format in &args.also {
        let ending = match format {
            SplatFormat::Spz => "spz",
            SplatFormat::Splat => "splat",
        };
        let file = args.out.join(&reconstruction.appearance.file);
        write_gaussians(&file.with_extension(ending), &read_gaussians(&file, Kind::Ellipsoid)?)?;
    }
    record(args, &reconstruction, begun.elapsed().as_secs_f64())?;
    let text = describe(&reconstruction, &args.out);
    ui.answer(&Answer { capture: &report, reconstruction }, text)
}

/// What it took, into `timings.json`.
fn record(args: &ReconstructArgs, r: &Reconstruction, seconds: f64) -> Result<()> {
    let mut timing = Timing::of(seconds);
    timing.core_seconds = r.appearance.core_seconds;
    timing.peak_memory_bytes = r.peak_memory_bytes;
    timing.input = Some(args.scan.clone());
    timing.parts = [("appearance".to_owned(), r.appearance.seconds)].into();
    Ok(timings::record(&args.out, "reconstruct", timing)?)
}

fn describe(r: &Reconstruction, out: &Path) -> String {
    let mut text = format!(
        "{} photos trained on, {} held out{}\n",
        r.photos_trained,
        r.photos_held_out,
        if r.object_only { "; the object alone" } else { "; the whole scene" }
    );
    for left_out in &r.left_out {
        text += &format!("  left out  {left_out}\n");
    }
    text += &describe_set("appearance", &r.appearance, out);
    if let Some(bytes) = r.peak_memory_bytes {
        text += &format!("  memory    {:.0} MB at the most\n", bytes as f64 / 1e6);
    }
    text
}

fn describe_set(name: &str, set: &SetSummary, out: &Path) -> String {
    let cost = set.core_seconds.map_or(String::new(), |s| format!(", {:.1} core-minutes", s / 60.0));
    let mut text = format!(
        "  {name}: {} Gaussians after {} steps, {:.0} s{cost}, {}\n",
        set.gaussians,
        set.iterations,
        set.seconds,
        out.join(&set.file).display()
    );
    if !set.held_out.rows.is_empty() {
        text += &indented(&set.held_out);
    }
    text
}

fn indented(table: &Table) -> String {
    table.to_string().lines().map(|line| format!("    {line}\n")).collect()
}
