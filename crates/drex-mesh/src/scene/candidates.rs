//! Planes among the points that could be a support: RANSAC, one after the other.

use drex_core::stats::median;
use nalgebra::{Matrix3, Point3, Unit, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Scene, SupportOptions};

/// Points at which hypotheses are compared; more say nothing new.
const SAMPLE: usize = 5000;
/// Hypotheses for each plane.
const TRIES: usize = 3000;
/// Planes that are sought.
const MOST_PLANES: usize = 14;
/// Points that a plane must have.
const LEAST_POINTS: usize = 12;
/// Pixels of noise that are assumed before a plane has shown its own.
const NOISE_PX: f64 = 1.0;
/// Range in which a plane's own noise is believed, pixels.
const NOISE_RANGE_PX: (f64, f64) = (0.3, 2.5);
/// Standard deviations within which a point belongs to a plane.
const WITHIN: f64 = 3.0;
/// Share of the cameras that must be on one side.
const LEAST_ABOVE: f64 = 0.8;
/// Points further than this from where the cameras look are left out, in distances of the cameras.
const REACH: f64 = 3.0;
/// What a point below a plane costs it, against what one in it gives: no table has much below it where the cameras look.
const COST_BELOW: f64 = 0.3;
/// Radius round the target in which that is asked, in distances of the cameras.
const ROUND: f64 = 0.5;
/// Reach of the weight that makes the neighbourhood of the target count, in distances of the cameras.
const NEAR: f64 = 0.6;

/// A plane through points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane {
    pub point: Point3<f64>,
    pub up: Vector3<f64>,
}

impl Plane {
    pub fn height(&self, p: &Point3<f64>) -> f64 {
        self.up.dot(&(p - self.point))
    }

    /// The same plane with most cameras above it, and the share of them.
    fn turned(mut self, scene: &Scene) -> (Self, f64) {
        let above = scene.views.iter().filter(|v| self.height(&v.centre()) > 0.0).count();
        let n = scene.views.len();
        if 2 * above < n {
            self.up = -self.up;
        }
        (self, above.max(n - above) as f64 / n as f64)
    }

    /// Weighted least squares, and the ratio of the second to the largest spread (0: the points lie on a line).
    fn through(points: impl Iterator<Item = (Point3<f64>, f64)> + Clone) -> Option<(Self, f64)> {
        let total: f64 = points.clone().map(|(_, w)| w).sum();
        if !(total > 0.0) {
            return None;
        }
        let mean = points.clone().map(|(p, w)| p.coords * w).sum::<Vector3<f64>>() / total;
        let spread: Matrix3<f64> = points.map(|(p, w)| (p.coords - mean) * (p.coords - mean).transpose() * w).sum();
        let eigen = spread.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let up = eigen.eigenvectors.column(order[0]).into_owned();
        let flat = (eigen.eigenvalues[order[1]] / eigen.eigenvalues[order[2]].max(f64::MIN_POSITIVE)).max(0.0).sqrt();
        Some((Self { point: mean.into(), up }, flat))
    }
}

/// A plane with the points that belong to it.
#[derive(Debug, Clone)]
pub(super) struct Candidate {
    pub plane: Plane,
    /// Indices of points.
    pub inliers: Vec<usize>,
    /// Robust standard deviation of the points from the plane, in pixels.
    pub noise_px: f64,
}

/// How much a point counts: more where the cameras look.
pub(super) fn nearness(scene: &Scene, p: &Point3<f64>) -> f64 {
    1.0 / (1.0 + ((p - scene.target).norm() / (NEAR * scene.distance)).powi(2))
}

/// Planes with the cameras on one side, those with the most weight of points first.
pub(super) fn candidates(scene: &Scene, options: &SupportOptions) -> Vec<Candidate> {
    let mut left: Vec<usize> = (0..scene.points.len())
        .filter(|&i| (scene.points[i].position - scene.target).norm() < REACH * scene.distance)
        .collect();
    let mut random = ChaCha8Rng::seed_from_u64(options.seed);
    let mut found = Vec::new();
    while found.len() < MOST_PLANES && left.len() >= LEAST_POINTS {
        let Some(plane) = best_of_many(scene, &left, options, &mut random) else { break };
        let Some(candidate) = settle(scene, &left, plane) else { break };
        let taken: std::collections::BTreeSet<usize> = candidate.inliers.iter().copied().collect();
        left.retain(|i| !taken.contains(i));
        if candidate.plane.turned(scene).1 >= LEAST_ABOVE && allowed(&candidate.plane.up, options) {
            found.push(candidate);
        }
    }
    found
}

fn allowed(up: &Vector3<f64>, options: &SupportOptions) -> bool {
    options.up.as_ref().is_none_or(|prior| up.angle(&prior.direction) <= prior.tolerance_rad)
}

/// The hypothesis with the largest weight of points near it (MSAC, Torr and Zisserman 2000).
fn best_of_many(scene: &Scene, left: &[usize], options: &SupportOptions, random: &mut ChaCha8Rng) -> Option<Plane> {
    let step = left.len().div_ceil(SAMPLE).max(1);
    let start = random.random_range(0..step);
    let sample: Vec<usize> = left.iter().copied().skip(start).step_by(step).collect();
    let weights: Vec<f64> = sample.iter().map(|&i| nearness(scene, &scene.points[i].position)).collect();
    let place = |k: usize| scene.points[sample[k]].position;
    let mut best: Option<(f64, Plane)> = None;
    for n in 0..TRIES {
        // Small triangles find small planes, large ones fix large planes.
        let reach = scene.distance * [0.1, 0.3, 1.0][n % 3];
        let a = place(random.random_range(0..sample.len()));
        let mut near = || {
            (0..12).map(|_| place(random.random_range(0..sample.len()))).find(|p| {
                let d = (p - a).norm();
                d < reach && d > 0.1 * reach
            })
        };
        let (Some(b), Some(c)) = (near(), near()) else { continue };
        let normal = (b - a).cross(&(c - a));
        // A needle fixes no plane.
        if normal.norm() < 0.1 * (b - a).norm() * (c - a).norm() {
            continue;
        }
        let (plane, above) = Plane { point: a, up: normal.normalize() }.turned(scene);
        if above < LEAST_ABOVE || !allowed(&plane.up, options) {
            continue;
        }
        let score = score(scene, &sample, &weights, &plane);
        if best.as_ref().is_none_or(|(most, _)| score > *most) {
            best = Some((score, plane));
        }
    }
    best.map(|(_, plane)| plane)
}

fn score(scene: &Scene, sample: &[usize], weights: &[f64], plane: &Plane) -> f64 {
    let gain = |(&i, &w): (&usize, &f64)| {
        let p = &scene.points[i].position;
        let h = plane.height(p);
        let off = h / (WITHIN * NOISE_PX * scene.sigma(i, &plane.up));
        match off < -2.0 && (p - scene.target).norm() < ROUND * scene.distance {
            true => -COST_BELOW * w,
            false => w * (1.0 - off * off).max(0.0),
        }
    };
    sample.iter().zip(weights).map(gain).sum()
}

/// Least squares over what belongs to the plane, until that stays: weights of Tukey's function of the distance in standard
/// deviations, of each point's own certainty, and of the nearness to the target.
fn settle(scene: &Scene, left: &[usize], plane: Plane) -> Option<Candidate> {
    let (mut plane, mut noise_px) = (plane, NOISE_PX);
    for _ in 0..30 {
        let before = plane;
        let weight = |i: usize| {
            let p = &scene.points[i].position;
            let sigma = scene.sigma(i, &plane.up);
            let off = plane.height(p) / (1.5 * WITHIN * noise_px * sigma);
            let tukey = (1.0 - off * off).max(0.0).powi(2);
            tukey * nearness(scene, p) / (sigma / scene.distance).powi(2)
        };
        let members: Vec<(Point3<f64>, f64)> =
            left.iter().map(|&i| (scene.points[i].position, weight(i))).filter(|(_, w)| *w > 0.0).collect();
        if members.len() < 3 {
            return None;
        }
        let (fitted, flat) = Plane::through(members.iter().copied())?;
        if flat < 0.03 {
            return None;
        }
        plane = fitted.turned(scene).0;
        let spread = |reach: f64| {
            let offs =
                left.iter().map(|&i| (plane.height(&scene.points[i].position) / scene.sigma(i, &plane.up)).abs());
            median(offs.filter(|o| *o < reach))
        };
        let (low, high) = NOISE_RANGE_PX;
        noise_px = (1.4826 * spread(1.5 * WITHIN * noise_px).unwrap_or(NOISE_PX)).clamp(low, high);
        if plane.up.angle(&before.up) < 1e-7 && plane.height(&before.point).abs() < 1e-7 * scene.distance {
            break;
        }
    }
    let belongs =
        |&i: &usize| plane.height(&scene.points[i].position).abs() <= WITHIN * noise_px * scene.sigma(i, &plane.up);
    let inliers: Vec<usize> = left.iter().copied().filter(belongs).collect();
    (inliers.len() >= LEAST_POINTS).then_some(Candidate { plane, inliers, noise_px })
}

/// The unit normal of a plane.
pub(super) fn unit(up: Vector3<f64>) -> Unit<Vector3<f64>> {
    Unit::new_normalize(up)
}
