//! A recorded force: what of it is push, and how wrong it may be.
//!
//! White noise on the samples is carried into the estimate as unknown smooth errors of the force: what is faster hardly
//! moves a body. Their sizes are estimated along with the mass, each with the standard deviation that the noise gives it, so
//! that poses are weighed by what they tell in spite of them.

use drex_core::push::ForceProfile;
use nalgebra::{Point3, Vector3};

use crate::noise;

/// Shapes of errors over all axes, about as many at most.
const MOST: usize = 12;
/// Shapes on one run of samples, at most.
const HIGHEST: usize = 6;

/// A known force at a point of the object.
#[derive(Debug, Clone)]
pub(crate) struct KnownForce {
    pub times_s: Vec<f64>,
    pub forces_n: Vec<Vector3<f64>>,
    /// Where it acts, mesh frame.
    pub point: Point3<f64>,
    /// Errors of one standard deviation.
    pub errors: Vec<ErrorShape>,
}

/// An error of the force over a stretch of time.
#[derive(Debug, Clone)]
pub(crate) struct ErrorShape {
    pub times_s: Vec<f64>,
    pub forces_n: Vec<Vector3<f64>>,
}

impl KnownForce {
    pub(crate) fn new(profile: &ForceProfile) -> Self {
        let noise_n = noise::significant(&profile.forces_n);
        let forces_n = noise::without_idle(&profile.forces_n, noise_n);
        let errors = shapes(&profile.times_s, &forces_n, noise_n);
        Self { times_s: profile.times_s.clone(), forces_n, point: profile.point_in_object, errors }
    }

    /// When it first acts, seconds.
    pub(crate) fn onset_s(&self) -> Option<f64> {
        self.forces_n.iter().position(|f| f.iter().any(|x| *x != 0.0)).and_then(|k| self.times_s.get(k)).copied()
    }
}

/// Smooth shapes on the runs of samples that carry force along an axis: the lowest orthonormal polynomials of each, more of
/// them on longer runs, each times the standard deviation of a sample.
fn shapes(times_s: &[f64], forces_n: &[Vector3<f64>], noise_n: f64) -> Vec<ErrorShape> {
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
    let samples: usize = runs.iter().map(|(_, a, b)| b - a).sum();
    let spare = MOST.saturating_sub(runs.len());
    let mut out = Vec::new();
    for (axis, a, b) in runs {
        let share = 1 + spare * (b - a) / samples.max(1);
        for shape in polynomials(b - a, share.min(HIGHEST)) {
            let mut forces: Vec<_> = shape.iter().map(|x| Vector3::ith(axis, x * noise_n)).collect();
            let mut times = times_s[a..b].to_vec();
            // The last sample holds until the next one.
            if let Some(end) = times_s.get(b) {
                times.push(*end);
                forces.push(Vector3::zeros());
            }
            if times.len() > 1 {
                out.push(ErrorShape { times_s: times, forces_n: forces });
            }
        }
    }
    out
}

/// The first `count` orthonormal polynomials on `n` equally spaced samples.
fn polynomials(n: usize, count: usize) -> Vec<Vec<f64>> {
    let mut out: Vec<Vec<f64>> = Vec::new();
    for order in 0..count.min(n) {
        let x = |k: usize| (2.0 * k as f64 + 1.0) / n as f64 - 1.0;
        let mut p: Vec<f64> = match out.last() {
            // The next lower one times x keeps Gram and Schmidt's method well conditioned.
            Some(last) => last.iter().enumerate().map(|(k, y)| x(k) * y).collect(),
            None => vec![1.0; n],
        };
        for q in out.iter().skip(order.saturating_sub(2)) {
            let along: f64 = p.iter().zip(q).map(|(a, b)| a * b).sum();
            p.iter_mut().zip(q).for_each(|(a, b)| *a -= along * b);
        }
        let norm = p.iter().map(|a| a * a).sum::<f64>().sqrt();
        p.iter_mut().for_each(|a| *a /= norm);
        out.push(p);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_are_orthonormal_and_carry_the_noise_of_the_impulse() {
        let times: Vec<f64> = (0..200).map(|k| 0.01 * f64::from(k)).collect();
        let force = |k: usize| {
            let x = if (20..83).contains(&k) { 1.0 } else { 0.0 };
            Vector3::new(x, 0.0, if (120..127).contains(&k) { -1.0 } else { 0.0 })
        };
        let forces: Vec<_> = (0..200).map(force).collect();
        let out = shapes(&times, &forces, 0.1);
        assert!(out.len() <= MOST && out.len() >= MOST / 2, "{}", out.len());
        let x: Vec<&ErrorShape> = out.iter().filter(|s| s.forces_n[0].x != 0.0).collect();
        for (i, a) in x.iter().enumerate() {
            assert!(a.times_s[0] == times[20] && a.times_s[63] == times[83] && a.forces_n[63].x == 0.0);
            for (j, b) in x.iter().enumerate() {
                let dot: f64 = a.forces_n.iter().zip(&b.forces_n).map(|(a, b)| a.dot(b)).sum();
                assert!((dot - if i == j { 0.01 } else { 0.0 }).abs() < 1e-12, "{i} {j} {dot}");
            }
        }
        // Of the impulse of white noise, the first shape carries all.
        let impulse: f64 = x[0].forces_n.iter().map(|f| 0.01 * f.x).sum();
        assert!((impulse.abs() / (63.0_f64.sqrt() * 0.1 * 0.01) - 1.0).abs() < 1e-9);
        assert!(shapes(&times, &forces, 0.0).is_empty());
    }
}
