//! What a registration leaves in a folder: models, transforms.json, a report and a picture.

use std::collections::BTreeSet;
use std::path::Path;

use drex_core::capture::{Capture, PhotoFile};
use drex_core::{Error, Result, fsutil};
use serde::{Deserialize, Serialize};

use crate::folder::PhotoFolder;
use crate::front_end::{InputPhoto, RegisterOptions, Step};
use crate::marker::Marker;
use crate::picture::{self, PICTURE};
use crate::register::{Registration, register};
use crate::report::{PhotoReport, Report};
use crate::scale::{MarkerReport, scale_by_marker};
use crate::verdict::Verdict;
use crate::video::{VideoOptions, are_frames, choose_from};

/// What photos are registered with.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct FolderOptions {
    /// The registration's own options.
    pub register: RegisterOptions,
    /// A printed tag that gives the model metres, up and origin.
    pub marker: Option<Marker>,
}

/// The models of a folder of photos.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct FolderRegistration {
    /// As [`Registration::models`]; the first is in metres with z up where the marker told them.
    pub models: Vec<Capture>,
    /// What is written as `report.json`.
    pub report: FolderReport,
}

/// `report.json` of `drex sfm`: the report of the registration, and what it was made of.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct FolderReport {
    /// See [`PhotoFolder::sha256`].
    pub photos_sha256: String,
    /// Version of this crate, and the options without the marker.
    pub settings: String,
    /// Whether masks were used.
    pub masks: bool,
    /// What the marker said; absent where none was asked for, or it gave no scale: a note says why.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub marker: Option<MarkerReport>,
    /// What became of the photos.
    #[serde(flatten)]
    pub registration: Report,
}

/// Registers the photos of a folder, and puts the main model into metres where there is a marker.
///
/// A marker that gives no scale is no reason to lose the cameras: the model stays as it is, and a note of the report says why.
///
/// # Errors
/// As [`register`].
pub fn register_folder(
    folder: &PhotoFolder,
    options: &FolderOptions,
    progress: &(dyn Fn(Step) + Sync),
) -> Result<FolderRegistration, Verdict> {
    let (photos, passed_over) = frames_apart(folder, options, progress);
    let mut of_photos = options.register.clone();
    of_photos.video |= !passed_over.is_empty();
    let Registration { mut models, report: mut registration } = register(&photos, &of_photos, progress)?;
    if !passed_over.is_empty() {
        registration.notes.push(format!(
            "The photos are frames of a video: {} of {} were chosen by sharpness and parallax.",
            photos.len(),
            folder.photos.len()
        ));
        registration.photos.extend(passed_over.iter().map(|p| PhotoReport {
            name: p.name.clone(),
            why_not: Some("a frame of a video that is less sharp than the next ones, or shows nothing new".to_owned()),
            ..PhotoReport::default()
        }));
        registration.photos.sort_by(|a, b| a.name.cmp(&b.name));
    }
    registration.notes.splice(0..0, folder.notes.iter().cloned().chain(folder.partly_masked()));
    let mut scaled = None;
    if let (Some(marker), Some(main)) = (&options.marker, models.first_mut()) {
        progress(Step { stage: "marker", done: 0, total: main.views.len() });
        match scale_by_marker(main, marker) {
            Ok(found) => {
                for photo in registration.photos.iter_mut().filter(|p| p.model == Some(0)) {
                    photo.centre_sd = photo.centre_sd.map(|sd| sd * found.metres_per_unit);
                }
                registration.notes.extend(found.warning.as_ref().map(|w| format!("{}.", w.trim_end_matches('.'))));
                scaled = Some(found);
            }
            Err(e) => registration.notes.push(format!("The model has no scale: {e}.")),
        }
    }
    let report = FolderReport {
        photos_sha256: folder.sha256.clone(),
        settings: settings(options),
        masks: folder.has_masks(),
        marker: scaled,
        registration,
    };
    Ok(FolderRegistration { models, report })
}

/// The photos that are to be registered, and the frames of a video that are not: none if the photos are no frames, or none
/// can be chosen among them.
fn frames_apart(
    folder: &PhotoFolder,
    options: &FolderOptions,
    progress: &(dyn Fn(Step) + Sync),
) -> (Vec<InputPhoto>, Vec<InputPhoto>) {
    let all = &folder.photos;
    let files: Vec<PhotoFile> = all.iter().map(|p| PhotoFile { name: p.name.clone(), path: p.path.clone() }).collect();
    if options.register.video || !are_frames(&files) {
        return (all.clone(), Vec::new());
    }
    progress(Step { stage: "frames", done: 0, total: all.len() });
    let Ok(chosen) = choose_from(&files, &VideoOptions::default(), &mut |_| ()) else {
        return (all.clone(), Vec::new());
    };
    let chosen: BTreeSet<usize> = chosen.into_iter().collect();
    let (kept, rest): (Vec<_>, Vec<_>) = all.iter().cloned().enumerate().partition(|(i, _)| chosen.contains(i));
    let photos = |numbered: Vec<(usize, InputPhoto)>| numbered.into_iter().map(|(_, p)| p).collect();
    (photos(kept), photos(rest))
}

/// The options in one line; registrations of the same photos with the same line are the same.
fn settings(options: &FolderOptions) -> String {
    format!("drex-sfm {}, {:?}", env!("CARGO_PKG_VERSION"), options.register)
}

impl FolderRegistration {
    /// Writes into `out`: `report.json`, COLMAP models in `sparse/0`, `sparse/1`…, and `transforms.json` and the picture
    /// `cameras.png` of the first. What an earlier registration left there goes.
    ///
    /// # Errors
    /// If `out` holds a model that no registration wrote, or a file cannot be written.
    pub fn write(&self, out: &Path) -> Result<()> {
        remove(out)?;
        // First: it tells the next run whose models these are.
        let failed = |e: serde_json::Error| Error::value(format!("the report cannot be written: {e}"), "report this");
        let text = serde_json::to_string_pretty(&self.report).map_err(failed)? + "\n";
        fsutil::write_atomic(&fsutil::output_path(out, REPORT)?, text.as_bytes())?;
        for (k, model) in self.models.iter().enumerate() {
            model.write_colmap(&fsutil::output_path(out, &format!("sparse/{k}"))?)?;
        }
        if let Some(main) = self.models.first() {
            let picture = picture::draw(main, self.report.marker.is_some())?;
            fsutil::write_atomic(&fsutil::output_path(out, PICTURE)?, &picture)?;
            main.write_transforms(&fsutil::output_path(out, TRANSFORMS)?)?;
        }
        Ok(())
    }
}

const REPORT: &str = "report.json";
const TRANSFORMS: &str = "transforms.json";

/// What of `report.json` a later run needs.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[non_exhaustive]
pub struct StoredReport {
    /// See [`FolderReport::photos_sha256`].
    pub photos_sha256: String,
    /// See [`FolderReport::settings`].
    pub settings: String,
    /// See [`FolderReport::marker`].
    pub marker: Option<MarkerReport>,
    /// What was odd.
    pub notes: Vec<String>,
}

impl StoredReport {
    /// What an earlier registration left in `out`, if one did.
    ///
    /// # Errors
    /// If there is a report that cannot be read.
    pub fn read(out: &Path) -> Result<Option<Self>> {
        let file = out.join(REPORT);
        if !file.is_file() {
            return Ok(None);
        }
        fsutil::from_json(&file, &fsutil::read_text(&file)?).map(Some)
    }

    /// Whether the same photos would be registered with the same options, whatever marker gives the scale.
    pub fn is_of(&self, folder: &PhotoFolder, options: &FolderOptions) -> bool {
        self.photos_sha256 == folder.sha256 && self.settings == settings(options)
    }
}

/// Makes sure that a registration may be written into `out`.
///
/// # Errors
/// If there is a model that no registration wrote.
pub fn check_output(out: &Path) -> Result<()> {
    let models = out.join("sparse");
    let ours = matches!(StoredReport::read(out), Ok(Some(_)));
    if models.exists() && !ours {
        let what = format!("{} holds a model that drex sfm did not write", models.display());
        return Err(Error::value(what, "give another folder for the result, or move the model away"));
    }
    Ok(())
}

/// Removes what an earlier registration left in `out`.
///
/// # Errors
/// As [`check_output`], or if it cannot be removed.
pub fn remove(out: &Path) -> Result<()> {
    check_output(out)?;
    if !matches!(StoredReport::read(out), Ok(Some(_))) {
        return Ok(());
    }
    let gone = |path: &Path, result: std::io::Result<()>| match result {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io("remove", path, e)),
        _ => Ok(()),
    };
    let models = fsutil::output_path(out, "sparse")?;
    gone(&models, std::fs::remove_dir_all(&models))?;
    for name in [PICTURE, TRANSFORMS, "sparse_pc.ply", REPORT] {
        let file = fsutil::output_path(out, name)?;
        gone(&file, std::fs::remove_file(&file))?;
    }
    Ok(())
}
