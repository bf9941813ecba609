//! A model in metres, by a printed marker that its photos show.

use drex_core::camera::Camera;
use drex_core::capture::{Capture, View, read_rgb};
use drex_core::{Error, Pose, Result};
use nalgebra::{Point3, Similarity3, Translation3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::marker::{Detection, Marker, MarkerFit, Sighting, detect_all, metric, refine};
use crate::verdict::count;

/// What a marker said about a model; part of `report.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct MarkerReport {
    /// The marker as on the command line.
    pub marker: String,
    /// Photos of the model that show it.
    pub seen_in: usize,
    /// Of these, the ones that agree on its place.
    pub used: usize,
    /// Metres per unit of the model as it was when the marker was found; `drex sfm` writes it in metres.
    pub metres_per_unit: f64,
    /// Standard error of [`MarkerReport::metres_per_unit`], as a share of it.
    pub relative_sigma: f64,
    /// Root of the mean squared distance of a corner from the fitted square's, pixels.
    pub scatter_px: f64,
    /// Largest deviation of edges and diagonals from a square's, as a share.
    pub spread: f64,
    /// A sentence where the fit is doubtful.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning: Option<String>,
}

/// Finds the marker in the photos of a model and puts the model into metres: origin at the marker's centre, z up from its face, x
/// to the right of the upright marker.
///
/// # Errors
/// As [`measure_marker`]; the model stays as it is then.
pub fn scale_by_marker(capture: &mut Capture, marker: &Marker) -> Result<MarkerReport> {
    let (report, metric_from_model) = measure_marker(capture, marker)?;
    transform(capture, &metric_from_model);
    Ok(report)
}

/// Finds the marker in the photos of a model: what it says, and what maps the model to metres, origin at the marker's centre, z
/// up from its face, x to the right of the upright marker.
///
/// # Errors
/// If a photo cannot be read, or the marker gives no scale; see [`metric`].
pub fn measure_marker(capture: &Capture, marker: &Marker) -> Result<(MarkerReport, Similarity3<f64>)> {
    let tags: Vec<PhotoTags> = capture.views.par_iter().map(|v| find_tags(v, marker)).collect::<Result<_>>()?;
    let seen_in = tags.iter().filter(|l| !l.sightings.is_empty()).count();
    let others = tags.iter().flat_map(|l| &l.others);
    let sightings: Vec<Sighting> = tags.iter().flat_map(|l| l.sightings.iter().cloned()).collect();
    let fit = metric(&sightings, marker).map_err(|error| match error {
        Error::Value { what, remedy } if seen_in < LEAST_PHOTOS => {
            Error::value(what + &instead(others.copied()), remedy)
        }
        other => other,
    })?;
    let MarkerFit { metric_from_scene, scale, scale_sigma, rms_px, spread, used, warning, .. } = fit;
    let report = MarkerReport {
        marker: marker.to_string(),
        seen_in,
        used: used.len(),
        metres_per_unit: scale,
        relative_sigma: scale_sigma / scale,
        scatter_px: rms_px,
        spread,
        warning,
    };
    Ok((report, metric_from_scene))
}

/// Photos that have to see the marker; [`metric`] asks for as many.
const LEAST_PHOTOS: usize = 3;

/// Tags in one photo.
struct PhotoTags {
    sightings: Vec<Sighting>,
    /// Ids of tags that were not asked for.
    others: Vec<u32>,
}

fn find_tags(view: &View, marker: &Marker) -> Result<PhotoTags> {
    let ([width, height], rgb) = read_rgb(&view.photo)?;
    let grey: Vec<u8> = rgb.iter().map(crate::photos::luma).collect();
    let mut tags = PhotoTags { sightings: Vec::new(), others: Vec::new() };
    for (id, found) in detect_all(&grey, width, height, marker.family) {
        if id != marker.id {
            tags.others.push(id);
        } else if let Some(Detection { corners }) = refine(&grey, width, height, marker, &found, &view.lens) {
            let (camera, camera_from_world): (Camera, Pose) = (view.lens.clone(), view.camera_from_world);
            tags.sightings.push(Sighting { camera, camera_from_world, corners });
        }
    }
    Ok(tags)
}

/// Which tags the photos show instead; nothing where they show none.
fn instead(others: impl Iterator<Item = u32>) -> String {
    let mut counts = std::collections::BTreeMap::<u32, usize>::new();
    others.for_each(|id| *counts.entry(id).or_default() += 1);
    // A tag that is in one photo only may be a chance pattern.
    let shown: Vec<String> =
        counts.iter().filter(|(_, n)| **n > 1).map(|(id, n)| format!("tag {id} ({})", count(*n, "photo"))).collect();
    if shown.is_empty() { String::new() } else { format!(" (they show {})", shown.join(", ")) }
}

/// Moves the world of a capture: x becomes `new_from_old` x.
fn transform(capture: &mut Capture, new_from_old: &Similarity3<f64>) {
    let turn = new_from_old.isometry.rotation;
    for view in &mut capture.views {
        let centre = new_from_old * Point3::from(view.camera_from_world.inverse().translation.vector);
        let rotation = view.camera_from_world.rotation * turn.inverse();
        view.camera_from_world = Pose::from_parts(Translation3::from(-(rotation * centre.coords)), rotation);
    }
    for point in &mut capture.points {
        point.position = (new_from_old * Point3::from(point.position)).into();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drex_core::camera::CameraModel;
    use drex_core::capture::SparsePoint;
    use nalgebra::{UnitQuaternion, Vector3};

    #[test]
    fn a_moved_world_projects_to_the_same_pixels() {
        let lens = Camera::new(CameraModel::SimplePinhole, 640, 480, &[500.0, 320.0, 240.0]).unwrap();
        let rotation = UnitQuaternion::from_euler_angles(0.3, -0.2, 1.1);
        let view = View {
            name: "a.png".into(),
            photo: "a.png".into(),
            mask: None,
            depth: None,
            confidence: None,
            normal: None,
            lens,
            camera_from_world: Pose::from_parts(Translation3::new(0.1, -0.3, 4.0), rotation),
            keypoints: Vec::new(),
        };
        let point = SparsePoint { position: [0.4, -0.2, 0.3], rgb: [0; 3], error_px: 0.0, track: Vec::new() };
        let mut capture = Capture {
            folder: "x".into(),
            views: vec![view],
            points: vec![point],
            unregistered: Vec::new(),
            notes: Vec::new(),
        };
        let pixel = |c: &Capture| {
            let v = &c.views[0];
            v.lens.project(&(v.camera_from_world * Point3::from(c.points[0].position))).unwrap()
        };
        let before = (pixel(&capture), capture.centres()[0]);
        let axis = UnitQuaternion::from_scaled_axis(Vector3::new(0.2, 0.7, -0.4));
        let to_metres = Similarity3::from_parts(Translation3::new(3.0, -1.0, 0.5), axis, 0.125);
        transform(&mut capture, &to_metres);
        assert!((pixel(&capture) - before.0).norm() < 1e-9);
        assert!((capture.centres()[0] - to_metres * before.1).norm() < 1e-12);
        assert!((Point3::from(capture.points[0].position) - to_metres * Point3::new(0.4, -0.2, 0.3)).norm() < 1e-12);
    }
}
