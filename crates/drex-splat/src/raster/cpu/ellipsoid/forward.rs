//! One tile, drawn front to back.

use pulp::{Simd, WithSimd};

use super::super::super::{MIN_TRANSMITTANCE, RenderOptions, ScreenBox, TILE};
use super::super::lanes::{self, BLOCK, BLOCKS, Lanes, Mask, PIXEL_X, PIXEL_Y, Plane, per_block, place};
use super::{End, Splat};

pub(super) struct DrawTile<'a> {
    pub splats: &'a [Splat],
    pub boxes: &'a [ScreenBox],
    /// Splats of this tile, nearest first.
    pub list: &'a [u32],
    /// Pixels from the image's corner to the tile's.
    pub corner: (usize, usize),
    pub options: &'a RenderOptions,
}

/// Sums over the splats of a tile.
pub(super) struct DrawnTile {
    pub end: End,
    colour: [Plane; 3],
    depth: Plane,
    count: Plane,
}

impl WithSimd for DrawTile<'_> {
    type Output = DrawnTile;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> DrawnTile {
        if self.options.smooth_cutoff { self.draw::<S, true>(simd) } else { self.draw::<S, false>(simd) }
    }
}

impl DrawTile<'_> {
    #[inline(always)]
    fn draw<S: Simd, const SMOOTH: bool>(self, simd: S) -> DrawnTile {
        let mut out = DrawnTile {
            end: End { t: Plane([1.0; TILE * TILE]), last: Plane::ZERO },
            colour: [Plane::ZERO; 3],
            depth: Plane::ZERO,
            count: Plane::ZERO,
        };
        let DrawnTile { end, colour: [red, green, blue], depth, count } = &mut out;
        // Transmittance in front of the next splat; the pixel has stopped where the sign is negative.
        let t = end.t.registers_mut::<S>();
        let last = end.last.registers_mut::<S>();
        let sums = [red, green, blue, depth].map(Plane::registers_mut::<S>);
        let count = count.registers_mut::<S>();
        let (x, y) = (PIXEL_X.registers::<S>(), PIXEL_Y.registers::<S>());
        let max_alpha = Lanes::splat(simd, self.options.max_alpha);
        let least = Lanes::splat(simd, lanes::least_exponent(SMOOTH));
        let least_t = Lanes::splat(simd, MIN_TRANSMITTANCE);
        let zero = Lanes::splat(simd, 0.0);
        let one = Lanes::splat(simd, 1.0);

        for (k, &id) in self.list.iter().enumerate() {
            let place = Lanes::splat(simd, (k + 1) as f32);
            let splat = Broadcast::new(simd, &self.splats[id as usize], self.corner);
            let (columns, rows) = blocks(&self.boxes[id as usize], self.corner);
            for block_row in rows.0..rows.1 {
                for block in block_row * BLOCKS + columns.0..block_row * BLOCKS + columns.1 {
                    for v in block * per_block::<S>()..(block + 1) * per_block::<S>() {
                        let exponent = splat.exponent(Lanes(simd, x[v]), Lanes(simd, y[v]));
                        let t_here = Lanes(simd, t[v]);
                        let touched = exponent.ge(least).and(t_here.gt(zero));
                        if !touched.any() {
                            continue;
                        }
                        let (alpha, _) = lanes::opacity::<S, SMOOTH>(exponent, max_alpha);
                        let t_next = t_here * (one - alpha);
                        let drawn: Mask<S> = touched.and(t_next.gt(least_t));
                        let w = drawn.select(t_here * alpha, zero);
                        t[v] = drawn.select(t_next, touched.select(-t_here, t_here)).1;
                        last[v] = drawn.select(place, Lanes(simd, last[v])).1;
                        for c in 0..4 {
                            sums[c][v] = w.mul_add(splat.payload[c], Lanes(simd, sums[c][v])).1;
                        }
                        count[v] = drawn.select(Lanes(simd, count[v]) + one, Lanes(simd, count[v])).1;
                    }
                }
            }
        }
        for t in &mut end.t.0 {
            *t = t.abs();
        }
        out
    }
}

impl DrawnTile {
    /// Puts the tile into the images; `count` may have no rows.
    pub fn write(
        &self,
        background: [f32; 3],
        rgb: &mut [&mut [[f32; 3]]],
        alpha: &mut [&mut [f32]],
        depth: &mut [&mut [f32]],
        count: &mut [&mut [u32]],
    ) {
        for (row, rgb) in rgb.iter_mut().enumerate() {
            for (x, rgb) in rgb.iter_mut().enumerate() {
                let i = place(x, row);
                let t = self.end.t.0[i];
                *rgb = std::array::from_fn(|c| self.colour[c].0[i] + t * background[c]);
                alpha[row][x] = 1.0 - t;
                depth[row][x] = self.depth.0[i];
            }
        }
        for (row, count) in count.iter_mut().enumerate() {
            for (x, count) in count.iter_mut().enumerate() {
                *count = self.count.0[place(x, row)] as u32;
            }
        }
    }
}

/// A splat in every lane, its mean counted from the tile's corner.
pub(super) struct Broadcast<S: Simd> {
    mean: [Lanes<S>; 2],
    pub whiten: [Lanes<S>; 3],
    log2_opacity: Lanes<S>,
    /// Red, green, blue, depth.
    pub payload: [Lanes<S>; 4],
}

impl<S: Simd> Broadcast<S> {
    #[inline(always)]
    pub fn new(simd: S, s: &Splat, corner: (usize, usize)) -> Self {
        let [red, green, blue] = s.colour;
        Self {
            mean: [Lanes::splat(simd, s.mean[0] - corner.0 as f32), Lanes::splat(simd, s.mean[1] - corner.1 as f32)],
            whiten: [Lanes::splat(simd, s.whiten[0]), Lanes::splat(simd, s.whiten[1]), Lanes::splat(simd, s.whiten[2])],
            log2_opacity: Lanes::splat(simd, s.log2_opacity),
            payload: [
                Lanes::splat(simd, red),
                Lanes::splat(simd, green),
                Lanes::splat(simd, blue),
                Lanes::splat(simd, s.depth),
            ],
        }
    }

    /// Whitened offset (u, v) of the pixels at (x, y).
    #[inline(always)]
    pub fn offset(&self, x: Lanes<S>, y: Lanes<S>) -> (Lanes<S>, Lanes<S>) {
        let (dx, dy) = (x - self.mean[0], y - self.mean[1]);
        (self.whiten[0].mul_add(dx, self.whiten[1] * dy), self.whiten[2] * dy)
    }

    /// log₂ of the opacity at the whitened offset (u, v).
    #[inline(always)]
    pub fn exponent_at(&self, u: Lanes<S>, v: Lanes<S>) -> Lanes<S> {
        u.neg_mul_add(u, v.neg_mul_add(v, self.log2_opacity))
    }

    #[inline(always)]
    fn exponent(&self, x: Lanes<S>, y: Lanes<S>) -> Lanes<S> {
        let (u, v) = self.offset(x, y);
        self.exponent_at(u, v)
    }
}

/// Columns and rows of a tile's blocks that a box touches, first and one past the last.
#[inline(always)]
pub(super) fn blocks(b: &ScreenBox, corner: (usize, usize)) -> ((usize, usize), (usize, usize)) {
    let range = |from: u16, to: u16, corner: usize| {
        let from = (from as usize).saturating_sub(corner) / BLOCK;
        let to = (to as usize).saturating_sub(corner).div_ceil(BLOCK).min(BLOCKS);
        (from, to)
    };
    (range(b.x0, b.x1, corner.0), range(b.y0, b.y1, corner.1))
}
