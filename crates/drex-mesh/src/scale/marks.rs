//! Named marks in photos, and what known distances or a known layout of them say.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Point2, Point3};
use serde::{Deserialize, Serialize};

use drex_core::camera::Camera;
use drex_core::{Pose, fsutil};

use crate::scale::similarity::Similarity;
use crate::scale::triangulate::{Sighting, Triangulated, triangulate};
use crate::{Error, Result};

/// Marks by photo and name, pixels: `{"photo.jpg": {"A": [x, y]}}`, in COLMAP's convention (the centre of the first pixel is
/// (0.5, 0.5)).
pub type Marks = BTreeMap<String, BTreeMap<String, [f64; 2]>>;

/// Reads a file of marks.
///
/// # Errors
/// If it cannot be read or is no such JSON, with line and column, or a coordinate is not finite.
pub fn read_marks(path: &Path) -> Result<Marks> {
    let marks: Marks = fsutil::from_json(path, &fsutil::read_text(path)?)?;
    for (photo, seen) in &marks {
        if let Some((mark, _)) = seen.iter().find(|(_, p)| p.iter().any(|c| !c.is_finite())) {
            return Err(drex_core::Error::content(
                path,
                None,
                format!("mark {mark} in {photo} is not finite"),
                "give its pixel",
            )
            .into());
        }
    }
    Ok(marks)
}

/// Triangulates every mark. `photo` gives the camera and its pose in the model for the name of a photo; photos that
/// the model does not know (`None`) are skipped.
///
/// # Errors
/// If a mark cannot be triangulated; the message names it.
pub fn triangulate_marks<'a>(
    marks: &Marks,
    photo: impl Fn(&str) -> Option<(&'a Camera, Pose)>,
) -> Result<BTreeMap<String, Triangulated>> {
    let mut sightings: BTreeMap<&str, Vec<Sighting<'a>>> = BTreeMap::new();
    for (name, seen) in marks {
        for (mark, &pixel) in seen {
            let of_mark = sightings.entry(mark).or_default();
            if let Some((camera, world_from_camera)) = photo(name) {
                of_mark.push(Sighting { camera, world_from_camera, pixel: Point2::from(pixel) });
            }
        }
    }
    sightings
        .into_iter()
        .map(|(mark, seen)| match triangulate(&seen) {
            Ok(found) => Ok((mark.to_string(), found)),
            Err(Error::Value { what, remedy }) => Err(Error::Value { what: format!("mark {mark}: {what}"), remedy }),
            Err(other) => Err(other),
        })
        .collect()
}

/// A measured distance between two marks.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownDistance {
    /// One mark.
    pub from: String,
    /// The other.
    pub to: String,
    /// Their distance, metres.
    pub distance_m: f64,
}

/// Scale of a model from known distances.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ScaleFit {
    /// Metres per unit of the model.
    pub metres_per_unit: f64,
    /// What each distance is with that scale.
    pub distances: Vec<DistanceResidual>,
}

/// A known distance and what the scaled model says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct DistanceResidual {
    /// One mark.
    pub from: String,
    /// The other.
    pub to: String,
    /// As given, metres.
    pub given_m: f64,
    /// In the scaled model, metres.
    pub model_m: f64,
}

/// The scale that fits known distances between marks best: least squares of s L - D, so s = Σ L D / Σ L². With one
/// distance it is exact; with several, the residuals tell how far they contradict each other.
///
/// # Errors
/// If there is no distance, one is not positive, a mark is unknown, or two marks coincide.
pub fn scale_from_distances(marks: &BTreeMap<String, Point3<f64>>, distances: &[KnownDistance]) -> Result<ScaleFit> {
    if distances.is_empty() {
        return Err(Error::value("no known distance is given", "give two marks and their distance in metres"));
    }
    let place = |name: &str| {
        marks.get(name).ok_or_else(|| {
            let known = marks.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
            Error::value(format!("no mark is called {name:?}"), format!("use one of {known}"))
        })
    };
    let mut lengths = Vec::with_capacity(distances.len());
    for d in distances {
        let length = (place(&d.from)? - place(&d.to)?).norm();
        if !(d.distance_m > 0.0 && d.distance_m.is_finite() && length > 0.0) {
            return Err(Error::value(
                format!("{} to {} is {} m and {length} units of the model", d.from, d.to, d.distance_m),
                "give two different marks and a positive distance",
            ));
        }
        lengths.push(length);
    }
    let ld: f64 = lengths.iter().zip(distances).map(|(l, d)| l * d.distance_m).sum();
    let metres_per_unit = ld / lengths.iter().map(|l| l * l).sum::<f64>();
    let residual = |(d, l): (&KnownDistance, &f64)| DistanceResidual {
        from: d.from.clone(),
        to: d.to.clone(),
        given_m: d.distance_m,
        model_m: l * metres_per_unit,
    };
    Ok(ScaleFit { metres_per_unit, distances: distances.iter().zip(&lengths).map(residual).collect() })
}

/// Scale and frame at once from a sheet whose marks have known places: metric_from_model with the sheet's axes, z up, and
/// the root mean square distance of the marks from their places, metres.
///
/// `layout` gives x and y of each mark on the sheet, metres, x to the right and y away from the reader; marks without a place
/// and places without a mark do not count. Some of `cameras` (positions in the model) must be above the sheet.
///
/// # Errors
/// If fewer than three marks are in both, they lie on a line, or most cameras would be below the sheet (a mirrored layout:
/// y downwards, as in pixels).
pub fn sheet_from_marks(
    marks: &BTreeMap<String, Point3<f64>>,
    layout: &BTreeMap<String, [f64; 2]>,
    cameras: &[Point3<f64>],
) -> Result<(Similarity, f64)> {
    let both = || layout.iter().filter_map(|(name, &[x, y])| Some((marks.get(name)?, Point3::new(x, y, 0.0))));
    let (model, sheet): (Vec<Point3<f64>>, Vec<Point3<f64>>) = both().map(|(m, s)| (*m, s)).unzip();
    let (sheet_from_model, rms_m) = Similarity::between(&model, &sheet)?;
    let below = cameras.iter().filter(|c| sheet_from_model.point(c).z < 0.0).count();
    if 2 * below > cameras.len() {
        return Err(Error::value(
            "the layout of the sheet is mirrored: with it the cameras are below the sheet",
            "give y upwards on the sheet as you read it, not downwards as in an image",
        ));
    }
    Ok((sheet_from_model, rms_m))
}
