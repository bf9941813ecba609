//! Squared distances of descriptors, exact on every processor, by AVX2 where there is AVX2.
//!
//! The engine's own use AVX2 only where no wider vectors are known: in a program that was built for AVX-512 as well, on a machine that has it,
//! they fall back to one number at a time.

use openmvg_features::matching::DistanceMetric;

/// 128 numbers that tell what a keypoint looks like.
pub(crate) type Descriptor = [u8; 128];

/// For the engine's search.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SquaredDistance {
    #[cfg(target_arch = "x86_64")]
    avx2: Option<pulp::x86::V3>,
}

impl Default for SquaredDistance {
    fn default() -> Self {
        Self {
            #[cfg(target_arch = "x86_64")]
            avx2: pulp::x86::V3::try_new(),
        }
    }
}

impl DistanceMetric<u8> for SquaredDistance {
    fn distance(&self, a: &[u8], b: &[u8]) -> f32 {
        let (Ok(a), Ok(b)) = (a.try_into(), b.try_into()) else { return f32::INFINITY };
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = self.avx2 {
            return simd.vectorize(avx2::One { simd, a, b }) as f32;
        }
        squared(a, b) as f32
    }

    fn is_valid_descriptor(&self, descriptor: &[u8]) -> bool {
        descriptor.len() == 128
    }
}

/// Calls `take` with the distances of one of `first` to some of `second` that follow each other, and the indices of the first two, until each two have met.
/// Those of one descriptor come in the order of the others.
pub(crate) fn each(first: &[Descriptor], second: &[Descriptor], mut take: impl FnMut([usize; 2], &[u32])) {
    #[cfg(target_arch = "x86_64")]
    if let Some(simd) = pulp::x86::V3::try_new() {
        return simd.vectorize(avx2::Each { simd, first, second, take });
    }
    for (i, a) in first.iter().enumerate() {
        for (j, b) in second.iter().enumerate() {
            take([i, j], &[squared(a, b)]);
        }
    }
}

fn squared(a: &Descriptor, b: &Descriptor) -> u32 {
    a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b)).pow(2)).sum()
}

/// Everything here is inlined into [`pulp::x86::V3::vectorize`].
#[cfg(target_arch = "x86_64")]
mod avx2 {
    use pulp::x86::V3;
    use pulp::{NullaryFnOnce, cast, i16x16, i32x8, u8x16};

    use super::Descriptor;

    pub(super) struct One<'a> {
        pub(super) simd: V3,
        pub(super) a: &'a Descriptor,
        pub(super) b: &'a Descriptor,
    }

    impl NullaryFnOnce for One<'_> {
        type Output = u32;

        #[inline(always)]
        fn call(self) -> u32 {
            squared(self.simd, &wide(self.simd, self.a), self.b)
        }
    }

    pub(super) struct Each<'a, F> {
        pub(super) simd: V3,
        pub(super) first: &'a [Descriptor],
        pub(super) second: &'a [Descriptor],
        pub(super) take: F,
    }

    /// Descriptors of the second photo that are compared side by side: four vectors of eight, which stay in the processor's nearest memory.
    const BLOCK: usize = 32;

    impl<F: FnMut([usize; 2], &[u32])> NullaryFnOnce for Each<'_, F> {
        type Output = ();

        /// |a - b|² = |a|² + |b|² - 2 a·b, where two numbers of `a` meet those of eight descriptors at a time.
        #[inline(always)]
        fn call(mut self) {
            let simd = self.simd;
            let norm = |d: &Descriptor| d.iter().map(|v| i32::from(*v).pow(2)).sum::<i32>();
            let pairs = |d: &Descriptor| -> [i32; 64] { cast(wide(simd, d)) };
            let first: Vec<_> = self.first.iter().map(|d| (norm(d), pairs(d))).collect();
            let mut tile = [[[0; 8]; BLOCK / 8]; 64];
            let mut norms = [[0; 8]; BLOCK / 8];
            for (start, block) in (0..).step_by(BLOCK).zip(self.second.chunks(BLOCK)) {
                for (at, descriptor) in block.iter().enumerate() {
                    norms[at / 8][at % 8] = norm(descriptor);
                    for (row, pair) in tile.iter_mut().zip(pairs(descriptor)) {
                        row[at / 8][at % 8] = pair;
                    }
                }
                // Copies into vectors take time where each is used.
                let (tile, norms): ([[i16x16; BLOCK / 8]; 64], [i32x8; BLOCK / 8]) = (cast(tile), cast(norms));
                for (i, (norm, pairs)) in first.iter().enumerate() {
                    let mut dots = [simd.splat_i32x8(0); BLOCK / 8];
                    for (pair, row) in pairs.iter().zip(&tile) {
                        let a: i16x16 = cast(simd.splat_i32x8(*pair));
                        dots = std::array::from_fn(
                            #[inline(always)]
                            |k| {
                                let products = simd.multiply_wrapping_add_adjacent_i16x16(a, row[k]);
                                simd.wrapping_add_i32x8(dots[k], products)
                            },
                        );
                    }
                    let distances: [u32; BLOCK] = cast(std::array::from_fn::<i32x8, { BLOCK / 8 }, _>(
                        #[inline(always)]
                        |k| {
                            let norms = simd.wrapping_add_i32x8(simd.splat_i32x8(*norm), norms[k]);
                            simd.wrapping_sub_i32x8(norms, simd.wrapping_add_i32x8(dots[k], dots[k]))
                        },
                    ));
                    (self.take)([i, start], &distances[..block.len()]);
                }
            }
        }
    }

    #[inline(always)]
    fn wide(simd: V3, descriptor: &Descriptor) -> [i16x16; 8] {
        let (blocks, _) = pulp::as_arrays::<16, _>(descriptor);
        std::array::from_fn(
            #[inline(always)]
            |k| simd.convert_u8x16_to_i16x16(cast::<_, u8x16>(blocks[k])),
        )
    }

    #[inline(always)]
    fn squared(simd: V3, a: &[i16x16; 8], b: &Descriptor) -> u32 {
        let b = wide(simd, b);
        let mut sums = [simd.splat_i32x8(0); 2];
        for k in 0..8 {
            let off = simd.wrapping_sub_i16x16(a[k], b[k]);
            let squares = simd.multiply_wrapping_add_adjacent_i16x16(off, off);
            sums[k % 2] = simd.wrapping_add_i32x8(sums[k % 2], squares);
        }
        let lanes: [i32; 8] = cast::<i32x8, _>(simd.wrapping_add_i32x8(sums[0], sums[1]));
        // An iterator's sum would be a call.
        ((lanes[0] + lanes[1]) + (lanes[2] + lanes[3]) + (lanes[4] + lanes[5]) + (lanes[6] + lanes[7])) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_and_single_numbers_agree() {
        let any =
            |k: usize| -> Descriptor { std::array::from_fn(|i| (((i + 1) * (k + 3) * 2_654_435_761) >> 7) as u8) };
        let mut all: Vec<Descriptor> = (0..40).map(any).collect();
        all.extend([[0; 128], [255; 128]]);
        let metric = SquaredDistance::default();
        let mut count = 0;
        each(&all, &all, |[i, start], distances| {
            for (j, distance) in (start..).zip(distances) {
                count += 1;
                assert_eq!(*distance, squared(&all[i], &all[j]), "{i}, {j}");
                assert_eq!(*distance as f32, metric.distance(&all[i], &all[j]), "{i}, {j}");
            }
        });
        assert_eq!(count, all.len() * all.len());
        assert_eq!(squared(&[0; 128], &[255; 128]), 128 * 255 * 255);
    }
}
