//! How large a scan is: photos alone do not tell.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use drex_core::capture::Capture;
use drex_mesh::{ScaleFit, read_marks, scale_from_distances, triangulate_marks};
use drex_sfm::MarkerReport;
use nalgebra::Point3;

use crate::Result;
use crate::error::refuse;
use crate::place::FrameOptions;

/// Where the scale of a scan is from, if its depth maps have it.
pub(crate) const DEPTH_CAMERA: &str = "depth camera";

/// How large a scan is.
#[derive(Clone)]
pub(crate) struct Scale {
    pub(crate) metres_per_unit: f64,
    pub(crate) from: &'static str,
    pub(crate) distances: Option<ScaleFit>,
    pub(crate) marker: Option<MarkerReport>,
    /// Places of the marks in the scan's frame, where known distances asked for them.
    pub(crate) marks: BTreeMap<String, Point3<f64>>,
}

impl Scale {
    fn of(metres_per_unit: f64, from: &'static str) -> Self {
        Self { metres_per_unit, from, distances: None, marker: None, marks: BTreeMap::new() }
    }

    /// From a printed tag in the photos.
    pub(crate) fn by_marker(marker: MarkerReport) -> Self {
        let metres_per_unit = marker.metres_per_unit;
        Self { marker: Some(marker), ..Self::of(metres_per_unit, "marker") }
    }

    /// From a number, known distances between marks, or a depth camera. Needs no depth map of photos, so that a scan that
    /// cannot be metric is refused before hours go into it.
    pub(crate) fn new(cameras: &Capture, options: &FrameOptions) -> Result<Self> {
        if let Some(metres_per_unit) = options.scale {
            return Ok(Self::of(metres_per_unit, "given"));
        }
        if !options.distances.is_empty() {
            let marks = marks_of(cameras, options)?;
            let fit = scale_from_distances(&marks, &options.distances)?;
            let metres_per_unit = fit.metres_per_unit;
            return Ok(Self { distances: Some(fit), marks, ..Self::of(metres_per_unit, "known distances") });
        }
        let measured = |path: &Path| path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
        if cameras.views.iter().all(|v| v.depth.as_deref().is_some_and(measured)) {
            return Ok(Self::of(1.0, DEPTH_CAMERA));
        }
        no_scale(&cameras.folder)
    }

    /// Refuses photos without cameras for which nothing gives a scale, before their cameras are found.
    pub(crate) fn check(photos: &Path, options: &FrameOptions) -> Result<()> {
        if options.scale.is_some() || !photos.exists() {
            return Ok(());
        }
        if options.distances.is_empty() {
            return no_scale(photos);
        }
        if photos.is_dir() {
            let marks = read_marks(&options.marks.clone().unwrap_or_else(|| photos.join("marks.json")))?;
            // Any places that differ tell whether every mark has a name that is known.
            let names = marks.values().flat_map(BTreeMap::keys).collect::<BTreeSet<_>>().into_iter().enumerate();
            let places = names.map(|(k, name)| (name.clone(), Point3::new(k as f64, 0.0, 0.0))).collect();
            scale_from_distances(&places, &options.distances)?;
        }
        Ok(())
    }
}

fn no_scale<T>(scan: &Path) -> Result<T> {
    refuse!(
        "{} has no scale: photos alone do not tell how large things are; lay a printed tag beside the object and give \
         --marker tag36h11:ID:SIDE_M, or measure the distance of two marks and give --distance A-C=0.12 with the marks' \
         pixels in marks.json, or give --scale in metres per unit",
        scan.display()
    )
}

/// Places of the marks in the scan's frame.
fn marks_of(cameras: &Capture, options: &FrameOptions) -> Result<BTreeMap<String, Point3<f64>>> {
    let file = options.marks.clone().unwrap_or_else(|| cameras.folder.join("marks.json"));
    let marks = read_marks(&file)?;
    let view = |name: &str| cameras.views.iter().find(|v| v.name == name);
    let found = triangulate_marks(&marks, |name| view(name).map(|v| (&v.lens, v.camera_from_world.inverse())))?;
    Ok(found.into_iter().map(|(name, t)| (name, t.point)).collect())
}
