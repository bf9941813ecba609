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

/// Calls `take` with the indices and the distance of each two of `first` and `second`.
pub(crate) fn each(first: &[Descriptor], second: &[Descriptor], mut take: impl FnMut([usize; 2], u32)) {
    #[cfg(target_arch = "x86_64")]
    if let Some(simd) = pulp::x86::V3::try_new() {
        return simd.vectorize(avx2::Each { simd, first, second, take });
    }
    for (i, a) in first.iter().enumerate() {
        for (j, b) in second.iter().enumerate() {
            take([i, j], squared(a, b));
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

    impl<F: FnMut([usize; 2], u32)> NullaryFnOnce for Each<'_, F> {
        type Output = ();

        #[inline(always)]
        fn call(mut self) {
            for (i, a) in self.first.iter().enumerate() {
                let a = wide(self.simd, a);
                for (j, b) in self.second.iter().enumerate() {
                    (self.take)([i, j], squared(self.simd, &a, b));
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
        lanes.into_iter().sum::<i32>() as u32
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
        each(&all, &all, |[i, j], distance| {
            count += 1;
            assert_eq!(distance, squared(&all[i], &all[j]), "{i}, {j}");
            assert_eq!(distance as f32, metric.distance(&all[i], &all[j]), "{i}, {j}");
        });
        assert_eq!(count, all.len() * all.len());
        assert_eq!(squared(&[0; 128], &[255; 128]), 128 * 255 * 255);
    }
}
