//! `drex reconstruct`: photos become Gaussians and depth maps.

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use drex_splat::capture::{self, Capture, CaptureOptions, CaptureReport, ColmapOptions, VideoOptions};
use drex_splat::io::{read_gaussians, write_gaussians};
use drex_splat::metrics::Table;
use drex_splat::raster::Cpu;
use drex_splat::reconstruct::{Reconstruction, SetSummary, reconstruct};
use drex_splat::train::Progress;
use drex_splat::{Kind, ReconstructOptions};
use indicatif::ProgressBar;
use serde::Serialize;

use crate::cli::{ReconstructArgs, SplatFormat};
use crate::timings::{self, Timing};
use crate::ui::Ui;

/// The answer of `drex reconstruct --json`.
#[derive(Serialize)]
struct Answer<'a> {
    capture: &'a CaptureReport,
    #[serde(flatten)]
    reconstruction: Reconstruction,
}

/// Finds the cameras where they are not given, trains both sets, writes them, answers with their scores.
pub fn run(args: &ReconstructArgs, seed: Option<u64>, ui: &Ui) -> Result<()> {
    let mut within = CaptureOptions::default();
    within.masks.clone_from(&args.masks);
    let begun = Instant::now();
    let programs = Programs { colmap: &args.colmap, ffmpeg: &args.ffmpeg, limit: args.tools.limit() };
    let capture = open(&args.scan, &args.out, &within, &programs, ui)?;
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
    let (report, reconstruction) = train(&capture, &args.out, &options, args.gpu, ui)?;
    for format in &args.also {
        let ending = match format {
            SplatFormat::Spz => "spz",
            SplatFormat::Splat => "splat",
        };
        for (set, kind) in [(&reconstruction.appearance, Kind::Ellipsoid), (&reconstruction.surface, Kind::Surfel)] {
            let file = args.out.join(&set.file);
            write_gaussians(&file.with_extension(ending), &read_gaussians(&file, kind)?)?;
        }
    }
    record(args, &reconstruction, begun.elapsed().as_secs_f64())?;
    let text = describe(&reconstruction, &args.out);
    ui.answer(&Answer { capture: &report, reconstruction }, text)
}

/// What it took, into `timings.json`.
fn record(args: &ReconstructArgs, r: &Reconstruction, seconds: f64) -> Result<()> {
    let sets = [("appearance", &r.appearance), ("surface", &r.surface)];
    let mut timing = Timing::of(seconds);
    timing.core_seconds = sets.iter().map(|(_, set)| set.core_seconds).sum();
    timing.peak_memory_bytes = r.peak_memory_bytes;
    timing.input = Some(args.scan.clone());
    timing.parts = sets.iter().map(|(part, set)| (String::from(*part), set.seconds)).collect();
    timings::record(&args.out, "reconstruct", timing)
}

/// Says what to trust of the capture, trains both sets and writes them and the depth maps into `out`.
pub fn train(
    capture: &Capture,
    out: &Path,
    options: &ReconstructOptions,
    on_gpu: bool,
    ui: &Ui,
) -> Result<(CaptureReport, Reconstruction)> {
    let report = capture.report()?;
    for line in report.to_string().lines() {
        ui.note(line);
    }
    let mut bar: Option<(Kind, ProgressBar)> = None;
    let mut psnr = 0.0;
    let mut first_step = 0;
    let mut on_progress = |kind: Kind, p: &Progress, steps: u32, seconds: f64| {
        if bar.as_ref().is_none_or(|(of, _)| *of != kind) {
            let label = if kind == Kind::Ellipsoid { "appearance" } else { "surface" };
            bar = Some((kind, ui.bar(label, u64::from(steps))));
            psnr = p.psnr;
            first_step = p.step - 1; // more than 0 after --resume
        }
        psnr += 0.02 * (p.psnr - psnr); // a mean over about fifty photos
        if let Some((_, bar)) = &bar {
            bar.set_position(u64::from(p.step));
            let speed = f64::from(p.step - first_step) / seconds.max(1e-9);
            bar.set_message(format!("{psnr:.1} dB, {speed:.0} it/s, {} Gaussians", p.gaussians));
            if p.step == steps {
                bar.finish_and_clear();
            }
        }
    };
    let reconstruction = if on_gpu {
        reconstruct(capture, &report, &gpu()?, out, options, &mut on_progress)?
    } else {
        reconstruct(capture, &report, &Cpu, out, options, &mut on_progress)?
    };
    Ok((report, reconstruction))
}

/// The first GPU there is.
#[cfg(feature = "wgpu")]
fn gpu() -> Result<drex_splat::raster::Gpu> {
    Ok(drex_splat::raster::Gpu::new()?)
}

#[cfg(not(feature = "wgpu"))]
fn gpu() -> Result<Cpu> {
    anyhow::bail!("this drex was built without a GPU; build it with `--features wgpu`, or leave --gpu out")
}

/// The programs that photos and videos may need.
pub struct Programs<'a> {
    /// COLMAP.
    pub colmap: &'a Path,
    /// ffmpeg.
    pub ffmpeg: &'a Path,
    /// ffmpeg, or a step of COLMAP, is stopped after this time.
    pub limit: Duration,
}

/// The capture in `scan`; cameras come from COLMAP where the folder has none, photos from ffmpeg where it is a video.
pub fn open(scan: &Path, out: &Path, within: &CaptureOptions, programs: &Programs<'_>, ui: &Ui) -> Result<Capture> {
    let mut colmap = ColmapOptions::default();
    (colmap.program, colmap.time_limit) = (programs.colmap.into(), programs.limit);
    if !scan.exists() {
        bail!("there is no {}; give a folder with photos, or a video", scan.display());
    }
    let spinner = ui.spinner("cameras");
    let mut show = |line: &str| spinner.set_message(line.to_owned());
    let mut folder = scan.to_path_buf();
    if scan.is_file() {
        folder = out.join("scan");
        let images = folder.join("images");
        if images.exists() {
            ui.note(format!(
                "going on with the frames in {}; remove them to take those of {} anew",
                images.display(),
                scan.display()
            ));
        } else {
            let mut video = VideoOptions::default();
            (video.program, video.time_limit) = (programs.ffmpeg.into(), programs.limit);
            let made: Vec<&Path> = [folder.as_path(), out].into_iter().filter(|f| !f.exists()).collect();
            let frames = capture::extract_frames(scan, &folder, &video, &mut show).inspect_err(|_| {
                // Only empty folders go; one that stays is no error.
                made.iter().for_each(|f| drop(std::fs::remove_dir(f)));
            })?;
            ui.note(format!("{frames} frames of {}", scan.display()));
        }
    }
    let capture = Capture::open(&folder, within, &colmap, &mut show)?;
    spinner.finish_and_clear();
    Ok(capture)
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
    for (name, set) in [("appearance", &r.appearance), ("surface", &r.surface)] {
        text += &describe_set(name, set, out);
    }
    text += &format!("  depth     {} maps in {}\n", r.depth_maps, out.join("depth").display());
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
