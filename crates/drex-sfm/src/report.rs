//! What happened to each photo, and what of the models to trust.

use std::collections::BTreeMap;

use drex_core::capture::{Capture, Keypoint, SparsePoint, View};
use drex_core::stats::upper_median;
use serde::Serialize;

use crate::cameras::FocalSource;
use crate::front_end::{FrontEnd, InputPhoto};
use crate::refine::Refined;
use crate::verdict::{Verdict, list};
use crate::verify::{Geometry, Pair};

/// The report of a registration; `report.json` of `drex sfm`.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Report {
    /// One per photo that was given, in their order.
    pub photos: Vec<PhotoReport>,
    /// One per model, the one with the most photos first.
    pub models: Vec<ModelReport>,
    /// Share of the keypoints that belong to a background which stands still while the object turns; absent where the photos show none. Poses
    /// are then relative to what turns.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub still_background: Option<f64>,
    /// Pairs of photos that match and contradict the others: look-alike views.
    pub contradicting_pairs: usize,
    /// What was odd, in sentences.
    pub notes: Vec<String>,
}

/// What became of a photo.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct PhotoReport {
    /// Its name.
    pub name: String,
    /// Index of its model; absent for a photo that was left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<usize>,
    /// Why it was left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why_not: Option<String>,
    /// Keypoints that were used (of those that the mask shows).
    pub keypoints: usize,
    /// Points of the model that it sees.
    pub points: usize,
    /// Median reprojection error of these, pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub median_error_px: Option<f64>,
    /// Formal standard deviation of its rotation, degrees, each axis: what the noise of the pixels makes of it. A lens that is told badly adds to
    /// all photos alike.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_sd_deg: Option<f64>,
    /// Formal standard deviation of its place, units of the model, each axis.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub centre_sd: Option<f64>,
}

/// What of a model to trust.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ModelReport {
    /// Photos with a pose.
    pub photos: usize,
    /// Points.
    pub points: usize,
    /// Photos that see a point, mean.
    pub mean_track: f64,
    /// Median reprojection error, pixels.
    pub median_error_px: f64,
    /// Share of the observations that were placed by aligning patches, and the standard deviation of one axis of these and of the others, pixels.
    pub aligned: f64,
    /// See [`ModelReport::aligned`].
    pub aligned_sd_px: f64,
    /// See [`ModelReport::aligned`].
    pub detected_sd_px: f64,
    /// Its lenses.
    pub lenses: Vec<LensReport>,
}

/// What was expected of a lens and what was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct LensReport {
    /// Image size, pixels.
    pub size_px: [u32; 2],
    /// Where the first focal length is from.
    pub focal_from: FocalSource,
    /// The first focal length, pixels.
    pub focal_prior_px: f64,
    /// The focal length that the photos agree on, pixels.
    pub focal_px: f64,
    /// COLMAP's name of the lens model.
    pub model: String,
    /// Its parameters in COLMAP's order.
    pub params: Vec<f64>,
}

impl Report {
    pub(crate) fn new(photos: &[InputPhoto], unreadable: &[(String, String)]) -> Self {
        let why: BTreeMap<&str, &str> = unreadable.iter().map(|(n, w)| (n.as_str(), w.as_str())).collect();
        let photo = |p: &InputPhoto| PhotoReport {
            name: p.name.clone(),
            model: None,
            why_not: why.get(p.name.as_str()).map(|w| format!("it cannot be read: {w}")),
            keypoints: 0,
            points: 0,
            median_error_px: None,
            rotation_sd_deg: None,
            centre_sd: None,
        };
        Self {
            photos: photos.iter().map(photo).collect(),
            models: Vec::new(),
            still_background: None,
            contradicting_pairs: 0,
            notes: Vec::new(),
        }
    }

    /// Enters a model and its photos.
    pub(crate) fn add_model(&mut self, index: usize, refined: &Refined, front: &FrontEnd) {
        let model = &refined.model;
        let mut errors: Vec<Vec<f64>> = vec![Vec::new(); model.views.len()];
        for p in &model.points {
            for o in &p.observations {
                let error = model.project(o.view, &p.position).map_or(f64::INFINITY, |q| (q - o.pixel).norm());
                errors[o.view].push(error);
            }
        }
        let observations: usize = errors.iter().map(Vec::len).sum();
        for (k, view) in model.views.iter().enumerate() {
            let name = &front.photos[view.photo].name;
            let Some(entry) = self.photos.iter_mut().find(|p| p.name == *name) else { continue };
            entry.model = Some(index);
            entry.points = errors[k].len();
            entry.median_error_px = upper_median(errors[k].iter().copied());
            entry.rotation_sd_deg = refined.sigmas.as_ref().map(|s| s[k].rotation_rad.to_degrees());
            entry.centre_sd = refined.sigmas.as_ref().map(|s| s[k].centre);
        }
        for (photo, why) in &refined.removed {
            let name = &front.photos[*photo].name;
            if let Some(entry) = self.photos.iter_mut().find(|p| p.name == *name) {
                entry.why_not = Some(why.clone());
            }
        }
        let lens = |(k, lens): (usize, &crate::model::Lens)| {
            let of = model.views.iter().find(|v| v.lens == k).map_or(0, |v| front.camera_of[v.photo]);
            let (group, camera) = (&front.groups[of], lens.to_camera().ok());
            LensReport {
                size_px: [lens.width, lens.height],
                focal_from: group.source,
                focal_prior_px: group.focal_px,
                focal_px: lens.numbers[0],
                model: camera.as_ref().map_or(String::new(), |c| c.model().name().to_owned()),
                params: camera.map_or(Vec::new(), |c| c.params().to_vec()),
            }
        };
        self.models.push(ModelReport {
            photos: model.views.len(),
            points: model.points.len(),
            mean_track: observations as f64 / model.points.len().max(1) as f64,
            median_error_px: upper_median(errors.iter().flatten().copied()).unwrap_or(0.0),
            aligned: refined.aligned,
            aligned_sd_px: refined.adjusted.sigmas_px[1],
            detected_sd_px: refined.adjusted.sigmas_px[0],
            lenses: model.lenses.iter().enumerate().map(lens).collect(),
        });
    }

    /// Says of each photo that was left out why, and what else is worth a sentence.
    pub(crate) fn finish(&mut self, front: &FrontEnd, pairs: &[Pair], refused: Vec<Verdict>) {
        let mut partners = vec![0usize; front.photos.len()];
        let mut turned = vec![0usize; front.photos.len()];
        for pair in pairs {
            let of = if matches!(pair.geometry, Geometry::Turn { .. }) { &mut turned } else { &mut partners };
            pair.views.iter().for_each(|&v| of[v] += 1);
        }
        for (k, photo) in front.photos.iter().enumerate() {
            let Some(entry) = self.photos.iter_mut().find(|p| p.name == photo.name) else { continue };
            entry.keypoints = front.features[k].keypoints.len();
            if entry.model.is_some() || entry.why_not.is_some() {
                continue;
            }
            entry.why_not = Some(if front.features[k].blurred {
                "it is blurred".into()
            } else if entry.keypoints < 60 {
                format!("it has only {} points to recognise", entry.keypoints)
            } else if partners[k] + turned[k] == 0 {
                "it shows nothing that another photo shows".into()
            } else if partners[k] == 0 {
                "it was taken from the same place as another photo".into()
            } else {
                format!(
                    "it matches {} other photos, but too few of the model's points, or contradicts them",
                    partners[k]
                )
            });
        }
        if self.models.len() > 1 {
            let sizes: Vec<String> = self.models.iter().map(|m| m.photos.to_string()).collect();
            self.notes.push(format!("The photos show {} scenes, of {} photos.", sizes.len(), sizes.join(", ")));
        }
        if let Some(share) = self.still_background {
            self.notes.push(format!(
                "The camera stood still and the object turned: {:.0} % of the points belong to a background that stands still and were left \
                 out; poses are relative to what turns.",
                100.0 * share
            ));
        }
        if self.contradicting_pairs > 0 {
            self.notes.push(format!(
                "{} pairs of photos look alike and contradict the others; they were left out.",
                self.contradicting_pairs
            ));
        }
        let left: Vec<&str> = self.photos.iter().filter(|p| p.model.is_none()).map(|p| p.name.as_str()).collect();
        if !left.is_empty() {
            self.notes.push(format!("Left out: {}.", list(&left)));
        }
        self.notes.extend(refused.into_iter().map(|v| format!("A part of the photos has no cameras: {v}.")));
    }
}

impl Refined {
    /// The model as a capture.
    pub(crate) fn capture(&self, front: &FrontEnd) -> Capture {
        let model = &self.model;
        let mut order: Vec<usize> = (0..model.views.len()).collect();
        order.sort_by_key(|&k| &front.photos[model.views[k].photo].name);
        let mut place = vec![0; order.len()];
        order.iter().enumerate().for_each(|(at, &k)| place[k] = at);
        let mut views: Vec<View> = Vec::with_capacity(order.len());
        for &k in &order {
            let (view, photo) = (&model.views[k], &front.photos[model.views[k].photo]);
            let Ok(lens) = model.lenses[view.lens].to_camera() else { continue };
            let keypoint = |p: &openmvg_sfm::Keypoint| Keypoint {
                x: f64::from(p.x()) + 0.5,
                y: f64::from(p.y()) + 0.5,
                point: None,
            };
            views.push(View {
                name: photo.name.clone(),
                photo: photo.path.clone(),
                mask: photo.mask.clone(),
                depth: None,
                confidence: None,
                normal: None,
                lens,
                camera_from_world: view.camera_from_world,
                keypoints: front.features[view.photo].keypoints.iter().map(keypoint).collect(),
            });
        }
        let mut points = Vec::with_capacity(model.points.len());
        for (index, p) in model.points.iter().enumerate() {
            let error = |o: &crate::model::Observation| {
                model.project(o.view, &p.position).map_or(0.0, |q| (q - o.pixel).norm())
            };
            let error_px = p.observations.iter().map(error).sum::<f64>() / p.observations.len().max(1) as f64;
            let mut track: Vec<(usize, usize)> = p.observations.iter().map(|o| (place[o.view], o.keypoint)).collect();
            track.sort_unstable();
            for o in &p.observations {
                if let Some(keypoint) = views.get_mut(place[o.view]).and_then(|v| v.keypoints.get_mut(o.keypoint)) {
                    *keypoint = Keypoint { x: o.pixel.x + 0.5, y: o.pixel.y + 0.5, point: Some(index) };
                }
            }
            points.push(SparsePoint { position: p.position.coords.into(), rgb: p.rgb, error_px, track });
        }
        let folder = front.photos.first().map_or_else(Default::default, root_of);
        Capture { folder, views, points, unregistered: Vec::new(), notes: Vec::new() }
    }
}

/// The folder that a photo's name starts from.
fn root_of(photo: &InputPhoto) -> std::path::PathBuf {
    let depth = std::path::Path::new(&photo.name).components().count();
    photo.path.ancestors().nth(depth).map_or_else(Default::default, Into::into)
}
