//! What a track tells about itself: gaps, velocities, noise, and how long the object rested.

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::{Trajectory, Twist};
use crate::stats::median;

/// MAD of a normal distribution of unit standard deviation.
const MAD_OF_NORMAL: f64 = 0.674_489_750_196_081_7;

/// A stretch without samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gap {
    /// Last time before it, seconds.
    pub start_s: f64,
    /// First time after it, seconds.
    pub end_s: f64,
}

/// Speeds at one sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Speeds {
    /// Speed of the tracked origin, m/s.
    pub linear_m_s: f64,
    /// Rate of rotation, rad/s.
    pub angular_rad_s: f64,
}

/// Standard deviations of the noise of a track, estimated from the track itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackNoise {
    /// Of the position, per axis of the reference frame, metres. A camera's depth is its z.
    pub position_m: Vector3<f64>,
    /// Of the orientation, per axis of the body's rotation vector, radians.
    pub rotation_rad: Vector3<f64>,
}

/// Standard deviations of a pose track.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseNoise {
    /// Per axis, metres.
    pub position_m: f64,
    /// Per axis of the rotation vector, radians.
    pub rotation_rad: f64,
}

impl TrackNoise {
    /// One number for all axes: root mean square.
    pub fn pooled(&self) -> PoseNoise {
        PoseNoise {
            position_m: (self.position_m.norm_squared() / 3.0).sqrt(),
            rotation_rad: (self.rotation_rad.norm_squared() / 3.0).sqrt(),
        }
    }
}

impl Trajectory {
    /// Median time between samples, seconds; `None` with fewer than two.
    pub fn median_step_s(&self) -> Option<f64> {
        median(self.times_s.windows(2).map(|w| w[1] - w[0]))
    }

    /// The stretches between samples that are longer than `factor` times the median step.
    pub fn gaps(&self, factor: f64) -> Vec<Gap> {
        let Some(step) = self.median_step_s() else { return Vec::new() };
        self.times_s
            .windows(2)
            .filter(|w| w[1] - w[0] > factor * step)
            .map(|w| Gap { start_s: w[0], end_s: w[1] })
            .collect()
    }

    /// Velocities at the samples, in the reference frame: the derivative of the parabola through each sample and its
    /// neighbours (central differences for uneven steps), one-sided at the ends. Zero for a single sample.
    pub fn velocities(&self) -> Vec<Twist> {
        let slopes: Vec<(f64, Twist)> = (1..self.len())
            .map(|i| {
                let h = self.times_s[i] - self.times_s[i - 1];
                let (a, b) = (&self.poses[i - 1], &self.poses[i]);
                let linear = (b.translation.vector - a.translation.vector) / h;
                // exp(h ω) R_a = R_b with ω in the reference frame.
                let angular = (b.rotation * a.rotation.inverse()).scaled_axis() / h;
                (h, Twist { linear, angular })
            })
            .collect();
        let still = Twist { linear: Vector3::zeros(), angular: Vector3::zeros() };
        (0..self.len())
            .map(|i| match (i.checked_sub(1).and_then(|k| slopes.get(k)), slopes.get(i)) {
                (Some((h0, s0)), Some((h1, s1))) => {
                    let (w0, w1) = (h1 / (h0 + h1), h0 / (h0 + h1));
                    Twist { linear: s0.linear * w0 + s1.linear * w1, angular: s0.angular * w0 + s1.angular * w1 }
                }
                (Some((_, s)), None) | (None, Some((_, s))) => *s,
                (None, None) => still,
            })
            .collect()
    }

    /// Linear and angular speed at the samples.
    pub fn speeds(&self) -> Vec<Speeds> {
        self.velocities()
            .iter()
            .map(|v| Speeds { linear_m_s: v.linear.norm(), angular_rad_s: v.angular.norm() })
            .collect()
    }

    /// White noise of the track, per axis, from how far each sample lies off the line (geodesic) through its neighbours;
    /// neither outliers nor a short motion move the estimate by much. An acceleration a that lasts for
    /// most of the track adds about a h²/2 for samples h apart. `None` with fewer than five samples.
    pub fn noise(&self) -> Option<TrackNoise> {
        if self.len() < 5 {
            return None;
        }
        let mut offsets: [Vec<f64>; 6] = Default::default();
        for i in 1..self.len() - 1 {
            let (h0, h1) = (self.times_s[i] - self.times_s[i - 1], self.times_s[i + 1] - self.times_s[i]);
            let (w0, w1) = (h1 / (h0 + h1), h0 / (h0 + h1));
            let (a, b, c) = (&self.poses[i - 1], &self.poses[i], &self.poses[i + 1]);
            let position = b.translation.vector - a.translation.vector * w0 - c.translation.vector * w1;
            let middle =
                a.rotation * UnitQuaternion::from_scaled_axis((a.rotation.inverse() * c.rotation).scaled_axis() * w1);
            let rotation = (middle.inverse() * b.rotation).scaled_axis();
            // The variance of the offset is σ² (1 + w0² + w1²).
            let scale = (1.0 + w0 * w0 + w1 * w1).sqrt().recip();
            for k in 0..3 {
                offsets[k].push((position[k] * scale).abs());
                offsets[3 + k].push((rotation[k] * scale).abs());
            }
        }
        let sd = offsets.map(robust_sd);
        Some(TrackNoise {
            position_m: Vector3::new(sd[0], sd[1], sd[2]),
            rotation_rad: Vector3::new(sd[3], sd[4], sd[5]),
        })
    }

    /// How many leading samples show an object at rest, up to `noise`: the index of the first sample from which on
    /// the medians of the next five samples leave the median of all before them by more than `sigmas` standard
    /// deviations of that difference, in any axis. All samples if that never happens; `sigmas` of 6 suits trackers
    /// whose noise is not quite white.
    pub fn leading_rest(&self, noise: &TrackNoise, sigmas: f64) -> usize {
        const WINDOW: usize = 5;
        // Variance of a median over that of a mean, for normal noise.
        const MEDIAN_OVER_MEAN: f64 = std::f64::consts::FRAC_PI_2;
        let Some(first) = self.poses.first() else { return 0 };
        let coordinates: Vec<[f64; 6]> =
            self.poses.iter().map(|p| crate::pose::pose_difference(first, p).into()).collect();
        let sd: Vec<f64> = noise.position_m.iter().chain(&noise.rotation_rad).copied().collect();
        let middle = |range: &[[f64; 6]], k: usize| median(range.iter().map(|c| c[k])).unwrap_or(0.0);
        for i in WINDOW..self.len().saturating_sub(WINDOW - 1) {
            let spread = (MEDIAN_OVER_MEAN * (1.0 / WINDOW as f64 + 1.0 / i as f64)).sqrt();
            let moved = (0..6).any(|k| {
                let step = middle(&coordinates[i..i + WINDOW], k) - middle(&coordinates[..i], k);
                step.abs() > sigmas * sd[k] * spread && step.abs() > f64::EPSILON
            });
            if moved {
                return i;
            }
        }
        self.len()
    }
}

/// Flips signs in a sequence of quaternions w, x, y, z, so that each is on the side of the one before it
/// (dot product not negative). q and -q are the same rotation; files and plots should not jump between them.
pub fn make_signs_continuous(quats_wxyz: &mut [[f64; 4]]) {
    for i in 1..quats_wxyz.len() {
        let before = quats_wxyz[i - 1];
        let dot: f64 = before.iter().zip(&quats_wxyz[i]).map(|(a, b)| a * b).sum();
        if dot < 0.0 {
            for v in &mut quats_wxyz[i] {
                *v = -*v;
            }
        }
    }
}

/// Standard deviation from absolute deviations, most of which are of a normal distribution: the root mean square of those
/// within three standard deviations, starting from the median.
fn robust_sd(deviations: Vec<f64>) -> f64 {
    /// Variance of a unit normal cut off at ±3.
    const CUT_VARIANCE: f64 = 0.973_335;
    let mut sd = median(deviations.clone()).unwrap_or(0.0) / MAD_OF_NORMAL;
    for _ in 0..3 {
        let (sum, count) =
            deviations.iter().filter(|d| **d <= 3.0 * sd).fold((0.0, 0usize), |(sum, n), d| (sum + d * d, n + 1));
        if count > 0 {
            sd = (sum / count as f64 / CUT_VARIANCE).sqrt();
        }
    }
    sd
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pose;

    /// A screw motion: p = (t, t², 0), rotation 0.7 t about a fixed world axis.
    fn screw(times: &[f64]) -> Trajectory {
        let axis = Vector3::new(1.0, 2.0, -0.5).normalize();
        let poses: Vec<Pose> = times
            .iter()
            .map(|&t| {
                let start = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.4, 0.9));
                Pose::from_parts(
                    Vector3::new(t, t * t, 0.0).into(),
                    UnitQuaternion::from_scaled_axis(axis * (0.7 * t)) * start,
                )
            })
            .collect();
        Trajectory::from_samples(times, &poses).unwrap()
    }

    #[test]
    fn velocities_of_a_screw_are_exact_inside_despite_uneven_steps() {
        let times = [0.0, 0.1, 0.15, 0.3, 0.42, 0.5];
        let v = screw(&times).velocities();
        let axis = Vector3::new(1.0, 2.0, -0.5).normalize();
        for i in 1..times.len() - 1 {
            assert!((v[i].linear - Vector3::new(1.0, 2.0 * times[i], 0.0)).norm() < 1e-12, "{i}");
        }
        for twist in &v {
            assert!((twist.angular - axis * 0.7).norm() < 1e-12);
        }
        assert!((screw(&times).speeds()[0].angular_rad_s - 0.7).abs() < 1e-12);
    }

    #[test]
    fn gaps_and_medians() {
        let track = screw(&[0.0, 0.1, 0.2, 0.5, 0.6]);
        assert!((track.median_step_s().unwrap() - 0.1).abs() < 1e-12);
        assert_eq!(track.gaps(2.0), [Gap { start_s: 0.2, end_s: 0.5 }]);
        assert!(Trajectory::default().gaps(1.0).is_empty() && Trajectory::default().velocities().is_empty());
    }

    #[test]
    fn resampling_keeps_the_motion_and_refuses_to_extrapolate() {
        let track = screw(&(0..=20).map(|i| f64::from(i) * 0.05).collect::<Vec<_>>());
        let fine = track.resampled_at_rate(100.0).unwrap();
        assert_eq!(fine.len(), 101);
        for (t, pose) in fine.times_s().iter().zip(fine.poses()) {
            // The rotation is a geodesic, so slerp is exact; the parabola is off by h²/4 at most.
            assert!((pose.translation.y - t * t).abs() <= 0.05f64.powi(2) / 4.0 + 1e-12);
            assert!(pose.rotation.angle_to(&screw(&[*t]).poses()[0].rotation) < 1e-7);
        }
        assert!(track.resampled(&[1.2]).is_err() && track.resampled_at_rate(0.0).is_err());
        assert!(track.resampled_at_rate(f64::NAN).is_err() && track.resampled_at_rate(1e300).is_err());
    }

    #[test]
    fn noise_and_rest_are_found_in_a_track_with_outliers() {
        // Deterministic, nearly normal noise: sums of twelve uniforms of a linear congruential generator.
        let mut state = 7u64;
        let mut normal = || {
            (0..12)
                .map(|_| {
                    state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    (state >> 11) as f64 / (1u64 << 53) as f64
                })
                .sum::<f64>()
                - 6.0
        };
        let (sp, sr) = (0.002, 0.01);
        let (mut times, mut poses) = (Vec::new(), Vec::new());
        for i in 0..400 {
            let t = f64::from(i) / 30.0;
            // Rest until 10 s, then an acceleration of 0.2 m/s².
            let x = 0.1 * (t - 10.0).max(0.0).powi(2);
            let outlier = if i % 37 == 5 { 0.05 } else { 0.0 };
            let p = Vector3::new(x + outlier, 0.0, 0.0) + Vector3::new(normal(), normal(), 3.0 * normal()) * sp;
            let r = Vector3::new(normal(), normal(), normal()) * sr;
            times.push(t);
            poses.push(Pose::from_parts(p.into(), UnitQuaternion::from_scaled_axis(r)));
        }
        let track = Trajectory::from_samples(&times, &poses).unwrap();
        let noise = track.noise().unwrap();
        for (estimate, truth) in noise.position_m.iter().zip([sp, sp, 3.0 * sp]) {
            assert!((estimate / truth - 1.0).abs() < 0.2, "{estimate} against {truth}");
        }
        assert!(noise.rotation_rad.iter().all(|s| (s / sr - 1.0).abs() < 0.2));
        let moving = times[track.leading_rest(&noise, 6.0)];
        assert!((9.8..10.6).contains(&moving), "{moving}");
        let still = Trajectory::from_samples(&times[..300], &poses[..300]).unwrap();
        assert_eq!(still.leading_rest(&noise, 6.0), 300);
    }

    #[test]
    fn signs_follow_the_neighbour() {
        let mut q = [[1.0, 0.0, 0.0, 0.0], [-0.9, 0.1, 0.0, 0.0], [0.8, -0.2, 0.0, 0.0], [-0.7, 0.3, 0.0, 0.0]];
        make_signs_continuous(&mut q);
        assert!(q.iter().all(|q| q[0] > 0.0));
        assert_eq!(q[1], [0.9, -0.1, 0.0, 0.0]);
    }
}
