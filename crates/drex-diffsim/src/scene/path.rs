//! Prescribed motion.

use drex_core::Pose;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

use super::check_series;
use crate::{Result, SimError};

/// How a path goes from one pose to the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Blend {
    /// At constant velocity: for dense samples.
    Linear,
    /// From rest to rest with the least jerk: s = 10 x³ - 15 x⁴ + 6 x⁵ (Flash and Hogan 1985).
    Stops,
}

/// Poses over time; the first holds before, the last after.
#[derive(Debug, Clone)]
pub struct Path {
    times_s: Vec<f64>,
    poses: Vec<Pose>,
    /// Rotation vector in the world from each pose to the next.
    turns: Vec<Vector3<f64>>,
    blend: Blend,
}

/// Where a path is, how fast, and what speeds it up. Velocities are those of the frame's origin, in the world.
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
    /// Constant velocity between samples: for a recorded motion.
    ///
    /// # Errors
    /// If the numbers of samples differ, times do not increase or a number is not finite.
    pub fn linear(times_s: &[f64], poses: &[Pose]) -> Result<Self> {
        Self::new(times_s, poses, Blend::Linear)
    }

    /// At rest at every sample, with the least jerk in between: for a planned motion.
    ///
    /// # Errors
    /// As [`Path::linear`].
    pub fn stops(times_s: &[f64], poses: &[Pose]) -> Result<Self> {
        Self::new(times_s, poses, Blend::Stops)
    }

    fn new(times_s: &[f64], poses: &[Pose], blend: Blend) -> Result<Self> {
        check_series("path", times_s, poses.len())?;
        let finite = |p: &Pose| p.translation.vector.iter().chain(p.rotation.coords.iter()).all(|x| x.is_finite());
        if let Some(i) = poses.iter().position(|p| !finite(p)) {
            return Err(SimError::NotFinite { what: format!("pose {i} of a path") });
        }
        let turns = poses.windows(2).map(|w| (w[1].rotation * w[0].rotation.inverse()).scaled_axis()).collect();
        Ok(Self { times_s: times_s.to_vec(), poses: poses.to_vec(), turns, blend })
    }

    /// The motion at time t.
    pub fn at(&self, t: f64) -> Motion {
        let k = self.times_s.partition_point(|&s| s <= t);
        let zero = Vector3::zeros();
        if k == 0 || k == self.times_s.len() {
            let pose = self.poses[k.saturating_sub(1)];
            return Motion { pose, velocity: zero, angular_velocity: zero, acceleration: zero, angular_acceleration: zero };
        }
        let (a, b) = (&self.poses[k - 1], &self.poses[k]);
        let span = self.times_s[k] - self.times_s[k - 1];
        let x = (t - self.times_s[k - 1]) / span;
        let (s, ds, dds) = match self.blend {
            Blend::Linear => (x, 1.0, 0.0),
            Blend::Stops => (
                x * x * x * (10.0 - x * (15.0 - 6.0 * x)),
                30.0 * x * x * (1.0 - x) * (1.0 - x),
                60.0 * x * (1.0 - x) * (1.0 - 2.0 * x),
            ),
        };
        let (way, turn) = (b.translation.vector - a.translation.vector, self.turns[k - 1]);
        let point = Point3::from(a.translation.vector + way * s);
        let rotation = UnitQuaternion::from_scaled_axis(turn * s) * a.rotation;
        Motion {
            pose: Pose::from_parts(Translation3::from(point.coords), rotation),
            velocity: way * (ds / span),
            angular_velocity: turn * (ds / span),
            acceleration: way * (dds / (span * span)),
            angular_acceleration: turn * (dds / (span * span)),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)] // a test may panic
mod tests {
    use super::*;

    #[test]
    fn velocities_and_accelerations_are_those_of_the_poses() {
        let poses = [
            Pose::identity(),
            Pose::from_parts(Translation3::new(0.1, -0.2, 0.3), UnitQuaternion::from_euler_angles(0.3, -0.4, 1.0)),
            Pose::from_parts(Translation3::new(0.0, 0.2, 0.1), UnitQuaternion::from_euler_angles(0.1, 0.4, 1.5)),
        ];
        for path in [Path::linear(&[0.0, 0.5, 1.5], &poses).unwrap(), Path::stops(&[0.0, 0.5, 1.5], &poses).unwrap()] {
            for t in [0.1, 0.35, 0.7, 1.2] {
                let h = 1e-4;
                let (m, p, n) = (path.at(t - h), path.at(t), path.at(t + h));
                let v = (n.pose.translation.vector - m.pose.translation.vector) / (2.0 * h);
                let w = (n.pose.rotation * m.pose.rotation.inverse()).scaled_axis() / (2.0 * h);
                assert!((v - p.velocity).norm() < 1e-6 && (w - p.angular_velocity).norm() < 1e-6);
                let a = (n.velocity - m.velocity) / (2.0 * h);
                let alpha = (n.angular_velocity - m.angular_velocity) / (2.0 * h);
                assert!((a - p.acceleration).norm() < 1e-5 && (alpha - p.angular_acceleration).norm() < 1e-5);
            }
            assert_eq!(path.at(-1.0).pose, poses[0]);
            assert_eq!(path.at(2.0).velocity, Vector3::zeros());
        }
        let stops = Path::stops(&[0.0, 0.5, 1.5], &poses).unwrap();
        assert!(stops.at(0.5 - 1e-9).velocity.norm() < 1e-6 && stops.at(0.5 + 1e-9).velocity.norm() < 1e-6);
        assert!(Path::linear(&[0.0, 0.0], &poses[..2]).is_err() && Path::linear(&[], &[]).is_err());
    }
}
