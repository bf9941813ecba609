//! Which photos share a camera, and how long its focal length is before any photo has a pose.

use nalgebra::{Matrix3, Point2};
use openmvg_core::PixelThreshold;
use openmvg_core::camera::{RadialDistortion, TangentialDistortion};
use openmvg_geometry::correspondence::PixelCorrespondence;
use openmvg_geometry::fundamental::estimate_fundamental;
use openmvg_geometry::robust::RobustOptions;
use openmvg_sfm::{Camera, RunSeed};
use rayon::prelude::*;

use drex_core::camera::Camera as Calibration;

use crate::features::Features;
use crate::matching::PairMatches;
use crate::model::Lens;
use crate::photos::Header;
use crate::verdict::{Cause, Verdict};

/// Focal length in units of the longer side where nothing says more: between a phone's main lens (0.75) and a normal one (1.4).
const BLIND_GUESS: f64 = 1.0;
/// Focal lengths that are tried, in units of the longer side.
const SHORTEST: f64 = 0.4;
const LONGEST: f64 = 3.0;
const STEPS: usize = 80;
/// Pairs that vote, at most, and matches that one needs.
const MOST_VOTERS: usize = 120;
const LEAST_MATCHES: usize = 60;

/// Where a focal length is from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FocalSource {
    /// A calibration that was given; it is kept.
    Calibration,
    /// The EXIF block of the photos.
    Exif,
    /// The epipolar geometry of many pairs.
    Vote,
    /// Nothing but the size of the photos.
    Guess,
}

/// Photos of one camera.
#[derive(Debug, Clone)]
pub(crate) struct Group {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) focal_px: f64,
    pub(crate) source: FocalSource,
    /// The lens that was given.
    pub(crate) calibration: Option<Lens>,
}

impl Group {
    /// The camera for the engine, whose first pixel has its centre at (0, 0).
    pub(crate) fn camera(&self) -> Result<Camera, String> {
        if let Some(lens) = &self.calibration {
            return lens.engine_camera().ok_or_else(|| "the calibration has no lens that can be used".into());
        }
        let (cx, cy) = (f64::from(self.width) / 2.0 - 0.5, f64::from(self.height) / 2.0 - 0.5);
        let (f, none) = (self.focal_px, TangentialDistortion::None);
        Camera::try_brown_conrady(f, f, cx, cy, RadialDistortion::K1(0.0), none).map_err(|e| e.to_string())
    }
}

/// Groups the photos by what their EXIF blocks say of the device, and by size; the second list has the group of each photo.
pub(crate) fn group(headers: &[Header]) -> (Vec<Group>, Vec<usize>) {
    let mut keys: Vec<(u32, u32, Option<&str>)> = Vec::new();
    let mut groups: Vec<Group> = Vec::new();
    let mut of_photo = Vec::with_capacity(headers.len());
    for header in headers {
        let key = (header.width, header.height, header.device.as_deref());
        let at = keys.iter().position(|k| *k == key).unwrap_or_else(|| {
            let guess = BLIND_GUESS * f64::from(header.width.max(header.height));
            let source = if header.focal_px.is_some() { FocalSource::Exif } else { FocalSource::Guess };
            let focal_px = header.focal_px.unwrap_or(guess);
            groups.push(Group { width: header.width, height: header.height, focal_px, source, calibration: None });
            keys.push(key);
            groups.len() - 1
        });
        of_photo.push(at);
    }
    (groups, of_photo)
}

/// Gives all photos the calibrated camera.
pub(crate) fn calibrate(groups: &mut [Group], calibration: &Calibration) -> Result<(), Verdict> {
    for group in groups {
        let refuse = |what: String| {
            Err(Verdict::new(Cause::Input, what, "give the calibration of these photos, or leave it out"))
        };
        let (w, h) = (f64::from(group.width), f64::from(group.height));
        let (cw, ch) = (f64::from(calibration.width_px()), f64::from(calibration.height_px()));
        if (w / h - cw / ch).abs() > 0.01 * w / h {
            return refuse(format!("the calibration is for {cw} x {ch} pixels, a photo has {w} x {h}"));
        }
        let Some(lens) = calibration.resized(group.width, group.height).ok().as_ref().and_then(Lens::of_camera) else {
            return refuse(format!("the lens model {} cannot be used", calibration.model().name()));
        };
        group.focal_px = lens.numbers[0];
        group.source = FocalSource::Calibration;
        group.calibration = Some(lens);
    }
    Ok(())
}

/// The focal length, pixels, that makes the fundamental matrices of many pairs of one camera essential.
///
/// With principal points in the middle, E = K F K has two equal singular values at the right focal length (Hartley and Zisserman,
/// section 9.6.1); (s1 - s2)/(s1 + s2) is summed over the pairs, each cut off so that no pair counts for more than one. Cameras that
/// look at one point from one distance say nothing each, and their curves are flat. `None` where the sum has no clear minimum.
pub(crate) fn vote(group: &Group, pairs: &[&PairMatches], photos: &[Features], seed: u64) -> Option<f64> {
    const CUT: f64 = 0.2;
    let mut voters: Vec<&PairMatches> = pairs.iter().copied().filter(|p| p.matches.len() >= LEAST_MATCHES).collect();
    voters.sort_by_key(|p| (std::cmp::Reverse(p.matches.len()), p.views));
    voters.truncate(MOST_VOTERS);
    let side = f64::from(group.width.max(group.height));
    let ratio = (LONGEST / SHORTEST).powf(1.0 / (STEPS - 1) as f64);
    let focals: Vec<f64> = (0..STEPS).map(|k| side * SHORTEST * ratio.powi(k as i32)).collect();
    let curve = |pair: &&PairMatches| -> Option<Vec<f64>> {
        let f = fundamental(group, pair, photos, seed)?;
        let cost = |focal: &f64| {
            let k = Matrix3::from_diagonal(&nalgebra::Vector3::new(*focal, *focal, 1.0));
            let s = (k * f * k).singular_values();
            ((s[0] - s[1]) / (s[0] + s[1])).min(CUT) / CUT
        };
        Some(focals.iter().map(cost).collect())
    };
    let curves: Vec<Vec<f64>> = voters.par_iter().filter_map(curve).collect();
    if curves.len() < 3 {
        return None;
    }
    let sum: Vec<f64> = (0..STEPS).map(|k| curves.iter().map(|c| c[k]).sum::<f64>() / curves.len() as f64).collect();
    let best = (0..STEPS).min_by(|&a, &b| sum[a].total_cmp(&sum[b]))?;
    let mut sorted = sum.clone();
    sorted.sort_by(f64::total_cmp);
    let contrast = sorted[STEPS / 2] - sum[best];
    (contrast > 0.15 && best > 0 && best < STEPS - 1).then_some(focals[best])
}

/// The fundamental matrix of a pair in pixels from the middle of the photos.
fn fundamental(group: &Group, pair: &PairMatches, photos: &[Features], seed: u64) -> Option<Matrix3<f64>> {
    let middle = [f64::from(group.width) / 2.0 - 0.5, f64::from(group.height) / 2.0 - 0.5];
    let at = |photo: usize, k: usize| {
        let p = &photos[photo].keypoints[k];
        Point2::new(f64::from(p.x()) - middle[0], f64::from(p.y()) - middle[1])
    };
    let [i, j] = pair.views;
    let data: Vec<_> = pair.matches.iter().map(|m| PixelCorrespondence::new(at(i, m.first), at(j, m.second))).collect();
    let own = RunSeed::from_u64(seed).derive("drex-sfm/focal", &[i as u64, j as u64]);
    let options = RobustOptions::default().with_seed(own).with_max_draws(1000);
    let found = estimate_fundamental(&data, PixelThreshold::try_new(2.0).ok()?, &options).ok()?;
    (found.inlier_count() >= LEAST_MATCHES).then(|| *found.model().matrix())
}
