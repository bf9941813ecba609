//! Photos that the engine left out, or placed by few points: placed again by all points that any of their matches lead to.

use std::collections::BTreeMap;

use drex_core::Pose;
use nalgebra::{Point2, Translation3, UnitQuaternion};
use openmvg_core::AngularThreshold;
use openmvg_geometry::pose::{AbsolutePoseOptions, BearingToPoint, estimate_absolute_pose_guided};
use openmvg_geometry::robust::{RobustGuidance, RobustOptions};
use openmvg_sfm::RunSeed;
use rayon::prelude::*;

use crate::features::Features;
use crate::matching::PairMatches;
use crate::model::{Model, Observation, View};

/// A photo that the engine placed by fewer points is placed again.
const WEAK_POINTS: usize = 60;
/// Points on which a pose has to stand, and their share of the matches that lead to points.
const LEAST_POINTS: usize = 15;
const LEAST_SHARE: f64 = 0.3;
/// A point's image may be this far from its keypoint, pixels.
const WITHIN_PX: f64 = 3.0;

/// What is known of the photos that may be placed.
pub(crate) struct Relocation<'a> {
    pub(crate) features: &'a [Features],
    pub(crate) matches: &'a [PairMatches],
    /// Photos without a model, sorted.
    pub(crate) left: &'a [usize],
    /// The lens of the model that a photo has, if any photo of the model shares its camera.
    pub(crate) lens_of: &'a (dyn Fn(usize) -> Option<usize> + Sync),
    pub(crate) seed: u64,
}

/// Places weak and missing photos, round by round, until no more can be; returns the photos that were taken out of the model because
/// their points contradict each other. Two views are never left.
pub(crate) fn relocate(model: &mut Model, with: &Relocation<'_>) -> Vec<usize> {
    let mut removed = Vec::new();
    let weak: Vec<usize> = model
        .counts()
        .iter()
        .enumerate()
        .filter(|(_, n)| **n < WEAK_POINTS)
        .map(|(view, _)| model.views[view].photo)
        .collect();
    for photo in weak {
        if model.views.len() <= 3 {
            break;
        }
        let lens = (with.lens_of)(photo);
        model.remove(photo);
        match lens.and_then(|lens| place(model, photo, lens, with)) {
            Some(found) => model.insert(found),
            None => removed.push(photo),
        }
    }
    let mut left: Vec<usize> = with.left.iter().chain(&removed).copied().collect();
    left.sort_unstable();
    loop {
        let frozen = &*model;
        let try_one = |&photo: &usize| place(frozen, photo, (with.lens_of)(photo)?, with);
        let found: Vec<Placed> = left.par_iter().filter_map(try_one).collect();
        if found.is_empty() {
            break;
        }
        for placed in found {
            left.retain(|p| *p != placed.view.photo);
            model.insert(placed);
        }
    }
    removed.retain(|p| left.binary_search(p).is_ok());
    removed
}

/// A view with the points that it sees.
pub(crate) struct Placed {
    pub(crate) view: View,
    /// Index of a point, keypoint, pixel.
    pub(crate) sightings: Vec<(usize, usize, Point2<f64>)>,
}

fn place(model: &Model, photo: usize, lens: usize, with: &Relocation<'_>) -> Option<Placed> {
    let mut point_of = BTreeMap::new();
    for (index, p) in model.points.iter().enumerate() {
        for o in &p.observations {
            point_of.insert((model.views[o.view].photo, o.keypoint), index);
        }
    }
    // Keypoint to point, with the number of photos that say so.
    let mut votes = BTreeMap::<(usize, usize), usize>::new();
    for pair in with.matches {
        let Some(at) = pair.views.iter().position(|v| *v == photo) else { continue };
        let other = pair.views[1 - at];
        for m in &pair.matches {
            let (own, its) = (m.keypoints()[at], m.keypoints()[1 - at]);
            if let Some(&point) = point_of.get(&(other, its)) {
                *votes.entry((own, point)).or_default() += 1;
            }
        }
    }
    let mut best = BTreeMap::<usize, (usize, usize)>::new();
    for ((keypoint, point), n) in votes {
        let entry = best.entry(keypoint).or_insert((point, n));
        if n > entry.1 {
            *entry = (point, n);
        }
    }
    let mut candidates: Vec<(usize, usize, usize)> = best.into_iter().map(|(k, (p, n))| (n, k, p)).collect();
    candidates.sort_by_key(|&(n, k, p)| (std::cmp::Reverse(n), k, p));
    let camera = model.lenses[lens].engine_camera()?;
    let mut data = Vec::with_capacity(candidates.len());
    let mut used = Vec::with_capacity(candidates.len());
    for &(_, keypoint, point) in &candidates {
        let k = &with.features[photo].keypoints[keypoint];
        let pixel = Point2::new(f64::from(k.x()), f64::from(k.y()));
        let Ok(bearing) = camera.bearing(&pixel) else { continue };
        let Ok(one) = BearingToPoint::try_new(model.points[point].position, bearing) else { continue };
        data.push(one);
        used.push((point, keypoint, pixel));
    }
    if data.len() < LEAST_POINTS {
        return None;
    }
    let seed = RunSeed::from_u64(with.seed).derive("drex-sfm/relocate", &[photo as u64]);
    let options = AbsolutePoseOptions::default().with_robust_options(RobustOptions::default().with_seed(seed));
    let within = AngularThreshold::try_new(WITHIN_PX / model.lenses[lens].numbers[0]).ok()?;
    let order: Vec<usize> = (0..data.len()).collect();
    let found = estimate_absolute_pose_guided(&data, within, &options, RobustGuidance::ranked(&order)).ok()?;
    let inliers = found.inliers().to_vec();
    if inliers.len() < LEAST_POINTS || (inliers.len() as f64) < LEAST_SHARE * data.len() as f64 {
        return None;
    }
    let pose = found.into_model();
    let rotation = UnitQuaternion::from_rotation_matrix(pose.rotation());
    let camera_from_world = Pose::from_parts(Translation3::from(pose.translation()), rotation);
    let view = View { photo, camera_from_world, lens };
    // A point is seen once.
    let mut sightings: Vec<(usize, usize, Point2<f64>)> = inliers.into_iter().map(|k| used[k]).collect();
    sightings.sort_by_key(|s| s.0);
    sightings.dedup_by_key(|s| s.0);
    Some(Placed { view, sightings })
}

impl Model {
    /// Points that each view sees.
    pub(crate) fn counts(&self) -> Vec<usize> {
        let mut counts = vec![0; self.views.len()];
        self.points.iter().flat_map(|p| &p.observations).for_each(|o| counts[o.view] += 1);
        counts
    }

    /// Takes a photo out, with what is then seen by one photo alone.
    pub(crate) fn remove(&mut self, photo: usize) {
        let Some(gone) = self.views.iter().position(|v| v.photo == photo) else { return };
        self.views.remove(gone);
        for point in &mut self.points {
            point.observations.retain(|o| o.view != gone);
            point.observations.iter_mut().filter(|o| o.view > gone).for_each(|o| o.view -= 1);
        }
        self.points.retain(|p| p.observations.len() >= 2);
    }

    /// Adds a photo.
    fn insert(&mut self, placed: Placed) {
        let view = self.views.len();
        for (point, keypoint, pixel) in placed.sightings {
            self.points[point].observations.push(Observation { view, keypoint, pixel, aligned: false });
        }
        self.views.push(placed.view);
    }
}
