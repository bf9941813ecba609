//! One tile, drawn front to back.

use pulp::{Simd, WithSimd};

use super::super::super::{MIN_TRANSMITTANCE, RenderOptions};
use super::super::lanes::{
    self, BLOCK, BLOCK_BIT, BLOCK_X, BLOCK_Y, BLOCKS, Lanes, Mask, PIXEL_X, PIXEL_Y, PIXELS, Plane, per_block, place,
};
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
        let [zero, one, least_t, least_exponent] =
            [0.0, 1.0, MIN_TRANSMITTANCE, lanes::least_exponent(SMOOTH)].map(|value| Lanes::splat(simd, value));

        // Blocks with a pixel that has not stopped.
        let mut open = u16::MAX;
        let mut near = [Splat::default(); AHEAD];
        for k in 0..self.list.len() {
            if k % AHEAD == 0 {
                fetch(&mut near, self.splats, &self.list[k..], self.corner);
            }
            let place = Lanes::splat(simd, (k + 1) as f32);
            let splat = Broadcast::new(simd, &near[k % AHEAD]);
            let mut to_do = splat.blocks(least_exponent) & open;
            let mut done = 0;
            while to_do != 0 {
                let block = to_do.trailing_zeros() as usize % (BLOCKS * BLOCKS);
                let bit = 1 << block;
                to_do &= to_do - 1;
                let mut stopped = false;
                for v in block * per_block::<S>()..(block + 1) * per_block::<S>() {
                    let exponent = splat.exponent(Lanes(simd, x[v]), Lanes(simd, y[v]));
                    let t_here = Lanes(simd, t[v]);
                    let touched = exponent.ge(least_exponent).and(t_here.gt(zero));
                    if !touched.any() {
                        continue;
                    }
                    done |= bit;
                    let (alpha, _) = lanes::opacity::<S, SMOOTH>(exponent, max_alpha);
                    let t_next = t_here * (one - alpha);
                    let drawn: Mask<S> = touched.and(t_next.gt(least_t));
                    let w = drawn.select(t_here * alpha, zero);
                    stopped |= touched.and(t_next.le(least_t)).any();
                    t[v] = drawn.select(t_next, touched.select(-t_here, t_here)).1;
                    last[v] = drawn.select(place, Lanes(simd, last[v])).1;
                    red[v] = w.mul_add(splat.payload[0], Lanes(simd, red[v])).1;
                    green[v] = w.mul_add(splat.payload[1], Lanes(simd, green[v])).1;
                    blue[v] = w.mul_add(splat.payload[2], Lanes(simd, blue[v])).1;
                    depth[v] = w.mul_add(splat.payload[3], Lanes(simd, depth[v])).1;
                    if COUNT {
                        count[v] = (Lanes(simd, count[v]) + drawn.select(one, zero)).1;
                    }
                }
                if stopped {
                    let mut still_open = false;
                    for v in block * per_block::<S>()..(block + 1) * per_block::<S>() {
                        still_open |= Lanes(simd, t[v]).gt(zero).any();
                    }
                    open &= if still_open { u16::MAX } else { !bit };
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

/// Splats of a list that are fetched together: each lies somewhere else in memory, and waiting for them one by one is
/// a third of the time of a scene that does not fit into the cache.
pub(super) const AHEAD: usize = 32;

/// The next splats of a list, their means counted from the tile's corner.
#[inline(always)]
pub(super) fn fetch(near: &mut [Splat; AHEAD], splats: &[Splat], list: &[u32], corner: (usize, usize)) {
    for (near, &id) in near.iter_mut().zip(list) {
        *near = splats[id as usize];
        near.mean = [near.mean[0] - corner.0 as f32, near.mean[1] - corner.1 as f32];
    }
}

/// A splat in every lane.
pub(super) struct Broadcast<S: Simd> {
    mean: [Lanes<S>; 2],
    valley: [Lanes<S>; 2],
    pub whiten: [Lanes<S>; 3],
    log2_opacity: Lanes<S>,
    /// Red, green, blue, depth.
    pub payload: [Lanes<S>; 4],
}

impl<S: Simd> Broadcast<S> {
    #[inline(always)]
    pub fn new(simd: S, s: &Splat) -> Self {
        let [red, green, blue] = s.colour;
        Self {
            mean: [Lanes::splat(simd, s.mean[0]), Lanes::splat(simd, s.mean[1])],
            valley: [Lanes::splat(simd, s.valley[0]), Lanes::splat(simd, s.valley[1])],
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

    /// The blocks of the tile with a pixel where log₂ of the opacity reaches `least`, one bit each.
    ///
    /// q = u² + v² is convex, so its least value over the pixel centres of a block, taken as a rectangle, lies on one of
    /// the two edges that face the mean; there it is where `valley` meets the edge, or at the edge's nearer end.
    #[inline(always)]
    pub fn blocks(&self, least: Lanes<S>) -> u16 {
        let simd = least.0;
        let side = Lanes::splat(simd, (BLOCK - 1) as f32);
        let zero = Lanes::splat(simd, 0.0);
        // Rounding may make a splat a little smaller here than where it is drawn.
        let reach = self.log2_opacity - least + Lanes::splat(simd, 1e-4);
        let mut bits = 0.0;
        for ((x, y), bit) in
            BLOCK_X.registers::<S>().iter().zip(BLOCK_Y.registers::<S>()).zip(BLOCK_BIT.registers::<S>())
        {
            let (x0, y0) = (Lanes(simd, *x) - self.mean[0], Lanes(simd, *y) - self.mean[1]);
            let (x1, y1) = (x0 + side, y0 + side);
            let (x, y) = (zero.max(x0).min(x1), zero.max(y0).min(y1));
            let along_x = (self.valley[0] * y).max(x0).min(x1);
            let along_y = (self.valley[1] * x).max(y0).min(y1);
            let q = self.squared(along_x, y).min(self.squared(x, along_y));
            bits += q.le(reach).select(Lanes(simd, *bit), zero).sum();
        }
        bits as u16
    }

    /// u² + v² at an offset from the mean.
    #[inline(always)]
    fn squared(&self, dx: Lanes<S>, dy: Lanes<S>) -> Lanes<S> {
        let (u, v) = (self.whiten[0].mul_add(dx, self.whiten[1] * dy), self.whiten[2] * dy);
        u.mul_add(u, v * v)
    }

    #[inline(always)]
    fn exponent(&self, x: Lanes<S>, y: Lanes<S>) -> Lanes<S> {
        let (u, v) = self.offset(x, y);
        self.exponent_at(u, v)
    }
}
