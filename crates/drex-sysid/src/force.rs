//! A recorded force: what of it is push, and how wrong it may be.
//!
//! White noise on the samples is carried into the estimate as unknown smooth errors of the force: what is faster hardly
//! moves a body. Their sizes are estimated along with the mass, each with the standard deviation that the noise gives it, so
//! that poses are weighed by what they tell in spite of them. One error no pose can tell: a factor on the whole force moves
//! everything as the same factor on the mass does. Noise of deviation s on samples u has such a part, of the relative size
//! s / |u|; it goes straight into the interval.

use std::ops::Range;

use drex_recording::ForceProfile;
use nalgebra::{Point3, Vector3};
use rand_chacha::ChaCha8Rng;

use crate::noise::{self, normal};

/// Shapes of errors over all axes, about as many at most.
const MOST: usize = 12;
/// Shapes on one run of samples, at most.
const HIGHEST: usize = 6;

/// A known force at a point of the object.
#[derive(Debug, Clone)]
pub(crate) struct KnownForce {
    pub times_s: Vec<f64>,
    pub forces_n: Vec<Vector3<f64>>,
    /// Torque about the point, per sample; empty without one. Its noise is not modelled.
    pub torques_nm: Vec<Vector3<f64>>,
    /// Where it acts, mesh frame.
    pub point: Point3<f64>,
    /// Standard deviation of the noise of a sample, newtons; zero without noise.
    pub noise_n: f64,
    /// The same as a factor on the whole force.
    pub factor_sd: f64,
    /// Other errors, of one standard deviation each.
    pub errors: Vec<Vec<Vector3<f64>>>,
}

impl KnownForce {
    pub(crate) fn new(profile: &ForceProfile) -> Self {
        let noise_n = noise::significant(&profile.forces_n);
        let forces_n = noise::without_idle(&profile.forces_n, noise_n);
        let runs = runs(&forces_n);
        let forces_n = with_crosswise(&profile.forces_n, forces_n, &runs);
        let errors = shapes(&forces_n, &runs, noise_n);
        let size = forces_n.iter().map(Vector3::norm_squared).sum::<f64>().sqrt();
        let factor_sd = if size > 0.0 { noise_n / size } else { 0.0 };
        let torques_nm = noise::without_idle(&profile.torques_nm, noise::significant(&profile.torques_nm));
        Self {
            times_s: profile.times_s.clone(),
            forces_n,
            torques_nm,
            point: profile.point_in_object,
            noise_n,
            factor_sd,
            errors,
        }
    }

    /// As much noise as the record has, where the force acts, across as along, and without what the error shapes make up; empty without
    /// noise.
    pub(crate) fn noise(&self, sign: f64, random: &mut ChaCha8Rng) -> Vec<Vector3<f64>> {
        if self.noise_n == 0.0 {
            return Vec::new();
        }
        let size = sign * self.noise_n;
        let acts = |x: f64| if x == 0.0 { 0.0 } else { 1.0 };
        let mut noise: Vec<Vector3<f64>> =
            self.forces_n.iter().map(|f| f.map(|x| acts(x) * size * normal(random))).collect();
        for shape in std::iter::once(&self.forces_n).chain(&self.errors) {
            let dot = |a: &[Vector3<f64>]| a.iter().zip(shape).map(|(a, b)| a.dot(b)).sum::<f64>();
            let along = dot(&noise) / dot(shape).max(f64::MIN_POSITIVE);
            noise.iter_mut().zip(shape).for_each(|(n, s)| *n -= s * along);
        }
        noise
    }

    /// The samples with errors of the sizes `sizes` and with `noise`.
    pub(crate) fn with(&self, sizes: &[f64], noise: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let mut out = self.forces_n.clone();
        out.iter_mut().zip(noise).for_each(|(f, n)| *f += n);
        for (shape, size) in self.errors.iter().zip(sizes).filter(|(_, s)| **s != 0.0) {
            out.iter_mut().zip(shape).for_each(|(f, e)| *f += e * *size);
        }
        out
    }

    /// When it first acts, seconds.
    pub(crate) fn onset_s(&self) -> Option<f64> {
        let first = |samples: &[Vector3<f64>]| samples.iter().position(|f| f.iter().any(|x| *x != 0.0));
        let k = first(&self.forces_n).into_iter().chain(first(&self.torques_nm)).min();
        k.and_then(|k| self.times_s.get(k)).copied()
    }
}

/// Samples one after another that carry force along an axis.
#[derive(Debug, Clone)]
struct Run {
    axis: usize,
    samples: Range<usize>,
    /// Axes that carry none meanwhile.
    across: Vec<usize>,
}

fn runs(forces_n: &[Vector3<f64>]) -> Vec<Run> {
    let mut out = Vec::new();
    for axis in 0..3 {
        let mut from = None;
        for k in 0..=forces_n.len() {
            let acts = forces_n.get(k).is_some_and(|f| f[axis] != 0.0);
            match (from, acts) {
                (None, true) => from = Some(k),
                (Some(a), false) => {
                    let is_idle = |o: &usize| *o != axis && forces_n[a..k].iter().all(|f| f[*o] == 0.0);
                    out.push(Run { axis, samples: a..k, across: (0..3).filter(is_idle).collect() });
                    from = None;
                }
                _ => {}
            }
        }
    }
    out
}

/// The force with what the record shows beside its direction: across a run, as much of the same profile as fits the samples there.
fn with_crosswise(recorded: &[Vector3<f64>], mut forces_n: Vec<Vector3<f64>>, runs: &[Run]) -> Vec<Vector3<f64>> {
    for run in runs {
        let profile: Vec<f64> = forces_n[run.samples.clone()].iter().map(|f| f[run.axis]).collect();
        let size: f64 = profile.iter().map(|x| x * x).sum();
        for &o in &run.across {
            let share = profile.iter().zip(&recorded[run.samples.clone()]).map(|(p, f)| p * f[o]).sum::<f64>() / size;
            forces_n[run.samples.clone()].iter_mut().zip(&profile).for_each(|(f, p)| f[o] += share * p);
        }
    }
    forces_n
}

/// Smooth shapes on the runs of samples that carry force along an axis: the lowest orthonormal polynomials of each, more of
/// them on longer runs, without the part that is a factor on the whole force, and another direction of the run; each times the
/// standard deviation of a sample.
fn shapes(forces_n: &[Vector3<f64>], runs: &[Run], noise_n: f64) -> Vec<Vec<Vector3<f64>>> {
    if noise_n == 0.0 {
        return Vec::new();
    }
    let samples: usize = runs.iter().map(|r| r.samples.len()).sum();
    let spare = MOST.saturating_sub(runs.len());
    let mut found: Vec<Vec<Vector3<f64>>> = Vec::new();
    let mut basis = vec![forces_n.to_vec()];
    normalize(&mut basis[0]);
    for run in runs {
        let n = run.samples.len();
        let share = 1 + spare * n / samples.max(1);
        let along = polynomials(n, share.min(HIGHEST)).into_iter().map(|p| (run.axis, p));
        let profile: Vec<f64> = forces_n[run.samples.clone()].iter().map(|f| f[run.axis]).collect();
        for (axis, shape) in along.chain(run.across.iter().map(|o| (*o, profile.clone()))) {
            let mut whole = vec![Vector3::zeros(); forces_n.len()];
            whole[run.samples.clone()].iter_mut().zip(&shape).for_each(|(f, x)| f[axis] = *x);
            normalize(&mut whole);
            // Twice is enough (Parlett, The Symmetric Eigenvalue Problem, 6.9).
            for other in basis.iter().chain(&basis) {
                let along: f64 = whole.iter().zip(other).map(|(a, b)| a.dot(b)).sum();
                whole.iter_mut().zip(other).for_each(|(a, b)| *a -= b * along);
            }
            // What is left of one that the others make up is rounding.
            if normalize(&mut whole) > 1e-3 {
                found.push(whole.clone());
                basis.push(whole);
            }
        }
    }
    found.iter_mut().flatten().for_each(|f| *f *= noise_n);
    found
}

/// Scales a series to length one; returns its length.
fn normalize(series: &mut [Vector3<f64>]) -> f64 {
    let size = series.iter().map(Vector3::norm_squared).sum::<f64>().sqrt();
    if size > 0.0 {
        series.iter_mut().for_each(|f| *f /= size);
    }
    size
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
    fn shapes_are_orthonormal_and_none_is_a_factor_on_the_force() {
        let force = |k: usize| {
            let x = if (20..83).contains(&k) { 1.0 + 0.01 * k as f64 } else { 0.0 };
            Vector3::new(x, 0.0, if (120..127).contains(&k) { -1.0 } else { 0.0 })
        };
        let forces: Vec<_> = (0..200).map(force).collect();
        let out = shapes(&forces, &runs(&forces), 0.1);
        // Six for the run of 63 samples, two for that of 7, two directions of each; the factor on the force may be one of them.
        assert!((11..=12).contains(&out.len()), "{}", out.len());
        let dot = |a: &[Vector3<f64>], b: &[Vector3<f64>]| a.iter().zip(b).map(|(a, b)| a.dot(b)).sum::<f64>();
        for (i, a) in out.iter().enumerate() {
            assert!(dot(a, &forces).abs() < 1e-9);
            assert!(a[..20].iter().chain(&a[127..]).all(|f| f.norm() == 0.0));
            for (j, b) in out.iter().enumerate() {
                let expected = if i == j { 0.01 } else { 0.0 };
                assert!((dot(a, b) - expected).abs() < 1e-9, "{i} {j}");
            }
        }
        assert!(shapes(&forces, &runs(&forces), 0.0).is_empty());
    }
}
