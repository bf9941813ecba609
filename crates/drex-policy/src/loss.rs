//! What is minimised, and its derivatives with respect to the network's outputs. Plain f64: the network only multiplies matrices.

use crate::density::{TAIL, log_student, log_sum_exp};
use crate::norm::STRETCH;
use crate::weights::Layout;

/// Two columns of a rotation by θ differ by |Δ|² = 4/3 θ² on average over axes.
const COLUMNS: f64 = 0.75;

/// One over the square of a tenth of the length.
const NEAR: f64 = 100.0;

/// Constants of the outputs and of the loss.
#[derive(Debug, Clone)]
pub(crate) struct Scales {
    /// Centre and half width of each joint's interval, rad.
    pub joint_intervals: Vec<(f64, f64)>,
    /// Centre and half width of ln(grip force · friction / weight).
    pub log_ratio_interval: (f64, f64),
    /// Share of the likelihood that every mode gets, whether it explains the grasp or not.
    pub share: f64,
    /// Weight of the distance of the nearest mode.
    pub nearest_weight: f64,
    /// Weight of the force term.
    pub force_weight: f64,
    /// Weight of the contact term.
    pub contact_weight: f64,
}

/// A grasp in the network's numbers.
#[derive(Debug, Clone)]
pub(crate) struct Target {
    /// rad.
    pub joints: Vec<f64>,
    /// See [`crate::norm::wrist_numbers`].
    pub wrist: [f64; 9],
    /// ln(grip force · friction / weight).
    pub log_ratio: f64,
    /// Which finger touches.
    pub contacts: Vec<bool>,
    /// How much this grasp counts.
    pub weight: f64,
}

/// Means over the batch of the terms of the loss, see [`crate::EpochStats`].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct LossParts {
    /// Mean squared joint error of the mode that explains the grasp best, rad².
    pub joint: f64,
    /// Squared distance of its wrist, in lengths.
    pub wrist: f64,
    pub force: f64,
    pub contact: f64,
    /// Negative log-likelihood, translation in lengths.
    pub nll: f64,
    pub total: f64,
}

impl LossParts {
    /// Adds `share` of another.
    pub fn add(&mut self, other: &Self, share: f64) {
        self.joint += share * other.joint;
        self.wrist += share * other.wrist;
        self.force += share * other.force;
        self.contact += share * other.contact;
        self.nll += share * other.nll;
        self.total += share * other.total;
    }
}

/// The outputs of one mode, decoded, with what their derivatives need.
pub(crate) struct Mode<'a> {
    layout: &'a Layout,
    scales: &'a Scales,
    /// [`Layout::mode_width`] outputs.
    out: &'a [f32],
}

impl<'a> Mode<'a> {
    pub fn new(layout: &'a Layout, scales: &'a Scales, out: &'a [f32]) -> Self {
        Self { layout, scales, out }
    }

    fn at(&self, i: usize) -> f64 {
        f64::from(self.out[i])
    }

    /// Angle of a joint, rad, and its derivative with respect to the output.
    pub fn joint(&self, j: usize) -> (f64, f64) {
        let (middle, half) = self.scales.joint_intervals[j];
        let tanh = self.at(j).tanh();
        (middle + half * STRETCH * tanh, half * STRETCH * (1.0 - tanh * tanh))
    }

    /// ln(grip force · friction / weight) and its derivative with respect to the output.
    pub fn log_ratio(&self) -> (f64, f64) {
        let (centre, half) = self.scales.log_ratio_interval;
        let tanh = self.at(self.layout.force()).tanh();
        (centre + half * tanh, half * (1.0 - tanh * tanh))
    }

    pub fn logit(&self) -> f64 {
        self.at(self.layout.logit())
    }

    /// Cross-entropy of one finger's contact and its derivative with respect to the logit.
    pub fn contact(&self, finger: usize, touches: f64) -> (f64, f64) {
        let logit = self.at(self.layout.contacts() + finger);
        // ln(1 + e^x) - y x, written so that neither side overflows.
        (logit.max(0.0) - touches * logit + (-logit.abs()).exp().ln_1p(), sigmoid(logit) - touches)
    }

    /// Mean squared gap of the joints, rad², and squared gap of the wrist, lengths².
    fn gaps(&self, joints: &[f64], wrist: &[f64; 9]) -> (f64, f64) {
        let joint = joints.iter().enumerate().map(|(j, q)| (self.joint(j).0 - q).powi(2)).sum::<f64>();
        let gap = |(i, w): (usize, &f64)| {
            let scale = if i < 3 { 1.0 } else { COLUMNS };
            scale * (self.at(self.layout.wrist() + i) - w).powi(2)
        };
        (joint / joints.len() as f64, wrist.iter().enumerate().map(gap).sum())
    }

    /// Adds `weight` times the derivative of the sum of [`gaps`](Self::gaps).
    fn pull(&self, joints: &[f64], wrist: &[f64; 9], weight: f64, derivatives: &mut [f32]) {
        for (j, q) in joints.iter().enumerate() {
            let (angle, slope) = self.joint(j);
            derivatives[j] += (weight * 2.0 * (angle - q) * slope / joints.len() as f64) as f32;
        }
        for (i, w) in wrist.iter().enumerate() {
            let scale = if i < 3 { 1.0 } else { COLUMNS };
            derivatives[self.layout.wrist() + i] +=
                (weight * scale * 2.0 * (self.at(self.layout.wrist() + i) - w)) as f32;
        }
    }

    /// z² in parts (one per spread) of this mode's joints and wrist from given ones; `derivatives` gets dz²/d(output) of joints and wrist.
    pub fn distance(
        &self,
        joints: &[f64],
        wrist: &[f64; 9],
        inverse: &[f64],
        parts: &mut [f64],
        derivatives: &mut [f64],
    ) -> f64 {
        let count = self.layout.joints;
        for j in 0..count {
            let (angle, slope) = self.joint(j);
            let z = (angle - joints[j]) * inverse[j];
            parts[j] = z * z;
            derivatives[j] = 2.0 * z * inverse[j] * slope;
        }
        (parts[count], parts[count + 1]) = (0.0, 0.0);
        for (i, wanted) in wrist.iter().enumerate() {
            let (part, scale) = if i < 3 { (count, 1.0) } else { (count + 1, COLUMNS) };
            let weight = scale * inverse[part] * inverse[part];
            let gap = self.at(self.layout.wrist() + i) - wanted;
            parts[part] += weight * gap * gap;
            derivatives[count + i] = 2.0 * weight * gap;
        }
        parts.iter().sum()
    }
}

pub(crate) fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// How many coordinates each spread stands for.
fn dimensions(layout: &Layout, spread: usize) -> f64 {
    if spread < layout.joints { 1.0 } else { 3.0 }
}

/// What [`demo_loss`] finds.
pub(crate) struct Found {
    pub parts: LossParts,
    /// B x K x width.
    pub outputs: Vec<f32>,
    /// One per spread.
    pub log_spread: Vec<f32>,
    /// B x K: probability that a mode made the grasp.
    pub responsible: Vec<f64>,
}

/// Mean over the B targets, each times its weight, of
///
/// (1 − s) · −ln Σ_k π_k p_k + s · mean_k −ln p_k + nearest_weight · ρ(min_k d_k²) + Σ_k r_k \[ force_weight (ℓ_k − ℓ)² + contact_weight Σ_f BCE \],
///
/// with p_k of [`crate::density`], π the softmax of the logits, s the share and r_k the (fixed) probability that mode k made the grasp.
///
/// d is the grasp distance of [`crate::grasp_distance_m`] over a tenth of the length, and ρ(x) = 2 (√(1 + x) − 1): quadratic for near grasps and
/// linear for far ones, which the likelihood with its tails would leave to themselves (winner takes all, Rupprecht et al. 2017).
/// `learn_modes`: whether π gets a derivative.
pub(crate) fn demo_loss(
    layout: &Layout,
    outputs: &[f32],
    log_spread: &[f32],
    targets: &[Target],
    scales: &Scales,
    learn_modes: bool,
) -> Found {
    let (width, modes, joints) = (layout.mode_width(), layout.modes, layout.joints);
    let count = layout.joints + 6;
    let inverse: Vec<f64> = log_spread.iter().map(|s| f64::from(-s).exp()).collect();
    let log_spreads: f64 = log_spread.iter().enumerate().map(|(i, s)| dimensions(layout, i) * f64::from(*s)).sum();
    let mut found = Found {
        parts: LossParts::default(),
        outputs: vec![0.0; outputs.len()],
        log_spread: vec![0.0; log_spread.len()],
        responsible: Vec::with_capacity(targets.len() * modes),
    };
    let mut spread_slope = vec![0.0; log_spread.len()];
    let mut z_parts = vec![0.0; modes * layout.spreads()];
    let mut derivatives = vec![0.0; modes * (joints + 9)];
    for (row, target) in targets.iter().enumerate() {
        let out = &outputs[row * modes * width..(row + 1) * modes * width];
        let gradient = &mut found.outputs[row * modes * width..(row + 1) * modes * width];
        let decoded: Vec<Mode<'_>> = out.chunks_exact(width).map(|o| Mode::new(layout, scales, o)).collect();
        let z2: Vec<f64> = decoded
            .iter()
            .zip(z_parts.chunks_exact_mut(layout.spreads()).zip(derivatives.chunks_exact_mut(joints + 9)))
            .map(|(m, (parts, derivatives))| m.distance(&target.joints, &target.wrist, &inverse, parts, derivatives))
            .collect();
        let log_p: Vec<f64> = z2.iter().map(|&z| log_student(z, log_spreads, count)).collect();
        let log_z = log_sum_exp(decoded.iter().map(Mode::logit));
        let joint_log: Vec<f64> = decoded.iter().zip(&log_p).map(|(m, p)| m.logit() - log_z + p).collect();
        let log_likelihood = log_sum_exp(joint_log.iter().copied());
        let responsible: Vec<f64> = joint_log.iter().map(|l| (l - log_likelihood).exp()).collect();
        let scale = target.weight / targets.len() as f64;

        let mut parts = LossParts { nll: -log_likelihood, ..LossParts::default() };
        let near: Vec<(f64, f64)> = decoded.iter().map(|m| m.gaps(&target.joints, &target.wrist)).collect();
        let best = (0..modes).fold(0, |b, k| if near[k].0 + near[k].1 < near[b].0 + near[b].1 { k } else { b });
        (parts.joint, parts.wrist) = near[best];
        let root = (1.0 + NEAR * (parts.joint + parts.wrist)).sqrt();
        let pull = scale * scales.nearest_weight * NEAR / root;
        decoded[best].pull(&target.joints, &target.wrist, pull, &mut gradient[best * width..(best + 1) * width]);
        let mean_log = log_p.iter().sum::<f64>() / modes as f64;
        parts.total = -(1.0 - scales.share) * log_likelihood - scales.share * mean_log;
        parts.total += scales.nearest_weight * 2.0 * (root - 1.0);
        for (k, mode) in decoded.iter().enumerate() {
            let share = (1.0 - scales.share) * responsible[k] + scales.share / modes as f64;
            // d(−ln p_k)/dz².
            let pull = scale * share * (TAIL + count as f64) / (2.0 * (TAIL + z2[k]));
            let gradient = &mut gradient[k * width..(k + 1) * width];
            for (g, slope) in gradient.iter_mut().zip(&derivatives[k * (joints + 9)..(k + 1) * (joints + 9)]) {
                *g += (pull * slope) as f32;
            }
            for (i, z) in z_parts[k * layout.spreads()..(k + 1) * layout.spreads()].iter().enumerate() {
                spread_slope[i] += scale * share * dimensions(layout, i) - 2.0 * pull * z;
            }
            if learn_modes {
                let probability = (mode.logit() - log_z).exp();
                let slope = scale * (1.0 - scales.share) * (probability - responsible[k]);
                gradient[layout.logit()] += slope as f32;
            }
            let (log_ratio, slope) = mode.log_ratio();
            let gap = log_ratio - target.log_ratio;
            parts.force += responsible[k] * gap * gap;
            gradient[layout.force()] += (scale * scales.force_weight * responsible[k] * 2.0 * gap * slope) as f32;
            for (f, touches) in target.contacts.iter().enumerate() {
                let (entropy, slope) = mode.contact(f, f64::from(u8::from(*touches)));
                parts.contact += responsible[k] * entropy;
                gradient[layout.contacts() + f] += (scale * scales.contact_weight * responsible[k] * slope) as f32;
            }
        }
        parts.total += scales.force_weight * parts.force + scales.contact_weight * parts.contact;
        found.parts.add(&parts, scale);
        found.responsible.extend(responsible);
    }
    found.log_spread.iter_mut().zip(spread_slope).for_each(|(g, s)| *g = s as f32);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAYOUT: Layout = Layout { joints: 2, modes: 3, hidden: 8, frequencies: 1, fingers: 2 };

    fn scales() -> Scales {
        Scales {
            joint_intervals: vec![(0.1, 1.0), (-0.2, 0.5)],
            log_ratio_interval: (1.0, 1.5),
            share: 0.05,
            nearest_weight: 0.4,
            force_weight: 0.7,
            contact_weight: 0.3,
        }
    }

    fn wave(count: usize, step: f64) -> Vec<f64> {
        (0..count).map(|i| ((i as f64 + 1.0) * step).sin()).collect()
    }

    fn targets() -> Vec<Target> {
        [(1.0, 0.4), (0.5, -0.3)]
            .into_iter()
            .enumerate()
            .map(|(i, (weight, q))| Target {
                joints: vec![q, -0.1],
                wrist: std::array::from_fn(|n| ((n + 5 * i) as f64).cos()),
                log_ratio: 0.8 + 0.5 * i as f64,
                contacts: vec![true, i == 0],
                weight,
            })
            .collect()
    }

    /// The loss written from its formula, with responsibilities given: the oracle for values and derivatives.
    fn plain(outputs: &[f64], log_spread: &[f64], responsible: &[f64]) -> f64 {
        let (l, s, width) = (LAYOUT, scales(), LAYOUT.mode_width());
        let mut total = 0.0;
        for (b, t) in targets().iter().enumerate() {
            let modes: Vec<&[f64]> = outputs[b * 3 * width..(b + 1) * 3 * width].chunks(width).collect();
            let log_p = |o: &[f64]| {
                let mut z2 = 0.0;
                for j in 0..2 {
                    let (m, h) = s.joint_intervals[j];
                    z2 += ((m + h * STRETCH * o[j].tanh() - t.joints[j]) / log_spread[j].exp()).powi(2);
                }
                for i in 0..9 {
                    let (spread, c) = if i < 3 { (log_spread[2], 1.0) } else { (log_spread[3], 0.75) };
                    z2 += c * ((o[2 + i] - t.wrist[i]) / spread.exp()).powi(2);
                }
                let log_spreads = log_spread[0] + log_spread[1] + 3.0 * log_spread[2] + 3.0 * log_spread[3];
                log_student(z2, log_spreads, 8)
            };
            let sum: f64 = modes.iter().map(|o| o[l.logit()].exp()).sum();
            let mixture: f64 = modes.iter().map(|o| o[l.logit()].exp() / sum * log_p(o).exp()).sum();
            let mean = modes.iter().map(|o| log_p(o)).sum::<f64>() / 3.0;
            let mut loss = -(1.0 - s.share) * mixture.ln() - s.share * mean;
            let distance = |o: &[f64]| {
                let joints = (0..2).map(|j| {
                    let (m, h) = s.joint_intervals[j];
                    (m + h * STRETCH * o[j].tanh() - t.joints[j]).powi(2) / 2.0
                });
                let wrist = (0..9).map(|i| (o[2 + i] - t.wrist[i]).powi(2) * if i < 3 { 1.0 } else { 0.75 });
                100.0 * (joints.sum::<f64>() + wrist.sum::<f64>())
            };
            let nearest = modes.iter().map(|o| distance(o)).fold(f64::INFINITY, f64::min);
            loss += s.nearest_weight * 2.0 * ((1.0 + nearest).sqrt() - 1.0);
            for (k, o) in modes.iter().enumerate() {
                let r = responsible[b * 3 + k];
                loss += r * s.force_weight * (1.0 + 1.5 * o[l.force()].tanh() - t.log_ratio).powi(2);
                for f in 0..2 {
                    let p = sigmoid(o[l.contacts() + f]);
                    loss -= r * s.contact_weight * if t.contacts[f] { p.ln() } else { (1.0 - p).ln() };
                }
            }
            total += t.weight * loss / 2.0;
        }
        total
    }

    #[test]
    fn value_and_derivatives_match_the_formula() {
        let mut outputs = wave(2 * 3 * LAYOUT.mode_width(), 0.7);
        let mut log_spread = vec![-0.3, 0.2, 0.1, -0.2];
        let narrow = |v: &[f64]| v.iter().map(|v| *v as f32).collect::<Vec<_>>();
        let wide = |v: &[f32]| v.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
        outputs = wide(&narrow(&outputs));
        log_spread = wide(&narrow(&log_spread));
        let found = demo_loss(&LAYOUT, &narrow(&outputs), &narrow(&log_spread), &targets(), &scales(), true);
        let expected = plain(&outputs, &log_spread, &found.responsible);
        assert!((found.parts.total / expected - 1.0).abs() < 1e-9, "{} against {expected}", found.parts.total);
        let step = 1e-6;
        for i in 0..outputs.len() {
            let value = outputs[i];
            outputs[i] = value + step;
            let above = plain(&outputs, &log_spread, &found.responsible);
            outputs[i] = value - step;
            let below = plain(&outputs, &log_spread, &found.responsible);
            outputs[i] = value;
            let slope = (above - below) / (2.0 * step);
            assert!((f64::from(found.outputs[i]) - slope).abs() < 1e-5, "output {i}: {} {slope}", found.outputs[i]);
        }
        for i in 0..log_spread.len() {
            let value = log_spread[i];
            log_spread[i] = value + step;
            let above = plain(&outputs, &log_spread, &found.responsible);
            log_spread[i] = value - step;
            let below = plain(&outputs, &log_spread, &found.responsible);
            log_spread[i] = value;
            let slope = (above - below) / (2.0 * step);
            assert!(
                (f64::from(found.log_spread[i]) - slope).abs() < 1e-5,
                "spread {i}: {} {slope}",
                found.log_spread[i]
            );
        }
        assert!(found.responsible.chunks(3).all(|r| (r.iter().sum::<f64>() - 1.0).abs() < 1e-12));
    }

    #[test]
    fn fixed_modes_get_no_derivative() {
        let outputs: Vec<f32> = wave(2 * 3 * LAYOUT.mode_width(), 0.7).iter().map(|v| *v as f32).collect();
        let found = demo_loss(&LAYOUT, &outputs, &[0.0; 4], &targets(), &scales(), false);
        assert!(found.outputs.chunks(LAYOUT.mode_width()).all(|m| m[LAYOUT.logit()] == 0.0));
    }
}
