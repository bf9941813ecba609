//! The set in training: its Gaussians and what Adam remembers of each.

use crate::optim::{Moments, adam_step};
use crate::train::options::{Rates, TrainOptions};
use crate::{GaussianGradients, Gaussians, Result};

/// Gaussians with the moments of their parameters.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Model {
    pub gaussians: Gaussians,
    pub moments: [Moments; GROUPS],
}

/// Groups of parameters: means, rotations, scales, opacities, colours.
pub(crate) const GROUPS: usize = 5;
const OPACITY: usize = 3;

impl Model {
    pub fn new(gaussians: Gaussians) -> Self {
        let n = gaussians.len();
        let moments = [3, 4, 3, 1, gaussians.sh_stride()].map(|stride| Moments::new(stride, n));
        Self { gaussians, moments }
    }

    pub fn len(&self) -> usize {
        self.gaussians.len()
    }

    /// One step of Adam, `step` 1-based; positions move by `position_rate`, scene units.
    pub fn descend(
        &mut self,
        gradients: &GaussianGradients,
        rates: &Rates,
        position_rate: f32,
        step: u32,
    ) -> Result<()> {
        let g = &mut self.gaussians;
        let mut colour_rates = vec![rates.colour_rest; g.sh_stride()];
        colour_rates[..3].fill(rates.colour);
        let [means, rotations, scales, opacities, colours] = &mut self.moments;
        adam_step(g.means.as_flattened_mut(), gradients.means.as_flattened(), means, &[position_rate; 3], step)?;
        adam_step(
            g.rotations.as_flattened_mut(),
            gradients.rotations.as_flattened(),
            rotations,
            &[rates.rotation; 4],
            step,
        )?;
        adam_step(
            g.log_scales.as_flattened_mut(),
            gradients.log_scales.as_flattened(),
            scales,
            &[rates.scale; 3],
            step,
        )?;
        adam_step(&mut g.logit_opacities, &gradients.logit_opacities, opacities, &[rates.opacity], step)?;
        adam_step(&mut g.sh, &gradients.sh, colours, &colour_rates, step)
    }

    /// Keeps those that are marked.
    pub fn retain(&mut self, keep: &[bool]) {
        if keep.iter().all(|&k| k) {
            return;
        }
        self.gaussians = self.gaussians.filtered(|i| keep[i]);
        for m in &mut self.moments {
            m.retain(keep);
        }
    }

    /// Appends a copy of number `i` with empty moments; gives its index.
    pub fn duplicate(&mut self, i: usize) -> usize {
        let g = &mut self.gaussians;
        let stride = g.sh_stride();
        g.means.push(g.means[i]);
        g.rotations.push(g.rotations[i]);
        g.log_scales.push(g.log_scales[i]);
        g.logit_opacities.push(g.logit_opacities[i]);
        g.sh.extend_from_within(i * stride..(i + 1) * stride);
        g.labels.push(g.labels[i]);
        for m in &mut self.moments {
            m.append_zeros(1);
        }
        self.len() - 1
    }

    /// Makes number `to` a copy of number `from`, moments left as they are.
    pub fn overwrite(&mut self, to: usize, from: usize) {
        let g = &mut self.gaussians;
        let stride = g.sh_stride();
        g.means[to] = g.means[from];
        g.rotations[to] = g.rotations[from];
        g.log_scales[to] = g.log_scales[from];
        g.logit_opacities[to] = g.logit_opacities[from];
        g.sh.copy_within(from * stride..(from + 1) * stride, to * stride);
        g.labels[to] = g.labels[from];
    }

    /// Forgets the moments of number `i`.
    pub fn forget(&mut self, i: usize) {
        for m in &mut self.moments {
            m.zero(i);
        }
    }

    /// Caps every opacity and forgets its moments (Kerbl et al. 2023, section 5.2).
    pub fn reset_opacities(&mut self, most: f32) {
        let logit = logit(most);
        for (i, o) in self.gaussians.logit_opacities.iter_mut().enumerate() {
            *o = o.min(logit);
            self.moments[OPACITY].zero(i);
        }
    }

    /// Adds the derivative of `opacity_weight` mean opacity + `scale_weight` mean scale.
    pub fn add_shrinkage(&self, gradients: &mut GaussianGradients, opacity_weight: f32, scale_weight: f32) {
        let g = &self.gaussians;
        let axes = if g.kind == crate::Kind::Surfel { 2 } else { 3 };
        let n = g.len().max(1) as f32;
        for i in 0..g.len() {
            let o = g.opacity(i);
            gradients.logit_opacities[i] += opacity_weight * o * (1.0 - o) / n;
            for k in 0..axes {
                gradients.log_scales[i][k] += scale_weight * g.log_scales[i][k].exp() / (axes as f32 * n);
            }
        }
    }

    /// Whether every number is finite; else the index of the first Gaussian where one is not.
    pub fn first_not_finite(&self) -> Option<usize> {
        let g = &self.gaussians;
        let stride = g.sh_stride();
        (0..g.len()).find(|&i| {
            let numbers = g.means[i].iter().chain(&g.rotations[i]).chain(&g.log_scales[i]);
            !(numbers.chain(&g.sh[i * stride..(i + 1) * stride]).all(|v| v.is_finite())
                && g.logit_opacities[i].is_finite())
        })
    }
}

/// Logit of a probability.
pub(crate) fn logit(p: f32) -> f32 {
    (p / (1.0 - p)).ln()
}

/// The rate of the positions in scene units.
pub(crate) fn position_rate(options: &TrainOptions, step: u32, extent: f64) -> f32 {
    options.position_rate_at(step) * extent as f32
}
