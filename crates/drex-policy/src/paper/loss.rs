//! The two losses of the paper and their derivatives with respect to the 19 outputs: 16 angles, two contacts and a force after the sigmoid.

use super::{JOINTS, PaperLoss};

/// Weights of the second phase. The paper's force weight of 0.3 multiplies a loss that already has a factor of 0.1.
const CONTACT_WEIGHT: f64 = 0.8;
const FORCE_WEIGHT: f64 = 0.3 * 0.1;

/// Keeps the logarithms of the cross-entropy finite.
const EDGE: f64 = 1e-7;

/// MSE(a) + BCE(r) + MSE(f) with r = f = 1, means over the batch and over the numbers of each kind. All samples see the same outputs.
pub(crate) fn demo_loss(out: &[f64], labels: &[&[f64]]) -> (PaperLoss, Vec<f64>) {
    let mut derivatives = vec![0.0; out.len()];
    let count = (labels.len().max(1) * JOINTS) as f64;
    let mut joints = 0.0;
    for label in labels {
        for j in 0..JOINTS {
            let gap = out[j] - label[j];
            joints += gap * gap / count;
            derivatives[j] += 2.0 * gap / count;
        }
    }
    let contacts = cross_entropy(out, [1.0, 1.0], 1.0, &mut derivatives);
    let force = squared_force(out, 1.0, 1.0, &mut derivatives);
    (PaperLoss { joints, contacts, force, total: joints + contacts + force }, derivatives)
}

/// 0.8 BCE(r) + 0.3 · 0.1 MSE(f); the joint angles have no loss.
pub(crate) fn contact_loss(out: &[f64], touching: [f64; 2], wanted_force: f64) -> (PaperLoss, Vec<f64>) {
    let mut derivatives = vec![0.0; out.len()];
    let contacts = cross_entropy(out, touching, CONTACT_WEIGHT, &mut derivatives);
    let force = squared_force(out, wanted_force, FORCE_WEIGHT, &mut derivatives);
    (PaperLoss { joints: 0.0, contacts, force, total: CONTACT_WEIGHT * contacts + FORCE_WEIGHT * force }, derivatives)
}

/// Mean binary cross-entropy of the two contacts; adds `weight` times its derivative.
fn cross_entropy(out: &[f64], labels: [f64; 2], weight: f64, derivatives: &mut [f64]) -> f64 {
    let mut sum = 0.0;
    for (i, label) in labels.into_iter().enumerate() {
        let p = out[JOINTS + i].clamp(EDGE, 1.0 - EDGE);
        sum -= 0.5 * (label * p.ln() + (1.0 - label) * (1.0 - p).ln());
        derivatives[JOINTS + i] += weight * 0.5 * (p - label) / (p * (1.0 - p));
    }
    sum
}

fn squared_force(out: &[f64], wanted: f64, weight: f64, derivatives: &mut [f64]) -> f64 {
    let gap = out[JOINTS + 2] - wanted;
    derivatives[JOINTS + 2] += weight * 2.0 * gap;
    gap * gap
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outputs() -> Vec<f64> {
        (0..19).map(|i| if i < JOINTS { (i as f64).sin() } else { 0.2 + 0.25 * (i - JOINTS) as f64 }).collect()
    }

    fn check(loss: impl Fn(&[f64]) -> (PaperLoss, Vec<f64>), plain: impl Fn(&[f64]) -> f64) {
        let mut out = outputs();
        let (parts, derivatives) = loss(&out);
        assert!((parts.total - plain(&out)).abs() < 1e-12, "{} against {}", parts.total, plain(&out));
        for i in 0..out.len() {
            let (value, step) = (out[i], 1e-6);
            out[i] = value + step;
            let above = plain(&out);
            out[i] = value - step;
            let below = plain(&out);
            out[i] = value;
            assert!((derivatives[i] - (above - below) / (2.0 * step)).abs() < 1e-7, "output {i}");
        }
    }

    #[test]
    fn terms_match_their_formulas() {
        let labels: Vec<Vec<f64>> =
            (0..8).map(|b| (0..16).map(|j| (f64::from(b) + 0.3 * f64::from(j)).cos()).collect()).collect();
        let batch: Vec<&[f64]> = labels.iter().map(Vec::as_slice).collect();
        let first = |o: &[f64]| {
            let mse: f64 =
                labels.iter().map(|l| (0..16).map(|j| (o[j] - l[j]).powi(2)).sum::<f64>() / 16.0).sum::<f64>() / 8.0;
            mse - (o[16].ln() + o[17].ln()) / 2.0 + (o[18] - 1.0).powi(2)
        };
        check(|o| demo_loss(o, &batch), first);
        let second = |o: &[f64]| 0.8 * -(o[16].ln() + (1.0 - o[17]).ln()) / 2.0 + 0.3 * (0.1 * (o[18] - 0.4).powi(2));
        check(|o| contact_loss(o, [1.0, 0.0], 0.4), second);
        assert!(contact_loss(&outputs(), [1.0, 1.0], 1.0).1[..JOINTS].iter().all(|s| *s == 0.0));
    }
}
