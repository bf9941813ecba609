//! The derivative of one tile, back to front.
//!
//! With w_i = T_i α_i and the loss Σ_i w_i q_i (q collects what the pixel's gradient asks of a splat's colour, depth and
//! presence), dL/dα_i = T_i q_i - (Σ_{j>i} w_j q_j) / (1 - α_i). T is rebuilt from its end by T_i = T_{i+1} / (1 - α_i).

use drex_core::camera::PinholeCamera;
use pulp::{Simd, WithSimd};

use super::super::super::{RenderGradients, RenderOptions, TILE};
use super::super::lanes::{self, BLOCKS, Lanes, PIXEL_X, PIXEL_Y, Plane, per_block, place};
use super::forward::{AHEAD, Broadcast, fetch};
use super::{End, Splat, Sums};

pub(super) struct DifferentiateTile<'a> {
    pub splats: &'a [Splat],
    pub list: &'a [u32],
    pub corner: (usize, usize),
    pub options: &'a RenderOptions,
    pub end: &'a End,
    pub incoming: &'a Incoming,
    /// One a splat of the list.
    pub sums: &'a mut [Sums],
}

/// Derivatives of the loss by the pixels of a tile.
pub(super) struct Incoming {
    /// By red, green, blue, depth.
    payload: [Plane; 4],
    /// By alpha, what the background shows included.
    alpha: Plane,
}

impl Incoming {
    /// Takes a tile out of the images; zero outside the image.
    pub fn read(
        gradients: &RenderGradients,
        background: [f32; 3],
        camera: &PinholeCamera,
        corner: (usize, usize),
    ) -> Self {
        let mut out = Self { payload: [Plane::ZERO; 4], alpha: Plane::ZERO };
        for y in 0..TILE.min(camera.height - corner.1) {
            let from = (corner.1 + y) * camera.width + corner.0;
            for x in 0..TILE.min(camera.width - corner.0) {
                let (i, pixel) = (place(x, y), from + x);
                if let Some(rgb) = gradients.rgb.get(pixel) {
                    for c in 0..3 {
                        out.payload[c].0[i] = rgb[c];
                        out.alpha.0[i] -= rgb[c] * background[c];
                    }
                }
                out.payload[3].0[i] = gradients.depth.get(pixel).copied().unwrap_or(0.0);
                out.alpha.0[i] += gradients.alpha.get(pixel).copied().unwrap_or(0.0);
            }
        }
        out
    }
}

impl WithSimd for DifferentiateTile<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        if self.options.smooth_cutoff { self.run::<S, true>(simd) } else { self.run::<S, false>(simd) }
    }
}

impl DifferentiateTile<'_> {
    #[inline(always)]
    fn run<S: Simd, const SMOOTH: bool>(self, simd: S) {
        let mut t = self.end.t;
        // Σ w q of the splats behind.
        let mut behind = Plane::ZERO;
        let (t, behind) = (t.registers_mut::<S>(), behind.registers_mut::<S>());
        let last = self.end.last.registers::<S>();
        let [red, green, blue, depth] = &self.incoming.payload;
        let d_payload = [red.registers::<S>(), green.registers::<S>(), blue.registers::<S>(), depth.registers::<S>()];
        let d_alpha = self.incoming.alpha.registers::<S>();
        let (x, y) = (PIXEL_X.registers::<S>(), PIXEL_Y.registers::<S>());
        let max_alpha = Lanes::splat(simd, self.options.max_alpha);
        let least = Lanes::splat(simd, lanes::least_exponent(SMOOTH));
        let zero = Lanes::splat(simd, 0.0);
        let one = Lanes::splat(simd, 1.0);

        let mut near = [Splat::default(); AHEAD];
        let reached = self.end.blocks.len();
        for k in (0..reached).rev() {
            if k % AHEAD == AHEAD - 1 || k + 1 == reached {
                fetch(&mut near, self.splats, &self.list[k - k % AHEAD..=k], self.corner);
            }
            let mut to_do = self.end.blocks[k];
            if to_do == 0 {
                continue;
            }
            let here = Lanes::splat(simd, (k + 1) as f32);
            let a = near[k % AHEAD].whiten[0];
            let splat = Broadcast::new(simd, &near[k % AHEAD]);
            let mut sum = [zero; 6];
            let mut sum_abs = [zero; 2];
            let mut sum_payload = [zero; 4];
            while to_do != 0 {
                let block = to_do.trailing_zeros() as usize % (BLOCKS * BLOCKS);
                to_do &= to_do - 1;
                for i in block * per_block::<S>()..(block + 1) * per_block::<S>() {
                    let (u, v) = splat.offset(Lanes(simd, x[i]), Lanes(simd, y[i]));
                    let exponent = splat.exponent_at(u, v);
                    let touched = exponent.ge(least).and(Lanes(simd, last[i]).ge(here));
                    let (alpha, slope) = lanes::opacity::<S, SMOOTH>(exponent, max_alpha);
                    let through = (one - alpha).recip();
                    let t_here = Lanes(simd, t[i]) * through;
                    let w = touched.select(t_here * alpha, zero);
                    let mut q = Lanes(simd, d_alpha[i]);
                    for c in 0..4 {
                        let d = Lanes(simd, d_payload[c][i]);
                        q = d.mul_add(splat.payload[c], q);
                        sum_payload[c] = w.mul_add(d, sum_payload[c]);
                    }
                    let d_alpha = (Lanes(simd, behind[i]) * through).neg_mul_add(one, t_here * q);
                    behind[i] = w.mul_add(q, Lanes(simd, behind[i])).1;
                    t[i] = touched.select(t_here, Lanes(simd, t[i])).1;

                    let g = touched.select(slope * d_alpha, zero);
                    let (gu, gv) = (g * u, g * v);
                    sum[0] = sum[0] + g;
                    sum[1] = sum[1] + gu;
                    sum[2] = sum[2] + gv;
                    sum[3] = gu.mul_add(u, sum[3]);
                    sum[4] = gu.mul_add(v, sum[4]);
                    sum[5] = gv.mul_add(v, sum[5]);
                    sum_abs[0] = sum_abs[0] + gu.abs();
                    sum_abs[1] = sum_abs[1] + splat.whiten[1].mul_add(gu, splat.whiten[2] * gv).abs();
                }
            }
            let two_ln2 = 2.0 * std::f32::consts::LN_2;
            self.sums[k] = Sums {
                moments: [sum[0].sum(), sum[1].sum(), sum[2].sum(), sum[3].sum(), sum[4].sum(), sum[5].sum()],
                abs_mean: [two_ln2 * a * sum_abs[0].sum(), two_ln2 * sum_abs[1].sum()],
                colour: [sum_payload[0].sum(), sum_payload[1].sum(), sum_payload[2].sum()],
                depth: sum_payload[3].sum(),
            };
        }
    }
}
