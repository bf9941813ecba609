//! Masks of the object in a scan's photos, made where there are none: as files that a person can correct.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use drex_core::Pose;
use drex_core::capture::{Capture, read_rgb};
use drex_core::fsutil;
use drex_mesh::Similarity;
use drex_sfm::masks::{Mask, MaskInput, MaskOptions, MaskPoint, MaskRegion, MaskView, Photo, make_masks};
use nalgebra::{Point3, Translation3};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::error::refuse;
use crate::place::{self, FrameOptions, box_around, sparse_points};
use crate::{Error, Progress, Result};

/// Folder of the masks and name of their report, below the output folder.
pub(crate) const MASKS: &str = "masks";
const REPORT: &str = "masks/report.json";

/// How masks were made; written as `masks/report.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct MaskReport {
    /// What says which thing the object is.
    pub object_from: String,
    /// Other things that stand on the table.
    pub others_on_table: usize,
    /// Maps points of the scan into the frame of the table (z up, the table z = 0, the scan's unit); rows of a 4 x 4 matrix.
    pub table_from_scan: [[f64; 4]; 4],
    /// Lower and upper corner of the object's box in the frame of the table.
    pub object_box: [[f64; 3]; 2],
    /// Why table or object may be the wrong one, in sentences.
    pub doubts: Vec<String>,
    /// One per photo with a camera, in their order.
    pub photos: Vec<PhotoMask>,
    /// Hash of photos, cameras and what was asked for: masks with the same are the same.
    made_of: String,
}

/// The mask of a photo.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct PhotoMask {
    /// Name of the photo.
    pub photo: String,
    /// Pixels that show the object.
    pub object_px: usize,
    /// 0 to 1: how well the photo and the shape that all photos voted for agree.
    pub confidence: f64,
    /// Whether somebody changed the file after it was made, or made it: then it is kept.
    pub corrected: bool,
    /// What is doubtful about it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub doubt: Option<String>,
    /// Of the file, as it was when it was last looked at.
    sha256: String,
}

impl MaskReport {
    /// Names of the photos whose masks are doubtful.
    pub fn doubtful(&self) -> Vec<&str> {
        self.photos.iter().filter(|p| p.doubt.is_some()).map(|p| p.photo.as_str()).collect()
    }
}

/// Masks as they lie in the output folder.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Masks {
    /// How they were made.
    pub report: MaskReport,
    /// Their files, in the order of the views.
    pub files: Vec<PathBuf>,
    /// Whether any file is another one than when it was last looked at, so that what was made of it is out of date.
    pub changed: bool,
}

/// Whether masks were made in this output folder.
pub(crate) fn made_masks_in(out: &Path) -> bool {
    out.join(REPORT).is_file()
}

/// The object's mask for each photo of `cameras`, as `out/masks/NAME.png` (white is the object) with `out/masks/report.json`.
///
/// Table and object are found by the sparse points, as for a mesh. Masks that an earlier run made of the same cameras with the
/// same options are kept, and so is every file that somebody changed since or put there.
///
/// # Errors
/// If there is no table, no object on it, or a photo or file cannot be read or written.
pub fn object_masks(cameras: &Capture, frame: &FrameOptions, out: &Path, progress: &dyn Progress) -> Result<Masks> {
    let names = cameras.views.iter().map(|v| format!("{MASKS}/{}.png", v.name));
    let files = names.map(|name| Ok(fsutil::output_path(out, &name)?)).collect::<Result<Vec<PathBuf>>>()?;
    let report_file = fsutil::output_path(out, REPORT)?;
    let earlier: Option<MaskReport> = match report_file.is_file() {
        true => Some(fsutil::from_json(&report_file, &fsutil::read_text(&report_file)?)?),
        false => None,
    };
    let known: BTreeMap<&str, &PhotoMask> =
        earlier.iter().flat_map(|r| &r.photos).map(|p| (p.photo.as_str(), p)).collect();
    // A file that is not as it was made is somebody's work.
    let mut theirs = Vec::new();
    let mut changed = false;
    for (view, file) in cameras.views.iter().zip(&files) {
        let known = known.get(view.name.as_str());
        let hash = if file.is_file() { Some(hash(&fsutil::read_bytes(file)?)) } else { None };
        let as_it_was = hash.is_some() && hash.as_ref() == known.map(|k| &k.sha256);
        changed |= !as_it_was;
        theirs.push(hash.filter(|_| !as_it_was || known.is_some_and(|k| k.corrected)));
    }
    let made_of = made_of(cameras, frame)?;
    // Somebody may have edited the report, too.
    let of_each = |r: &MaskReport| r.photos.iter().map(|p| &p.photo).eq(cameras.views.iter().map(|v| &v.name));
    let whole = files.iter().all(|f| f.is_file());
    let mut report = match earlier.clone().filter(|r| whole && r.made_of == made_of && of_each(r)) {
        Some(report) => {
            let folder = out.join(MASKS);
            progress
                .note(&format!("going on with the masks in {}; remove it to have them made again", folder.display()));
            report
        }
        None => {
            changed = true;
            let (mut report, masks) = make(cameras, frame, progress)?;
            report.made_of = made_of;
            for (k, mask) in masks.iter().enumerate().filter(|(k, _)| theirs[*k].is_none()) {
                let png = mask.to_png()?;
                report.photos[k].sha256 = hash(&png);
                fsutil::write_atomic(&files[k], &png)?;
            }
            report
        }
    };
    for (k, sha256) in theirs.into_iter().enumerate().filter_map(|(k, t)| Some((k, t?))) {
        let object_px = white_pixels(&files[k], cameras, k)?;
        let photo = cameras.views[k].name.clone();
        report.photos[k] = PhotoMask { photo, object_px, confidence: 1.0, corrected: true, doubt: None, sha256 };
    }
    let kept = report.photos.iter().filter(|p| p.corrected).count();
    if kept > 0 {
        progress.note(&format!("{kept} masks in {} are not drex's own and are kept", out.join(MASKS).display()));
    }
    if earlier.as_ref() != Some(&report) {
        let text = serde_json::to_string_pretty(&report).map_err(Error::json)? + "\n";
        fsutil::write_atomic(&report_file, text.as_bytes())?;
    }
    Ok(Masks { report, files, changed })
}

fn make(cameras: &Capture, frame: &FrameOptions, progress: &dyn Progress) -> Result<(MaskReport, Vec<Mask>)> {
    if cameras.points.is_empty() {
        refuse!(
            "{} has cameras and no sparse points, by which the object is found: give a model with points, or masks",
            cameras.folder.display()
        );
    }
    let place = place::find(cameras, sparse_points(cameras), &[], &[], 1.0, frame)?;
    let of_region = || frame.region.map(|r| box_around(&r, &place.table_from_scan)).map(|(lo, hi)| [lo, hi]);
    let Some([mut lower, upper]) = place.object.or_else(of_region) else {
        refuse!("nothing says where the object is in {}", cameras.folder.display());
    };
    lower.z = 0.0;
    let region = MaskRegion { world_from_region: pose(&place.table_from_scan).inverse(), lower, upper };
    let views: Vec<MaskView> = cameras
        .views
        .iter()
        .map(|v| MaskView { name: v.name.clone(), camera: v.lens.clone(), camera_from_world: v.camera_from_world })
        .collect();
    let points: Vec<MaskPoint> = cameras
        .points
        .iter()
        .map(|p| {
            let mut photos: Vec<u32> = p.track.iter().map(|(view, _)| *view as u32).collect();
            photos.dedup();
            MaskPoint { position: Point3::from(p.position), rgb: p.rgb, photos }
        })
        .collect();
    let load = |k: usize| {
        let ([width, height], rgb) = read_rgb(&cameras.views[k].photo).map_err(|e| e.to_string())?;
        Ok(Photo { width_px: width as u32, height_px: height as u32, rgb: rgb.into_flattened() })
    };
    progress.begin("masks", Some(100));
    let input = MaskInput { views: &views, points: &points, region: &region, load: &load };
    let masks = make_masks(&input, &MaskOptions::default(), &mut |share, _| progress.at((100.0 * share) as u64, ""))?;
    progress.end();
    let photo = |(view, mask): (&MaskView, &Mask)| PhotoMask {
        photo: view.name.clone(),
        object_px: mask.object_px(),
        confidence: mask.confidence,
        corrected: false,
        doubt: mask.doubt.clone(),
        sha256: String::new(),
    };
    let matrix = place.table_from_scan.to_matrix();
    let report = MaskReport {
        object_from: place.object_from.to_owned(),
        others_on_table: place.others.len(),
        table_from_scan: [0, 1, 2, 3].map(|r| [0, 1, 2, 3].map(|c| matrix[(r, c)])),
        object_box: [lower.into(), upper.into()],
        doubts: place.doubts,
        photos: views.iter().zip(&masks).map(photo).collect(),
        made_of: String::new(),
    };
    Ok((report, masks))
}

/// A similarity whose scale is one.
fn pose(s: &Similarity) -> Pose {
    Pose::from_parts(Translation3::from(s.translation), s.rotation)
}

fn hash(bytes: &[u8]) -> String {
    fsutil::hex(&Sha256::digest(bytes))
}

/// Hash of everything that masks depend on.
fn made_of(cameras: &Capture, frame: &FrameOptions) -> Result<String> {
    let mut all =
        format!("{} {:?} {:?} {:?} {}", env!("CARGO_PKG_VERSION"), frame.up, frame.region, frame.object, frame.seed);
    for view in &cameras.views {
        let photo = hash(&fsutil::read_bytes(&view.photo)?);
        all += &format!("\n{} {photo} {:?} {:?}", view.name, view.lens, view.camera_from_world);
    }
    Ok(hash(all.as_bytes()))
}

/// Of somebody's mask, which must be of its photo's size.
fn white_pixels(file: &Path, cameras: &Capture, view: usize) -> Result<usize> {
    let ([width, height], rgb) = read_rgb(file)?;
    let lens = &cameras.views[view].lens;
    if [width, height] != [lens.width_px() as usize, lens.height_px() as usize] {
        refuse!(
            "{} has {width} x {height} pixels and its photo {} x {}: make it of the photo's size, or remove it",
            file.display(),
            lens.width_px(),
            lens.height_px()
        );
    }
    Ok(rgb.iter().filter(|p| p[0] >= 128).count())
}
