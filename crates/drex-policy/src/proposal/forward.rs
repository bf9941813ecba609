//! The network without a tensor library: what proposes grasps in milliseconds on one core.
//!
//! Columns are samples: an array (inputs, outputs), row-major, is its transpose as nalgebra stores it.

use nalgebra::{DMatrix, DMatrixView};

use super::scene::{PATCH, SCALARS};
use super::weights::{Layout, at};

/// What the network says of places: PLACE x A features, and K x A logarithms of rates.
pub(crate) struct Places {
    pub features: DMatrix<f32>,
    pub log_rates: DMatrix<f32>,
}

/// A network ready to be asked.
pub(crate) struct Forward<'a> {
    arrays: Vec<DMatrixView<'a, f32>>,
    values: &'a [Vec<f32>],
}

impl<'a> Forward<'a> {
    pub fn new(layout: &Layout, arrays: &'a [Vec<f32>]) -> Self {
        let view = |((_, [inputs, outputs]), values): ((&str, [usize; 2]), &'a Vec<f32>)| {
            DMatrixView::from_slice(values, outputs, inputs)
        };
        Self { arrays: layout.arrays().into_iter().zip(arrays).map(view).collect(), values: arrays }
    }

    /// Looks at places: `patches` are A times [`PATCH`] points, `scalars` A times [`SCALARS`] numbers.
    pub fn places(&self, patches: &[f32], scalars: &[f32]) -> Places {
        let count = scalars.len() / SCALARS;
        let mut x = DMatrix::from_column_slice(3, count * PATCH, patches);
        for layer in at::POINT {
            x = self.dense(layer, &x, true);
        }
        let width = x.nrows();
        let (mut most, mut mean) = (DMatrix::zeros(width, count), DMatrix::zeros(width, count));
        for (i, point) in x.column_iter().enumerate() {
            let (mut most, mut mean) = (most.column_mut(i / PATCH), mean.column_mut(i / PATCH));
            for ((v, most), mean) in point.iter().zip(most.iter_mut()).zip(mean.iter_mut()) {
                // No value is negative.
                *most = v.max(*most);
                *mean += v / PATCH as f32;
            }
        }
        let scalars = DMatrix::from_column_slice(SCALARS, count, scalars);
        let mut x = self.arrays[at::FROM_MAX] * most;
        x += self.arrays[at::FROM_MEAN] * mean;
        x += self.arrays[at::FROM_SCALARS] * scalars;
        self.finish(at::PLACE_BIAS, &mut x, true);
        let features = self.dense(at::PLACE2, &x, true);
        let log_rates = self.dense(at::RATE, &features, false);
        Places { features, log_rates }
    }

    /// The changes of prototypes at places, a column for each pair (place, prototype).
    pub fn changes(&self, features: &DMatrix<f32>, pairs: &[(usize, usize)]) -> DMatrix<f32> {
        let mut x = DMatrix::zeros(features.nrows(), pairs.len());
        for (mut column, (place, _)) in x.column_iter_mut().zip(pairs) {
            column.copy_from(&features.column(*place));
        }
        let mut x = self.arrays[at::CHANGE_OF_PLACE] * x;
        for (mut column, (_, prototype)) in x.column_iter_mut().zip(pairs) {
            column += self.arrays[at::CHANGE_OF_PROTOTYPE].column(*prototype);
        }
        x.apply(|v| *v = v.max(0.0));
        let x = self.dense(at::CHANGE2, &x, true);
        self.dense(at::CHANGE3, &x, false)
    }

    /// The layer with its weight at `layer` and its bias next to it.
    fn dense(&self, layer: usize, x: &DMatrix<f32>, rectified: bool) -> DMatrix<f32> {
        let mut out = self.arrays[layer] * x;
        self.finish(layer + 1, &mut out, rectified);
        out
    }

    fn finish(&self, bias: usize, x: &mut DMatrix<f32>, rectified: bool) {
        let bias = &self.values[bias];
        for column in x.as_mut_slice().chunks_exact_mut(bias.len()) {
            for (v, b) in column.iter_mut().zip(bias) {
                *v += b;
                if rectified {
                    *v = v.max(0.0);
                }
            }
        }
    }
}
