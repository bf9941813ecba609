//! A recorded force: what of it is push, and how wrong it may be.
//!
//! White noise on the samples is carried into the estimate as unknown errors of the mean force over short stretches: what is
//! faster than a stretch hardly moves a body. They are estimated along with the mass, each with the standard deviation
//! that the noise gives it, so that poses are weighed by what they tell in spite of them.

use drex_core::push::ForceProfile;
use nalgebra::{Point3, Vector3};

use crate::noise;

/// Stretches over all axes, at most.
const MOST: usize = 16;

/// A known force at a point of the object.
#[derive(Debug, Clone)]
pub(crate) struct KnownForce {
    pub times_s: Vec<f64>,
    pub forces_n: Vec<Vector3<f64>>,
    /// Where it acts, mesh frame.
    pub point: Point3<f64>,
    /// Errors of one standard deviation.
    pub errors: Vec<Stretch>,
}

/// A constant error of the force along one axis for a while; nothing before and after.
#[derive(Debug, Clone)]
pub(crate) struct Stretch {
    pub times_s: [f64; 2],
    pub force_n: Vector3<f64>,
}

impl KnownForce {
    pub(crate) fn new(profile: &ForceProfile) -> Self {
        let noise_n = noise::significant(&profile.forces_n);
        let forces_n = noise::without_idle(&profile.forces_n, noise_n);
        let errors = stretches(&profile.times_s, &forces_n, noise_n);
        Self { times_s: profile.times_s.clone(), forces_n, point: profile.point_in_object, errors }
    }

    /// When it first acts, seconds.
    pub(crate) fn onset_s(&self) -> Option<f64> {
        self.forces_n.iter().position(|f| f.iter().any(|x| *x != 0.0)).and_then(|k| self.times_s.get(k)).copied()
    }
}

/// Runs of samples that carry force along an axis, cut into pieces of about equal length.
fn stretches(times_s: &[f64], forces_n: &[Vector3<f64>], noise_n: f64) -> Vec<Stretch> {
    if noise_n == 0.0 {
        return Vec::new();
    }
    let mut runs: Vec<(usize, usize, usize)> = Vec::new();
    for axis in 0..3 {
        let mut from = None;
        for k in 0..=forces_n.len() {
            let acts = forces_n.get(k).is_some_and(|f| f[axis] != 0.0);
            match (from, acts) {
                (None, true) => from = Some(k),
                (Some(a), false) => {
                    runs.push((axis, a, k));
                    from = None;
                }
                _ => {}
            }
        }
    }
    let pieces = |length: usize| runs.iter().map(|(_, a, b)| (b - a).div_ceil(length)).sum::<usize>();
    let longest = forces_n.len().max(1);
    let length = (3..=longest).find(|&l| pieces(l) <= MOST).unwrap_or(longest);
    let mut out = Vec::new();
    for (axis, a, b) in runs {
        let count = (b - a).div_ceil(length);
        for i in 0..count {
            let (from, to) = (a + (b - a) * i / count, a + (b - a) * (i + 1) / count);
            let end = times_s.get(to).or(times_s.last());
            if let (Some(&start), Some(&end)) = (times_s.get(from), end)
                && end > start
            {
                let sd = noise_n / ((to - from) as f64).sqrt();
                out.push(Stretch { times_s: [start, end], force_n: Vector3::ith(axis, sd) });
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stretches_cover_what_acts_and_carry_its_noise() {
        let times: Vec<f64> = (0..200).map(|k| 0.01 * f64::from(k)).collect();
        let force = |k: usize| if (20..83).contains(&k) { Vector3::x() } else { Vector3::zeros() };
        let forces: Vec<_> = (0..200).map(force).collect();
        let out = stretches(&times, &forces, 0.1);
        assert!(out.len() <= MOST && out.len() >= MOST / 2, "{}", out.len());
        assert!((out[0].times_s[0] - 0.2).abs() < 1e-12 && (out[out.len() - 1].times_s[1] - 0.83).abs() < 1e-12);
        assert!(out.windows(2).all(|w| w[0].times_s[1] == w[1].times_s[0]));
        // The variance of the whole impulse is that of its samples.
        let variance: f64 = out.iter().map(|s| ((s.times_s[1] - s.times_s[0]) * s.force_n.x).powi(2)).sum();
        assert!((variance / (63.0 * (0.1_f64 * 0.01).powi(2)) - 1.0).abs() < 1e-9);
        assert!(stretches(&times, &forces, 0.0).is_empty());
    }
}
