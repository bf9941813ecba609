//! Writes a capture as a sparse model of COLMAP, binary.
//!
//! Layout: COLMAP's documentation, "Binary File Format". Little-endian; world to camera, x right, y down, z forward;
//! keypoints have the centre of the first pixel at (0.5, 0.5), as here.

use std::path::Path;

use super::{Capture, SparsePoint, View, refuse};
use crate::camera::Camera;
use crate::fsutil::write_atomic;
use crate::pose::to_wxyz;
use crate::{Error, Result};

/// COLMAP's "no point".
const NO_POINT: u64 = u64::MAX;

impl Capture {
    /// Writes the capture as a COLMAP model: `cameras.bin`, `images.bin` and `points3D.bin` in `folder`, each replaced as a
    /// whole. [`Capture::load`] reads the same views and points from it, COLMAP 3.x and 4.x too.
    ///
    /// Views of equal lenses share a camera, its id counted from 1; ids of images count from 1 in the order of names, ids of
    /// points from 1 in their own order. Tracks are what the keypoints say. The same capture makes the same bytes.
    /// `rigs.bin` and `frames.bin` of another model, which newer versions of COLMAP would believe, are removed.
    ///
    /// # Errors
    /// If there is no view, two views have one name, a number is not finite, a keypoint names a point that is not there, or
    /// the files cannot be written.
    pub fn write_colmap(&self, folder: &Path) -> Result<()> {
        let views = by_name(&self.views)?;
        let (lenses, lens_of) = distinct_lenses(&views);
        let files = [
            ("points3D.bin", points_bytes(&self.points, &tracks(&views, self.points.len())?)?),
            ("images.bin", images_bytes(&views, &lens_of)?),
            ("cameras.bin", cameras_bytes(&lenses)),
        ];
        for name in ["rigs.bin", "frames.bin"] {
            let path = folder.join(name);
            match std::fs::remove_file(&path) {
                Err(e) if path.exists() => return Err(Error::io("remove", path, e)),
                _ => (),
            }
        }
        files.iter().try_for_each(|(name, bytes)| write_atomic(&folder.join(name), bytes))
    }
}

/// The views sorted by name, which no two share.
fn by_name(views: &[View]) -> Result<Vec<&View>> {
    let mut views: Vec<_> = views.iter().collect();
    views.sort_by(|a, b| a.name.cmp(&b.name));
    if views.is_empty() {
        return refuse("the capture has no view", "write one whose photos have cameras");
    }
    if let Some(pair) = views.windows(2).find(|pair| pair[0].name == pair[1].name) {
        return refuse(format!("two cameras are of the same photo, {}", pair[0].name), "keep one of them");
    }
    match views.iter().find(|v| v.name.is_empty() || v.name.contains('\0')) {
        Some(view) => refuse(format!("{:?} is no name of a photo in a COLMAP model", view.name), "rename it"),
        None => Ok(views),
    }
}

/// The lenses that differ, in the order of the first view of each, and which of them each view has.
fn distinct_lenses<'a>(views: &[&'a View]) -> (Vec<&'a Camera>, Vec<usize>) {
    let mut lenses: Vec<&Camera> = Vec::new();
    let index = |view: &&'a View| {
        lenses.iter().position(|lens| **lens == view.lens).unwrap_or_else(|| {
            lenses.push(&view.lens);
            lenses.len() - 1
        })
    };
    let lens_of = views.iter().map(index).collect();
    (lenses, lens_of)
}

/// The image id and the index of the keypoint of each sighting, point by point.
fn tracks(views: &[&View], points: usize) -> Result<Vec<Vec<(u32, u32)>>> {
    let mut tracks = vec![Vec::new(); points];
    for (i, view) in views.iter().enumerate() {
        for (k, keypoint) in view.keypoints.iter().enumerate() {
            let Some(point) = keypoint.point else { continue };
            let Some(track) = tracks.get_mut(point) else {
                let what = format!("keypoint {k} of {} sees point {point} of {points}", view.name);
                return refuse(what, "give the index of a point of the capture");
            };
            track.push((i as u32 + 1, k as u32));
        }
    }
    Ok(tracks)
}

fn cameras_bytes(lenses: &[&Camera]) -> Vec<u8> {
    let mut out = Bytes::default();
    out.u64(lenses.len() as u64);
    for (i, lens) in lenses.iter().enumerate() {
        out.u32(i as u32 + 1).u32(lens.model() as u32);
        out.u64(u64::from(lens.width_px())).u64(u64::from(lens.height_px())).numbers(lens.params());
    }
    out.0
}

fn images_bytes(views: &[&View], lens_of: &[usize]) -> Result<Vec<u8>> {
    let mut out = Bytes::default();
    out.u64(views.len() as u64);
    for (i, (view, lens)) in views.iter().zip(lens_of).enumerate() {
        let (translation, wxyz) = to_wxyz(&view.camera_from_world);
        let keypoints = view.keypoints.iter().flat_map(|k| [k.x, k.y]);
        if translation.into_iter().chain(wxyz).chain(keypoints).any(|v| !v.is_finite()) {
            let what = format!("the pose or a keypoint of {} is not finite", view.name);
            return refuse(what, "leave the view out");
        }
        out.u32(i as u32 + 1).numbers(&wxyz).numbers(&translation).u32(*lens as u32 + 1);
        out.0.extend(view.name.as_bytes());
        out.0.push(0);
        out.u64(view.keypoints.len() as u64);
        for keypoint in &view.keypoints {
            out.numbers(&[keypoint.x, keypoint.y]).u64(keypoint.point.map_or(NO_POINT, |p| p as u64 + 1));
        }
    }
    Ok(out.0)
}

fn points_bytes(points: &[SparsePoint], tracks: &[Vec<(u32, u32)>]) -> Result<Vec<u8>> {
    let mut out = Bytes::default();
    out.u64(points.len() as u64);
    for (i, (point, track)) in points.iter().zip(tracks).enumerate() {
        if point.position.iter().chain([&point.error_px]).any(|v| !v.is_finite()) {
            return refuse(format!("point {i} has a number that is not finite"), "leave the point out");
        }
        out.u64(i as u64 + 1).numbers(&point.position);
        out.0.extend(point.rgb);
        out.numbers(&[point.error_px]).u64(track.len() as u64);
        for (image, keypoint) in track {
            out.u32(*image).u32(*keypoint);
        }
    }
    Ok(out.0)
}

/// Little-endian bytes.
#[derive(Default)]
struct Bytes(Vec<u8>);

impl Bytes {
    fn u32(&mut self, value: u32) -> &mut Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn u64(&mut self, value: u64) -> &mut Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn numbers(&mut self, values: &[f64]) -> &mut Self {
        self.0.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        self
    }
}
