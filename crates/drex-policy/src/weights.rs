//! The numbers a network consists of, by name: how many there are, where they start, and their file format.
//!
//! Files are in the safetensors format (eight bytes with the length of a JSON header, the header with type, shape and byte range
//! of each tensor, then the raw little-endian values), so that other programs can read the weights.

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

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
}

impl Layout {
    /// Outputs per mode: joints, translation, two columns of a rotation, log squeeze per weight, logit.
    pub fn mode_width(&self) -> usize {
        self.joints + 3 + 6 + 2
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
            ("trunk.from_mass", [1, h]),
            ("trunk.bias", [1, h]),
            ("head1.weight", [h, h]),
            ("head1.bias", [1, h]),
            ("head2.weight", [h, self.modes * self.mode_width()]),
            ("head2.from_mass", [1, self.modes * self.mode_width()]),
            ("head2.bias", [1, self.modes * self.mode_width()]),
        ]
    }

    /// How many numbers the network has.
    pub fn parameters(&self) -> usize {
        self.arrays().iter().map(|(_, [rows, columns])| rows * columns).sum()
    }
}

/// The values of every array of a [`Layout`], row-major.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Weights {
    pub layout: Layout,
    /// In the order of [`Layout::arrays`].
    pub arrays: Vec<Vec<f32>>,
}

impl Weights {
    /// Where training starts: matrices uniform in ±sqrt(6 / inputs) (He et al. 2015, equation 10, as a uniform distribution), biases zero.
    /// The last layer is ten times smaller, and zero for the mass: at the start, modes come from its bias, which the caller sets.
    pub fn initial(layout: Layout, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let scale = |name| match name {
            "head2.weight" => 0.1,
            "head2.from_mass" => 0.0,
            _ => 1.0,
        };
        let arrays = layout.arrays().into_iter().map(|(name, [rows, columns])| {
            let bound = scale(name) * (6.0 / rows as f64).sqrt();
            let draw = |_| {
                if bound == 0.0 || name.ends_with("bias") { 0.0 } else { random.random_range(-bound..bound) as f32 }
            };
            (0..rows * columns).map(draw).collect()
        });
        Self { layout, arrays: arrays.collect() }
    }

    /// The bias of the last layer: one row of [`Layout::mode_width`] numbers per mode.
    pub fn mode_bias(&mut self, mode: usize) -> &mut [f32] {
        let width = self.layout.mode_width();
        // `arrays` is never empty: `initial` and `from_bytes` fill it by `Layout::arrays`, whose last entry is this bias.
        let last = self.arrays.len() - 1;
        &mut self.arrays[last][mode * width..(mode + 1) * width]
    }

    /// The weights as a safetensors file. The same weights give the same bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut header = BTreeMap::new();
        let mut data = Vec::with_capacity(4 * self.layout.parameters());
        for ((name, shape), values) in self.layout.arrays().into_iter().zip(&self.arrays) {
            let start = data.len();
            data.extend(values.iter().flat_map(|v| v.to_le_bytes()));
            header.insert(
                name.to_owned(),
                Entry { dtype: "F32".into(), shape: shape.to_vec(), data_offsets: [start, data.len()] },
            );
        }
        let mut header = serde_json::to_vec(&header).unwrap_or_default();
        // The format wants the values aligned to eight bytes and allows spaces after the header.
        header.resize(header.len().next_multiple_of(8), b' ');
        let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
        bytes.append(&mut header);
        bytes.append(&mut data);
        bytes
    }

    /// Reads [`Weights::to_bytes`], or any safetensors file with exactly these arrays as F32.
    ///
    /// # Errors
    /// A sentence that says what is wrong. No input panics or allocates more than its own length.
    pub fn from_bytes(layout: Layout, bytes: &[u8]) -> Result<Self, String> {
        let (length, rest) = bytes.split_first_chunk::<8>().ok_or("the file is shorter than its header")?;
        let length = usize::try_from(u64::from_le_bytes(*length)).ok().filter(|&l| l <= rest.len());
        let (header, data) = rest.split_at(length.ok_or("the header is longer than the file")?);
        let mut header: BTreeMap<String, serde_json::Value> =
            serde_json::from_slice(header).map_err(|e| format!("the header is no JSON object ({e})"))?;
        header.remove("__metadata__"); // free text that the format allows
        let mut arrays = Vec::new();
        let mut used = 0;
        for (name, shape) in layout.arrays() {
            let entry = header.remove(name).ok_or_else(|| format!("array '{name}' is missing"))?;
            let entry: Entry = serde_json::from_value(entry).map_err(|e| format!("array '{name}': {e}"))?;
            if entry.dtype != "F32" || entry.shape != shape {
                return Err(format!("array '{name}' is {} {:?}, not F32 {shape:?}", entry.dtype, entry.shape));
            }
            let [start, end] = entry.data_offsets;
            let values = data.get(start..end).filter(|v| v.len() == 4 * shape[0] * shape[1]);
            let values = values.ok_or_else(|| {
                format!("array '{name}' has bytes {start} .. {end}, which do not hold {shape:?} numbers")
            })?;
            used += values.len();
            let values: Vec<f32> = values.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect();
            if let Some(at) = values.iter().position(|v| !v.is_finite()) {
                return Err(format!("array '{name}' holds {} at position {at}", values[at]));
            }
            arrays.push(values);
        }
        if let Some(name) = header.keys().next() {
            return Err(format!("array '{name}' does not belong to this network"));
        }
        if used != data.len() {
            return Err(format!("the arrays take {used} bytes but the file holds {}", data.len()));
        }
        Ok(Self { layout, arrays })
    }
}

/// What the header of a safetensors file says about one array.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    dtype: String,
    shape: Vec<usize>,
    data_offsets: [usize; 2],
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SMALL: Layout = Layout { joints: 2, modes: 3, hidden: 4, frequencies: 1 };

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
        let layout = Layout { joints: 16, modes: 8, hidden: 64, frequencies: 6 };
        let weights = Weights::initial(layout, 1);
        let matrix = &weights.arrays[2];
        let variance = matrix.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / matrix.len() as f64;
        assert!((variance * 64.0 / 2.0 - 1.0).abs() < 0.05, "He: variance 2 / inputs, found {variance}");
        assert!(weights.arrays[1].iter().all(|v| *v == 0.0));
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
        fn arbitrary_bytes_never_panic(noise in prop::collection::vec(any::<u8>(), 0..40), at in 0usize..2500, cut in any::<bool>()) {
            let mut bytes = Weights::initial(SMALL, 5).to_bytes();
            let at = at.min(bytes.len());
            let end = if cut { bytes.len() } else { (at + noise.len()).min(bytes.len()) };
            bytes.splice(at..end, noise);
            let _ = Weights::from_bytes(SMALL, &bytes);
        }
    }
}
