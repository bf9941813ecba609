//! The numbers of a proposal network, by name.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::scene::SCALARS;

/// Widths of the layers for points, for places, and for the changes of prototypes.
const POINT: [usize; 3] = [32, 64, 128];
const PLACE: usize = 256;
const CHANGE: usize = 128;

/// Sizes that fix the shape of every array.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Layout {
    /// Joints of the hand.
    pub joints: usize,
    /// Prototypes of grasps.
    pub prototypes: usize,
}

/// Places in [`Layout::arrays`].
pub(crate) mod at {
    pub const POINT: [usize; 3] = [0, 2, 4];
    pub const FROM_MAX: usize = 6;
    pub const FROM_MEAN: usize = 7;
    pub const FROM_SCALARS: usize = 8;
    pub const PLACE_BIAS: usize = 9;
    pub const PLACE2: usize = 10;
    pub const RATE: usize = 12;
    pub const CHANGE_OF_PLACE: usize = 14;
    pub const CHANGE_OF_PROTOTYPE: usize = 15;
    pub const CHANGE2: usize = 16;
    pub const CHANGE3: usize = 18;
}

impl Layout {
    /// Numbers of a change: shift and turn of the wrist, then the joints.
    pub fn change(&self) -> usize {
        6 + self.joints
    }

    /// Name and shape (inputs, outputs) of every array.
    pub fn arrays(&self) -> Vec<(&'static str, [usize; 2])> {
        let [a, b, c] = POINT;
        vec![
            ("point1.weight", [3, a]),
            ("point1.bias", [1, a]),
            ("point2.weight", [a, b]),
            ("point2.bias", [1, b]),
            ("point3.weight", [b, c]),
            ("point3.bias", [1, c]),
            ("place.from_max", [c, PLACE]),
            ("place.from_mean", [c, PLACE]),
            ("place.from_scalars", [SCALARS, PLACE]),
            ("place.bias", [1, PLACE]),
            ("place2.weight", [PLACE, PLACE]),
            ("place2.bias", [1, PLACE]),
            ("rate.weight", [PLACE, self.prototypes]),
            ("rate.bias", [1, self.prototypes]),
            ("change.of_place", [PLACE, CHANGE]),
            ("change.of_prototype", [self.prototypes, CHANGE]),
            ("change2.weight", [CHANGE, CHANGE]),
            ("change2.bias", [1, CHANGE]),
            ("change3.weight", [CHANGE, self.change()]),
            ("change3.bias", [1, self.change()]),
        ]
    }

    /// Where training starts: matrices uniform in ±sqrt(6 / inputs) (He et al. 2015, equation 10, as a uniform distribution), the last ones
    /// ten times smaller, biases zero.
    pub fn initial(&self, seed: u64) -> Vec<Vec<f32>> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let array = |(name, [rows, columns]): (&str, [usize; 2])| {
            let inputs = if name == "change.of_prototype" { 6 } else { rows };
            let small = name == "rate.weight" || name == "change3.weight";
            let bound = (6.0 / inputs as f64).sqrt() * if small { 0.1 } else { 1.0 };
            let draw = |_| if name.ends_with("bias") { 0.0 } else { random.random_range(-bound..bound) as f32 };
            (0..rows * columns).map(draw).collect()
        };
        self.arrays().into_iter().map(array).collect()
    }
}
