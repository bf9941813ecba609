//! Which photos share a camera, and how long its focal length is before any photo has a pose.

use drex_core::stats::upper_median;
use nalgebra::Point2;
use openmvg_core::camera::{RadialDistortion, TangentialDistortion};
use openmvg_core::{NormalizedImageThreshold, PixelThreshold};
use openmvg_geometry::correspondence::{BearingCorrespondence, PixelCorrespondence};
use openmvg_geometry::essential::estimate_essential;
use openmvg_geometry::fundamental::estimate_fundamental;
use openmvg_geometry::robust::RobustOptions;
use openmvg_sfm::{Camera, RunSeed};
use rayon::prelude::*;

use drex_core::camera::Camera as Calibration;

use crate::features::Features;
use crate::matching::{Match, PairMatches};
use crate::model::Lens;
use crate::photos::Header;
use crate::verdict::{Cause, Verdict};

/// Focal length in units of the longer side where nothing says more: between a phone's main lens (0.75) and a normal one (1.4).
const BLIND_GUESS: f64 = 1.0;
/// Focal lengths that are tried, in units of the longer side, each 1.12 times the one before.
const SHORTEST: f64 = 0.5;
const LONGEST: f64 = 3.07;
const STEPS: usize = 17;
/// Pairs that vote, at most and at least, at most of one photo, and the matches that one needs, before and after a fundamental matrix.
const MOST_VOTERS: usize = 80;
const LEAST_VOTERS: usize = 3;
const MOST_PER_PHOTO: usize = 6;
const LEAST_MATCHES: usize = 50;
const LEAST_AGREEING: usize = 35;
/// How far the best focal length stands out from the median one, in shares of matches. Turntables, which say nothing, have less.
const LEAST_CONTRAST: f64 = 0.004;

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

/// The focal length, in units of the longer side, that makes most matches of many pairs of one camera agree.
///
/// For each pair the matches on one fundamental matrix are kept; for each candidate the share of them that an essential matrix explains
/// to a pixel is averaged over the pairs, and the top of a parabola through the best three is taken. That is far more robust than the
/// singular values of the fundamental matrices (Hartley and Zisserman, section 9.6.1), of which a single one is often degenerate.
/// Cameras that look at one point from one distance say nothing: `None` where the curve has no clear inner maximum.
/// `groups` are the sizes of the photos, `pairs` those that vote.
pub(crate) fn vote(groups: &Voters<'_>, pairs: &[&PairMatches], seed: u64) -> Option<f64> {
    let mut voters: Vec<&PairMatches> = pairs.iter().copied().filter(|p| p.matches.len() >= LEAST_MATCHES).collect();
    voters.sort_by_key(|p| (std::cmp::Reverse(p.matches.len()), p.views));
    // Spread over the photos: the best pairs of a set are often of a few photos.
    let mut uses = vec![0usize; groups.photos.len()];
    voters.retain(|p| {
        let fresh = p.views.iter().any(|v| uses[*v] < MOST_PER_PHOTO);
        p.views.iter().filter(|_| fresh).for_each(|v| uses[*v] += 1);
        fresh
    });
    voters.truncate(MOST_VOTERS);
    let ratio = (LONGEST / SHORTEST).powf(1.0 / (STEPS - 1) as f64);
    let candidates: Vec<f64> = (0..STEPS).map(|k| SHORTEST * ratio.powi(k as i32)).collect();
    let curve = |pair: &&PairMatches| -> Option<Vec<f64>> {
        let agreeing = groups.agreeing(pair, seed)?;
        Some(candidates.iter().map(|c| groups.share(pair, &agreeing, *c, seed)).collect())
    };
    let curves: Vec<Vec<f64>> = voters.par_iter().filter_map(curve).collect();
    if curves.len() < LEAST_VOTERS {
        return None;
    }
    let mean: Vec<f64> = (0..STEPS).map(|k| curves.iter().map(|c| c[k]).sum::<f64>() / curves.len() as f64).collect();
    let best = (0..STEPS).max_by(|&a, &b| mean[a].total_cmp(&mean[b]).then(b.cmp(&a)))?;
    let contrast = mean[best] - upper_median(mean.iter().copied())?;
    if best == 0 || best == STEPS - 1 || contrast < LEAST_CONTRAST {
        return None;
    }
    let (before, after) = (mean[best] - mean[best - 1], mean[best] - mean[best + 1]);
    let offset = 0.5 * (before - after) / (before + after).max(f64::MIN_POSITIVE);
    Some(candidates[best] * ratio.powf(offset))
}

/// Photos of one camera, upright or turned.
pub(crate) struct Voters<'a> {
    pub(crate) photos: &'a [Features],
    pub(crate) headers: &'a [Header],
}

impl Voters<'_> {
    /// A keypoint from the middle of its photo, in units of the longer side.
    fn place(&self, photo: usize, keypoint: usize) -> Point2<f64> {
        let (p, header) = (&self.photos[photo].keypoints[keypoint], &self.headers[photo]);
        let (w, h) = (f64::from(header.width), f64::from(header.height));
        Point2::new(f64::from(p.x()) - 0.5 * w + 0.5, f64::from(p.y()) - 0.5 * h + 0.5) / w.max(h)
    }

    /// Pixels of the pair's photos in units of the longer side.
    fn pixel(&self, pair: &PairMatches) -> f64 {
        let side = |v: &usize| f64::from(self.headers[*v].width.max(self.headers[*v].height));
        1.0 / pair.views.iter().map(side).fold(f64::INFINITY, f64::min)
    }

    /// The matches on one fundamental matrix.
    fn agreeing(&self, pair: &PairMatches, seed: u64) -> Option<Vec<[Point2<f64>; 2]>> {
        // The estimator's own limits are in pixels of a photo of usual size.
        let (scale, [i, j]) = (1.0 / self.pixel(pair), pair.views);
        let places: Vec<[Point2<f64>; 2]> =
            pair.matches.iter().map(Match::keypoints).map(|[a, b]| [self.place(i, a), self.place(j, b)]).collect();
        let data: Vec<_> = places.iter().map(|[a, b]| PixelCorrespondence::new(a * scale, b * scale)).collect();
        let own = RunSeed::from_u64(seed).derive("drex-sfm/focal/fundamental", &[i as u64, j as u64]);
        let options = RobustOptions::default().with_seed(own).with_max_draws(1000);
        let found = estimate_fundamental(&data, PixelThreshold::try_new(3.0).ok()?, &options).ok()?;
        (found.inlier_count() >= LEAST_AGREEING).then(|| found.inliers().iter().map(|&k| places[k]).collect())
    }

    /// The share of these that an essential matrix explains to a pixel at a focal length.
    fn share(&self, pair: &PairMatches, agreeing: &[[Point2<f64>; 2]], focal: f64, seed: u64) -> f64 {
        let ray = |p: &Point2<f64>| nalgebra::Vector3::new(p.x, p.y, focal).normalize();
        let data: Vec<_> =
            agreeing.iter().filter_map(|[a, b]| BearingCorrespondence::try_new(ray(a), ray(b)).ok()).collect();
        let [i, j] = pair.views.map(|v| v as u64);
        let own = RunSeed::from_u64(seed).derive("drex-sfm/focal/essential", &[i, j]);
        let options = RobustOptions::default().with_seed(own).with_max_draws(300);
        let Ok(within) = NormalizedImageThreshold::try_new(self.pixel(pair) / focal) else { return 0.0 };
        estimate_essential(&data, within, &options).map_or(0.0, |f| f.inlier_count() as f64 / data.len() as f64)
    }
}
