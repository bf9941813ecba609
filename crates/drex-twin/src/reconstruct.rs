//! Photos to Gaussians and depth maps, with the programs that photos and videos may need.

use std::path::Path;
use std::time::Duration;

use drex_core::capture::{Capture, CaptureOptions, CaptureReport};
use drex_sfm::programs::{ColmapOptions, VideoOptions, extract_frames, find_cameras};
use drex_splat::raster::Cpu;
use drex_splat::reconstruct::{Reconstruction, reconstruct};
use drex_splat::train::Progress as Step;
use drex_splat::{Kind, ReconstructOptions};

use crate::error::refuse;
use crate::{Progress, Result};

/// Says what to trust of the capture, trains both sets of Gaussians and writes them and the depth maps into `out`.
pub fn train_gaussians(
    capture: &Capture,
    out: &Path,
    options: &ReconstructOptions,
    on_gpu: bool,
    progress: &dyn Progress,
) -> Result<(CaptureReport, Reconstruction)> {
    let report = capture.report()?;
    for line in report.to_string().lines() {
        progress.note(line);
    }
    let mut at_work: Option<Kind> = None;
    let mut psnr = 0.0;
    let mut first_step = 0;
    let mut on_progress = |kind: Kind, p: &Step, steps: u32, seconds: f64| {
        if at_work != Some(kind) {
            let label = if kind == Kind::Ellipsoid { "appearance" } else { "surface" };
            at_work = Some(kind);
            progress.begin(label, Some(u64::from(steps)));
            psnr = p.psnr;
            first_step = p.step - 1; // more than 0 after --resume
        }
        psnr += 0.02 * (p.psnr - psnr); // a mean over about fifty photos
        let speed = f64::from(p.step - first_step) / seconds.max(1e-9);
        let message = format!("{psnr:.1} dB, {speed:.0} it/s, {} Gaussians", p.gaussians);
        progress.at(u64::from(p.step), &message);
        if p.step == steps {
            progress.end();
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
    refuse!("this drex was built without a GPU; build it with `--features wgpu`, or leave --gpu out")
}

/// The programs that photos and videos may need.
pub struct Programs<'a> {
    /// Path of COLMAP.
    pub colmap: &'a Path,
    /// Path of ffmpeg.
    pub ffmpeg: &'a Path,
    /// Time after which ffmpeg, or a step of COLMAP, is stopped.
    pub limit: Duration,
}

/// The capture in `scan`; cameras come from COLMAP where the folder has none, photos from ffmpeg where it is a video.
pub fn open_capture(
    scan: &Path,
    out: &Path,
    within: &CaptureOptions,
    programs: &Programs<'_>,
    progress: &dyn Progress,
) -> Result<Capture> {
    let mut colmap = ColmapOptions::default();
    (colmap.program, colmap.time_limit) = (programs.colmap.into(), programs.limit);
    if !scan.exists() {
        refuse!("there is no {}; give a folder with photos, or a video", scan.display());
    }
    progress.begin("cameras", None);
    let mut show = |line: &str| progress.at(0, line);
    let mut folder = scan.to_path_buf();
    if scan.is_file() {
        folder = out.join("scan");
        let images = folder.join("images");
        if images.exists() {
            progress.note(&format!(
                "going on with the frames in {}; remove them to take those of {} anew",
                images.display(),
                scan.display()
            ));
        } else {
            let mut video = VideoOptions::default();
            (video.program, video.time_limit) = (programs.ffmpeg.into(), programs.limit);
            let made: Vec<&Path> = [folder.as_path(), out].into_iter().filter(|f| !f.exists()).collect();
            let frames = extract_frames(scan, &folder, &video, &mut show).inspect_err(|_| {
                // Only empty folders go; one that stays is no error.
                made.iter().for_each(|f| drop(std::fs::remove_dir(f)));
            })?;
            progress.note(&format!("{frames} frames of {}", scan.display()));
        }
    }
    let capture = if Capture::is_in(&folder) {
        Capture::load(&folder, within)?
    } else {
        find_cameras(&folder, within, &colmap, &mut show)?
    };
    progress.end();
    Ok(capture)
}
