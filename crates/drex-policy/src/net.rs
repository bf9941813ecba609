//! The network itself: a PointNet encoder, mass after pooling, K modes. The only module that knows burn.
//!
//! Tensor shapes: N points, E numbers per encoded point, B samples, K modes, J joints, H hidden units.

use burn::tensor::activation::{log_softmax, relu};
use burn::tensor::{Device, Tensor, TensorData};

use crate::norm::STRETCH;
use crate::weights::{Layout, Weights};
use crate::{Error, Result};

/// What one training step works on. All arrays are row-major.
#[derive(Debug)]
pub(crate) struct Batch<'a> {
    /// N x E encoded points.
    pub encoded: &'a [f32],
    /// B mass inputs.
    pub mass: &'a [f32],
    /// B x J joint angles, rad.
    pub joints: &'a [f32],
    /// B x 9 wrist numbers.
    pub wrist: &'a [f32],
    /// B logarithms of squeeze per weight.
    pub log_ratio: &'a [f32],
}

/// Constants of the outputs and of the loss.
#[derive(Debug, Clone)]
pub(crate) struct Scales {
    /// Centre and half width of each joint's interval, rad.
    pub joint_intervals: Vec<(f64, f64)>,
    /// Centre and half width of ln(squeeze / weight).
    pub log_ratio_interval: (f64, f64),
    /// Lever of angles and scale of the wrist translation, m.
    pub length_m: f64,
    /// Share of the grasp loss that goes to the modes that did not win.
    pub share: f64,
    /// Weight of the force term.
    pub force_weight: f64,
    /// Weight of the mode term.
    pub mode_weight: f64,
}

/// Means over the batch of the terms of the loss, see [`crate::EpochStats`].
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LossParts {
    pub joint: f64,
    pub wrist: f64,
    pub force: f64,
    pub mode: f64,
    pub total: f64,
}

/// Outputs of the last layer for each mass: B x K x [`Layout::mode_width`], row-major.
///
/// # Errors
/// If the build has no backend or the backend fails.
pub(crate) fn outputs(weights: &Weights, encoded: &[f32], mass: &[f32]) -> Result<Vec<f32>> {
    let device = device()?;
    let parameters = load(weights, &device);
    values(forward(&weights.layout, &parameters, encoded, mass, &device))
}

/// The loss of a batch and its derivatives with respect to every array of the weights.
///
/// # Errors
/// If the build has no backend or the backend fails.
pub(crate) fn loss_and_gradients(
    weights: &Weights,
    batch: &Batch<'_>,
    scales: &Scales,
) -> Result<(LossParts, Vec<Vec<f32>>)> {
    let device = device()?.autodiff();
    let parameters: Vec<Tensor<2>> = load(weights, &device).into_iter().map(Tensor::require_grad).collect();
    let outputs = forward(&weights.layout, &parameters, batch.encoded, batch.mass, &device);
    let (parts, total) = loss(&weights.layout, outputs, batch, scales, &device)?;
    let mut gradients = total.backward();
    let of = |p: &Tensor<2>| match p.grad_remove(&mut gradients) {
        Some(gradient) => values(gradient),
        None => Err(Error::Backend { what: "a weight has no gradient".into() }),
    };
    let gradients = parameters.iter().map(of).collect::<Result<_>>()?;
    Ok((parts, gradients))
}

/// The encoder runs once whatever the number of samples: they share the cloud, and the mass joins after pooling.
fn forward(layout: &Layout, p: &[Tensor<2>], encoded: &[f32], mass: &[f32], device: &Device) -> Tensor<3> {
    let weight = |i: usize| p[i].clone();
    let points = encoded.len() / crate::cloud::encoding_width(layout.frequencies);
    let x = tensor(encoded.to_vec(), [points, crate::cloud::encoding_width(layout.frequencies)], device);
    let x = relu(x.matmul(weight(0)) + weight(1));
    let x = relu(x.matmul(weight(2)) + weight(3));
    let x = relu(x.matmul(weight(4)) + weight(5));
    // Pooled before the heads (Qi et al. 2017): the heads see the whole object, not a vote of single points.
    let object = x.clone().max_dim(0).matmul(weight(6)) + x.mean_dim(0).matmul(weight(7)) + weight(9);
    let mass = tensor(mass.to_vec(), [mass.len(), 1], device);
    let [samples, _] = mass.dims();
    let x = relu(mass.clone().matmul(weight(8)) + object);
    let x = relu(x.matmul(weight(10)) + weight(11));
    // The mass also goes straight to the outputs: a power law of the squeeze in the mass needs nothing else.
    let x = x.matmul(weight(12)) + mass.matmul(weight(13)) + weight(14);
    x.reshape([samples, layout.modes, layout.mode_width()])
}

/// Winner takes all, with a small share for the others (Rupprecht et al. 2017, equation 6), plus force and mode terms of the winner:
///
/// mean over B of [ Σ_k w_k ρ(d_k²) + force_weight (ℓ_win − ℓ)² − mode_weight ln p_win ],
/// where d is the grasp distance over a tenth of the length and ρ(s) = 2 (√(1 + s) − 1): quadratic for near grasps and linear for far ones,
/// so that a mode settles among grasps that are alike instead of between grasps that are not.
fn loss(
    layout: &Layout,
    outputs: Tensor<3>,
    batch: &Batch<'_>,
    scales: &Scales,
    device: &Device,
) -> Result<(LossParts, Tensor<1>)> {
    let (samples, joints, modes) = (batch.mass.len(), layout.joints, layout.modes);
    let part = |start: usize, length: usize| outputs.clone().narrow(2, start, length);
    let row = |of: fn(&(f64, f64)) -> f64| scales.joint_intervals.iter().map(|i| of(i) as f32).collect::<Vec<_>>();

    let (middle, half) = (row(|i| i.0), row(|i| i.1 * STRETCH));
    let angles = part(0, joints).tanh() * cube(half, [1, 1, joints], device) + cube(middle, [1, 1, joints], device);
    let joint = (angles - cube(batch.joints.to_vec(), [samples, 1, joints], device)).square().mean_dim(2);

    let wrist = (part(joints, 9) - cube(batch.wrist.to_vec(), [samples, 1, 9], device)).square();
    // Two columns of a rotation by θ differ by |Δ|² = 4/3 θ² on average over axes, hence 3/4.
    let turn = wrist.clone().narrow(2, 3, 6).sum_dim(2) * 0.75;
    let wrist = wrist.narrow(2, 0, 3).sum_dim(2) + turn;

    // In units of a tenth of the length: joint and wrist are already over the length.
    let distance: Tensor<2> = ((joint.clone() + wrist.clone()) * 100.0).reshape([samples, modes]);
    let winner = one_hot_of_least(&values(distance.clone().detach())?, modes);
    let winner = tensor(winner, [samples, modes], device);
    let mean = 1.0 / samples as f64;
    let others = if modes > 1 { scales.share / (modes - 1) as f64 } else { 0.0 };
    let own = if modes > 1 { 1.0 - scales.share } else { 1.0 };
    let shares = winner.clone() * (own - others) + others;
    let robust = ((distance + 1.0).sqrt() - 1.0) * 2.0;
    let grasp_term = (robust * shares).sum() * mean;

    let (centre, half) = scales.log_ratio_interval;
    let log_ratio: Tensor<2> = part(joints + 9, 1).reshape([samples, modes]).tanh() * half + centre;
    let force = (log_ratio - tensor(batch.log_ratio.to_vec(), [samples, 1], device)).square();
    let force_term = (force * winner.clone()).sum() * mean;

    let logits: Tensor<2> = part(joints + 10, 1).reshape([samples, modes]);
    let mode_term = -(log_softmax(logits, 1) * winner.clone()).sum() * mean;

    let winners_mean = |t: Tensor<3>| (t.reshape([samples, modes]) * winner.clone()).detach().sum() * mean;
    let parts = Tensor::cat(
        vec![winners_mean(joint), winners_mean(wrist), force_term.clone().detach(), mode_term.clone().detach()],
        0,
    );
    let total = grasp_term + force_term * scales.force_weight + mode_term * scales.mode_weight;
    let parts = values(Tensor::cat(vec![parts, total.clone().detach()], 0))?;
    let at = |i: usize| f64::from(parts.get(i).copied().unwrap_or(f32::NAN));
    let wrist = at(1) * scales.length_m.powi(2);
    Ok((LossParts { joint: at(0), wrist, force: at(2), mode: at(3), total: at(4) }, total))
}

/// One in the column of the least value of each row (the first of equals), zero elsewhere.
fn one_hot_of_least(values: &[f32], columns: usize) -> Vec<f32> {
    let mut mask = vec![0.0; values.len()];
    for (row, mask) in values.chunks(columns).zip(mask.chunks_mut(columns)) {
        let mut least = 0;
        for (i, value) in row.iter().enumerate() {
            if *value < row[least] {
                least = i;
            }
        }
        mask[least] = 1.0;
    }
    mask
}

fn load(weights: &Weights, device: &Device) -> Vec<Tensor<2>> {
    let arrays = weights.layout.arrays().into_iter().zip(&weights.arrays);
    arrays.map(|((_, shape), values)| tensor(values.clone(), shape, device)).collect()
}

fn tensor(values: Vec<f32>, shape: [usize; 2], device: &Device) -> Tensor<2> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn cube(values: Vec<f32>, shape: [usize; 3], device: &Device) -> Tensor<3> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn values<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>> {
    tensor.try_into_vec_as::<f32>().map_err(|e| Error::Backend { what: e.to_string() })
}

#[cfg(feature = "flex")]
fn device() -> Result<Device> {
    Ok(Device::flex())
}

#[cfg(not(feature = "flex"))]
fn device() -> Result<Device> {
    Err(Error::NoBackend)
}

#[cfg(all(test, feature = "flex"))]
mod tests {
    use super::*;

    const LAYOUT: Layout = Layout { joints: 2, modes: 3, hidden: 8, frequencies: 1 };

    fn scales() -> Scales {
        Scales {
            joint_intervals: vec![(0.1, 1.0), (-0.2, 0.5)],
            log_ratio_interval: (1.0, 1.5),
            length_m: 0.1,
            share: 0.05,
            force_weight: 0.7,
            mode_weight: 0.3,
        }
    }

    fn wave(count: usize, step: f32) -> Vec<f32> {
        (0..count).map(|i| ((i as f32 + 1.0) * step).sin()).collect()
    }

    /// The same network and loss in plain f64, written from the formulas: the oracle for values and derivatives.
    fn plain_loss(w: &[Vec<f64>], batch: &Batch<'_>, s: &Scales) -> f64 {
        let (l, h) = (LAYOUT, LAYOUT.hidden);
        let dense = |x: &[f64], m: &[f64], b: Option<&[f64]>| -> Vec<f64> {
            let columns = m.len() / x.len();
            let sum = |j: usize| x.iter().enumerate().map(|(i, v)| v * m[i * columns + j]).sum::<f64>();
            (0..columns).map(|j| sum(j) + b.map_or(0.0, |b| b[j])).collect()
        };
        let relu = |x: Vec<f64>| x.into_iter().map(|v| v.max(0.0)).collect::<Vec<_>>();
        let wide = |x: &[f32]| x.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
        let (mut most, mut mean) = (vec![f64::NEG_INFINITY; h], vec![0.0; h]);
        let rows: Vec<_> = batch.encoded.chunks(9).collect();
        for row in &rows {
            let x = relu(dense(&wide(row), &w[0], Some(&w[1])));
            let x = relu(dense(&x, &w[2], Some(&w[3])));
            let x = relu(dense(&x, &w[4], Some(&w[5])));
            for j in 0..h {
                most[j] = x[j].max(most[j]);
                mean[j] += x[j] / rows.len() as f64;
            }
        }
        let (from_max, from_mean) = (dense(&most, &w[6], None), dense(&mean, &w[7], None));
        let mut total = 0.0;
        for b in 0..batch.mass.len() {
            let from_mass = dense(&[f64::from(batch.mass[b])], &w[8], None);
            let x = relu((0..h).map(|j| from_max[j] + from_mean[j] + from_mass[j] + w[9][j]).collect());
            let x = relu(dense(&x, &w[10], Some(&w[11])));
            let direct = dense(&[f64::from(batch.mass[b])], &w[13], None);
            let out = dense(&x, &w[12], Some(&w[14]));
            let out: Vec<f64> = out.iter().zip(direct).map(|(a, b)| a + b).collect();
            let modes: Vec<_> = out.chunks(l.mode_width()).collect();
            let distance = |o: &[f64]| {
                let joint = (0..l.joints).map(|j| {
                    let (middle, half) = s.joint_intervals[j];
                    (middle + half * STRETCH * o[j].tanh() - f64::from(batch.joints[b * l.joints + j])).powi(2)
                });
                let wrist = (0..9).map(|i| {
                    let difference = o[l.joints + i] - f64::from(batch.wrist[b * 9 + i]);
                    difference.powi(2) * if i < 3 { 1.0 } else { 0.75 }
                });
                100.0 * (joint.sum::<f64>() / l.joints as f64 + wrist.sum::<f64>())
            };
            let distances: Vec<f64> = modes.iter().map(|o| distance(o)).collect();
            let win = (1..l.modes).fold(0, |best, k| if distances[k] < distances[best] { k } else { best });
            for (k, d) in distances.iter().enumerate() {
                let share = if k == win { 1.0 - s.share } else { s.share / (l.modes - 1) as f64 };
                total += share * 2.0 * ((1.0 + d).sqrt() - 1.0);
            }
            let force = s.log_ratio_interval.0 + s.log_ratio_interval.1 * modes[win][l.joints + 9].tanh();
            total += s.force_weight * (force - f64::from(batch.log_ratio[b])).powi(2);
            let sum = modes.iter().map(|o| o[l.joints + 10].exp()).sum::<f64>().ln();
            total += s.mode_weight * (sum - modes[win][l.joints + 10]);
        }
        total / batch.mass.len() as f64
    }

    #[test]
    fn loss_and_gradients_match_plain_f64_and_finite_differences() {
        let mut weights = Weights::initial(LAYOUT, 3);
        weights.arrays[13] = wave(weights.arrays[13].len(), 2.1); // zero at the start, which would hide its part
        let (encoded, joints, wrist) = (wave(5 * 9, 0.7), wave(4, 1.3), wave(18, 0.9));
        let batch =
            Batch { encoded: &encoded, mass: &[-1.0, 0.5], joints: &joints, wrist: &wrist, log_ratio: &[0.8, 1.4] };
        let (parts, gradients) = loss_and_gradients(&weights, &batch, &scales()).unwrap();
        let mut plain: Vec<Vec<f64>> =
            weights.arrays.iter().map(|a| a.iter().map(|v| f64::from(*v)).collect()).collect();
        let expected = plain_loss(&plain, &batch, &scales());
        assert!((parts.total / expected - 1.0).abs() < 1e-5, "{} against {expected}", parts.total);
        let step = 1e-6;
        let largest = gradients.iter().flatten().fold(0.0_f64, |a, g| a.max(f64::from(g.abs())));
        let mut compared = 0;
        for a in 0..plain.len() {
            for i in (0..plain[a].len()).step_by(3) {
                let value = plain[a][i];
                plain[a][i] = value + step;
                let above = plain_loss(&plain, &batch, &scales());
                plain[a][i] = value - step;
                let below = plain_loss(&plain, &batch, &scales());
                plain[a][i] = value;
                let expected = (above - below) / (2.0 * step);
                let found = f64::from(gradients[a][i]);
                assert!((found - expected).abs() < 1e-4 * largest, "array {a}, entry {i}: {found} against {expected}");
                compared += 1;
            }
        }
        assert!(compared > 100 && largest > 0.1);
    }

    #[test]
    fn order_of_points_does_not_matter_and_mass_does() {
        let weights = Weights::initial(LAYOUT, 9);
        let encoded = wave(5 * 9, 0.7);
        let mut reversed: Vec<f32> = encoded.chunks(9).rev().flatten().copied().collect();
        let a = outputs(&weights, &encoded, &[0.5]).unwrap();
        let b = outputs(&weights, &reversed, &[0.5]).unwrap();
        assert_eq!(a.len(), LAYOUT.modes * LAYOUT.mode_width());
        assert!(a.iter().zip(&b).all(|(x, y)| (x - y).abs() < 1e-5));
        let c = outputs(&weights, &encoded, &[-1.0]).unwrap();
        assert!(a.iter().zip(&c).any(|(x, y)| (x - y).abs() > 1e-3));
        reversed.truncate(9);
        let d = outputs(&weights, &reversed, &[0.5, -1.0]).unwrap();
        assert_eq!(d.len(), 2 * a.len());
    }
}
