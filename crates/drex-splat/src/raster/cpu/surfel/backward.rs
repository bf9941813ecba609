//! The backward of drawing surfels in one tile, front to back again, on SIMD registers.
//!
//! With G_i = ∂L/∂w_i, all else fixed, ∂L/∂α_i = T_i G_i - Σ_{j>i} w_j G_j / (1 - α_i). The sum over all splats of a
//! pixel is known from its images, so what lies behind a splat is that sum less what has been passed.

use pulp::{Simd, WithSimd};

use super::super::lanes::{Lanes, PIXELS, Plane, per_block};
use super::forward::{Rules, Splat, TileSums, meet, pixels, step};

/// Derivative of the loss by the sums of a tile. A pixel outside the image has zeros.
#[derive(Debug, Clone)]
pub(super) struct TileGradients {
    pub rgb: [Plane; 3],
    /// By Σ w, with the background's share.
    pub alpha: Plane,
    pub depth: Plane,
    pub normal: [Plane; 3],
    pub median: Plane,
    /// By Σ w_i w_j (1/z_i - 1/z_j)².
    pub distortion: Plane,
}

impl TileGradients {
    pub const ZERO: Self = Self {
        rgb: [Plane::ZERO; 3],
        alpha: Plane::ZERO,
        depth: Plane::ZERO,
        normal: [Plane::ZERO; 3],
        median: Plane::ZERO,
        distortion: Plane::ZERO,
    };
}

/// Sums over the pixels of a tile of the derivatives by one splat.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Record {
    /// By M, row by row.
    pub m: [f32; 9],
    /// By the floor's centre.
    pub centre: [f32; 2],
    /// By a motion of the whole splat in the image, absolute values of the pixels.
    pub abs: [f32; 2],
    /// By ln opacity.
    pub log_opacity: f32,
    pub colour: [f32; 3],
    pub normal: [f32; 3],
    /// By the z of the centre as a depth.
    pub depth: f32,
}

/// Fills the records of the splats of one tile.
pub(super) struct Differentiate<'a> {
    /// As drawn.
    pub splats: &'a [Splat],
    /// The blocks each touched.
    pub blocks: &'a [u16],
    pub rules: Rules,
    pub sums: &'a TileSums,
    pub gradients: &'a TileGradients,
    pub records: &'a mut [Record],
}

impl WithSimd for Differentiate<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        if self.rules.geometry {
            differentiate::<S, true>(simd, self);
        } else {
            differentiate::<S, false>(simd, self);
        }
    }
}

#[inline(always)]
fn differentiate<S: Simd, const GEOMETRY: bool>(simd: S, tile: Differentiate<'_>) {
    let Differentiate { splats, blocks, rules, sums, gradients, records } = tile;
    let zero = Lanes::splat(simd, 0.0);
    let mut transmittance = Plane([1.0; PIXELS]);
    let mut behind = Plane::ZERO;
    for r in 0..PIXELS / S::F32_LANES {
        behind.registers_mut::<S>()[r] = total::<S, GEOMETRY>(simd, sums, gradients, r).1;
    }
    for k in 0..splats.len() {
        let s = &splats[k];
        let mut bits = blocks[k];
        if bits == 0 {
            continue;
        }
        let mut g_m = [zero; 9];
        let (mut g_centre, mut g_abs, mut g_log_opacity) = ([zero; 2], [zero; 2], zero);
        let (mut g_colour, mut g_normal, mut g_depth) = ([zero; 3], [zero; 3], zero);
        while bits != 0 {
            let block = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            for r in block * per_block::<S>()..(block + 1) * per_block::<S>() {
                let (x, y) = pixels(simd, r);
                let Some(meeting) = meet(simd, s, &rules, x, y) else { continue };
                let t = Lanes(simd, transmittance.registers::<S>()[r]);
                let pass = step(simd, &meeting, t);
                transmittance.registers_mut::<S>()[r] = pass.transmittance.1;
                let w = pass.w;

                // G, and the derivatives by what is summed.
                let by_alpha = Lanes(simd, gradients.alpha.registers::<S>()[r]);
                let by_depth = Lanes(simd, gradients.depth.registers::<S>()[r]);
                let z = if rules.ray_depth { meeting.z } else { Lanes::splat(simd, s.depth) };
                let mut g = by_depth.mul_add(z, by_alpha);
                for i in 0..3 {
                    let by_rgb = Lanes(simd, gradients.rgb[i].registers::<S>()[r]);
                    g = by_rgb.mul_add(Lanes::splat(simd, s.colour[i]), g);
                    g_colour[i] = w.mul_add(by_rgb, g_colour[i]);
                }
                let w_depth = w * by_depth;
                let mut by_z = zero;
                if rules.ray_depth {
                    by_z = w_depth;
                } else {
                    g_depth = g_depth + w_depth;
                }
                let mut by_q2 = zero;
                if GEOMETRY {
                    for i in 0..3 {
                        let by_normal = Lanes(simd, gradients.normal[i].registers::<S>()[r]);
                        g = by_normal.mul_add(Lanes::splat(simd, s.normal[i]), g);
                        g_normal[i] = w.mul_add(by_normal, g_normal[i]);
                    }
                    let by_distortion = Lanes(simd, gradients.distortion.registers::<S>()[r]);
                    let (a, m1) =
                        (Lanes(simd, sums.alpha.registers::<S>()[r]), Lanes(simd, sums.m1.registers::<S>()[r]));
                    let m2 = Lanes(simd, sums.m2.registers::<S>()[r]);
                    let mu = meeting.q[2] - Lanes(simd, sums.first.registers::<S>()[r]);
                    // Σ_j w_j (μ - μ_j)² and half its derivative by μ.
                    let slope = mu.mul_add(a, -m1);
                    g = by_distortion.mul_add(mu.mul_add(slope - m1, m2), g);
                    by_q2 = (w + w) * by_distortion * slope;
                    let at = Lanes(simd, sums.median_at.registers::<S>()[r]);
                    let here = Lanes::splat(simd, k as f32);
                    let is_median = pass.touched.and(at.ge(here)).and(at.le(here));
                    by_z = by_z + is_median.select(Lanes(simd, gradients.median.registers::<S>()[r]), zero);
                }

                // Opacity.
                let rest = w.neg_mul_add(g, Lanes(simd, behind.registers::<S>()[r]));
                behind.registers_mut::<S>()[r] = rest.1;
                let one = Lanes::splat(simd, 1.0);
                let by_alpha = t * g - rest * (one - meeting.alpha).recip();
                let by_log_alpha = pass.touched.select(by_alpha * meeting.slope, zero);
                g_log_opacity = g_log_opacity + by_log_alpha;

                // Where the ray meets the disc: ln α = -rho / 2, and z = 1 / q₂.
                let h = meeting.on_disc.select(by_log_alpha * meeting.z, zero);
                let by_q0 = -(h * meeting.u);
                let by_q1 = -(h * meeting.v);
                let z2 = meeting.z * meeting.z;
                by_q2 = h.mul_add(meeting.rho3.min(Lanes::splat(simd, s.radius2)), z2.neg_mul_add(by_z, by_q2));
                by_q2 = pass.touched.select(by_q2, zero);
                add_row(&mut g_m, 0, by_q0, &meeting.dx, &meeting.dy);
                add_row(&mut g_m, 3, by_q1, &meeting.dx, &meeting.dy);
                add_row(&mut g_m, 6, by_q2, &meeting.dx, &meeting.dy);
                let on_floor = meeting.on_disc.select(zero, by_log_alpha + by_log_alpha);
                let (fx, fy) = (on_floor * meeting.ex, on_floor * meeting.ey);
                g_centre = [g_centre[0] + fx, g_centre[1] + fy];

                // The whole splat moved by a pixel: the centre follows, q takes one column of M less.
                let moved = [(0, fx), (1, fy)];
                for (i, floor) in moved {
                    let by_move = by_q0.neg_mul_add(
                        Lanes::splat(simd, s.m[i]),
                        by_q1.neg_mul_add(
                            Lanes::splat(simd, s.m[3 + i]),
                            by_q2.neg_mul_add(Lanes::splat(simd, s.m[6 + i]), floor),
                        ),
                    );
                    g_abs[i] = g_abs[i] + by_move.abs();
                }
            }
        }
        let record = &mut records[k];
        for i in 0..9 {
            record.m[i] = g_m[i].sum();
        }
        for i in 0..2 {
            record.centre[i] = g_centre[i].sum();
            record.abs[i] = g_abs[i].sum();
        }
        for i in 0..3 {
            record.colour[i] = g_colour[i].sum();
            if GEOMETRY {
                record.normal[i] = g_normal[i].sum();
            }
        }
        record.log_opacity = g_log_opacity.sum();
        record.depth = g_depth.sum();
    }
}

/// Σ_j w_j G_j over all splats of a pixel.
#[inline(always)]
fn total<S: Simd, const GEOMETRY: bool>(simd: S, sums: &TileSums, gradients: &TileGradients, r: usize) -> Lanes<S> {
    let mut total = times(simd, &gradients.alpha, &sums.alpha, r, Lanes::splat(simd, 0.0));
    total = times(simd, &gradients.depth, &sums.depth, r, total);
    for i in 0..3 {
        total = times(simd, &gradients.rgb[i], &sums.rgb[i], r, total);
        if GEOMETRY {
            total = times(simd, &gradients.normal[i], &sums.normal[i], r, total);
        }
    }
    if GEOMETRY {
        // Distortion is of second degree in w: Σ_j w_j ∂/∂w_j counts it twice.
        let m1 = Lanes(simd, sums.m1.registers::<S>()[r]);
        let a_m2 = Lanes(simd, sums.alpha.registers::<S>()[r]) * Lanes(simd, sums.m2.registers::<S>()[r]);
        let distortion = m1.neg_mul_add(m1, a_m2);
        total = Lanes(simd, gradients.distortion.registers::<S>()[r]).mul_add(distortion + distortion, total);
    }
    total
}

#[inline(always)]
fn times<S: Simd>(simd: S, a: &Plane, b: &Plane, r: usize, sum: Lanes<S>) -> Lanes<S> {
    Lanes(simd, a.registers::<S>()[r]).mul_add(Lanes(simd, b.registers::<S>()[r]), sum)
}

#[inline(always)]
fn add_row<S: Simd>(g_m: &mut [Lanes<S>; 9], at: usize, by_q: Lanes<S>, dx: &Lanes<S>, dy: &Lanes<S>) {
    g_m[at] = by_q.mul_add(*dx, g_m[at]);
    g_m[at + 1] = by_q.mul_add(*dy, g_m[at + 1]);
    g_m[at + 2] = g_m[at + 2] + by_q;
}
