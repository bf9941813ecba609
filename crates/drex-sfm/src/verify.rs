//! Which matches of two photos one rigid scene explains.

use nalgebra::{Matrix3, Point2, Rotation3, Vector3};
use openmvg_core::{AlgorithmRng, NormalizedImageThreshold, PixelThreshold};
use openmvg_geometry::correspondence::{BearingCorrespondence, PixelCorrespondence};
use openmvg_geometry::essential::estimate_essential_guided;
use openmvg_geometry::homography::estimate_homography;
use openmvg_geometry::robust::{RobustGuidance, RobustOptions};
use openmvg_sfm::{Camera, RelativePose, RunSeed};

use crate::features::Features;
use crate::matching::{Match, PairMatches};

/// Distance of a keypoint from its epipolar line, pixels of a photo of 1000 pixels, that noise and an unknown lens may make.
const WITHIN_PX: f64 = 4.0;
/// A pair has at least so many matches on one epipolar geometry, and so large a share of its matches.
const LEAST_INLIERS: usize = 16;
const LEAST_SHARE: f64 = 0.10;
/// A homography that explains this share of what the epipolar geometry does says that the pair shows a plane, or that the camera only turned.
const DOMINANT: f64 = 0.95;

/// What two photos have in common.
#[derive(Debug, Clone)]
pub(crate) struct Pair {
    pub(crate) views: [usize; 2],
    /// Which of the pairs of photos that were matched it is.
    pub(crate) matched: usize,
    /// One flag per match of these.
    pub(crate) inliers: Vec<bool>,
    pub(crate) geometry: Geometry,
}

/// How the cameras of a pair stand to each other.
#[derive(Debug, Clone)]
pub(crate) enum Geometry {
    /// Epipolar geometry with its relative pose.
    Epipolar { essential: Matrix3<f64>, second_from_first: RelativePose },
    /// All common points lie in a plane: the pair is sure, its relative pose is one of two.
    Plane { homography: Matrix3<f64> },
    /// The camera turned about its centre.
    Turn { second_from_first: Rotation3<f64> },
}

impl Pair {
    pub(crate) fn inlier_count(&self) -> usize {
        self.inliers.iter().filter(|i| **i).count()
    }

    /// The rotation between the cameras, where it is sure.
    pub(crate) fn rotation(&self) -> Option<Rotation3<f64>> {
        match &self.geometry {
            Geometry::Epipolar { second_from_first, .. } => Some(*second_from_first.rotation_source_to_target()),
            Geometry::Turn { second_from_first } => Some(*second_from_first),
            Geometry::Plane { .. } => None,
        }
    }
}

/// Checks the pair number `matched`; `None` where too few matches agree.
pub(crate) fn verify(
    matched: usize,
    pair: &PairMatches,
    photos: &[Features],
    cameras: [&Camera; 2],
    seed: u64,
) -> Option<Pair> {
    let [i, j] = pair.views;
    let pixel = |photo: usize, k: usize| {
        let p = &photos[photo].keypoints[k];
        Point2::new(f64::from(p.x()), f64::from(p.y()))
    };
    // Best first, so that good samples are drawn early.
    let mut order: Vec<usize> = (0..pair.matches.len()).collect();
    order.sort_by(|&a, &b| pair.matches[a].distance.total_cmp(&pair.matches[b].distance).then(a.cmp(&b)));
    let mut bearings = Vec::with_capacity(order.len());
    let mut pixels = Vec::with_capacity(order.len());
    let focal = cameras.iter().filter_map(|c| c.focal_lengths()).map(|(fx, _)| fx).fold(f64::INFINITY, f64::min);
    let straight = |bearing: &Vector3<f64>| Point2::new(focal * bearing.x / bearing.z, focal * bearing.y / bearing.z);
    let mut used = Vec::with_capacity(order.len());
    for index in order {
        let m = &pair.matches[index];
        let [first, second] = m.keypoints();
        let first = cameras[0].bearing(&pixel(i, first)).ok()?;
        let second = cameras[1].bearing(&pixel(j, second)).ok()?;
        let Ok(both) = BearingCorrespondence::try_new(first.into_inner(), second.into_inner()) else { continue };
        bearings.push(both);
        pixels.push(PixelCorrespondence::new(straight(&first), straight(&second)));
        used.push(index);
    }
    if bearings.len() < LEAST_INLIERS {
        return None;
    }
    let seed = RunSeed::from_u64(seed).derive("drex-sfm/verify", &[i as u64, j as u64]);
    let within = PixelThreshold::try_new(WITHIN_PX).ok()?;
    let threshold = NormalizedImageThreshold::from_pixels(within, focal).ok()?;
    let best_first: Vec<usize> = (0..bearings.len()).collect();
    let options = RobustOptions::default().with_seed(seed).with_max_draws(2000);
    let found = estimate_essential_guided(&bearings, threshold, &options, RobustGuidance::ranked(&best_first)).ok()?;
    let support = found.inliers();
    if support.len() < LEAST_INLIERS || (support.len() as f64) < LEAST_SHARE * bearings.len() as f64 {
        return None;
    }
    let flags = |of: &[usize]| {
        let mut inliers = vec![false; pair.matches.len()];
        of.iter().for_each(|&k| inliers[used[k]] = true);
        inliers
    };
    let make = |inliers, geometry| Some(Pair { views: pair.views, matched, inliers, geometry });
    let turned = rotation_of(&bearings, support);
    let off = |k: &usize| (turned * bearings[*k].bearing1()).angle(bearings[*k].bearing2());
    let follow = support.iter().filter(|k| off(k) < WITHIN_PX / focal).count();
    if follow as f64 >= DOMINANT * support.len() as f64 {
        return make(flags(support), Geometry::Turn { second_from_first: turned });
    }
    let both_ways = PixelThreshold::try_new(WITHIN_PX * std::f64::consts::SQRT_2).ok()?;
    let few = RobustOptions::default().with_confidence(0.99).with_max_draws(256).with_seed(seed);
    if let Ok(plane) = estimate_homography(&pixels, both_ways, &few)
        && plane.inlier_count() as f64 >= DOMINANT * support.len() as f64
    {
        return make(flags(support), Geometry::Plane { homography: *plane.model().matrix() });
    }
    let agreeing: Vec<BearingCorrespondence> = support.iter().map(|&k| bearings[k]).collect();
    let second_from_first = found.model().decompose_with_cheirality(&agreeing)?;
    make(flags(support), Geometry::Epipolar { essential: *found.model().matrix(), second_from_first })
}

/// The share of a pair's matches that one rotation explains, by the best of 200 rotations from two matches each; `None` for pairs of few
/// matches. A third of the matches of a good pair may be wrong, so a share of 0.7 is next to all.
pub(crate) fn turn_share(pair: &PairMatches, photos: &[Features], cameras: [&Camera; 2]) -> Option<f64> {
    const LEAST_MATCHES: usize = 30;
    let [i, j] = pair.views;
    let bearing = |camera: &Camera, photo: usize, k: usize| {
        let p = &photos[photo].keypoints[k];
        camera.bearing(&Point2::new(f64::from(p.x()), f64::from(p.y()))).ok().map(|b| b.into_inner())
    };
    let both = |m: &Match| {
        let [first, second] = m.keypoints();
        BearingCorrespondence::try_new(bearing(cameras[0], i, first)?, bearing(cameras[1], j, second)?).ok()
    };
    let bearings: Vec<BearingCorrespondence> = pair.matches.iter().filter_map(both).collect();
    if bearings.len() < LEAST_MATCHES {
        return None;
    }
    let focal = cameras.iter().filter_map(|c| c.focal_lengths()).map(|(fx, _)| fx).fold(f64::INFINITY, f64::min);
    let mut random = AlgorithmRng::new(RunSeed::from_u64(0).derive("drex-sfm/turn", &[i as u64, j as u64]));
    let mut most = 0;
    for _ in 0..200 {
        let two = [random.index(bearings.len())?, random.index(bearings.len())?];
        let rotation = rotation_of(&bearings, &two);
        let follows = |b: &&BearingCorrespondence| (rotation * b.bearing1()).angle(b.bearing2()) < WITHIN_PX / focal;
        most = most.max(bearings.iter().filter(follows).count());
    }
    Some(most as f64 / bearings.len() as f64)
}

/// The rotation that takes first bearings nearest to second ones (Kabsch).
fn rotation_of(bearings: &[BearingCorrespondence], support: &[usize]) -> Rotation3<f64> {
    let sum: Matrix3<f64> = support.iter().map(|&k| bearings[k].bearing2() * bearings[k].bearing1().transpose()).sum();
    let svd = sum.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Rotation3::identity() };
    let proper = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    Rotation3::from_matrix_unchecked(u * proper * v_t)
}
