//! What acts on the bodies: gravity, support, applied forces, prescribed spheres.

use nalgebra::{Point3, Vector3};

use crate::{Result, Scalar, SimError};

/// The surroundings of the bodies.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Scene<T: Scalar> {
    /// Gravity in the world, m/s².
    pub gravity: Vector3<T>,
    /// A horizontal plane that fills everything below it.
    pub table: Option<Table<T>>,
    /// Fixed boxes.
    pub boxes: Vec<FixedBox<T>>,
    /// Forces over time.
    pub forces: Vec<AppliedForce<T>>,
    /// Spheres on prescribed paths.
    pub pushers: Vec<Pusher<T>>,
}

/// The table plane z = height.
#[derive(Debug, Clone, Copy)]
pub struct Table<T> {
    /// Height in the world, metres.
    pub height_m: f64,
    /// Coulomb friction against the bodies.
    pub friction: T,
}

/// A fixed box, axis-aligned in the world.
#[derive(Debug, Clone, Copy)]
pub struct FixedBox<T> {
    /// Centre, metres.
    pub center: Point3<f64>,
    /// Half extents, metres.
    pub half: Vector3<f64>,
    /// Coulomb friction against the bodies.
    pub friction: T,
}

/// Where a force acts.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ForcePoint {
    /// At a point fixed to the body, in its frame.
    Body(Point3<f64>),
    /// At a point of the world that moves with the samples of the force (linear in between).
    World(Vec<Point3<f64>>),
}

/// A force in the world, held from each sample to the next (zero-order hold), zero before the first and from the last on.
#[derive(Debug, Clone)]
pub struct AppliedForce<T> {
    /// Which body it acts on.
    pub body: usize,
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
    /// A sampled force on `body`.
    ///
    /// # Errors
    /// If the numbers of samples differ, times do not increase or a number is not finite.
    pub fn new(body: usize, times_s: &[f64], forces_n: &[Vector3<f64>], point: ForcePoint) -> Result<Self> {
        check_series("force", times_s, forces_n.len())?;
        if forces_n.iter().any(|f| f.iter().any(|x| !x.is_finite())) {
            return Err(SimError::NotFinite { what: "a sample of the applied force".into() });
        }
        let points: &[Point3<f64>] = match &point {
            ForcePoint::Body(p) => std::slice::from_ref(p),
            ForcePoint::World(p) => {
                check_series("force point", times_s, p.len())?;
                p
            }
        };
        if points.iter().any(|p| p.iter().any(|x| !x.is_finite())) {
            return Err(SimError::NotFinite { what: "a point of the applied force".into() });
        }
        let mut impulse = vec![Vector3::zeros(); times_s.len()];
        for i in 1..times_s.len() {
            impulse[i] = impulse[i - 1] + forces_n[i - 1] * (times_s[i] - times_s[i - 1]);
        }
        Ok(Self { body, times_s: times_s.to_vec(), forces_n: forces_n.to_vec(), impulse, point, gain: T::one() })
    }

    /// Where it acts.
    pub fn point(&self) -> &ForcePoint {
        &self.point
    }

    /// Mean force over [t, t + dt], newtons, before the gain.
    pub(crate) fn mean(&self, t: f64, dt: f64) -> Vector3<f64> {
        (self.impulse_until(t + dt) - self.impulse_until(t)) / dt
    }

    /// The world point at time t, for forces that move in the world.
    pub(crate) fn world_point(&self, t: f64) -> Option<Point3<f64>> {
        match &self.point {
            ForcePoint::Body(_) => None,
            ForcePoint::World(p) => Some(interpolate(&self.times_s, p, t)),
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

/// A sphere that moves along a prescribed path, whatever it meets.
#[derive(Debug, Clone)]
pub struct Pusher<T> {
    /// Sphere radius, metres.
    pub radius_m: f64,
    /// Friction against the bodies.
    pub friction: T,
    times_s: Vec<f64>,
    centers: Vec<Point3<f64>>,
}

impl<T: Scalar> Pusher<T> {
    /// A sphere whose centre passes `centers` at `times_s`, linearly in between, at rest before and after.
    ///
    /// # Errors
    /// If the numbers of samples differ, times do not increase or a number is not finite.
    pub fn new(radius_m: f64, friction: T, times_s: &[f64], centers: &[Point3<f64>]) -> Result<Self> {
        check_series("pusher path", times_s, centers.len())?;
        if radius_m.is_nan() || radius_m <= 0.0 || centers.iter().any(|p| p.iter().any(|x| !x.is_finite())) {
            return Err(SimError::NotFinite { what: "radius or path of the pusher".into() });
        }
        Ok(Self { radius_m, friction, times_s: times_s.to_vec(), centers: centers.to_vec() })
    }

    /// Centre and velocity at time t.
    pub(crate) fn at(&self, t: f64) -> (Point3<f64>, Vector3<f64>) {
        let k = self.times_s.partition_point(|&s| s <= t);
        if k == 0 || k == self.times_s.len() {
            return (self.centers[k.saturating_sub(1)], Vector3::zeros());
        }
        let v = (self.centers[k] - self.centers[k - 1]) / (self.times_s[k] - self.times_s[k - 1]);
        (self.centers[k - 1] + v * (t - self.times_s[k - 1]), v)
    }
}

impl<T: Scalar> Scene<T> {
    /// Nothing but gravity of 9.81 m/s².
    pub fn empty() -> Self {
        let g = Vector3::new(T::zero(), T::zero(), T::lift(-9.81));
        Self { gravity: g, table: None, boxes: Vec::new(), forces: Vec::new(), pushers: Vec::new() }
    }

    /// A table at height zero under gravity of 9.81 m/s².
    pub fn on_table(friction: T) -> Self {
        Self { table: Some(Table { height_m: 0.0, friction }), ..Self::empty() }
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

fn check_series(what: &str, times_s: &[f64], values: usize) -> Result<()> {
    if times_s.is_empty() || times_s.len() != values {
        return Err(SimError::Series {
            what: format!("{what}: {} times but {values} values", times_s.len()),
            remedy: "give one value per time, at least one".into(),
        });
    }
    if let Some(i) = (1..times_s.len()).find(|&i| times_s[i].is_nan() || times_s[i] <= times_s[i - 1]) {
        return Err(SimError::Series {
            what: format!("{what}: time {i} ({} s) is not after the one before", times_s[i]),
            remedy: "sort the samples by time and drop repeated ones".into(),
        });
    }
    if !(times_s[0].is_finite() && times_s[times_s.len() - 1].is_finite()) {
        return Err(SimError::NotFinite { what: format!("a time of the {what}") });
    }
    Ok(())
}
