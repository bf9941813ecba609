//! An affine map of the colours, one a photo: what automatic exposure and white balance changed from photo to photo.

use rayon::prelude::*;

use drex_core::simd::vectorised;

/// Pixels that one task of a parallel loop does.
const CHUNK: usize = 1 << 13;

/// `rgb' = A rgb + b`, applied to a render before it is compared with its photo (as in the 2024 revision of the code of
/// Kerbl et al. 2023, and in Urban Radiance Fields, Rematas et al. 2022, section 4.2).
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Exposure {
    /// Rows of (A | b), for red, green and blue.
    pub matrix: [[f32; 4]; 3],
}

impl Default for Exposure {
    fn default() -> Self {
        Self { matrix: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]] }
    }
}

impl Exposure {
    /// One colour.
    #[inline(always)]
    pub fn apply(&self, rgb: [f32; 3]) -> [f32; 3] {
        self.matrix.map(|m| m[0] * rgb[0] + m[1] * rgb[1] + m[2] * rgb[2] + m[3])
    }

    /// All colours of an image.
    pub fn apply_all(&self, rgb: &[[f32; 3]]) -> Vec<[f32; 3]> {
        rgb.par_iter().with_min_len(CHUNK).map(|rgb| self.apply(*rgb)).collect()
    }

    /// Takes the derivative of a loss by the mapped colours, makes it the derivative by the colours `rgb` before the
    /// map, and gives the derivative by [`Exposure::matrix`].
    pub fn backward(&self, rgb: &[[f32; 3]], gradient: &mut [[f32; 3]]) -> [[f32; 4]; 3] {
        let m = self.matrix;
        let chunks: Vec<[[f64; 4]; 3]> = gradient
            .par_chunks_mut(CHUNK)
            .zip(rgb.par_chunks(CHUNK))
            .map(|(gradient, rgb)| {
                vectorised(
                    #[inline(always)]
                    || {
                        let mut sums = [[0.0; 4]; 3];
                        for (g, rgb) in gradient.iter_mut().zip(rgb) {
                            let rgb1 = [rgb[0], rgb[1], rgb[2], 1.0].map(f64::from);
                            for c in 0..3 {
                                (0..4).for_each(|k| sums[c][k] += f64::from(g[c]) * rgb1[k]);
                            }
                            *g = std::array::from_fn(|k| m[0][k] * g[0] + m[1][k] * g[1] + m[2][k] * g[2]);
                        }
                        sums
                    },
                )
            })
            .collect();
        std::array::from_fn(|c| std::array::from_fn(|k| chunks.iter().map(|sums| sums[c][k]).sum::<f64>() as f32))
    }
}
