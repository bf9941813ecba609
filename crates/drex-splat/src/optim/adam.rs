//! Adam (Kingma and Ba 2015, algorithm 1) over flat slices, a learning rate for each number a Gaussian has, with moments that follow
//! Gaussians when they are removed, added or reset.

use rayon::prelude::*;

use crate::{Error, Result};
use drex_core::simd::vectorised;

/// Decay of the first moment.
pub const BETA1: f32 = 0.9;
/// Decay of the second moment.
pub const BETA2: f32 = 0.999;
/// Added to the root of the second moment (Kerbl et al. 2023): far below the gradients of a mean over all pixels.
pub const EPSILON: f32 = 1e-15;

/// Numbers that one task of the parallel loop does.
const CHUNK: usize = 1 << 13;

/// First and second moments of the gradients of a group of parameters, `stride` numbers a Gaussian.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Moments {
    /// Numbers a Gaussian has in this group, for instance 3 for its centre.
    pub stride: usize,
    m: Vec<f32>,
    v: Vec<f32>,
}

impl Moments {
    /// Zeros for `count` Gaussians of `stride` numbers.
    pub fn new(stride: usize, count: usize) -> Self {
        Self { stride, m: vec![0.0; stride * count], v: vec![0.0; stride * count] }
    }

    /// From a checkpoint's [`Moments::m`] and [`Moments::v`].
    ///
    /// # Errors
    /// If the two differ in length, or their length is not a multiple of the stride.
    pub fn from_parts(stride: usize, m: Vec<f32>, v: Vec<f32>) -> Result<Self> {
        if m.len() != v.len() || stride == 0 || !m.len().is_multiple_of(stride) {
            return Err(Error::Training {
                what: format!("{} first and {} second moments for {stride} numbers a Gaussian", m.len(), v.len()),
                remedy: "read a checkpoint that was written whole".into(),
            });
        }
        Ok(Self { stride, m, v })
    }

    /// First moments, Gaussian by Gaussian.
    pub fn m(&self) -> &[f32] {
        &self.m
    }

    /// Second moments, Gaussian by Gaussian.
    pub fn v(&self) -> &[f32] {
        &self.v
    }

    /// First and second moments, Gaussian by Gaussian.
    pub fn slices_mut(&mut self) -> (&mut [f32], &mut [f32]) {
        (&mut self.m, &mut self.v)
    }

    /// Removes the moments of the Gaussians that are not kept; those past the end of `keep` are kept.
    pub fn retain(&mut self, keep: &[bool]) {
        for moments in [&mut self.m, &mut self.v] {
            let mut at = 0..;
            let stride = self.stride.max(1);
            moments.retain(|_| at.next().and_then(|i| keep.get(i / stride)).is_none_or(|keep| *keep));
        }
    }

    /// Adds zeros for `count` Gaussians at the end.
    pub fn append_zeros(&mut self, count: usize) {
        let len = self.m.len() + count * self.stride;
        self.m.resize(len, 0.0);
        self.v.resize(len, 0.0);
    }

    /// Forgets the moments of Gaussian `i`, if there is one.
    pub fn zero(&mut self, i: usize) {
        for moments in [&mut self.m, &mut self.v] {
            let of_i = moments.iter_mut().skip(i.saturating_mul(self.stride)).take(self.stride);
            of_i.for_each(|moment| *moment = 0.0);
        }
    }
}

/// One step `t` (the first is 1) down the gradient `grads` of `params`, with a learning rate for each of the numbers a
/// Gaussian has in this group:
///
/// ```text
/// m = β₁m + (1 - β₁)g    v = β₂v + (1 - β₂)g²    θ -= rate m/(1 - β₁ᵗ) / (√(v/(1 - β₂ᵗ)) + ε)
/// ```
///
/// # Errors
/// If parameters, gradients and moments differ in length, or rates and stride do. Nothing has changed then.
pub fn adam_step(params: &mut [f32], grads: &[f32], moments: &mut Moments, rates: &[f32], t: u32) -> Result<()> {
    if params.len() != grads.len() || params.len() != moments.m.len() || rates.len() != moments.stride {
        return Err(Error::Training {
            what: format!(
                "step {t} of {} parameters, {} a Gaussian, has {} gradients, {} moments and {} rates",
                params.len(),
                moments.stride,
                grads.len(),
                moments.m.len(),
                rates.len()
            ),
            remedy: "change the moments (retain, append_zeros) whenever Gaussians are removed or added".into(),
        });
    }
    let correction = |beta: f32| (1.0 - f64::from(beta).powf(f64::from(t.max(1)))) as f32;
    // The corrections leave the loop: rate m̂ / (√v̂ + ε) = step m / (√v per_root + ε).
    let (by_first, per_root) = (1.0 / correction(BETA1), 1.0 / correction(BETA2).sqrt());
    let chunk = moments.stride * (CHUNK / moments.stride).max(1);
    let steps: Vec<f32> = rates.iter().map(|rate| rate * by_first).cycle().take(chunk).collect();
    let moments = moments.m.par_chunks_mut(chunk).zip(moments.v.par_chunks_mut(chunk));
    let chunks = params.par_chunks_mut(chunk).zip(grads.par_chunks(chunk)).zip(moments);
    chunks.for_each(|((params, grads), (m, v))| {
        vectorised(
            #[inline(always)]
            || {
                let moments = m.iter_mut().zip(v.iter_mut());
                for (((p, g), (m, v)), step) in params.iter_mut().zip(grads).zip(moments).zip(&steps) {
                    let first = BETA1 * *m + (1.0 - BETA1) * g;
                    // Unseen Gaussians' moments shrink for ever; subnormal numbers would slow every step down.
                    *m = if first.abs() < f32::MIN_POSITIVE { 0.0 } else { first };
                    *v = BETA2 * *v + (1.0 - BETA2) * g * g;
                    *p -= step * *m / (v.sqrt() * per_root + EPSILON);
                }
            },
        );
    });
    Ok(())
}
