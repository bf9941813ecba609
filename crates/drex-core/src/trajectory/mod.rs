//! Time-stamped poses.

mod analysis;

use nalgebra::Vector3;

pub use self::analysis::{Gap, PoseNoise, Speeds, TrackNoise, make_signs_continuous};
use crate::pose::interpolate;
use crate::{Error, Pose, Result};

/// Poses of one body at increasing times of one clock, seconds. Quaternions are sign-continuous by construction
/// of the pose type: use [`crate::pose::pose_difference`], never quaternion entries.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trajectory {
    times_s: Vec<f64>,
    poses: Vec<Pose>,
}

/// Linear (m/s, in the reference frame) and angular (rad/s, in the reference frame) velocity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Twist {
    /// Linear velocity of the tracked origin.
    pub linear: Vector3<f64>,
    /// Angular velocity.
    pub angular: Vector3<f64>,
}

impl Trajectory {
    /// A trajectory from samples in any order: they are sorted by time; of samples with the same time the first stays.
    ///
    /// # Errors
    /// If a time is not finite or there are not as many times as poses.
    pub fn from_samples(times_s: &[f64], poses: &[Pose]) -> Result<Self> {
        if times_s.len() != poses.len() {
            return Err(Error::value(
                format!("{} times but {} poses", times_s.len(), poses.len()),
                "give one time per pose",
            ));
        }
        if let Some(i) = times_s.iter().position(|t| !t.is_finite()) {
            return Err(Error::value(format!("time {i} is not finite"), "remove the sample"));
        }
        let mut order: Vec<usize> = (0..times_s.len()).collect();
        order.sort_by(|&a, &b| times_s[a].total_cmp(&times_s[b]));
        order.dedup_by(|a, b| times_s[*a] == times_s[*b]);
        Ok(Self {
            times_s: order.iter().map(|&i| times_s[i]).collect(),
            poses: order.iter().map(|&i| poses[i]).collect(),
        })
    }

    /// Times in seconds, strictly increasing.
    pub fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// One pose per time.
    pub fn poses(&self) -> &[Pose] {
        &self.poses
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.times_s.len()
    }

    /// Whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.times_s.is_empty()
    }

    /// First and last time; `None` when empty.
    pub fn span_s(&self) -> Option<(f64, f64)> {
        Some((*self.times_s.first()?, *self.times_s.last()?))
    }

    /// The pose at time `t_s`: linear and slerp between neighbours; `None` outside the recorded span.
    pub fn at(&self, t_s: f64) -> Option<Pose> {
        let (first, last) = self.span_s()?;
        if !(t_s >= first && t_s <= last) {
            return None;
        }
        let i = self.times_s.partition_point(|&t| t <= t_s).clamp(1, self.len().max(2) - 1);
        if self.len() == 1 {
            return Some(self.poses[0]);
        }
        let (t0, t1) = (self.times_s[i - 1], self.times_s[i]);
        Some(interpolate(&self.poses[i - 1], &self.poses[i], (t_s - t0) / (t1 - t0)))
    }

    /// The same motion with `offset_s` added to every time.
    pub fn shifted(&self, offset_s: f64) -> Self {
        Self { times_s: self.times_s.iter().map(|t| t + offset_s).collect(), poses: self.poses.clone() }
    }

    /// Every pose with another frame on its left: `c_from_a` turns `a_from_b` into `c_from_b`.
    pub fn left_mul(&self, c_from_a: &Pose) -> Self {
        Self { times_s: self.times_s.clone(), poses: self.poses.iter().map(|p| c_from_a * p).collect() }
    }

    /// Every pose with another frame on its right: `b_from_c` turns `a_from_b` into `a_from_c`.
    pub fn right_mul(&self, b_from_c: &Pose) -> Self {
        Self { times_s: self.times_s.clone(), poses: self.poses.iter().map(|p| p * b_from_c).collect() }
    }

    /// The motion at the given times, interpolated as in [`Trajectory::at`].
    ///
    /// # Errors
    /// If a time is outside the recorded span.
    pub fn resampled(&self, times_s: &[f64]) -> Result<Self> {
        let poses = times_s
            .iter()
            .map(|&t| {
                self.at(t).ok_or_else(|| {
                    let span = self.span_s().map_or("nothing".into(), |(a, b)| format!("{a:.3} to {b:.3} s"));
                    Error::value(
                        format!("time {t:.3} s is outside the recording ({span})"),
                        "ask only for times inside it",
                    )
                })
            })
            .collect::<Result<Vec<_>>>()?;
        Self::from_samples(times_s, &poses)
    }

    /// The motion at a steady `rate_hz` from its first time on.
    ///
    /// # Errors
    /// If the rate is not positive, the trajectory is empty, or it would have more than ten million samples.
    pub fn resampled_at_rate(&self, rate_hz: f64) -> Result<Self> {
        const MOST: f64 = 1e7;
        let Some((first, last)) = self.span_s() else {
            return Err(Error::value("the trajectory is empty", "give one with samples"));
        };
        let steps = ((last - first) * rate_hz).floor();
        if !(rate_hz > 0.0 && rate_hz.is_finite() && steps < MOST) {
            return Err(Error::value(
                format!("a rate of {rate_hz} Hz over {:.3} s", last - first),
                "give a positive rate that makes at most ten million samples",
            ));
        }
        // Rounding may carry the last time a hair beyond the end.
        let times: Vec<f64> = (0..=steps as usize).map(|i| (first + i as f64 / rate_hz).min(last)).collect();
        self.resampled(&times)
    }
}
