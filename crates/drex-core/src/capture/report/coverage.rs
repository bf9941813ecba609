//! From which directions an object was seen.

use std::fmt;

use nalgebra::{Matrix3, Point3, Unit, Vector3};
use serde::Serialize;

use super::super::Capture;
use crate::stats::upper_median;

/// A direction counts as seen when a camera is within this angle of it.
const SEEN_WITHIN_DEG: f64 = 30.0;
/// Directions that are asked about, spread evenly over the sphere.
const DIRECTIONS: usize = 1000;

/// From which directions the object was seen, angles in degrees.
///
/// Azimuth 0 is the first camera's and grows to the left as seen from above; elevation is positive above. Up is the mean
/// of the cameras' own.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Coverage {
    /// What the cameras look at, world frame: the median of the points inside the masks, or else the place nearest to
    /// the optical axes.
    pub centre: [f64; 3],
    /// Up, world frame, a unit vector.
    pub up: [f64; 3],
    /// Share of all directions, 0 to 1, from which a camera within 30° looks.
    pub seen: f64,
    /// The widest sector without a camera, from one azimuth to the next.
    pub azimuth_gap_deg: [f64; 2],
    /// Lowest and highest camera.
    pub elevation_deg: [f64; 2],
    /// Azimuth and elevation of the direction furthest from any camera.
    pub emptiest_deg: [f64; 2],
    /// The angle from there to the nearest camera.
    pub emptiest_distance_deg: f64,
}

impl Coverage {
    /// `centres` are the cameras that count.
    pub(super) fn new(capture: &Capture, centres: &[Point3<f64>], object: Option<Point3<f64>>) -> Option<Self> {
        let axis = |v: Vector3<f64>| move |view: &super::View| view.camera_from_world.rotation.inverse() * v;
        let up = capture.views.iter().map(axis(-Vector3::y())).sum::<Vector3<f64>>();
        let up = Unit::try_new(up, 1e-6)?;
        let centre = object.or_else(|| focus(capture))?;
        let directions: Vec<_> = centres.iter().filter_map(|c| Unit::try_new(c - centre, 1e-12)).collect();
        if directions.len() < 2 {
            return None;
        }
        let level = |d: &Vector3<f64>| Unit::try_new(d - up.as_ref() * up.dot(d), 1e-6);
        let zero = directions.iter().find_map(|d| level(d))?;
        let side = up.cross(&zero);
        let angles = |d: &Vector3<f64>| {
            let azimuth = d.dot(&side).atan2(d.dot(&zero)).to_degrees().rem_euclid(360.0);
            [azimuth, up.dot(d).clamp(-1.0, 1.0).asin().to_degrees()]
        };
        // A camera right above is at every azimuth and at none.
        const STEEP_DEG: f64 = 75.0;
        let cameras: Vec<_> = directions.iter().map(|d| angles(d)).collect();
        let mut azimuths: Vec<_> = cameras.iter().filter(|a| a[1].abs() < STEEP_DEG).map(|a| a[0]).collect();
        azimuths.sort_by(f64::total_cmp);
        let next = azimuths.iter().skip(1).copied().chain(azimuths.first().map(|a| a + 360.0));
        let gap = azimuths.iter().copied().zip(next).max_by(|a, b| (a.1 - a.0).total_cmp(&(b.1 - b.0)));
        let elevations = cameras.iter().map(|a| a[1]);
        let nearest = |d: &Vector3<f64>| {
            let cosine = directions.iter().map(|c| c.dot(d)).fold(-1.0, f64::max);
            cosine.clamp(-1.0, 1.0).acos().to_degrees()
        };
        let asked: Vec<_> = evenly_spread().map(|d| (nearest(&d), d)).collect();
        let (emptiest_distance_deg, emptiest) = asked.iter().max_by(|a, b| a.0.total_cmp(&b.0)).copied()?;
        Some(Self {
            centre: centre.into(),
            up: up.into_inner().into(),
            seen: asked.iter().filter(|(angle, _)| *angle <= SEEN_WITHIN_DEG).count() as f64 / asked.len() as f64,
            azimuth_gap_deg: gap.map_or([0.0, 360.0], |(a, b)| [a, b]),
            elevation_deg: [elevations.clone().fold(90.0, f64::min), elevations.fold(-90.0, f64::max)],
            emptiest_deg: angles(&emptiest),
            emptiest_distance_deg,
        })
    }
}

/// Directions on a spiral of equal areas (Fibonacci lattice).
fn evenly_spread() -> impl Iterator<Item = Vector3<f64>> {
    let golden = std::f64::consts::PI * (3.0 - 5.0f64.sqrt());
    (0..DIRECTIONS).map(move |i| {
        let z = 1.0 - (2 * i + 1) as f64 / DIRECTIONS as f64;
        let (sin, cos) = (golden * i as f64).sin_cos();
        let r = (1.0 - z * z).sqrt();
        Vector3::new(r * cos, r * sin, z)
    })
}

/// The place nearest to the optical axes: least sum of distances, by reweighted least squares, so that a few cameras that
/// look elsewhere do not move it. `None` where all axes are parallel.
fn focus(capture: &Capture) -> Option<Point3<f64>> {
    let axes: Vec<_> = capture
        .views
        .iter()
        .map(|v| (v.camera_from_world.inverse() * Point3::origin(), v.camera_from_world.inverse() * Vector3::z()))
        .collect();
    let mut weights = vec![1.0; axes.len()];
    let mut focus = None;
    for _ in 0..20 {
        let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
        for ((c, d), w) in axes.iter().zip(&weights) {
            let across = (Matrix3::identity() - d * d.transpose()) * *w;
            a += across;
            b += across * c.coords;
        }
        let a = a / weights.iter().sum::<f64>();
        let b = b / weights.iter().sum::<f64>();
        if a.determinant().abs() < 1e-9 {
            return None;
        }
        let x = a.try_inverse()? * b;
        let distances: Vec<_> = axes.iter().map(|(c, d)| (x - c.coords).cross(d).norm()).collect();
        let floor = 1e-3 * upper_median(distances.iter().copied())?.max(1e-9);
        weights = distances.iter().map(|r| 1.0 / r.max(floor)).collect();
        focus = Some(Point3::from(x));
    }
    focus
}

impl fmt::Display for Coverage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [from, to] = self.azimuth_gap_deg;
        let [low, high] = self.elevation_deg;
        let [azimuth, elevation] = self.emptiest_deg;
        write!(
            f,
            "Cameras within {SEEN_WITHIN_DEG:.0}° look from {:.0} % of all directions, from elevation {low:.0}° to \
             {high:.0}°; the widest sector without one is {:.0}°, from azimuth {from:.0}° to {:.0}°; furthest from any, by \
             {:.0}°, is the view from azimuth {azimuth:.0}°, elevation {elevation:.0}°.",
            100.0 * self.seen,
            to - from,
            to.rem_euclid(360.0),
            self.emptiest_distance_deg
        )
    }
}
