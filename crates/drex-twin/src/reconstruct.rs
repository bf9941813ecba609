//! Photos to cameras and Gaussians, with the programs that photos and videos may need.

use std::path::Path;
use std::time::Duration;

use drex_core::capture::{Capture, CaptureOptions, CaptureReport};
use drex_core::fsutil::output_path;
use drex_sfm::marker::Marker;
use drex_sfm::programs::{ColmapOptions, find_cameras};
use drex_sfm::video::{VideoOptions, choose_frames};
use drex_sfm::{
    FolderOptions, FolderRegistration, FolderReport, MarkerReport, PhotoFolder, Step, StoredReport, Verdict,
    measure_marker, register_folder,
};
use drex_splat::ReconstructOptions;
use drex_splat::raster::Cpu;
use drex_splat::reconstruct::{Reconstruction, reconstruct};
use drex_splat::train::Progress as TrainStep;

use crate::cameras::{COLMAP, FRAMES, SFM, is_video, load_found};
use crate::error::refuse;
use crate::progress::show_stages;
use crate::{Progress, Result};

/// Says what to trust of the capture, trains Gaussians and writes them into `out`.
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
    let mut psnr = 0.0;
    let mut first_step = None;
    let mut on_progress = |p: &TrainStep, steps: u32, seconds: f64| {
        let first_step = *first_step.get_or_insert_with(|| {
            progress.begin("appearance", Some(u64::from(steps)));
            psnr = p.psnr;
            p.step - 1 // more than 0 after --resume
        });
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

/// Whether there is a GPU that this program can use: to be asked before the minutes that cameras take.
///
/// # Errors
/// If there is none, or the program was built without.
pub fn gpu_is_there() -> Result<()> {
    gpu().map(drop)
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

/// Photos, or a video, whose cameras are known or are to be found.
#[derive(Debug, Clone)]
pub struct ScanInput<'a> {
    /// Folder of photos, with their cameras or without; or a video.
    pub scan: &'a Path,
    /// Folder for what is made: `scan/images` of a video, `sfm` (or `colmap`) of photos without cameras.
    pub out: &'a Path,
    /// Where masks and maps are.
    pub within: CaptureOptions,
    /// A printed tag in the photos, which gives the scale.
    pub marker: Option<Marker>,
    /// Of the search for cameras.
    pub seed: u64,
    /// The program COLMAP, where it is to find the cameras instead of drex.
    pub colmap: Option<&'a Path>,
    /// The program ffmpeg.
    pub ffmpeg: &'a Path,
    /// Time after which ffmpeg, or a step of COLMAP, is stopped.
    pub limit: Duration,
}

/// Photos with their cameras.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Cameras {
    /// The capture, in its own unit.
    pub capture: Capture,
    /// What the marker says of this unit, where one was asked for.
    pub marker: Option<MarkerReport>,
    /// Whether the cameras were found in this run, so that what was made of earlier ones is out of date.
    pub found_now: bool,
}

/// Shows the steps of a registration as work of its stages.
pub fn show_steps(progress: &dyn Progress) -> impl Fn(Step) + Sync + '_ {
    let show = show_stages(progress);
    move |step: Step| show(step.stage, step.done, step.total)
}

/// Sharp frames of a video that show something new, as photos in `folder/images`; those that are there already are kept.
///
/// # Errors
/// If ffmpeg is not installed, fails or takes longer than `limit`, or the video has too few frames or too little motion.
pub fn take_frames(video: &Path, folder: &Path, ffmpeg: &Path, limit: Duration, progress: &dyn Progress) -> Result<()> {
    let images = folder.join("images");
    if images.exists() {
        progress.note(&format!(
            "going on with the frames in {}; remove them to take those of {} anew",
            images.display(),
            video.display()
        ));
        return Ok(());
    }
    progress.begin("frames", None);
    let mut options = VideoOptions::default();
    (options.program, options.time_limit) = (ffmpeg.into(), limit);
    let made: Vec<&Path> = folder.ancestors().take_while(|f| !f.exists()).collect();
    let to = output_path(folder, "images")?;
    let frames = choose_frames(video, &to, &options, &mut |line| progress.at(0, line)).inspect_err(|_| {
        // Only empty folders go; one that stays is no error.
        made.iter().for_each(|f| drop(std::fs::remove_dir(f)));
    })?;
    progress.note(&format!(
        "{} of the {} frames of {}; {} are too blurred",
        frames.indices.len(),
        frames.decoded,
        video.display(),
        frames.blurred
    ));
    progress.end();
    Ok(())
}

impl ScanInput<'_> {
    /// The photos with their cameras: those that lie beside them, or that an earlier run found for the same photos, or that
    /// are found now. Nothing is written beside the photos.
    ///
    /// # Errors
    /// If a file is damaged, no camera can be found (the message says why), or the marker gives no scale.
    pub fn cameras(&self, progress: &dyn Progress) -> Result<Cameras> {
        if !self.scan.exists() {
            refuse!("there is no {}; give a folder with photos, or a video", self.scan.display());
        }
        // Finding cameras takes minutes.
        if let Some(masks) = self.within.masks.as_ref().filter(|m| !m.is_dir()) {
            refuse!("there is no folder {}; give the one with the masks", masks.display());
        }
        let mut folder = self.scan.to_path_buf();
        if is_video(self.scan) {
            folder = self.out.join(FRAMES);
            take_frames(self.scan, &folder, self.ffmpeg, self.limit, progress)?;
        }
        let (capture, marker, found_now) = if Capture::is_in(&folder) {
            (Capture::load(&folder, &self.within)?, None, false)
        } else if let Some(program) = self.colmap {
            let (capture, found_now) = self.by_colmap(program, &folder, progress)?;
            (capture, None, found_now)
        } else {
            self.by_registration(&folder, progress)?
        };
        self.masks_are_used(capture.views.iter().any(|v| v.mask.is_some()))?;
        let mut found = Cameras { capture, marker, found_now };
        let Some(asked) = self.marker else { return Ok(Cameras { marker: None, ..found }) };
        if found.marker.as_ref().is_none_or(|m| m.marker != asked.to_string()) {
            progress.begin("marker", None);
            found.marker = Some(measure_marker(&found.capture, &asked)?.0);
            progress.end();
        }
        Ok(found)
    }

    /// # Errors
    /// If masks were given and none of them `is_used`.
    fn masks_are_used(&self, is_used: bool) -> Result<()> {
        match &self.within.masks {
            Some(masks) if !is_used => refuse!(
                "{} has no mask of any photo of {}; a mask is a picture named like its photo",
                masks.display(),
                self.scan.display()
            ),
            _ => Ok(()),
        }
    }

    /// By the program COLMAP, or what it found earlier.
    fn by_colmap(&self, program: &Path, folder: &Path, progress: &dyn Progress) -> Result<(Capture, bool)> {
        let work = self.out.join(COLMAP);
        if let Some(capture) = load_found(folder, &work, &self.within)? {
            progress.note(&format!("going on with the cameras in {}", work.display()));
            return Ok((capture, false));
        }
        let mut options = ColmapOptions::default();
        (options.program, options.time_limit) = (program.into(), self.limit);
        progress.begin("cameras", None);
        let capture = find_cameras(folder, &work, &self.within, &options, &mut |line| progress.at(0, line))?;
        progress.end();
        Ok((capture, true))
    }

    /// By registration, or what one found earlier for the same photos.
    fn by_registration(&self, folder: &Path, progress: &dyn Progress) -> Result<(Capture, Option<MarkerReport>, bool)> {
        let out = self.out.join(SFM);
        let mut options = FolderOptions::default();
        options.register.video = is_video(self.scan);
        options.register.seed = self.seed;
        options.marker = self.marker;
        let mut within = self.within.clone();
        if within.masks.is_none() {
            within.masks = Some(folder.join("masks")).filter(|m| m.is_dir());
        }
        let photos = PhotoFolder::read(folder, &within, self.out)?;
        self.masks_are_used(photos.has_masks())?;
        if let Some(earlier) = StoredReport::read(&out)? {
            let same = earlier.is_of(&photos, &options);
            if let Some(mut capture) = if same { load_found(folder, &out, &self.within)? } else { None } {
                progress.note(&format!("going on with the cameras in {}", out.display()));
                capture.notes.extend(earlier.notes);
                return Ok((capture, earlier.marker.map(in_metres), false));
            }
            let what = "is of other photos or options, or incomplete: their cameras are found again";
            progress.note(&format!("{} {what}", out.display()));
        }
        let found = register_with_masks(&photos, &options, progress);
        progress.end();
        let found = found.inspect_err(|_| {
            // What is left of other photos must not be taken for theirs; the verdict says more than a failure here.
            drop(drex_sfm::remove(&out));
        })?;
        found.write(&out)?;
        for line in sentences(&found.report) {
            progress.note(&line);
        }
        let Some(mut capture) = load_found(folder, &out, &self.within)? else {
            refuse!("{} was written and cannot be found; run it again", out.display())
        };
        capture.notes.extend(found.report.registration.notes);
        Ok((capture, found.report.marker.map(in_metres), true))
    }
}

/// Registers the photos as a whole. Where something stands still while the object turns, or nothing is found, what masks show
/// may do better.
fn register_with_masks(
    photos: &PhotoFolder,
    options: &FolderOptions,
    progress: &dyn Progress,
) -> std::result::Result<FolderRegistration, Verdict> {
    let show = show_steps(progress);
    let whole = register_folder(&photos.without_masks(), options, &show);
    let doubtful = whole.as_ref().map_or(true, |w| w.report.registration.still_background.is_some());
    if !(doubtful && photos.has_masks()) {
        return whole;
    }
    let registered = |r: &FolderRegistration| r.models.first().map_or(0, |m| m.views.len());
    match (register_folder(photos, options, &show), whole) {
        (Ok(masked), Ok(whole)) => Ok(if registered(&masked) >= registered(&whole) { masked } else { whole }),
        (Ok(one), Err(_)) | (Err(_), Ok(one)) => Ok(one),
        (Err(_), Err(verdict)) => Err(verdict),
    }
}

/// What a registration found, for a person.
fn sentences(report: &FolderReport) -> Vec<String> {
    let r = &report.registration;
    let main = r.models.first();
    let mut lines = vec![format!(
        "cameras of {} of {} photos, median error {:.2} px",
        main.map_or(0, |m| m.photos),
        r.photos.len(),
        main.map_or(0.0, |m| m.median_error_px)
    )];
    let out = r.photos.iter().filter(|p| p.model.is_none());
    lines.extend(out.map(|p| format!("left out {}: {}", p.name, p.why_not.as_deref().unwrap_or("no reason is known"))));
    lines
}

/// The report of a marker for a model that was put into metres by it.
fn in_metres(mut report: MarkerReport) -> MarkerReport {
    report.metres_per_unit = 1.0;
    report
}
