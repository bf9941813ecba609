//! The network itself: a PointNet encoder, scalars after pooling, K modes. The only module besides paper mode that knows burn.
//!
//! Tensor shapes: N points, E numbers per encoded point, B samples, K modes, H hidden units.

use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor, TensorData};

use crate::weights::{LOG_SPREAD, Layout, SCALARS, Weights};
use crate::{Error, Result};

/// Outputs of the last layer for each row of scalars: B x K x [`Layout::mode_width`], row-major. `scalars` is B x [`SCALARS`].
///
/// # Errors
/// If the build has no backend or the backend fails.
pub(crate) fn outputs(weights: &Weights, encoded: &[f32], scalars: &[f32]) -> Result<Vec<f32>> {
    let device = device()?;
    let parameters = load(weights, &device);
    values(forward(&weights.layout, &parameters, encoded, scalars, &device))
}

/// What a loss says of the outputs.
pub(crate) struct Derivatives {
    /// Derivatives with respect to the outputs.
    pub outputs: Vec<f32>,
    /// Derivatives with respect to the logarithms of the spreads.
    pub log_spread: Vec<f32>,
}

/// Runs the network, asks `loss` for the derivatives of its outputs, and takes them back to every array of the weights.
///
/// # Errors
/// If the build has no backend or the backend fails.
pub(crate) fn gradients<T>(
    weights: &Weights,
    encoded: &[f32],
    scalars: &[f32],
    loss: impl FnOnce(&[f32]) -> (T, Derivatives),
) -> Result<(T, Vec<Vec<f32>>)> {
    let device = device()?.autodiff();
    let parameters: Vec<Tensor<2>> = load(weights, &device).into_iter().map(Tensor::require_grad).collect();
    let outputs = forward(&weights.layout, &parameters, encoded, scalars, &device);
    let (result, derivatives) = loss(&values(outputs.clone().detach())?);
    let total = (outputs.clone() * tensor(derivatives.outputs, outputs.dims(), &device)).sum();
    let mut gradients = total.backward();
    let mut found = Vec::new();
    for (i, p) in parameters.iter().enumerate() {
        found.push(match p.grad_remove(&mut gradients) {
            _ if i == LOG_SPREAD => derivatives.log_spread.clone(),
            Some(gradient) => values(gradient)?,
            None => return Err(Error::Backend { what: "a weight has no gradient".into() }),
        });
    }
    Ok((result, found))
}

/// The encoder runs once whatever the number of rows: they share the cloud, and the scalars join after pooling.
fn forward(layout: &Layout, p: &[Tensor<2>], encoded: &[f32], scalars: &[f32], device: &Device) -> Tensor<2> {
    let weight = |i: usize| p[i].clone();
    let width = crate::cloud::encoding_width(layout.frequencies);
    let x = tensor(encoded.to_vec(), [encoded.len() / width, width], device);
    let x = relu(x.matmul(weight(0)) + weight(1));
    let x = relu(x.matmul(weight(2)) + weight(3));
    let x = relu(x.matmul(weight(4)) + weight(5));
    // Pooled before the heads (Qi et al. 2017): the heads see the whole object, not a vote of single points.
    let object = x.clone().max_dim(0).matmul(weight(6)) + x.mean_dim(0).matmul(weight(7)) + weight(9);
    let scalars = tensor(scalars.to_vec(), [scalars.len() / SCALARS, SCALARS], device);
    let x = relu(scalars.clone().matmul(weight(8)) + object);
    let x = relu(x.matmul(weight(10)) + weight(11));
    // The scalars also go straight to the outputs: a power law of the grip force in mass and friction needs nothing else.
    x.matmul(weight(12)) + scalars.matmul(weight(13)) + weight(14)
}

fn load(weights: &Weights, device: &Device) -> Vec<Tensor<2>> {
    let arrays = weights.layout.arrays().into_iter().zip(&weights.arrays);
    arrays.map(|((_, shape), values)| tensor(values.clone(), shape, device)).collect()
}

pub(crate) fn tensor(values: Vec<f32>, shape: [usize; 2], device: &Device) -> Tensor<2> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

pub(crate) fn values<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>> {
    tensor.try_into_vec_as::<f32>().map_err(|e| Error::Backend { what: e.to_string() })
}

#[cfg(feature = "flex")]
pub(crate) fn device() -> Result<Device> {
    Ok(Device::flex())
}

#[cfg(not(feature = "flex"))]
pub(crate) fn device() -> Result<Device> {
    Err(Error::NoBackend)
}

#[cfg(all(test, feature = "flex"))]
mod tests {
    use super::*;

    const LAYOUT: Layout = Layout { joints: 2, modes: 3, hidden: 8, frequencies: 1, fingers: 1 };

    fn wave(count: usize, step: f32) -> Vec<f32> {
        (0..count).map(|i| ((i as f32 + 1.0) * step).sin()).collect()
    }

    /// The same network in plain f64, written from the formulas: the oracle for values and derivatives.
    fn plain(w: &[Vec<f64>], encoded: &[f32], scalars: &[f32]) -> Vec<f64> {
        let h = LAYOUT.hidden;
        let dense = |x: &[f64], m: &[f64]| -> Vec<f64> {
            let columns = m.len() / x.len();
            (0..columns).map(|j| x.iter().enumerate().map(|(i, v)| v * m[i * columns + j]).sum()).collect()
        };
        let add = |a: Vec<f64>, b: &[f64]| a.iter().zip(b).map(|(a, b)| a + b).collect::<Vec<_>>();
        let relu = |x: Vec<f64>| x.into_iter().map(|v| v.max(0.0)).collect::<Vec<_>>();
        let wide = |x: &[f32]| x.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
        let (mut most, mut mean) = (vec![f64::NEG_INFINITY; h], vec![0.0; h]);
        let rows: Vec<_> = encoded.chunks(9).collect();
        for row in &rows {
            let x = relu(add(dense(&wide(row), &w[0]), &w[1]));
            let x = relu(add(dense(&x, &w[2]), &w[3]));
            let x = relu(add(dense(&x, &w[4]), &w[5]));
            for j in 0..h {
                most[j] = x[j].max(most[j]);
                mean[j] += x[j] / rows.len() as f64;
            }
        }
        let object = add(add(dense(&most, &w[6]), &dense(&mean, &w[7])), &w[9]);
        let mut out = Vec::new();
        for s in scalars.chunks(SCALARS) {
            let x = relu(add(dense(&wide(s), &w[8]), &object));
            let x = relu(add(dense(&x, &w[10]), &w[11]));
            out.extend(add(add(dense(&x, &w[12]), &dense(&wide(s), &w[13])), &w[14]));
        }
        out
    }

    #[test]
    fn outputs_and_gradients_match_plain_f64_and_finite_differences() {
        let mut weights = Weights::initial(LAYOUT, 3);
        weights.arrays[13] = wave(weights.arrays[13].len(), 2.1); // zero at the start, which would hide its part
        let (encoded, scalars) = (wave(5 * 9, 0.7), [-1.0, 0.3, 0.5, 0.5, -0.2, 0.4]);
        // The loss is a fixed sum of the outputs: its derivative with respect to a weight is that of the network.
        let slope = wave(2 * 3 * LAYOUT.mode_width(), 1.9);
        let loss = |outputs: &[f32]| {
            let derivatives = Derivatives { outputs: slope.clone(), log_spread: vec![0.5; 4] };
            (outputs.to_vec(), derivatives)
        };
        let (outputs, gradients) = gradients(&weights, &encoded, &scalars, loss).unwrap();
        let mut w: Vec<Vec<f64>> = weights.arrays.iter().map(|a| a.iter().map(|v| f64::from(*v)).collect()).collect();
        let expected = plain(&w, &encoded, &scalars);
        assert_eq!(outputs.len(), expected.len());
        assert!(outputs.iter().zip(&expected).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-5));
        assert_eq!(gradients[LOG_SPREAD], [0.5; 4]);
        let total = |w: &[Vec<f64>]| {
            plain(w, &encoded, &scalars).iter().zip(&slope).map(|(a, b)| a * f64::from(*b)).sum::<f64>()
        };
        let largest = gradients.iter().flatten().fold(0.0_f64, |a, g| a.max(f64::from(g.abs())));
        let (step, mut compared) = (1e-6, 0);
        for a in 0..LOG_SPREAD {
            for i in (0..w[a].len()).step_by(3) {
                let value = w[a][i];
                w[a][i] = value + step;
                let above = total(&w);
                w[a][i] = value - step;
                let below = total(&w);
                w[a][i] = value;
                let expected = (above - below) / (2.0 * step);
                let found = f64::from(gradients[a][i]);
                assert!((found - expected).abs() < 1e-4 * largest, "array {a}, entry {i}: {found} against {expected}");
                compared += 1;
            }
        }
        assert!(compared > 100 && largest > 0.1);
    }

    #[test]
    fn order_of_points_does_not_matter_and_scalars_do() {
        let mut weights = Weights::initial(LAYOUT, 9);
        weights.arrays[13] = wave(weights.arrays[13].len(), 2.1);
        let encoded = wave(5 * 9, 0.7);
        let reversed: Vec<f32> = encoded.chunks(9).rev().flatten().copied().collect();
        let ask = |encoded: &[f32], scalars: [f32; 3]| outputs(&weights, encoded, &scalars).unwrap();
        let a = ask(&encoded, [0.5, 0.0, 0.0]);
        let near = |b: Vec<f32>| a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(near(ask(&reversed, [0.5, 0.0, 0.0])));
        for other in [[0.4, 0.0, 0.0], [0.5, 0.1, 0.0], [0.5, 0.0, 0.1]] {
            assert!(!near(ask(&encoded, other)));
        }
    }
}
