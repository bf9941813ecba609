//! What to trust of a capture: errors of the cameras, views that hang in the air, directions never seen, masks that do
//! not fit.

mod coverage;
mod masks;

use std::fmt;

use nalgebra::Point3;
use serde::Serialize;

pub use self::coverage::Coverage;
pub use self::masks::MaskCheck;
use super::assemble::count;
use super::{Capture, View};
use crate::Result;
use crate::stats::upper_median;

/// A view that sees fewer points than this may be anywhere.
const FEW_POINTS: usize = 50;
/// A camera further from the median camera than this many median distances is an outlier.
const FAR: f64 = 5.0;
/// A focal length that differs from the median by this factor is an outlier.
const OTHER_LENS: f64 = 1.25;

/// What to trust of a capture. [`std::fmt::Display`] says it in sentences.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CaptureReport {
    /// One per view, in the capture's order.
    pub views: Vec<ViewReport>,
    /// Photos without a camera.
    pub unregistered: Vec<String>,
    /// Number of sparse points.
    pub points: usize,
    /// Over all sightings of points; `None` where the capture has none.
    pub reprojection: Option<ReprojectionError>,
    /// From where the object was seen; `None` with fewer than two cameras.
    pub coverage: Option<Coverage>,
    /// What was odd when the capture was read.
    pub notes: Vec<String>,
}

/// Distance in the photo between where a point was seen and where the camera says it is, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ReprojectionError {
    /// Mean.
    pub mean_px: f64,
    /// Median.
    pub median_px: f64,
    /// Number of sightings.
    pub sightings: usize,
}

/// What to trust of one view.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ViewReport {
    /// Name of the photo.
    pub name: String,
    /// `None` where the view sees no point.
    pub reprojection: Option<ReprojectionError>,
    /// Distance from the median camera in median distances.
    pub distance: f64,
    /// Focal length by the longest side, over the median of all views.
    pub focal_ratio: f64,
    /// Whether the view has keypoints but rests on too few points to be trusted.
    pub few_points: bool,
    /// Whether the camera stands far from all others.
    pub far: bool,
    /// Whether the focal length is far from the others'.
    pub other_lens: bool,
    /// How well the mask fits the points; `None` without a mask, or without points to tell.
    pub mask: Option<MaskCheck>,
}

impl CaptureReport {
    /// Reads the masks, one at a time.
    pub(super) fn new(capture: &Capture) -> Result<Self> {
        let centres = capture.centres();
        let (_, distances) = distances_from_median(&centres);
        let far = outliers_by_place(&centres);
        let focal = |v: &View| v.lens.focal_px().mean() / f64::from(v.lens.width_px().max(v.lens.height_px()));
        let usual = upper_median(capture.views.iter().map(focal)).unwrap_or(1.0);
        let masks = masks::check(capture)?;
        let errors: Vec<_> = capture.views.iter().map(|v| reprojection_errors(capture, v)).collect();
        let has_points = !capture.points.is_empty() && errors.iter().any(|e| !e.is_empty());
        let views = capture.views.iter().enumerate().map(|(i, view)| {
            let focal_ratio = focal(view) / usual;
            ViewReport {
                name: view.name.clone(),
                reprojection: ReprojectionError::of(errors[i].clone()),
                distance: distances[i],
                focal_ratio,
                few_points: has_points && errors[i].len() < FEW_POINTS,
                far: far[i],
                other_lens: focal_ratio.max(1.0 / focal_ratio) > OTHER_LENS,
                mask: masks.checks[i].clone(),
            }
        });
        let near: Vec<_> = centres.iter().zip(&far).filter(|(_, far)| !**far).map(|(c, _)| *c).collect();
        Ok(Self {
            views: views.collect(),
            unregistered: capture.unregistered.clone(),
            points: capture.points.len(),
            reprojection: ReprojectionError::of(errors.concat()),
            coverage: Coverage::new(capture, &near, masks.object_centre),
            notes: capture.notes.clone(),
        })
    }

    /// Views whose mask does not fit the points.
    pub fn misplaced_masks(&self) -> Vec<&str> {
        self.names(|v| v.mask.as_ref().is_some_and(|m| m.misplaced))
    }

    /// Views whose camera stands far from all others.
    pub fn outlier_cameras(&self) -> Vec<&str> {
        self.names(|v| v.far)
    }

    /// Views whose camera or mask looks wrong, and why, a sentence each.
    pub fn faults(&self) -> Vec<String> {
        self.views.iter().flat_map(Self::problems).collect()
    }

    fn names(&self, wanted: impl Fn(&ViewReport) -> bool) -> Vec<&str> {
        self.views.iter().filter(|v| wanted(v)).map(|v| v.name.as_str()).collect()
    }
}

impl ReprojectionError {
    fn of(errors: Vec<f64>) -> Option<Self> {
        let sightings = errors.len();
        let mean_px = errors.iter().sum::<f64>() / sightings as f64;
        Some(Self { mean_px, median_px: upper_median(errors)?, sightings })
    }
}

fn reprojection_errors(capture: &Capture, view: &View) -> Vec<f64> {
    let error = |k: &super::Keypoint| {
        let point = Point3::from(capture.points.get(k.point?)?.position);
        let pixel = view.lens.project(&(view.camera_from_world * point))?;
        Some((pixel - nalgebra::Point2::new(k.x, k.y)).norm())
    };
    view.keypoints.iter().filter_map(error).collect()
}

/// Which cameras stand so far from the median of all that a mistake is likelier than a view.
pub(super) fn outliers_by_place(centres: &[Point3<f64>]) -> Vec<bool> {
    distances_from_median(centres).1.into_iter().map(|d| d > FAR).collect()
}

/// The median of positions by coordinate, and each one's distance from it in median distances.
fn distances_from_median(positions: &[Point3<f64>]) -> (Point3<f64>, Vec<f64>) {
    let centre = median_point(positions.iter().copied());
    let distances: Vec<_> = positions.iter().map(|p| (p - centre).norm()).collect();
    let usual = upper_median(distances.iter().copied()).filter(|d| *d > 0.0).unwrap_or(1.0);
    (centre, distances.into_iter().map(|d| d / usual).collect())
}

/// The median by coordinate; the origin of nothing.
fn median_point(positions: impl Iterator<Item = Point3<f64>> + Clone) -> Point3<f64> {
    let along = |k: usize| upper_median(positions.clone().map(|p| p[k])).unwrap_or(0.0);
    Point3::new(along(0), along(1), along(2))
}

impl fmt::Display for CaptureReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let files = self.views.len() + self.unregistered.len();
        writeln!(f, "{} of {} have a camera.", self.views.len(), count(files, "photo"))?;
        if !self.unregistered.is_empty() {
            writeln!(f, "Without a camera: {}.", self.unregistered.join(", "))?;
        }
        match &self.reprojection {
            Some(e) => writeln!(
                f,
                "{} are off by {:.2} px in the mean, {:.2} px in the median, over {}.",
                count(self.points, "sparse point"),
                e.mean_px,
                e.median_px,
                count(e.sightings, "sighting")
            )?,
            None => {
                writeln!(f, "{} without sightings: cameras cannot be checked.", count(self.points, "sparse point"))?
            }
        }
        self.worst_views(f)?;
        self.faults().iter().try_for_each(|fault| writeln!(f, "{fault}"))?;
        if let Some(coverage) = &self.coverage {
            writeln!(f, "{coverage}")?;
        }
        self.notes.iter().try_for_each(|note| writeln!(f, "{note}"))
    }
}

impl CaptureReport {
    fn worst_views(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut worst: Vec<_> =
            self.views.iter().filter_map(|v| Some((v.reprojection?.mean_px, v.name.as_str()))).collect();
        worst.sort_by(|a, b| b.0.total_cmp(&a.0));
        let worst: Vec<_> = worst.iter().take(3).map(|(px, name)| format!("{name} {px:.2} px")).collect();
        if worst.is_empty() { Ok(()) } else { writeln!(f, "The largest mean errors: {}.", worst.join(", ")) }
    }

    /// What looks wrong with a view, a sentence each.
    fn problems(view: &ViewReport) -> Vec<String> {
        let (name, mut found) = (&view.name, Vec::new());
        if view.few_points {
            let seen = view.reprojection.map_or(0, |e| e.sightings);
            found.push(format!("{name} rests on {}: its camera may be wrong.", count(seen, "point")));
        }
        if view.far {
            found.push(format!(
                "{name} stands {:.1} times as far out as half of the cameras: likely wrong.",
                view.distance
            ));
        }
        if view.other_lens {
            found.push(format!("{name} has {:.2} times the usual focal length.", view.focal_ratio));
        }
        found.extend(
            view.mask.as_ref().filter(|m| m.misplaced).map(|m| format!("{name}: the mask looks misplaced; {m}.")),
        );
        found
    }
}
