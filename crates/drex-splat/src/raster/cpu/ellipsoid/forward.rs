//! One tile, drawn front to back.

use pulp::{Simd, WithSimd};

use super::super::super::{MIN_TRANSMITTANCE, RenderOptions};
use super::super::lanes::{self, BLOCK, BLOCKS, Lanes, Mask, PIXEL_X, PIXEL_Y, PIXELS, Plane, per_block, place};
use super::{End, Splat};

pub(super) struct DrawTile<'a> {
    pub splats: &'a [Splat],
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
        match (self.options.smooth_cutoff, self.options.count) {
            (false, false) => self.draw::<S, false, false>(simd),
            (false, true) => self.draw::<S, false, true>(simd),
            (true, _) => self.draw::<S, true, true>(simd),
        }
    }
}

impl DrawTile<'_> {
    #[inline(always)]
    fn draw<S: Simd, const SMOOTH: bool, const COUNT: bool>(self, simd: S) -> DrawnTile {
        let mut out = DrawnTile {
            end: End { t: Plane([1.0; PIXELS]), last: Plane::ZERO, blocks: Vec::with_capacity(self.list.len()) },
            colour: [Plane::ZERO; 3],
            depth: Plane::ZERO,
            count: Plane::ZERO,
        };
        let DrawnTile { end, colour: [red, green, blue], depth, count } = &mut out;
        // Transmittance in front of the next splat; the pixel has stopped where the sign is negative.
        let t = end.t.registers_mut::<S>();
        let last = end.last.registers_mut::<S>();
        let (red, green, blue) = (red.registers_mut::<S>(), green.registers_mut::<S>(), blue.registers_mut::<S>());
        let (depth, count) = (depth.registers_mut::<S>(), count.registers_mut::<S>());
        let (x, y) = (PIXEL_X.registers::<S>(), PIXEL_Y.registers::<S>());
        let max_alpha = Lanes::splat(simd, self.options.max_alpha);
        let least = lanes::least_exponent(SMOOTH);
        let [zero, one, least_t, least_exponent] =
            [0.0, 1.0, MIN_TRANSMITTANCE, least].map(|value| Lanes::splat(simd, value));

        // Blocks with a pixel that has not stopped.
        let mut open = u16::MAX;
        for (k, &id) in self.list.iter().enumerate() {
            let splat = &self.splats[id as usize];
            let mut to_do = splat.blocks(self.corner, least) & open;
            let mut done = 0;
            let place = Lanes::splat(simd, (k + 1) as f32);
            let splat = Broadcast::new(simd, splat, self.corner);
            while to_do != 0 {
                let block = to_do.trailing_zeros() as usize % (BLOCKS * BLOCKS);
                let bit = 1 << block;
                to_do &= to_do - 1;
                let mut still_open = false;
                for v in block * per_block::<S>()..(block + 1) * per_block::<S>() {
                    let exponent = splat.exponent(Lanes(simd, x[v]), Lanes(simd, y[v]));
                    let t_here = Lanes(simd, t[v]);
                    let touched = exponent.ge(least_exponent).and(t_here.gt(zero));
                    if !touched.any() {
                        still_open = true;
                        continue;
                    }
                    done |= bit;
                    let (alpha, _) = lanes::opacity::<S, SMOOTH>(exponent, max_alpha);
                    let t_next = t_here * (one - alpha);
                    let drawn: Mask<S> = touched.and(t_next.gt(least_t));
                    let w = drawn.select(t_here * alpha, zero);
                    let t_next = drawn.select(t_next, touched.select(-t_here, t_here));
                    still_open |= t_next.gt(zero).any();
                    t[v] = t_next.1;
                    last[v] = drawn.select(place, Lanes(simd, last[v])).1;
                    red[v] = w.mul_add(splat.payload[0], Lanes(simd, red[v])).1;
                    green[v] = w.mul_add(splat.payload[1], Lanes(simd, green[v])).1;
                    blue[v] = w.mul_add(splat.payload[2], Lanes(simd, blue[v])).1;
                    depth[v] = w.mul_add(splat.payload[3], Lanes(simd, depth[v])).1;
                    if COUNT {
                        count[v] = (Lanes(simd, count[v]) + drawn.select(one, zero)).1;
                    }
                }
                if !still_open {
                    open &= !bit;
                }
            }
            end.blocks.push(done);
            if open == 0 {
                break;
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
        for (row, ((rgb, alpha), depth)) in rgb.iter_mut().zip(alpha).zip(depth).enumerate() {
            for (x, ((rgb, alpha), depth)) in rgb.iter_mut().zip(&mut **alpha).zip(&mut **depth).enumerate() {
                let i = place(x, row);
                let t = self.end.t.0[i];
                *rgb = std::array::from_fn(|c| self.colour[c].0[i] + t * background[c]);
                *alpha = 1.0 - t;
                *depth = self.depth.0[i];
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

impl Splat {
    /// The blocks of the tile at `corner` with a pixel centre where log₂ of the opacity may reach `least`, one bit each.
    /// In the strip of a row of blocks the ellipse u² + v² = d² reaches x = (±√(d² - v²) - b y) / a, farthest where
    /// y = ∓b d / (c √(b² + c²)) or at the strip's edge.
    #[inline(always)]
    pub fn blocks(&self, corner: (usize, usize), least: f32) -> u16 {
        let [a, b, c] = self.whiten;
        let (x, y) = (self.mean[0] - corner.0 as f32, self.mean[1] - corner.1 as f32);
        // A little more than needed, for rounding.
        let d2 = (self.log2_opacity - least) * (1.0 + 1e-5) + 1e-5;
        let d = d2.max(0.0).sqrt();
        let (height, farthest) = (d / c, -b * d / (c * (b * b + c * c).sqrt()));
        let mut blocks = 0;
        for row in 0..BLOCKS {
            let low = ((row * BLOCK) as f32 + 0.5 - y).max(-height);
            let high = ((row * BLOCK + BLOCK - 1) as f32 + 0.5 - y).min(height);
            if low > high {
                continue;
            }
            let reach = |dy: f32| (d2 - (c * dy) * (c * dy)).max(0.0).sqrt();
            let (right, left) = (farthest.max(low).min(high), (-farthest).max(low).min(high));
            let right = x + (reach(right) - b * right) / a;
            let left = x + (-reach(left) - b * left) / a;
            // Block k has its pixel centres from 4 k + 0.5 to 4 k + 3.5.
            let from = ((left - 3.5) * 0.25).max(0.0).ceil() as u32;
            let to = ((right - 0.5) * 0.25 + 1.0).clamp(0.0, BLOCKS as f32) as u32;
            if from < to {
                blocks |= ((1u16 << to) - (1 << from)) << (row * BLOCKS);
            }
        }
        blocks
    }
}
