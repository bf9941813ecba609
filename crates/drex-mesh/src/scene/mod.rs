//! What stands where in a scan of a whole scene: which plane is the table, which thing the object.
//!
//! ```text
//! sparse points with the views that see them, lenses, poses
//!   -> Scene           where the cameras look, how far they are, how sure each point is
//!   -> support_plane   candidate planes, ranked; the table, its runners-up, a doubt
//!   -> find_objects    groups of points that stand on the table; the one that the cameras or a click mean
//! ```
//! Everything here is geometry in the frame and unit of the scan, and independent of both: lengths are measured in
//! distances of the cameras, noise in pixels.

mod base;
mod candidates;
mod free_space;
mod objects;
mod support;

use std::num::NonZeroUsize;

use drex_core::Pose;
use drex_core::camera::{Camera, point_looked_at};
use drex_core::stats::median;
use nalgebra::{Matrix3, Point2, Point3, Unit, Vector3};

pub use self::base::silhouette_base;
pub use self::objects::{Choice, Click, Found, ObjectGroup, find_objects};
pub use self::support::{PlaneCandidate, Scores, SupportChoice, support_plane};
use crate::{Error, Result};

/// A direction that is known to be up, from a marker or the photos' own record of gravity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UpPrior {
    /// Up in the scan's frame.
    pub direction: Unit<Vector3<f64>>,
    /// How far a support's normal may be from it, rad.
    pub tolerance_rad: f64,
}

/// Settings of [`support_plane`].
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub struct SupportOptions {
    /// What is known of up.
    pub up: Option<UpPrior>,
    /// Seed of the search.
    pub seed: u64,
}

/// Points and views without which nothing can be said.
const LEAST: (usize, usize) = (3, 2);
/// Rounds of reweighting in the search for the point that the cameras look at.
const LOOK_ROUNDS: usize = 30;
/// The middle of a photo: this share of its width and height.
const MIDDLE: f64 = 0.7;
/// Standard deviation of a point along its own rays where the rays leave it free, in distances of the camera.
const FREE: f64 = 10.0;

/// A photo of the scene: its lens and where it was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneView {
    /// The lens.
    pub lens: Camera,
    /// Pose of the camera (OpenCV axes) in the scan's frame.
    pub world_from_camera: Pose,
}

impl SceneView {
    /// The pixel at which a point of the scan appears, if it does.
    pub fn pixel_of(&self, p: &Point3<f64>) -> Option<Point2<f64>> {
        let pixel = self.lens.project(&self.world_from_camera.inverse_transform_point(p))?;
        self.lens.contains(&pixel).then_some(pixel)
    }

    fn centre(&self) -> Point3<f64> {
        self.world_from_camera.translation.vector.into()
    }

    /// Unit optical axis in the scan's frame.
    fn axis(&self) -> Vector3<f64> {
        self.world_from_camera.rotation * Vector3::z()
    }
}

/// A point that photos see.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenePoint {
    /// Position in the scan's frame and unit.
    pub position: Point3<f64>,
    /// Indices of the views that see it; empty if unknown.
    pub views: Vec<usize>,
    /// Share (0 to 1) of these views whose mask shows it as the object, where there are masks.
    pub object_share: Option<f64>,
}

impl ScenePoint {
    /// A point of which only the place is known.
    pub fn at(position: Point3<f64>) -> Self {
        Self { position, views: Vec::new(), object_share: None }
    }
}

/// Points and views of a scan, with what follows from them.
#[derive(Debug, Clone)]
pub struct Scene {
    points: Vec<ScenePoint>,
    views: Vec<SceneView>,
    /// Covariance of each point, for one pixel of noise; unit of the scan squared.
    covariances: Vec<Matrix3<f64>>,
    target: Point3<f64>,
    distance: f64,
}

impl Scene {
    /// The scene of these points and views; points that are not finite are left out.
    ///
    /// # Errors
    /// If there are fewer than three points or two views, or the cameras do not look at one place.
    pub fn new(points: Vec<ScenePoint>, views: Vec<SceneView>) -> Result<Self> {
        let target = looked_at(&views).or_else(|| most_seen(&points, &views)).ok_or_else(|| {
            Error::value(
                format!("{} cameras do not look at one place", views.len()),
                "give masks of the object, or the box it is in",
            )
        });
        // Too little to look at is the better reason.
        match target {
            Err(e) if points.len() >= LEAST.0 && views.len() >= LEAST.1 => Err(e),
            target => Self::around(points, views, target.unwrap_or_default()),
        }
    }

    /// The scene of these points and views round a point that is known to be the object's.
    ///
    /// # Errors
    /// If there are fewer than three points or two views, or the cameras stand at the target.
    pub fn around(points: Vec<ScenePoint>, views: Vec<SceneView>, target: Point3<f64>) -> Result<Self> {
        let mut points = points;
        points.retain(|p| p.position.iter().all(|c| c.is_finite()));
        if points.len() < LEAST.0 || views.len() < LEAST.1 {
            return Err(Error::value(
                format!("{} points and {} cameras show no table", points.len(), views.len()),
                "give the sparse points and the cameras of the scan",
            ));
        }
        points.iter_mut().for_each(|p| p.views.retain(|&v| v < views.len()));
        let distance = median(views.iter().map(|v| (v.centre() - target).norm())).unwrap_or(0.0);
        if !(distance > 0.0 && distance.is_finite()) {
            return Err(Error::value("all cameras stand where they look", "check the poses of the scan"));
        }
        let covariances = points.iter().map(|p| covariance(p, &views, distance)).collect();
        Ok(Self { points, views, covariances, target, distance })
    }

    /// The points, without those that are not finite.
    pub fn points(&self) -> &[ScenePoint] {
        &self.points
    }

    /// The views, in the order given.
    pub fn views(&self) -> &[SceneView] {
        &self.views
    }

    /// The point that the cameras look at, scan's frame.
    pub fn target(&self) -> Point3<f64> {
        self.target
    }

    /// Median distance of the cameras from [`Scene::target`], unit of the scan.
    pub fn camera_distance(&self) -> f64 {
        self.distance
    }

    /// Standard deviation of point `i` along a unit direction for one pixel of noise, unit of the scan.
    pub fn sigma(&self, i: usize, direction: &Vector3<f64>) -> f64 {
        (self.covariances[i] * direction).dot(direction).max(0.0).sqrt()
    }

    /// Share of the views that have a point in the middle of their picture, hidden or not.
    pub fn middle_share(&self, p: &Point3<f64>) -> f64 {
        middle_share(p, &self.views)
    }
}

fn middle_share(p: &Point3<f64>, views: &[SceneView]) -> f64 {
    let in_middle = |v: &&SceneView| {
        v.pixel_of(p).is_some_and(|px| {
            let off = |x: f64, side: u32| (2.0 * x / f64::from(side) - 1.0).abs();
            off(px.x, v.lens.width_px()) < MIDDLE && off(px.y, v.lens.height_px()) < MIDDLE
        })
    };
    views.iter().filter(in_middle).count() as f64 / views.len() as f64
}

/// The point nearest to the optical axes by the sum of distances (L1, by reweighted least squares), so that cameras that look
/// elsewhere do not drag it. `None` if the axes are parallel or most cameras have it behind them.
fn looked_at(views: &[SceneView]) -> Option<Point3<f64>> {
    let poses: Vec<Pose> = views.iter().map(|v| v.world_from_camera).collect();
    let mut target = point_looked_at(&poses)?;
    for _ in 0..LOOK_ROUNDS {
        let off = |v: &SceneView| (v.centre() - target).cross(&v.axis()).norm();
        let typical = median(views.iter().map(off)).unwrap_or(0.0);
        let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
        for v in views {
            let across = (Matrix3::identity() - v.axis() * v.axis().transpose()) / (off(v) + 0.1 * typical + 1e-12);
            a += across;
            b += across * v.centre().coords;
        }
        target = Point3::from(a.try_inverse()? * b);
    }
    let before = views.iter().filter(|v| v.axis().dot(&(target - v.centre())) > 0.0).count();
    (target.iter().all(|c| c.is_finite()) && 2 * before > views.len()).then_some(target)
}

/// Where the axes do not meet: the middle of the points that most views have in the middle of their picture.
fn most_seen(points: &[ScenePoint], views: &[SceneView]) -> Option<Point3<f64>> {
    let shares: Vec<f64> = points.iter().map(|p| middle_share(&p.position, views)).collect();
    let most = shares.iter().copied().fold(0.0, f64::max);
    let best = || points.iter().zip(&shares).filter(|(_, s)| **s >= 0.9 * most).map(|(p, _)| p.position);
    let middle = |k: usize| median(best().map(|p| p[k]));
    (most >= 0.5).then(|| Some(Point3::new(middle(0)?, middle(1)?, middle(2)?)))?
}

/// Inverse of the sum over the views of (f/d)² (I - r rᵀ), r the ray's direction, d its length, f the focal length in pixels: the
/// covariance of a point triangulated with one pixel of noise. A point of fewer than two views is taken as sure to a
/// pixel in every direction, as a depth camera sees it.
fn covariance(p: &ScenePoint, views: &[SceneView], distance: f64) -> Matrix3<f64> {
    let mut information = Matrix3::zeros();
    for &i in &p.views {
        let v = &views[i];
        let ray = p.position - v.centre();
        let d = ray.norm().max(1e-9 * distance);
        let r = ray / d;
        let per_px = (v.lens.focal_px().mean() / d).powi(2);
        information += per_px * (Matrix3::identity() - r * r.transpose()) + Matrix3::identity() / (FREE * d).powi(2);
    }
    if p.views.len() < 2 {
        let nearest = views.iter().map(|v| (p.position - v.centre()).norm() / v.lens.focal_px().mean());
        let px = match p.views.first() {
            Some(&i) => (p.position - views[i].centre()).norm() / views[i].lens.focal_px().mean(),
            None => median(nearest).unwrap_or(0.0),
        };
        return Matrix3::identity() * px.max(1e-12 * distance).powi(2);
    }
    information.try_inverse().unwrap_or_else(|| Matrix3::identity() * distance.powi(2))
}

/// Every k-th of `n` indices so that at most `most` remain.
fn thinned(n: usize, most: NonZeroUsize) -> impl Iterator<Item = usize> {
    (0..n).step_by(n.div_ceil(most.get()).max(1))
}
