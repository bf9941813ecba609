//! The numbers the network consists of, by name: how many there are and where they start.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::tensors;

/// Numbers that join after pooling: mass, friction, height of the table below the object's centre.
pub(crate) const SCALARS: usize = 3;

/// Sizes that fix the shape of every weight array.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Layout {
    /// Joints of the hand.
    pub joints: usize,
    /// K, grasps held ready.
    pub modes: usize,
    /// Width of the hidden layers.
    pub hidden: usize,
    /// Frequencies of the positional encoding.
    pub frequencies: usize,
    /// Fingers of the hand.
    pub fingers: usize,
}

impl Layout {
    /// Outputs per mode: joints, translation, two columns of a rotation, log grip force per weight, logit, one contact logit per finger.
    pub fn mode_width(&self) -> usize {
        self.joints + 3 + 6 + 2 + self.fingers
    }

    /// Where in a mode's outputs the nine numbers of the wrist begin.
    pub fn wrist(&self) -> usize {
        self.joints
    }

    /// Where in a mode's outputs the grip force stands.
    pub fn force(&self) -> usize {
        self.joints + 9
    }

    /// Where in a mode's outputs its logit stands.
    pub fn logit(&self) -> usize {
        self.joints + 10
    }

    /// Where in a mode's outputs the contact logits begin.
    pub fn contacts(&self) -> usize {
        self.joints + 11
    }

    /// Logarithms of the spread: one per joint, one of the translation, one of the rotation.
    pub fn spreads(&self) -> usize {
        self.joints + 2
    }

    /// Name and shape of every array, in the order the network uses them. Matrices are (inputs, outputs).
    pub fn arrays(&self) -> Vec<(&'static str, [usize; 2])> {
        let h = self.hidden;
        vec![
            ("point1.weight", [crate::cloud::encoding_width(self.frequencies), h]),
            ("point1.bias", [1, h]),
            ("point2.weight", [h, h]),
            ("point2.bias", [1, h]),
            ("point3.weight", [h, h]),
            ("point3.bias", [1, h]),
            ("trunk.from_max", [h, h]),
            ("trunk.from_mean", [h, h]),
            ("trunk.from_scalars", [SCALARS, h]),
            ("trunk.bias", [1, h]),
            ("head1.weight", [h, h]),
            ("head1.bias", [1, h]),
            ("head2.weight", [h, self.modes * self.mode_width()]),
            ("head2.from_scalars", [SCALARS, self.modes * self.mode_width()]),
            ("head2.bias", [1, self.modes * self.mode_width()]),
            ("log_spread", [1, self.spreads()]),
        ]
    }

    /// How many numbers the network has.
    pub fn parameters(&self) -> usize {
        self.arrays().iter().map(|(_, [rows, columns])| rows * columns).sum()
    }
}

/// Places in [`Layout::arrays`].
const HEAD2_BIAS: usize = 14;
/// The array that the network's outputs do not depend on.
pub(crate) const LOG_SPREAD: usize = 15;

/// The values of every array of a [`Layout`], row-major.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Weights {
    pub layout: Layout,
    /// In the order of [`Layout::arrays`].
    pub arrays: Vec<Vec<f32>>,
}

impl Weights {
    /// Where training starts: matrices uniform in ±sqrt(6 / inputs) (He et al. 2015, equation 10, as a uniform distribution), biases zero.
    /// The last layer is ten times smaller, and zero for the scalars: at the start, modes come from its bias, which the caller sets.
    pub fn initial(layout: Layout, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let scale = |name| match name {
            "head2.weight" => 0.1,
            "head2.from_scalars" => 0.0,
            _ => 1.0,
        };
        let arrays = layout.arrays().into_iter().map(|(name, [rows, columns])| {
            let bound = scale(name) * (6.0 / rows as f64).sqrt();
            let draw = |_| {
                if bound == 0.0 || name.ends_with("bias") || name == "log_spread" {
                    0.0
                } else {
                    random.random_range(-bound..bound) as f32
                }
            };
            (0..rows * columns).map(draw).collect()
        });
        Self { layout, arrays: arrays.collect() }
    }

    /// The bias of the last layer: one row of [`Layout::mode_width`] numbers per mode.
    pub fn mode_bias(&mut self, mode: usize) -> &mut [f32] {
        let width = self.layout.mode_width();
        &mut self.arrays[HEAD2_BIAS][mode * width..(mode + 1) * width]
    }

    /// Logarithms of the spreads: joints in rad, translation in lengths, rotation in rad.
    pub fn log_spread(&self) -> &[f32] {
        &self.arrays[LOG_SPREAD]
    }

    /// The same, to be written.
    pub fn log_spread_mut(&mut self) -> &mut [f32] {
        &mut self.arrays[LOG_SPREAD]
    }

    /// The weights as a safetensors file. The same weights give the same bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        tensors::to_bytes(&self.named(""), None)
    }

    /// Every array with its name after `prefix`.
    pub fn named(&self, prefix: &str) -> Vec<tensors::Array<'_>> {
        let arrays = self.layout.arrays().into_iter().zip(&self.arrays);
        arrays.map(|((name, shape), values)| (format!("{prefix}{name}"), shape, values.as_slice())).collect()
    }

    /// Reads [`Weights::to_bytes`], or any safetensors file with exactly these arrays as F32.
    ///
    /// # Errors
    /// A sentence that says what is wrong. No input panics or allocates more than its own length.
    pub fn from_bytes(layout: Layout, bytes: &[u8]) -> Result<Self, String> {
        let expected: Vec<_> = layout.arrays().into_iter().map(|(name, shape)| (name.to_owned(), shape)).collect();
        Ok(Self { layout, arrays: tensors::from_bytes(&expected, bytes)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SMALL: Layout = Layout { joints: 2, modes: 3, hidden: 4, frequencies: 1, fingers: 2 };

    #[test]
    fn bytes_round_trip_and_are_stable() {
        let weights = Weights::initial(SMALL, 5);
        let bytes = weights.to_bytes();
        assert_eq!(bytes, weights.to_bytes());
        assert_eq!(Weights::from_bytes(SMALL, &bytes).unwrap(), weights);
        let other = Layout { hidden: 5, ..SMALL };
        assert!(Weights::from_bytes(other, &bytes).unwrap_err().contains("point1.weight"));
    }

    #[test]
    fn initial_values_have_their_spread() {
        let layout = Layout { joints: 16, modes: 8, hidden: 64, frequencies: 6, fingers: 4 };
        let weights = Weights::initial(layout, 1);
        let matrix = &weights.arrays[2];
        let variance = matrix.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / matrix.len() as f64;
        assert!((variance * 64.0 / 2.0 - 1.0).abs() < 0.05, "He: variance 2 / inputs, found {variance}");
        assert!(weights.arrays[1].iter().all(|v| *v == 0.0));
        assert_eq!(layout.arrays()[HEAD2_BIAS].0, "head2.bias");
        assert_eq!(layout.arrays()[LOG_SPREAD].0, "log_spread");
        assert_eq!(layout.parameters(), weights.arrays.iter().map(Vec::len).sum::<usize>());
    }

    #[test]
    fn damage_is_named() {
        let weights = Weights::initial(SMALL, 5);
        let bytes = weights.to_bytes();
        let start = 8 + u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
        let says = |bytes: &[u8], word: &str| {
            let message = Weights::from_bytes(SMALL, bytes).unwrap_err();
            assert!(message.contains(word), "'{word}' is missing in: {message}");
        };
        let header = |from: &str, to: &str| {
            let text = String::from_utf8(bytes[8..start].to_vec()).unwrap();
            assert!(text.contains(from), "{text}");
            let text = text.replacen(from, to, 1);
            [&(text.len() as u64).to_le_bytes()[..], text.as_bytes(), &bytes[start..]].concat()
        };
        says(&[], "shorter than its header");
        says(&bytes[..20], "longer than the file");
        says(&bytes[..bytes.len() - 4], "do not hold");
        says(&[&bytes[..], &[0; 4]].concat(), "but the file holds");
        says(&u64::MAX.to_le_bytes(), "longer than the file");
        says(&header("F32", "F16"), "not F32");
        says(&header("\"trunk.bias\"", "\"trunk.bais\""), "'trunk.bias' is missing");
        says(&header("{\"head1.bias\"", "{\"more\":0,\"head1.bias\""), "'more' does not belong");
        says(&header("{\"head1.bias\"", "{{"), "no JSON object");
        let mut nan = bytes.clone();
        nan[start..start + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        says(&nan, "holds NaN at position 0");
        let with_note = header("{\"head1.bias\"", "{\"__metadata__\":{\"a\":\"b\"},\"head1.bias\"");
        assert_eq!(Weights::from_bytes(SMALL, &with_note).unwrap(), weights);
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(noise in prop::collection::vec(any::<u8>(), 0..40), at in 0usize..3000, cut in any::<bool>()) {
            let mut bytes = Weights::initial(SMALL, 5).to_bytes();
            let at = at.min(bytes.len());
            let end = if cut { bytes.len() } else { (at + noise.len()).min(bytes.len()) };
            bytes.splice(at..end, noise);
            let _ = Weights::from_bytes(SMALL, &bytes);
        }
    }
}
