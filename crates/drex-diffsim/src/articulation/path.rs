//! A base that follows a path over time, whatever acts on it.

use drex_core::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use crate::math::exp;
use crate::{Result, SimError};

/// Poses at sample times, joined by cubic pieces with continuous velocity; at rest before the first and from the last
/// sample on.
///
/// The velocity at a sample is zero at both ends of the path and wherever a coordinate stands still or turns back, so
/// that a lift starts and stops smoothly, does not overshoot, and two samples make a smooth step. Between, it is the
/// harmonic mean of the slopes beside it (Fritsch and Butland, *SIAM J. Sci. Stat. Comput.* 5, 1984), coordinate by
/// coordinate, for rotations in the rotation vector from the sample before. The acceleration jumps at samples.
#[derive(Debug, Clone, PartialEq)]
pub struct BasePath {
    times_s: Vec<f64>,
    poses: Vec<Pose>,
    /// World velocity at each sample.
    velocities: Vec<Vector3<f64>>,
    /// Angular velocity at each sample, in the frame of that sample.
    rates: Vec<Vector3<f64>>,
    /// Rotation vector from each sample to the next, in the frame of either.
    turns: Vec<Vector3<f64>>,
}

/// Where a prescribed base is at one instant and how it moves; all in the world.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PathPoint {
    pub pose: Pose,
    pub velocity: Vector3<f64>,
    pub angular_velocity: Vector3<f64>,
    pub acceleration: Vector3<f64>,
    pub angular_acceleration: Vector3<f64>,
}

impl BasePath {
    /// A path through `poses` (world_from_base) at `times_s`, increasing, seconds of the simulation's clock.
    ///
    /// # Errors
    /// If there is no sample, the numbers differ, times do not increase, a number is not finite, or two neighbouring
    /// samples are half a turn apart, so that the way between them is not told.
    pub fn new(times_s: &[f64], poses: &[Pose]) -> Result<Self> {
        let n = times_s.len();
        if n == 0 || n != poses.len() {
            return Err(SimError::Series {
                what: format!("base path: {n} times but {} poses", poses.len()),
                remedy: "give one pose per time, at least one".into(),
            });
        }
        if let Some(i) = (0..n).find(|&i| {
            !times_s[i].is_finite() || poses[i].translation.vector.iter().any(|x| !x.is_finite()) || !is_unit(&poses[i])
        }) {
            return Err(SimError::NotFinite { what: format!("base path: time or pose of sample {i}") });
        }
        if let Some(i) = (1..n).find(|&i| times_s[i] <= times_s[i - 1]) {
            return Err(SimError::Series {
                what: format!("base path: time {i} ({} s) is not after the one before", times_s[i]),
                remedy: "sort the samples by time and drop repeated ones".into(),
            });
        }
        let turns: Vec<_> = poses.windows(2).map(|w| (w[0].rotation.inverse() * w[1].rotation).scaled_axis()).collect();
        if let Some(i) = turns.iter().position(|t| t.norm() > 0.99 * std::f64::consts::PI) {
            return Err(SimError::Series {
                what: format!("base path: samples {i} and {} are half a turn apart", i + 1),
                remedy: "add samples between them".into(),
            });
        }
        let steps: Vec<f64> = times_s.windows(2).map(|w| w[1] - w[0]).collect();
        let moves: Vec<_> = poses.windows(2).map(|w| w[1].translation.vector - w[0].translation.vector).collect();
        let (velocities, rates) = (slopes(&steps, &moves), slopes(&steps, &turns));
        Ok(Self { times_s: times_s.to_vec(), poses: poses.to_vec(), velocities, rates, turns })
    }

    /// Pose of the base at time t.
    pub fn pose(&self, t: f64) -> Pose {
        self.at(t).pose
    }

    /// Velocity of the base frame's origin and angular velocity at time t, world, m/s and rad/s.
    pub fn velocity(&self, t: f64) -> (Vector3<f64>, Vector3<f64>) {
        let p = self.at(t);
        (p.velocity, p.angular_velocity)
    }

    /// Pose, velocity and acceleration at time t. At a sample, the acceleration is that of the piece after it.
    pub(crate) fn at(&self, t: f64) -> PathPoint {
        let k = self.times_s.partition_point(|&s| s <= t);
        let o = Vector3::zeros();
        if k == 0 || k == self.times_s.len() {
            let pose = self.poses[k.saturating_sub(1)];
            return PathPoint { pose, velocity: o, angular_velocity: o, acceleration: o, angular_acceleration: o };
        }
        let (i, h) = (k - 1, self.times_s[k] - self.times_s[k - 1]);
        let s = (t - self.times_s[i]) / h;
        let (start, turn) = (&self.poses[i], &self.turns[i]);
        let step = self.poses[k].translation.vector - start.translation.vector;
        let (x, velocity, acceleration) = hermite(s, h, &step, &self.velocities[i], &self.velocities[k]);
        // The rotation vector from the sample before; its rate at the end is such that the body turns at `rates[k]`.
        let end = right_jacobian(turn).try_inverse().map_or(self.rates[k], |j| j * self.rates[k]);
        let (r, r1, r2) = hermite(s, h, turn, &self.rates[i], &end);
        let rotation = start.rotation * exp(&r);
        let (rate, change) = body_rate(&r, &r1, &r2);
        PathPoint {
            pose: Pose::from_parts(Translation3::from(start.translation.vector + x), rotation),
            velocity,
            angular_velocity: rotation * rate,
            acceleration,
            angular_acceleration: rotation * change,
        }
    }
}

fn is_unit(pose: &Pose) -> bool {
    (pose.rotation.quaternion().norm_squared() - 1.0).abs() < 1e-6
}

/// Velocity at each sample from the steps in time and space between them.
fn slopes(steps: &[f64], moves: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let mut out = vec![Vector3::zeros(); steps.len() + 1];
    for i in 1..steps.len() {
        let (h0, h1) = (steps[i - 1], steps[i]);
        for c in 0..3 {
            let (a, b) = (moves[i - 1][c] / h0, moves[i][c] / h1);
            if a * b > 0.0 {
                // The weights of unequal steps, as in Fritsch and Butland.
                let (wa, wb) = (h0 + 2.0 * h1, 2.0 * h0 + h1);
                out[i][c] = (wa + wb) / (wa / a + wb / b);
            }
        }
    }
    out
}

/// The cubic from zero to `step` with velocities `v0`, `v1`, at the fraction `s` of a piece of duration `h`:
/// displacement, velocity, acceleration.
fn hermite(
    s: f64,
    h: f64,
    step: &Vector3<f64>,
    v0: &Vector3<f64>,
    v1: &Vector3<f64>,
) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>) {
    let (a, b, c) = (v0 * h, step * 3.0 - (v0 * 2.0 + v1) * h, (v0 + v1) * h - step * 2.0);
    let x = (a + (b + c * s) * s) * s;
    (x, (a + (b * 2.0 + c * (3.0 * s)) * s) / h, (b * 2.0 + c * (6.0 * s)) / (h * h))
}

/// (1 - cos y)/y² and (1 - sin y / y)/y² of x = y², with their derivatives by x.
fn jacobian_factors(x: f64) -> ([f64; 2], [f64; 2]) {
    if x < 1e-2 {
        // The first terms left out are below 1e-14.
        let b = 0.5 - x * (1.0 / 24.0 - x * (1.0 / 720.0 - x * (1.0 / 40_320.0 - x / 3_628_800.0)));
        let b1 = -1.0 / 24.0 + x * (1.0 / 360.0 - x * (1.0 / 13_440.0 - x / 907_200.0));
        let c = 1.0 / 6.0 - x * (1.0 / 120.0 - x * (1.0 / 5040.0 - x * (1.0 / 362_880.0 - x / 39_916_800.0)));
        let c1 = -1.0 / 120.0 + x * (1.0 / 2520.0 - x * (1.0 / 120_960.0 - x / 9_979_200.0));
        return ([b, c], [b1, c1]);
    }
    let y = x.sqrt();
    let (sin, cos) = y.sin_cos();
    let (b, c) = ((1.0 - cos) / x, (1.0 - sin / y) / x);
    ([b, c], [(sin / (2.0 * y) - b) / x, ((sin / y - cos) / (2.0 * x) - c) / x])
}

/// The matrix that maps the rate of the rotation vector r to the angular velocity in the turned frame.
fn right_jacobian(r: &Vector3<f64>) -> nalgebra::Matrix3<f64> {
    let ([b, c], _) = jacobian_factors(r.norm_squared());
    let k = r.cross_matrix();
    nalgebra::Matrix3::identity() - k * b + k * k * c
}

/// Angular velocity and its rate of change, in the turned frame, of a rotation vector r with rates r1, r2.
/// The latter is also the angular acceleration, since a vector's own rotation does not change it.
fn body_rate(r: &Vector3<f64>, r1: &Vector3<f64>, r2: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let ([b, c], [b1, c1]) = jacobian_factors(r.norm_squared());
    let x1 = 2.0 * r.dot(r1);
    let (rx, rrx) = (r.cross(r1), r.cross(&r.cross(r1)));
    let rate = r1 - rx * b + rrx * c;
    let change =
        r2 - r.cross(r2) * b + r.cross(&r.cross(r2)) * c - rx * (b1 * x1) + rrx * (c1 * x1) + r1.cross(&rx) * c;
    (rate, change)
}

/// The constant angular velocity that turns `a` into `b` within `h`.
pub(crate) fn mean_rate(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>, h: f64) -> Vector3<f64> {
    (b * a.inverse()).scaled_axis() / h
}
