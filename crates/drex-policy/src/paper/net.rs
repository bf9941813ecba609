//! 24 -> 256 -> 256 -> 256 with ReLU, heads 16, 2 and 1, mean over the vertices after the heads.

use burn::tensor::activation::{relu, sigmoid};
use burn::tensor::{Device, Tensor};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{ENCODED, HIDDEN, JOINTS};
use crate::net::{device, tensor, values};
use crate::{Error, Result};

/// Name and shape of every array; matrices are (inputs, outputs).
pub(super) const ARRAYS: [(&str, [usize; 2]); 12] = [
    ("trunk1.weight", [ENCODED, HIDDEN]),
    ("trunk1.bias", [1, HIDDEN]),
    ("trunk2.weight", [HIDDEN, HIDDEN]),
    ("trunk2.bias", [1, HIDDEN]),
    ("trunk3.weight", [HIDDEN, HIDDEN]),
    ("trunk3.bias", [1, HIDDEN]),
    ("joints.weight", [HIDDEN, JOINTS]),
    ("joints.bias", [1, JOINTS]),
    ("contacts.weight", [HIDDEN, 2]),
    ("contacts.bias", [1, 2]),
    ("force.weight", [HIDDEN, 1]),
    ("force.bias", [1, 1]),
];

/// In the order of [`ARRAYS`], row-major.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Weights(pub Vec<Vec<f32>>);

impl Weights {
    /// Uniform in ±1/√inputs, weights and biases alike: what PyTorch's linear layers start from.
    pub fn initial(seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut bound = 0.0;
        let arrays = ARRAYS.map(|(name, [rows, columns])| {
            if name.ends_with("weight") {
                bound = 1.0 / (rows as f64).sqrt();
            }
            (0..rows * columns).map(|_| random.random_range(-bound..bound) as f32).collect()
        });
        Self(arrays.into())
    }
}

/// The 19 outputs for a mesh of V x 24 encoded vertices.
pub(super) fn outputs(weights: &Weights, encoded: &[f32]) -> Result<Vec<f64>> {
    let device = device()?;
    let out = values(forward(&load(weights, &device), encoded, &device))?;
    Ok(out.into_iter().map(f64::from).collect())
}

/// Derivatives of a loss of the outputs with respect to every array.
pub(super) fn gradients<T>(
    weights: &Weights,
    encoded: &[f32],
    loss: impl FnOnce(&[f64]) -> (T, Vec<f64>),
) -> Result<(T, Vec<Vec<f32>>)> {
    let device = device()?.autodiff();
    let parameters: Vec<Tensor<2>> = load(weights, &device).into_iter().map(Tensor::require_grad).collect();
    let out = forward(&parameters, encoded, &device);
    let plain: Vec<f64> = values(out.clone().detach())?.into_iter().map(f64::from).collect();
    let (result, derivatives) = loss(&plain);
    let derivatives: Vec<f32> = derivatives.into_iter().map(|s| s as f32).collect();
    let mut gradients = (out.clone() * tensor(derivatives, out.dims(), &device)).sum().backward();
    let of = |p: &Tensor<2>| match p.grad_remove(&mut gradients) {
        Some(gradient) => values(gradient),
        None => Err(Error::Backend { what: "a weight has no gradient".into() }),
    };
    Ok((result, parameters.iter().map(of).collect::<Result<_>>()?))
}

fn forward(p: &[Tensor<2>], encoded: &[f32], device: &Device) -> Tensor<2> {
    let layer = |x: Tensor<2>, i: usize| x.matmul(p[2 * i].clone()) + p[2 * i + 1].clone();
    let x = tensor(encoded.to_vec(), [encoded.len() / ENCODED, ENCODED], device);
    let x = (0..3).fold(x, |x, i| relu(layer(x, i)));
    let heads = vec![layer(x.clone(), 3), sigmoid(layer(x.clone(), 4)), sigmoid(layer(x, 5))];
    Tensor::cat(heads, 1).mean_dim(0)
}

fn load(weights: &Weights, device: &Device) -> Vec<Tensor<2>> {
    ARRAYS.iter().zip(&weights.0).map(|((_, shape), values)| tensor(values.clone(), *shape, device)).collect()
}

#[cfg(all(test, feature = "flex"))]
mod tests {
    use super::*;

    /// The network in plain f64.
    fn plain(w: &[Vec<f64>], encoded: &[f32]) -> Vec<f64> {
        let dense = |x: &[f64], i: usize| -> Vec<f64> {
            let columns = w[2 * i + 1].len();
            (0..columns)
                .map(|j| {
                    w[2 * i + 1][j] + x.iter().enumerate().map(|(n, v)| v * w[2 * i][n * columns + j]).sum::<f64>()
                })
                .collect()
        };
        let rows: Vec<&[f32]> = encoded.chunks(ENCODED).collect();
        let mut mean = vec![0.0; 19];
        for row in &rows {
            let mut x: Vec<f64> = row.iter().map(|v| f64::from(*v)).collect();
            for i in 0..3 {
                x = dense(&x, i).into_iter().map(|v| v.max(0.0)).collect();
            }
            let squash = |v: f64| 1.0 / (1.0 + (-v).exp());
            let out = dense(&x, 3).into_iter().chain(dense(&x, 4).into_iter().chain(dense(&x, 5)).map(squash));
            mean.iter_mut().zip(out).for_each(|(m, v)| *m += v / rows.len() as f64);
        }
        mean
    }

    #[test]
    fn shapes_outputs_and_gradients() {
        let weights = Weights::initial(4);
        assert_eq!(weights.0.iter().map(Vec::len).sum::<usize>(), 24 * 256 + 2 * 256 * 256 + 3 * 256 + 256 * 19 + 19);
        let encoded: Vec<f32> = (0..3 * ENCODED).map(|i| (i as f32 * 0.37).sin()).collect();
        let slope: Vec<f64> = (0..19).map(|i| (f64::from(i) * 1.3).cos()).collect();
        let (out, found) = gradients(&weights, &encoded, |out| (out.to_vec(), slope.clone())).unwrap();
        let mut w: Vec<Vec<f64>> = weights.0.iter().map(|a| a.iter().map(|v| f64::from(*v)).collect()).collect();
        assert!(out.iter().zip(plain(&w, &encoded)).all(|(a, b)| (a - b).abs() < 1e-5));
        assert_eq!(out, outputs(&weights, &encoded).unwrap());
        let total = |w: &[Vec<f64>]| plain(w, &encoded).iter().zip(&slope).map(|(a, b)| a * b).sum::<f64>();
        let largest = found.iter().flatten().fold(0.0_f64, |a, g| a.max(f64::from(g.abs())));
        for a in 0..ARRAYS.len() {
            for i in (0..w[a].len()).step_by(w[a].len() / 5 + 1) {
                let (value, step) = (w[a][i], 1e-5);
                w[a][i] = value + step;
                let above = total(&w);
                w[a][i] = value - step;
                let below = total(&w);
                w[a][i] = value;
                let slope = (above - below) / (2.0 * step);
                assert!((f64::from(found[a][i]) - slope).abs() < 1e-4 * largest, "{} {i}", ARRAYS[a].0);
            }
        }
    }
}
