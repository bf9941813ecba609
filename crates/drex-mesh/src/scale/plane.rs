//! The table in a cloud of points.

use drex_core::stats::upper_median;
use nalgebra::{Matrix3, Point3, Unit, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{Error, Result};

/// Settings of [`table_plane`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PlaneOptions {
    /// Points this close to a plane count for it in the search, in the unit of the points. `None`: 1/200 of their median
    /// distance from their middle.
    pub within: Option<f64>,
    /// Planes through three random points that are tried.
    pub tries: usize,
    /// Seed of the search.
    pub seed: u64,
}

impl Default for PlaneOptions {
    fn default() -> Self {
        Self { within: None, tries: 2000, seed: 1 }
    }
}

/// The plane an object stands on.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct TablePlane {
    /// A point of it: the middle of its points.
    pub point: Point3<f64>,
    /// Upward unit normal: to the side of the cameras.
    pub up: Unit<Vector3<f64>>,
    /// Points that belong to it.
    pub inliers: usize,
    /// Their root mean square distance from it, in the unit of the points.
    pub rms: f64,
}

impl TablePlane {
    /// A plane that is known, not found among points.
    pub fn new(point: Point3<f64>, up: Unit<Vector3<f64>>) -> Self {
        Self { point, up, inliers: 0, rms: 0.0 }
    }
}

/// Finds the plane that holds most points and has the cameras on one side: the table of a scan.
///
/// RANSAC over three points (Fischler and Bolles 1981), then least squares over the points within 2.5 robust standard
/// deviations, repeated until the choice stays. Cameras on both sides (more than one in ten on the other) disqualify a plane.
///
/// # Errors
/// If there are fewer than three points or no cameras, or no plane has the cameras on one side.
pub fn table_plane(points: &[Point3<f64>], cameras: &[Point3<f64>], options: &PlaneOptions) -> Result<TablePlane> {
    let points: Vec<Point3<f64>> = points.iter().filter(|p| p.iter().all(|c| c.is_finite())).copied().collect();
    if points.len() < 3 || cameras.is_empty() {
        return Err(Error::value(
            format!("{} points and {} cameras show no table", points.len(), cameras.len()),
            "give the sparse points and the camera positions of the scan",
        ));
    }
    let middle = Point3::from([0, 1, 2].map(|k| upper_median(points.iter().map(|p| p[k])).unwrap_or(0.0)));
    let within = options
        .within
        .unwrap_or_else(|| upper_median(points.iter().map(|p| (p - middle).norm())).unwrap_or(0.0) / 200.0);
    let mut random = ChaCha8Rng::seed_from_u64(options.seed);
    let mut best: Option<(usize, Plane)> = None;
    for _ in 0..options.tries {
        let [a, b, c] = [0; 3].map(|_| points[random.random_range(0..points.len())]);
        let Some(up) = (b - a).cross(&(c - a)).try_normalize(0.0) else { continue };
        let Some(plane) = (Plane { point: a, up }).with_above(cameras) else { continue };
        let count = points.iter().filter(|p| plane.height(p).abs() <= within).count();
        if best.as_ref().is_none_or(|(most, _)| count > *most) {
            best = Some((count, plane));
        }
    }
    let none = || {
        Error::value(
            "no plane among the points has the cameras on one side",
            "give the points of a scan that shows the table, or state the up direction",
        )
    };
    let (_, mut plane) = best.ok_or_else(none)?;
    let mut reach = within;
    for _ in 0..20 {
        let near: Vec<Point3<f64>> = points.iter().filter(|p| plane.height(p).abs() <= reach).copied().collect();
        let Some(fitted) = Plane::through(&near).and_then(|p| p.with_above(cameras)) else { break };
        // A wider net than the search's would take in what stands on the table.
        let spread = 1.4826 * upper_median(near.iter().map(|p| fitted.height(p).abs())).unwrap_or(0.0);
        let next = (2.5 * spread).min(within);
        let same = fitted.up.angle(&plane.up) < 1e-9 && (next - reach).abs() <= 1e-6 * reach;
        (plane, reach) = (fitted, next);
        if same {
            break;
        }
    }
    let heights: Vec<f64> = points.iter().map(|p| plane.height(p)).filter(|h| h.abs() <= reach).collect();
    if heights.len() < 3 {
        return Err(none());
    }
    let rms = (heights.iter().map(|h| h * h).sum::<f64>() / heights.len() as f64).sqrt();
    Ok(TablePlane { point: plane.point, up: Unit::new_normalize(plane.up), inliers: heights.len(), rms })
}

#[derive(Debug, Clone, Copy)]
struct Plane {
    point: Point3<f64>,
    up: Vector3<f64>,
}

impl Plane {
    fn height(&self, p: &Point3<f64>) -> f64 {
        self.up.dot(&(p - self.point))
    }

    /// The same plane with the cameras above it, if nine in ten are on one side.
    fn with_above(mut self, cameras: &[Point3<f64>]) -> Option<Self> {
        let above = cameras.iter().filter(|c| self.height(c) > 0.0).count();
        let most = above.max(cameras.len() - above);
        if above < most {
            self.up = -self.up;
        }
        (10 * most >= 9 * cameras.len()).then_some(self)
    }

    /// Least squares: through the mean, across the direction of least spread.
    fn through(points: &[Point3<f64>]) -> Option<Self> {
        if points.len() < 3 {
            return None;
        }
        let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
        let spread: Matrix3<f64> = points.iter().map(|p| (p.coords - mean) * (p.coords - mean).transpose()).sum();
        let eigen = spread.symmetric_eigen();
        let up = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
        Some(Self { point: mean.into(), up })
    }
}
