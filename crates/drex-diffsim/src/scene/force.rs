//! Forces over time.

use drex_core::Pose;
use nalgebra::{Point3, Vector3};

use crate::series::check_series;
use crate::{Error, Part, Result, Scalar};

/// Where a force acts.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ForcePoint {
    /// At a point fixed to the body, in its frame.
    Body(Point3<f64>),
    /// At a point of the world that moves with the samples of the force (linear in between).
    World(Vec<Point3<f64>>),
    /// Nowhere: it is a couple, and the samples are a torque in the world, N m.
    Couple,
}

/// A force in the world, held from each sample to the next (zero-order hold), zero before the first and from the last on.
#[derive(Debug, Clone)]
pub struct AppliedForce<T> {
    /// What it acts on: a body or a link.
    pub on: Part,
    /// Sample times, seconds, increasing.
    times_s: Vec<f64>,
    /// Force per sample, newtons.
    forces_n: Vec<Vector3<f64>>,
    /// Impulse from the first sample up to each sample, N s.
    impulse: Vec<Vector3<f64>>,
    /// Where it acts.
    point: ForcePoint,
    /// Factor on the force.
    pub gain: T,
}

impl<T: Scalar> AppliedForce<T> {
    /// A sampled force on a body or a link.
    ///
    /// # Errors
    /// If the numbers of samples differ, times do not increase or a number is not finite.
    pub fn new(on: Part, times_s: &[f64], forces_n: &[Vector3<f64>], point: ForcePoint) -> Result<Self> {
        check_series("force", times_s, forces_n.len())?;
        if forces_n.iter().any(|f| f.iter().any(|x| !x.is_finite())) {
            return Err(Error::NotFinite { what: "a sample of the applied force".into() });
        }
        let points: &[Point3<f64>] = match &point {
            ForcePoint::Body(p) => std::slice::from_ref(p),
            ForcePoint::World(p) => {
                check_series("force point", times_s, p.len())?;
                p
            }
            ForcePoint::Couple => &[],
        };
        if points.iter().any(|p| p.iter().any(|x| !x.is_finite())) {
            return Err(Error::NotFinite { what: "a point of the applied force".into() });
        }
        let mut impulse = vec![Vector3::zeros(); times_s.len()];
        for i in 1..times_s.len() {
            impulse[i] = impulse[i - 1] + forces_n[i - 1] * (times_s[i] - times_s[i - 1]);
        }
        Ok(Self { on, times_s: times_s.to_vec(), forces_n: forces_n.to_vec(), impulse, point, gain: T::one() })
    }

    /// Where it acts.
    pub fn point(&self) -> &ForcePoint {
        &self.point
    }

    /// Mean force over [t, t + dt], newtons, before the gain.
    pub fn mean(&self, t: f64, dt: f64) -> Vector3<f64> {
        (self.impulse_until(t + dt) - self.impulse_until(t)) / dt
    }

    /// Where the force acts in the world at time t on something at `pose`; `None` for a couple.
    pub fn world_point(&self, t: f64, pose: &Pose<T>) -> Option<Vector3<T>> {
        match &self.point {
            ForcePoint::Body(p) => Some(pose.translation.vector + pose.rotation * p.coords.map(T::lift)),
            ForcePoint::World(p) => Some(interpolate(&self.times_s, p, t).coords.map(T::lift)),
            ForcePoint::Couple => None,
        }
    }

    fn impulse_until(&self, t: f64) -> Vector3<f64> {
        let k = self.times_s.partition_point(|&s| s <= t);
        match k {
            0 => Vector3::zeros(),
            k if k == self.times_s.len() => self.impulse[k - 1],
            k => self.impulse[k - 1] + self.forces_n[k - 1] * (t - self.times_s[k - 1]),
        }
    }
}

fn interpolate(times_s: &[f64], points: &[Point3<f64>], t: f64) -> Point3<f64> {
    let k = times_s.partition_point(|&s| s <= t);
    if k == 0 || k == times_s.len() {
        return points[k.saturating_sub(1)];
    }
    let s = (t - times_s[k - 1]) / (times_s[k] - times_s[k - 1]);
    points[k - 1] + (points[k] - points[k - 1]) * s
}
