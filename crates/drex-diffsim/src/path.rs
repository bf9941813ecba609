//! Prescribed motion: a base or an obstacle that follows a path over time, whatever acts on it.

use drex_core::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use crate::math::exp;
use crate::series::check_series;
use crate::{Error, Result};

/// Poses over time; the first holds before, the last from its time on.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    times_s: Vec<f64>,
    poses: Vec<Pose>,
    /// Rotation vector from each sample to the next, in the frame of either.
    turns: Vec<Vector3<f64>>,
    blend: Blend,
}

/// What is between two samples.
#[derive(Debug, Clone, PartialEq)]
enum Blend {
    Linear,
    /// Cubic pieces: world velocity at each sample, and angular velocity in the frame of that sample.
    Smooth {
        velocities: Vec<Vector3<f64>>,
        rates: Vec<Vector3<f64>>,
    },
}

/// Where a path is at one instant and how it moves; all in the world, of the moving frame and its origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// World from the moving frame.
    pub pose: Pose,
    /// m/s.
    pub velocity: Vector3<f64>,
    /// rad/s.
    pub angular_velocity: Vector3<f64>,
    /// m/s².
    pub acceleration: Vector3<f64>,
    /// rad/s².
    pub angular_acceleration: Vector3<f64>,
}

impl Path {
    /// Constant velocity from each sample to the next: for dense samples of a recorded motion.
    ///
    /// # Errors
    /// If there is no sample, the numbers differ, times do not increase, a number is not finite, or two neighbouring
    /// samples are half a turn apart, so that the way between them is not told.
    pub fn linear(times_s: &[f64], poses: &[Pose]) -> Result<Self> {
        Ok(Self {
            times_s: times_s.to_vec(),
            poses: poses.to_vec(),
            turns: turns(times_s, poses)?,
            blend: Blend::Linear,
        })
    }

    /// Cubic pieces with continuous velocity, at rest at both ends: for a planned motion.
    ///
    /// The velocity at a sample is zero at both ends of the path and wherever a coordinate stands still or turns back, so
    /// that a lift starts and stops smoothly, does not overshoot, and two samples make a smooth step. Between, it is the
    /// harmonic mean of the slopes beside it (Fritsch and Butland, *SIAM J. Sci. Stat. Comput.* 5, 1984), coordinate by
    /// coordinate, for rotations in the rotation vector from the sample before. The acceleration jumps at samples.
    ///
    /// # Errors
    /// As [`Path::linear`].
    pub fn smooth(times_s: &[f64], poses: &[Pose]) -> Result<Self> {
        let turns = turns(times_s, poses)?;
        let steps: Vec<f64> = times_s.windows(2).map(|w| w[1] - w[0]).collect();
        let moves: Vec<_> = poses.windows(2).map(|w| w[1].translation.vector - w[0].translation.vector).collect();
        let blend = Blend::Smooth { velocities: slopes(&steps, &moves), rates: slopes(&steps, &turns) };
        Ok(Self { times_s: times_s.to_vec(), poses: poses.to_vec(), turns, blend })
    }

    /// Pose, velocity and acceleration at time t. At a sample, the acceleration is that of the piece after it.
    pub fn at(&self, t: f64) -> Motion {
        let k = self.times_s.partition_point(|&s| s <= t);
        let o = Vector3::zeros();
        if k == 0 || k == self.times_s.len() {
            let pose = self.poses[k.saturating_sub(1)];
            return Motion { pose, velocity: o, angular_velocity: o, acceleration: o, angular_acceleration: o };
        }
        let (i, h) = (k - 1, self.times_s[k] - self.times_s[k - 1]);
        let s = (t - self.times_s[i]) / h;
        let (start, turn) = (&self.poses[i], &self.turns[i]);
        let step = self.poses[k].translation.vector - start.translation.vector;
        let ((x, velocity, acceleration), (r, r1, r2)) = match &self.blend {
            Blend::Linear => ((step * s, step / h, o), (turn * s, turn / h, o)),
            Blend::Smooth { velocities, rates } => {
                // The rotation vector from the sample before; its rate at the end is such that the body turns at the
                // rate of the sample after.
                let end = right_jacobian(turn).try_inverse().map_or(rates[k], |j| j * rates[k]);
                (hermite(s, h, &step, &velocities[i], &velocities[k]), hermite(s, h, turn, &rates[i], &end))
            }
        };
        let rotation = start.rotation * exp(&r);
        let (rate, change) = body_rate(&r, &r1, &r2);
        Motion {
            pose: Pose::from_parts(Translation3::from(start.translation.vector + x), rotation),
            velocity,
            angular_velocity: rotation * rate,
            acceleration,
            angular_acceleration: rotation * change,
        }
    }
}

/// Rotation vectors between the samples of a path, which is checked.
fn turns(times_s: &[f64], poses: &[Pose]) -> Result<Vec<Vector3<f64>>> {
    check_series("path", times_s, poses.len())?;
    if let Some(i) = poses.iter().position(|p| p.translation.vector.iter().any(|x| !x.is_finite()) || !is_unit(p)) {
        return Err(Error::NotFinite { what: format!("path: the pose of sample {i}") });
    }
    let turns: Vec<_> = poses.windows(2).map(|w| (w[0].rotation.inverse() * w[1].rotation).scaled_axis()).collect();
    match turns.iter().position(|t| t.norm() > 0.99 * std::f64::consts::PI) {
        Some(i) => Err(Error::Series {
            what: format!("path: samples {i} and {} are half a turn apart", i + 1),
            remedy: "add samples between them".into(),
        }),
        None => Ok(turns),
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

#[cfg(test)]
mod tests {
    use super::*;

    /// At the border between series and closed form the two agree but for what a step from one to the other makes.
    #[test]
    fn the_series_of_the_jacobian_meets_its_closed_form() {
        let step = 1e-9;
        let ([b, c], [b1, c1]) = jacobian_factors(1e-2 - step);
        let ([bb, cc], [bb1, cc1]) = jacobian_factors(1e-2);
        for (series, closed, slope) in [(b, bb, b1), (c, cc, c1), (b1, bb1, 0.0), (c1, cc1, 0.0)] {
            assert!((series + slope * step - closed).abs() < 1e-11, "{series} {closed}");
        }
    }
}
