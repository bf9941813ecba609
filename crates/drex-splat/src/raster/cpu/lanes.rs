//! Arithmetic on one SIMD register, and the order in which the pixels of a tile fill registers.
//!
//! A tile's 16 x 16 pixels are kept block by block, 4 x 4 pixels each: a small splat touches fewer blocks than rows.
//! A block is one AVX-512 register, two AVX2 registers, or sixteen plain numbers. Everything here is inlined into the
//! one function that `pulp` compiles for the machine's instructions; closures are not, so kernels use none.

use std::ops::{Add, Mul, Neg, Sub};

use pulp::Simd;

use super::super::{MIN_ALPHA, TILE};

/// Pixels of a tile.
pub(crate) const PIXELS: usize = TILE * TILE;
/// Side of a block, pixels.
pub(crate) const BLOCK: usize = 4;
/// Blocks along a side of a tile.
pub(crate) const BLOCKS: usize = TILE / BLOCK;

/// Place of pixel (x, y) of a tile in a [`Plane`].
#[inline(always)]
pub(crate) const fn place(x: usize, y: usize) -> usize {
    ((y / BLOCK) * BLOCKS + x / BLOCK) * BLOCK * BLOCK + (y % BLOCK) * BLOCK + x % BLOCK
}

/// One number for every pixel of a tile, block by block.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Plane(pub [f32; PIXELS]);

/// x of the pixel centres from the tile's left edge.
pub(crate) static PIXEL_X: Plane = pixel_centres(true);
/// y of the pixel centres from the tile's upper edge.
pub(crate) static PIXEL_Y: Plane = pixel_centres(false);

/// One number for every block of a tile.
#[repr(align(64))]
pub(crate) struct BlockRow([f32; BLOCKS * BLOCKS]);

/// x of the first pixel centre of the blocks, from the tile's left edge.
pub(crate) static BLOCK_X: BlockRow = block_centres(true);
/// y of the first pixel centre of the blocks, from the tile's upper edge.
pub(crate) static BLOCK_Y: BlockRow = block_centres(false);
/// 2^block: the sum over blocks is a set of blocks in a word.
pub(crate) static BLOCK_BIT: BlockRow = {
    let mut row = BlockRow([0.0; BLOCKS * BLOCKS]);
    let mut b = 0;
    while b < BLOCKS * BLOCKS {
        row.0[b] = (1u32 << b) as f32;
        b += 1;
    }
    row
};

const fn block_centres(x_axis: bool) -> BlockRow {
    let mut row = BlockRow([0.0; BLOCKS * BLOCKS]);
    let mut b = 0;
    while b < BLOCKS * BLOCKS {
        row.0[b] = ((if x_axis { b % BLOCKS } else { b / BLOCKS }) * BLOCK) as f32 + 0.5;
        b += 1;
    }
    row
}

impl BlockRow {
    /// The row as registers.
    #[inline(always)]
    pub fn registers<S: Simd>(&self) -> &[S::f32s] {
        S::as_simd_f32s(&self.0).0
    }
}

const fn pixel_centres(x_axis: bool) -> Plane {
    let mut plane = Plane([0.0; PIXELS]);
    let mut i = 0;
    while i < PIXELS {
        let (x, y) = (i % TILE, i / TILE);
        plane.0[place(x, y)] = (if x_axis { x } else { y }) as f32 + 0.5;
        i += 1;
    }
    plane
}

impl Plane {
    pub const ZERO: Self = Self([0.0; PIXELS]);

    /// The plane as registers; block b is registers `b * per_block::<S>()` to `(b + 1) * per_block::<S>()`.
    #[inline(always)]
    pub fn registers<S: Simd>(&self) -> &[S::f32s] {
        S::as_simd_f32s(&self.0).0
    }

    /// The plane as registers to be written.
    #[inline(always)]
    pub fn registers_mut<S: Simd>(&mut self) -> &mut [S::f32s] {
        S::as_mut_simd_f32s(&mut self.0).0
    }
}

/// Registers that a block of 4 x 4 pixels takes.
#[inline(always)]
pub(crate) const fn per_block<S: Simd>() -> usize {
    BLOCK * BLOCK / S::F32_LANES
}

/// A register of single precision numbers with the operators of arithmetic.
#[derive(Clone, Copy)]
pub(crate) struct Lanes<S: Simd>(pub S, pub S::f32s);

/// A truth for every lane.
#[derive(Clone, Copy)]
pub(crate) struct Mask<S: Simd>(pub S, pub S::m32s);

impl<S: Simd> Lanes<S> {
    #[inline(always)]
    pub fn splat(simd: S, value: f32) -> Self {
        Self(simd, simd.splat_f32s(value))
    }

    /// `self * b + c`, rounded once where the machine can.
    #[inline(always)]
    pub fn mul_add(self, b: Self, c: Self) -> Self {
        Self(self.0, self.0.mul_add_e_f32s(self.1, b.1, c.1))
    }

    /// `c - self * b`.
    #[inline(always)]
    pub fn neg_mul_add(self, b: Self, c: Self) -> Self {
        Self(self.0, self.0.negate_mul_add_e_f32s(self.1, b.1, c.1))
    }

    #[inline(always)]
    pub fn recip(self) -> Self {
        Self(self.0, self.0.div_f32s(self.0.splat_f32s(1.0), self.1))
    }

    #[inline(always)]
    pub fn abs(self) -> Self {
        self.max(-self)
    }

    #[inline(always)]
    pub fn min(self, b: Self) -> Self {
        Self(self.0, self.0.min_f32s(self.1, b.1))
    }

    #[inline(always)]
    pub fn max(self, b: Self) -> Self {
        Self(self.0, self.0.max_f32s(self.1, b.1))
    }

    #[inline(always)]
    pub fn lt(self, b: Self) -> Mask<S> {
        Mask(self.0, self.0.less_than_f32s(self.1, b.1))
    }

    #[inline(always)]
    pub fn le(self, b: Self) -> Mask<S> {
        Mask(self.0, self.0.less_than_or_equal_f32s(self.1, b.1))
    }

    #[inline(always)]
    pub fn gt(self, b: Self) -> Mask<S> {
        b.lt(self)
    }

    #[inline(always)]
    pub fn ge(self, b: Self) -> Mask<S> {
        b.le(self)
    }

    /// Sum of the lanes.
    #[inline(always)]
    pub fn sum(self) -> f32 {
        self.0.reduce_sum_f32s(self.1)
    }

    /// 2^self for -126 < self < 127, to 2e-7 of the value: the exponent is put together from bits, the rest is a
    /// polynomial (the minimax coefficients of Cephes' exp2f).
    #[inline(always)]
    pub fn exp2(self) -> Self {
        let simd = self.0;
        // Adding 1.5 * 2^23 rounds to an integer and leaves it in the low bits.
        let shifter = Self::splat(simd, 12_582_912.0);
        let shifted = self + shifter;
        let f = self - (shifted - shifter);
        let mut p = Self::splat(simd, EXP2[0]);
        for c in &EXP2[1..] {
            p = p.mul_add(f, Self::splat(simd, *c));
        }
        let exponent = simd.wrapping_dyn_shl_u32s(simd.transmute_u32s_f32s(shifted.1), simd.splat_u32s(23));
        Self(simd, simd.transmute_f32s_u32s(simd.add_u32s(simd.transmute_u32s_f32s(p.1), exponent)))
    }
}

/// Coefficients of 2^f on [-1/2, 1/2], highest power first.
const EXP2: [f32; 7] =
    [1.535_336e-4, 1.339_887e-3, 9.618_437e-3, 5.550_332_5e-2, 0.240_226_48, core::f32::consts::LN_2, 1.0];

/// Half width of the band round [`MIN_ALPHA`] in which a splat fades out when the cut-off is smooth, relative.
pub(crate) const FADE: f32 = 0.5;

/// The exponent below which 2^exponent does not touch a pixel: log₂ of 1/255, or of the lower end of the fade.
#[inline(always)]
pub(crate) fn least_exponent(smooth: bool) -> f32 {
    const LOG2_MIN_ALPHA: f32 = -7.994_353_4;
    const LOG2_FADED: f32 = LOG2_MIN_ALPHA - 1.0; // log₂(1 - FADE) = -1
    if smooth { LOG2_FADED } else { LOG2_MIN_ALPHA }
}

/// Opacity α = min(2^exponent, max_alpha) in a pixel that is touched, and dα/d(ln 2^exponent): α itself, 0 where it is
/// clamped. With `SMOOTH`, α is multiplied by x³ (10 - 15x + 6x²), x rising from 0 to 1 over the band: smooth
/// to the second derivative, so that differences of fourth order hold.
#[inline(always)]
pub(crate) fn opacity<S: Simd, const SMOOTH: bool>(exponent: Lanes<S>, max_alpha: Lanes<S>) -> (Lanes<S>, Lanes<S>) {
    let simd = exponent.0;
    let zero = Lanes::splat(simd, 0.0);
    let free = exponent.exp2();
    let alpha = free.min(max_alpha);
    let slope = free.lt(max_alpha).select(free, zero);
    if !SMOOTH {
        return (alpha, slope);
    }
    let per_alpha = Lanes::splat(simd, 1.0 / (2.0 * FADE * MIN_ALPHA));
    let [one, six, ten, fifteen, thirty] = [1.0, 6.0, 10.0, 15.0, 30.0].map(|c| Lanes::splat(simd, c));
    let x = (alpha - Lanes::splat(simd, (1.0 - FADE) * MIN_ALPHA)) * per_alpha;
    let x = x.max(zero).min(one);
    let fade = x * x * x * (ten - x * (fifteen - six * x));
    let fade_slope = thirty * x * x * (one - x) * (one - x) * per_alpha;
    (alpha * fade, slope * (fade + alpha * fade_slope))
}

impl<S: Simd> Mask<S> {
    #[inline(always)]
    pub fn and(self, b: Self) -> Self {
        Self(self.0, self.0.and_m32s(self.1, b.1))
    }

    #[inline(always)]
    pub fn any(self) -> bool {
        self.0.first_true_m32s(self.1) < S::F32_LANES
    }

    /// `yes` where true, `no` elsewhere.
    #[inline(always)]
    pub fn select(self, yes: Lanes<S>, no: Lanes<S>) -> Lanes<S> {
        Lanes(self.0, self.0.select_f32s(self.1, yes.1, no.1))
    }
}

impl<S: Simd> Add for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Self(self.0, self.0.add_f32s(self.1, b.1))
    }
}

impl<S: Simd> Sub for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Self(self.0, self.0.sub_f32s(self.1, b.1))
    }
}

impl<S: Simd> Mul for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Self(self.0, self.0.mul_f32s(self.1, b.1))
    }
}

impl<S: Simd> Neg for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self::splat(self.0, 0.0) - self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Exp2([f32; 16]);

    impl pulp::WithSimd for Exp2 {
        type Output = [f32; 16];
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> [f32; 16] {
            let mut out = self.0;
            for x in S::as_mut_simd_f32s(&mut out).0 {
                *x = Lanes(simd, *x).exp2().1;
            }
            out
        }
    }

    #[test]
    fn exp2_is_exact_to_rounding() {
        for k in 0..4000 {
            let x = std::array::from_fn(|l| -16.0 + (k * 16 + l) as f32 * 2.6e-4);
            for (x, y) in x.iter().zip(pulp::Arch::new().dispatch(Exp2(x))) {
                let truth = f64::from(*x).exp2();
                assert!((f64::from(y) - truth).abs() < 2e-7 * truth, "2^{x}: {y}, not {truth}");
            }
        }
    }

    #[test]
    fn places_are_a_permutation() {
        let mut seen = [false; PIXELS];
        for y in 0..TILE {
            for x in 0..TILE {
                assert!(!std::mem::replace(&mut seen[place(x, y)], true));
                assert_eq!((PIXEL_X.0[place(x, y)], PIXEL_Y.0[place(x, y)]), (x as f32 + 0.5, y as f32 + 0.5));
            }
        }
    }
}
