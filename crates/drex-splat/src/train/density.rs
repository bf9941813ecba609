//! Birth and death of Gaussians: adaptive density control, and Markov chain Monte Carlo.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use rand::{Rng, RngExt};

use crate::train::model::{Model, logit};
use crate::train::options::{Adaptive, Mcmc};
use crate::{GaussianGradients, Kind};

/// What densification has seen since the last time.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Statistics {
    /// Sum of the length of the gradient by the projected centre, image from -1 to 1.
    pub gradient: Vec<f32>,
    /// In how many steps each was drawn.
    pub seen: Vec<u32>,
}

/// What a densification did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Change {
    pub born: usize,
    pub removed: usize,
}

impl Statistics {
    pub fn new(n: usize) -> Self {
        Self { gradient: vec![0.0; n], seen: vec![0; n] }
    }

    /// Adds one step at an image of `width` x `height` pixels.
    pub fn add(&mut self, gradients: &GaussianGradients, absolute: bool, width: usize, height: usize) {
        let (half_width, half_height) = (width as f32 / 2.0, height as f32 / 2.0);
        let by_centre = if absolute { &gradients.abs_mean2d } else { &gradients.mean2d };
        for (i, g) in by_centre.iter().enumerate().filter(|&(i, _)| gradients.radius[i] > 0.0) {
            self.gradient[i] += (g[0] * half_width).hypot(g[1] * half_height);
            self.seen[i] += 1;
        }
    }

    fn mean(&self, i: usize) -> f32 {
        if self.seen[i] == 0 { 0.0 } else { self.gradient[i] / self.seen[i] as f32 }
    }
}

/// Clones small Gaussians and splits large ones where the picture pulls at them, removes transparent ones, and large
/// ones if `prune_large` (Kerbl et al. 2023, section 5.2). At most `most` are left; those that are pulled most go first.
pub(crate) fn adapt(
    model: &mut Model,
    statistics: &Statistics,
    options: &Adaptive,
    (extent, most, prune_large): (f64, usize, bool),
    rng: &mut impl Rng,
) -> Change {
    let n = model.len();
    let extent = extent as f32;
    let mut candidates: Vec<usize> = (0..n).filter(|&i| statistics.mean(i) > options.gradient).collect();
    candidates.sort_by(|&a, &b| statistics.mean(b).total_cmp(&statistics.mean(a)).then(a.cmp(&b)));
    candidates.truncate(most.saturating_sub(n));
    candidates.sort_unstable();
    let mut keep = vec![true; n];
    let mut born = 0;
    for i in candidates {
        if largest_scale(model, i) <= options.clone_below * extent {
            model.duplicate(i);
            born += 1;
        } else {
            for _ in 0..2 {
                let child = model.duplicate(i);
                split_child(model, child, rng);
            }
            keep[i] = false;
            born += 2;
        }
    }
    keep.resize(model.len(), true);
    for i in 0..model.len() {
        let too_large = prune_large && largest_scale(model, i) > options.prune_scale * extent;
        if model.gaussians.opacity(i) < options.prune_opacity || too_large {
            keep[i] = false;
        }
    }
    let removed = keep.iter().filter(|&&k| !k).count();
    model.retain(&keep);
    Change { born, removed }
}

/// Moves a copy to a place drawn from the Gaussian it came from and shrinks it by 1.6.
fn split_child(model: &mut Model, i: usize, rng: &mut impl Rng) {
    let offset = axes_times(model, i, |s| s, normal3(rng));
    let g = &mut model.gaussians;
    for k in 0..3 {
        g.means[i][k] += offset[k];
        g.log_scales[i][k] -= 1.6_f32.ln();
    }
}

/// Moves dead Gaussians to live ones and lets the set grow, both without changing what is drawn (Kheradmand et al.
/// 2024, section 3.3 and appendix; the new opacity and scale of N copies at one place).
pub(crate) fn relocate(model: &mut Model, options: &Mcmc, most: usize, rng: &mut impl Rng) -> Change {
    let n = model.len();
    let opacity = |model: &Model, i: usize| model.gaussians.opacity(i);
    let dead: Vec<usize> = (0..n).filter(|&i| !(opacity(model, i) > options.min_opacity)).collect();
    let mut change = Change::default();
    if dead.len() < n {
        let live: Vec<usize> = (0..n).filter(|&i| opacity(model, i) > options.min_opacity).collect();
        let sources = draw(model, &live, dead.len(), rng);
        share_out(model, &sources, options.min_opacity);
        for (&to, &from) in dead.iter().zip(&sources) {
            model.overwrite(to, from);
        }
        change.removed = dead.len();
    }
    let grown = ((n as f32 * (1.0 + options.growth)) as usize).min(most).saturating_sub(n);
    let all: Vec<usize> = (0..n).collect();
    let sources = draw(model, &all, grown, rng);
    share_out(model, &sources, options.min_opacity);
    for &from in &sources {
        model.duplicate(from);
    }
    change.born = sources.len();
    change
}

/// `count` of `from`, drawn with probability proportional to their opacity.
fn draw(model: &Model, from: &[usize], count: usize, rng: &mut impl Rng) -> Vec<usize> {
    let mut sums = Vec::with_capacity(from.len());
    let mut total = 0.0_f64;
    for &i in from {
        total += f64::from(model.gaussians.opacity(i));
        sums.push(total);
    }
    if from.is_empty() || !(total > 0.0) {
        return Vec::new();
    }
    (0..count)
        .map(|_| {
            let at = rng.random::<f64>() * total;
            from[sums.partition_point(|&s| s <= at).min(from.len() - 1)]
        })
        .collect()
}

/// Gives each source the opacity and scale that it and its copies need to look, together, as it did.
fn share_out(model: &mut Model, sources: &[usize], min_opacity: f32) {
    let mut sorted = sources.to_vec();
    sorted.sort_unstable();
    for group in sorted.chunk_by(|a, b| a == b) {
        let i = group[0];
        let copies = (group.len() + 1).min(51);
        let o = f64::from(model.gaussians.opacity(i));
        let (shared, factor) = shared_opacity_and_scale(o, copies);
        let shared = (shared as f32).clamp(min_opacity, 1.0 - f32::EPSILON);
        model.gaussians.logit_opacities[i] = logit(shared);
        for s in &mut model.gaussians.log_scales[i] {
            *s += factor.ln() as f32;
        }
        model.forget(i);
    }
}

/// Opacity o' of each of N equal Gaussians that together let through as much as one of opacity o, and the factor on
/// their scale (Kheradmand et al. 2024, eq. 9): o' = 1 - (1 - o)^(1/N), s'/s = o / Σ_i Σ_k C(i-1, k) (-1)^k o'^(k+1) / √(k+1).
fn shared_opacity_and_scale(o: f64, copies: usize) -> (f64, f64) {
    let shared = 1.0 - (1.0 - o).powf(1.0 / copies as f64);
    let mut sum = 0.0;
    for i in 1..=copies {
        let mut binomial = 1.0;
        for k in 0..i {
            let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
            sum += binomial * sign * shared.powi(k as i32 + 1) / ((k + 1) as f64).sqrt();
            binomial *= (i - 1 - k) as f64 / (k + 1) as f64;
        }
    }
    (shared, if sum > 0.0 { o / sum } else { 1.0 })
}

/// Moves every position by noise shaped like its Gaussian, strong where the opacity is low (Kheradmand et al. 2024,
/// eq. 8).
pub(crate) fn shake(model: &mut Model, options: &Mcmc, position_rate: f32, rng: &mut impl Rng) {
    let strength = options.noise * position_rate;
    for i in 0..model.len() {
        let noise = normal3(rng);
        let o = model.gaussians.opacity(i);
        let gate = 1.0 / (1.0 + (100.0 * (o - options.min_opacity)).exp());
        if gate < 1e-6 {
            continue; // moves less than a millionth of what the noise would
        }
        let moved = covariance_times(model, i, noise * (strength * gate));
        for k in 0..3 {
            model.gaussians.means[i][k] += moved[k];
        }
    }
}

fn largest_scale(model: &Model, i: usize) -> f32 {
    let s = model.gaussians.log_scales[i];
    let third = if model.gaussians.kind == Kind::Surfel { f32::NEG_INFINITY } else { s[2] };
    s[0].max(s[1]).max(third).exp()
}

/// R diag(f(s)) x: a vector given along the splat's axes, in the world.
fn axes_times(model: &Model, i: usize, f: impl Fn(f32) -> f32, x: Vector3<f32>) -> Vector3<f32> {
    let g = &model.gaussians;
    let [w, a, b, c] = g.rotations[i];
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, a, b, c));
    let mut scales = g.log_scales[i].map(|s| f(s.exp()));
    if g.kind == Kind::Surfel {
        scales[2] = 0.0;
    }
    rotation * Vector3::new(scales[0] * x.x, scales[1] * x.y, scales[2] * x.z)
}

/// Σ x = R diag(s²) Rᵀ x.
fn covariance_times(model: &Model, i: usize, x: Vector3<f32>) -> Vector3<f32> {
    let [w, a, b, c] = model.gaussians.rotations[i];
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, a, b, c));
    axes_times(model, i, |s| s * s, rotation.inverse() * x)
}

/// Three independent standard normal numbers.
fn normal3(rng: &mut impl Rng) -> Vector3<f32> {
    let mut pair = || drex_core::stats::normal_pair(rng.random(), std::f32::consts::TAU * rng.random::<f32>());
    let ([x, y], [z, _]) = (pair(), pair());
    Vector3::new(x, y, z)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)] // tests say what is wrong by failing
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::train::init::from_points;

    fn model(n: usize) -> Model {
        let points: Vec<[f64; 3]> = (0..n).map(|i| [i as f64, (i * i % 7) as f64, (i % 3) as f64]).collect();
        Model::new(from_points(&points, &vec![[100; 3]; n], Kind::Ellipsoid, 1, 0.5))
    }

    #[test]
    fn shared_opacity_lets_through_what_one_did() {
        for (o, n) in [(0.9, 2), (0.5, 5), (0.99, 51), (0.01, 3)] {
            let (shared, factor) = shared_opacity_and_scale(o, n);
            assert!(((1.0 - shared).powi(n as i32) - (1.0 - o)).abs() < 1e-12);
            assert!(factor > 0.0 && factor <= 1.0 + 1e-9, "{o} {n}: {factor}");
        }
        // Two copies, by hand: sum = 2 o' - o'²/√2, o' = 1 - √(1 - o).
        let (shared, factor) = shared_opacity_and_scale(0.75, 2);
        assert!((shared - 0.5).abs() < 1e-12);
        assert!((factor - 0.75 / (1.0 - 0.25 / 2.0_f64.sqrt())).abs() < 1e-12);
    }

    #[test]
    fn adaptive_clones_small_splits_large_and_prunes() {
        let mut m = model(10);
        for (i, s) in m.gaussians.log_scales.iter_mut().enumerate() {
            *s = [if i == 3 { 1.0_f32 } else { 0.001 }.ln(); 3];
        }
        m.gaussians.logit_opacities[7] = logit(0.001);
        let mut statistics = Statistics::new(10);
        for i in [2, 3] {
            statistics.gradient[i] = 1.0;
            statistics.seen[i] = 10;
        }
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let change = adapt(&mut m, &statistics, &Adaptive::default(), (10.0, 100, false), &mut rng);
        assert_eq!(change, Change { born: 3, removed: 2 });
        assert_eq!(m.len(), 11);
        let large = m.gaussians.log_scales.iter().filter(|s| (s[0].exp() - 1.0 / 1.6).abs() < 1e-6).count();
        assert_eq!(large, 2);
        assert!(m.moments.iter().all(|x| x.m().len() == 11 * x.stride));
    }

    #[test]
    fn relocation_keeps_the_count_and_growth_is_capped() {
        let mut m = model(100);
        for i in 0..30 {
            m.gaussians.logit_opacities[i] = logit(0.001);
        }
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let change = relocate(&mut m, &Mcmc::default(), 103, &mut rng);
        assert_eq!(change, Change { born: 3, removed: 30 });
        assert_eq!(m.len(), 103);
        assert!((0..103).all(|i| m.gaussians.opacity(i) > 0.0049));
        assert!(m.gaussians.check().is_ok());
    }

    #[test]
    fn a_set_of_dead_gaussians_does_not_panic() {
        let mut m = model(4);
        m.gaussians.logit_opacities.fill(f32::NEG_INFINITY);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        assert_eq!(relocate(&mut m, &Mcmc::default(), 100, &mut rng), Change::default());
    }

    #[test]
    fn noise_has_the_shape_of_the_gaussian() {
        let mut m = model(2);
        m.gaussians.rotations[0] = [0.8, 0.6, 0.0, 0.0]; // about x
        m.gaussians.log_scales[0] = [0.0, 0.5_f32.ln(), 0.25_f32.ln()];
        let q = UnitQuaternion::from_quaternion(Quaternion::new(0.8_f32, 0.6, 0.0, 0.0)).to_rotation_matrix();
        let d = nalgebra::Matrix3::from_diagonal(&Vector3::new(1.0, 0.25, 0.0625));
        let x = Vector3::new(0.3, -0.2, 0.9);
        let expected = q.matrix() * d * q.matrix().transpose() * x;
        assert!((covariance_times(&m, 0, x) - expected).norm() < 1e-6);
    }
}
