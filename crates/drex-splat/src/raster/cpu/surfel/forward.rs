//! Surfels in one tile, front to back: the part of drawing that runs on SIMD registers.

use pulp::{Simd, WithSimd};

use super::super::lanes::{
    BLOCK, BLOCK_BIT, BLOCK_X, BLOCK_Y, Lanes, Mask, PIXEL_X, PIXEL_Y, PIXELS, Plane, opacity, per_block,
};
use super::bounds::Footprint;
use crate::raster::MIN_TRANSMITTANCE;

/// What the kernels read of a surfel. A pixel at d = (dx, dy, 1) from `origin` meets it at (u, v, 1) / z = M d.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Splat {
    /// Row by row.
    pub m: [f32; 9],
    /// Where pixels are counted from: in the image, or in the tile once [`Splat::in_tile`].
    pub origin: [f32; 2],
    /// The floor's centre from `origin`, pixels.
    pub centre: [f32; 2],
    /// Base 2 logarithm of the opacity.
    pub log2_opacity: f32,
    /// Largest u² + v², or floor's equivalent, that is drawn.
    pub radius2: f32,
    /// Smallest inverse depth that is drawn.
    pub min_inverse_depth: f32,
    /// Red, green, blue.
    pub colour: [f32; 3],
    /// Facing the camera, camera frame.
    pub normal: [f32; 3],
    /// z of the centre.
    pub depth: f32,
}

impl Splat {
    /// The same with pixels counted from the corner of a tile.
    pub fn in_tile(mut self, corner: [f32; 2]) -> Self {
        self.origin = [self.origin[0] - corner[0], self.origin[1] - corner[1]];
        self
    }
}

/// What is the same for all splats and tiles.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rules {
    /// Opacity of one splat in one pixel stays below this.
    pub max_alpha: f32,
    /// 1 / near.
    pub max_inverse_depth: f32,
    /// Whether depth is where the ray meets the surfel, not that of the centre.
    pub ray_depth: bool,
    /// Whether normals, distortion and median depth are asked for.
    pub geometry: bool,
    /// Whether opacity fades out above the cut.
    pub smooth: bool,
}

/// Sums over the splats of a tile, pixel by pixel. With `geometry` only: `normal` and what follows.
#[derive(Debug, Clone)]
pub(super) struct TileSums {
    /// Σ w c, without background.
    pub rgb: [Plane; 3],
    /// Σ w.
    pub alpha: Plane,
    /// Σ w z.
    pub depth: Plane,
    /// Splats that touch the pixel.
    pub count: Plane,
    /// Σ w n.
    pub normal: [Plane; 3],
    /// z of the last splat met with T > 1/2.
    pub median: Plane,
    /// Its place in the tile's list.
    pub median_at: Plane,
    /// Inverse depth of the pixel's first splat. μ counts from here, for only differences of inverse depths matter.
    pub first: Plane,
    /// Σ w μ.
    pub m1: Plane,
    /// Σ w μ².
    pub m2: Plane,
}

impl TileSums {
    pub const ZERO: Self = Self {
        rgb: [Plane::ZERO; 3],
        alpha: Plane::ZERO,
        depth: Plane::ZERO,
        count: Plane::ZERO,
        normal: [Plane::ZERO; 3],
        median: Plane::ZERO,
        median_at: Plane::ZERO,
        first: Plane::ZERO,
        m1: Plane::ZERO,
        m2: Plane::ZERO,
    };
}

/// A splat and where it may be.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Projected {
    pub splat: Splat,
    pub footprint: Footprint,
}

/// Draws the splats of one tile.
pub(super) struct Draw<'a> {
    pub projected: &'a [Projected],
    /// Those of this tile, nearest first.
    pub list: &'a [u32],
    /// Pixels from the image's corner to the tile's.
    pub corner: [f32; 2],
    /// Room for the splats of the list.
    pub scratch: &'a mut Vec<Splat>,
    /// Out: the blocks of 4 x 4 pixels that a splat touches, one bit each.
    pub blocks: &'a mut [u16],
    pub rules: Rules,
    pub sums: &'a mut TileSums,
}

impl WithSimd for Draw<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        if self.rules.geometry {
            draw::<S, true>(simd, self);
        } else {
            draw::<S, false>(simd, self);
        }
    }
}

#[inline(always)]
fn draw<S: Simd, const GEOMETRY: bool>(simd: S, tile: Draw<'_>) {
    let Draw { projected, list, corner, scratch: splats, blocks, rules, sums } = tile;
    splats.clear();
    for (&i, blocks) in list.iter().zip(blocks.iter_mut()) {
        let Projected { splat, footprint } = &projected[i as usize];
        splats.push(splat.in_tile(corner));
        *blocks = may_touch(simd, footprint, corner);
    }
    let (zero, one, half) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0), Lanes::splat(simd, 0.5));
    let mut hits = vec![0u16; splats.len()];
    for r in 0..PIXELS / S::F32_LANES {
        let bit = 1u16 << (r / per_block::<S>());
        let (x, y) = pixels(simd, r);
        let (mut transmittance, mut alpha, mut depth, mut count) = (one, zero, zero, zero);
        let (mut rgb, mut normal) = ([zero; 3], [zero; 3]);
        let (mut median, mut median_at, mut first, mut m1, mut m2) = (zero, zero, zero, zero, zero);
        for k in 0..splats.len() {
            let s = &splats[k];
            if blocks[k] & bit == 0 {
                continue;
            }
            let Some(meeting) = meet(simd, s, &rules, x, y) else { continue };
            let pass = step(simd, &meeting, transmittance);
            if pass.touched.any() {
                hits[k] |= bit;
                let w = pass.w;
                for i in 0..3 {
                    rgb[i] = w.mul_add(Lanes::splat(simd, s.colour[i]), rgb[i]);
                }
                alpha = alpha + w;
                count = count + pass.touched.select(one, zero);
                let z = if rules.ray_depth { meeting.z } else { Lanes::splat(simd, s.depth) };
                depth = w.mul_add(z, depth);
                if GEOMETRY {
                    for i in 0..3 {
                        normal[i] = w.mul_add(Lanes::splat(simd, s.normal[i]), normal[i]);
                    }
                    first = pass.touched.and(first.le(zero)).select(meeting.q[2], first);
                    let mu = meeting.q[2] - first;
                    let w_mu = w * mu;
                    m1 = m1 + w_mu;
                    m2 = w_mu.mul_add(mu, m2);
                    let in_front = pass.touched.and(transmittance.gt(half));
                    median = in_front.select(meeting.z, median);
                    median_at = in_front.select(Lanes::splat(simd, k as f32), median_at);
                }
            }
            transmittance = pass.transmittance;
            if !transmittance.gt(zero).any() {
                break;
            }
        }
        for i in 0..3 {
            sums.rgb[i].registers_mut::<S>()[r] = rgb[i].1;
        }
        sums.alpha.registers_mut::<S>()[r] = alpha.1;
        sums.depth.registers_mut::<S>()[r] = depth.1;
        sums.count.registers_mut::<S>()[r] = count.1;
        if GEOMETRY {
            for i in 0..3 {
                sums.normal[i].registers_mut::<S>()[r] = normal[i].1;
            }
            sums.median.registers_mut::<S>()[r] = median.1;
            sums.median_at.registers_mut::<S>()[r] = median_at.1;
            sums.first.registers_mut::<S>()[r] = first.1;
            sums.m1.registers_mut::<S>()[r] = m1.1;
            sums.m2.registers_mut::<S>()[r] = m2.1;
        }
    }
    blocks.copy_from_slice(&hits);
}

/// Pixel centres of register `r`, from the tile's corner.
#[inline(always)]
pub(super) fn pixels<S: Simd>(simd: S, r: usize) -> (Lanes<S>, Lanes<S>) {
    (Lanes(simd, PIXEL_X.registers::<S>()[r]), Lanes(simd, PIXEL_Y.registers::<S>()[r]))
}

/// Where the rays of a register of pixels meet a surfel. Numbers are finite in all lanes, meaningful where `near_enough`.
pub(super) struct Meeting<S: Simd> {
    /// Pixels from the splat's origin.
    pub dx: Lanes<S>,
    pub dy: Lanes<S>,
    /// Pixels from the floor's centre.
    pub ex: Lanes<S>,
    pub ey: Lanes<S>,
    /// (u, v, 1) / z.
    pub q: [Lanes<S>; 3],
    pub z: Lanes<S>,
    pub u: Lanes<S>,
    pub v: Lanes<S>,
    /// u² + v².
    pub rho3: Lanes<S>,
    /// Whether the disc counts, not the floor.
    pub on_disc: Mask<S>,
    /// Opacity, and its derivative by -rho / 2.
    pub alpha: Lanes<S>,
    pub slope: Lanes<S>,
    pub near_enough: Mask<S>,
}

/// None if no lane is touched.
#[inline(always)]
pub(super) fn meet<S: Simd>(simd: S, s: &Splat, rules: &Rules, x: Lanes<S>, y: Lanes<S>) -> Option<Meeting<S>> {
    let (dx, dy) = (x - Lanes::splat(simd, s.origin[0]), y - Lanes::splat(simd, s.origin[1]));
    let (ex, ey) = (dx - Lanes::splat(simd, s.centre[0]), dy - Lanes::splat(simd, s.centre[1]));
    let m = &s.m;
    let q0 = row(simd, [m[0], m[1], m[2]], dx, dy);
    let q1 = row(simd, [m[3], m[4], m[5]], dx, dy);
    let q2 = row(simd, [m[6], m[7], m[8]], dx, dy);
    let in_range =
        q2.gt(Lanes::splat(simd, s.min_inverse_depth)).and(q2.lt(Lanes::splat(simd, rules.max_inverse_depth)));
    let z = in_range.select(q2, Lanes::splat(simd, 1.0)).recip();
    let (u, v) = (q0 * z, q1 * z);
    let rho3 = u.mul_add(u, v * v);
    // σ = √½ px: (2DGS, eq. 11).
    let floor = ex.mul_add(ex, ey * ey);
    let rho2 = floor + floor;
    let radius2 = Lanes::splat(simd, s.radius2);
    let rho = rho3.min(rho2);
    let near_enough = in_range.and(rho.le(radius2));
    if !near_enough.any() {
        return None;
    }
    let half_log2_e = Lanes::splat(simd, -0.5 * std::f32::consts::LOG2_E);
    let exponent = rho.min(radius2).mul_add(half_log2_e, Lanes::splat(simd, s.log2_opacity));
    let max_alpha = Lanes::splat(simd, rules.max_alpha);
    let (alpha, slope) =
        if rules.smooth { opacity::<S, true>(exponent, max_alpha) } else { opacity::<S, false>(exponent, max_alpha) };
    let on_disc = rho3.le(rho2);
    Some(Meeting { dx, dy, ex, ey, q: [q0, q1, q2], z, u, v, rho3, on_disc, alpha, slope, near_enough })
}

#[inline(always)]
fn row<S: Simd>(simd: S, m: [f32; 3], dx: Lanes<S>, dy: Lanes<S>) -> Lanes<S> {
    Lanes::splat(simd, m[0]).mul_add(dx, Lanes::splat(simd, m[1]).mul_add(dy, Lanes::splat(simd, m[2])))
}

/// A splat's weight in a register of pixels.
pub(super) struct Pass<S: Simd> {
    /// T α, zero where the splat does not count.
    pub w: Lanes<S>,
    /// T behind the splat; zero once a pixel has stopped.
    pub transmittance: Lanes<S>,
    pub touched: Mask<S>,
}

#[inline(always)]
pub(super) fn step<S: Simd>(simd: S, meeting: &Meeting<S>, transmittance: Lanes<S>) -> Pass<S> {
    let zero = Lanes::splat(simd, 0.0);
    let w = transmittance * meeting.alpha;
    let next = transmittance - w;
    let goes_on = next.gt(Lanes::splat(simd, MIN_TRANSMITTANCE));
    let touched = meeting.near_enough.and(goes_on);
    Pass {
        w: touched.select(w, zero),
        transmittance: meeting.near_enough.select(goes_on.select(next, zero), transmittance),
        touched,
    }
}

/// The blocks of the tile at `corner` that a footprint meets, one bit each.
#[inline(always)]
fn may_touch<S: Simd>(simd: S, footprint: &Footprint, corner: [f32; 2]) -> u16 {
    let side = (BLOCK - 1) as f32;
    let [a, b] = footprint.axis;
    // Ranges of the first pixel of a block.
    let [x0, x1] = [footprint.x[0] - corner[0] - side, footprint.x[1] - corner[0]];
    let [y0, y1] = [footprint.y[0] - corner[1] - side, footprint.y[1] - corner[1]];
    let middle = a * corner[0] + b * corner[1] + 0.5 * side * (a + b);
    let reach = 0.5 * side * (a.abs() + b.abs());
    let [s0, s1] = [footprint.strip[0] - middle - reach, footprint.strip[1] - middle + reach];
    let mut bits = 0.0;
    for r in 0..BLOCK_X.registers::<S>().len() {
        let (x, y) = (Lanes(simd, BLOCK_X.registers::<S>()[r]), Lanes(simd, BLOCK_Y.registers::<S>()[r]));
        let along = Lanes::splat(simd, a).mul_add(x, Lanes::splat(simd, b) * y);
        let meets = within(simd, x, x0, x1).and(within(simd, y, y0, y1)).and(within(simd, along, s0, s1));
        bits += meets.select(Lanes(simd, BLOCK_BIT.registers::<S>()[r]), Lanes::splat(simd, 0.0)).sum();
    }
    bits as u16
}

#[inline(always)]
fn within<S: Simd>(simd: S, value: Lanes<S>, lo: f32, hi: f32) -> Mask<S> {
    value.ge(Lanes::splat(simd, lo)).and(value.le(Lanes::splat(simd, hi)))
}
