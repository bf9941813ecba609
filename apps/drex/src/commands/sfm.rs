//! `drex sfm`: cameras and sparse points from photos alone, or a sentence that says why not.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, bail};
use drex_core::capture::CaptureOptions;
use drex_sfm::{FocalSource, FolderOptions, FolderReport, ModelReport, PhotoFolder, register_folder};
use drex_twin::Progress;
use drex_twin::reconstruct::{show_steps, take_frames};
use serde::Serialize;

use crate::cli::SfmArgs;
use crate::ui::Ui;

/// The answer of `drex sfm --json`.
#[derive(Serialize)]
struct Answer<'a> {
    out: &'a Path,
    seconds: f64,
    #[serde(flatten)]
    report: &'a FolderReport,
}

/// Reads the photos, registers them, writes models, report and picture, answers with what to trust.
pub fn run(args: &SfmArgs, seed: Option<u64>, ui: &Ui) -> Result<()> {
    let begun = Instant::now();
    drex_sfm::check_output(&args.out)?;
    let video = drex_twin::cameras::is_video(&args.photos);
    let folder = if video {
        take_frames(&args.photos, &args.out, &args.ffmpeg, args.tools.limit(), ui)?;
        args.out.clone()
    } else {
        args.photos.clone()
    };
    let mut within = CaptureOptions::default();
    within.masks.clone_from(&args.masks);
    // Frames lie in the output folder itself.
    let photos = PhotoFolder::read(&folder, &within, if video { Path::new("") } else { &args.out })?;
    if let Some(masks) = &args.masks
        && !photos.has_masks()
    {
        bail!(
            "{} has no mask for any photo; name a photo's mask like the photo (IMG_1.png for IMG_1.jpg), or leave --masks out",
            masks.display()
        );
    }
    let mut options = FolderOptions::default();
    options.marker = args.marker;
    options.register.video = video;
    options.register.seed = seed.unwrap_or(0);
    if let Some(file) = &args.camera {
        options.register.calibration = Some(drex_sfm::read_calibration(file, photos.usual_size_px)?);
    }
    let registered = register_folder(&photos, &options, &show_steps(ui));
    ui.end();
    let registered = match registered {
        Ok(registered) => registered,
        Err(verdict) => {
            // A model of earlier photos must not be taken for one of these.
            drex_sfm::remove(&args.out)?;
            return Err(verdict.into());
        }
    };
    registered.write(&args.out)?;
    let report = &registered.report;
    let text = describe(report, &args.out);
    ui.answer(&Answer { out: &args.out, seconds: begun.elapsed().as_secs_f64(), report }, text)
}

fn describe(report: &FolderReport, out: &Path) -> String {
    let registration = &report.registration;
    let total = registration.photos.len();
    let mut text = String::new();
    for (k, model) in registration.models.iter().enumerate() {
        text += &describe_model(k, model, total);
    }
    if let Some(m) = &report.marker {
        text += &format!(
            "  scale    metres by {} in {} of {} photos that show it, +- {:.2} %, corners scatter by {:.2} px; z is up\n",
            m.marker,
            m.used,
            m.seen_in,
            100.0 * m.relative_sigma,
            m.scatter_px
        );
    }
    for note in &registration.notes {
        text += &format!("  note     {note}\n");
    }
    for photo in registration.photos.iter().filter(|p| p.model.is_none()) {
        text += &format!("  left out {}: {}\n", photo.name, photo.why_not.as_deref().unwrap_or("no reason is known"));
    }
    let files = ["sparse/0", "transforms.json", "report.json", "cameras.png"].map(|f| out.join(f));
    text + &format!("  written  {}\n", files.map(|f: PathBuf| f.display().to_string()).join(", "))
}

fn describe_model(index: usize, model: &ModelReport, total: usize) -> String {
    let name = if index == 0 { String::new() } else { format!("sparse/{index}: ") };
    let mut text = format!(
        "{name}{} of {total} photos registered, {} points, median error {:.2} px\n",
        model.photos, model.points, model.median_error_px
    );
    for lens in &model.lenses {
        let [width, height] = lens.size_px;
        let from = match lens.focal_from {
            FocalSource::Calibration => "the calibration that was given",
            FocalSource::Exif => "the photos' EXIF",
            FocalSource::Vote => "what pairs of photos say",
            FocalSource::Guess => "a guess",
        };
        text += &format!(
            "  focal    {:.1} px -> {:.1} px, {width} x {height}, first from {from}\n",
            lens.focal_prior_px, lens.focal_px
        );
    }
    text
}
