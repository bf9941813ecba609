//! Rendered normals that agree with the rendered depth (2DGS, Huang et al. 2024, eq. 14), and the derivative through the
//! normals of the depth.

use std::ops::Range;

use drex_core::camera::PinholeCamera;
use drex_core::simd::vectorised;
use rayon::prelude::*;

use super::normals::{Neighbours, Rays, cross, dot, inner_mut};
use super::{check_render, strip_rows, sum, unit};
use crate::{Render, RenderGradients, Result};

/// The depth d of the surface, z in the camera frame, row by row: d = (1 - r) depth / alpha + r median, with r the
/// `median_share`; 0 where the render is less opaque than `min_alpha`.
///
/// # Errors
/// If an image of the render that r needs has another size than the render.
pub fn surface_depth(render: &Render, median_share: f32, min_alpha: f32) -> Result<Vec<f32>> {
    check_render(render, "the opacity of a render", render.alpha.len())?;
    check_render(render, "the depth of a render", render.depth.len())?;
    if median_share > 0.0 {
        check_render(render, "the median depth of a render", render.median_depth.len())?;
    }
    let mut d = vec![0.0; render.alpha.len()];
    let rows = strip_rows(render.height) * render.width;
    d.par_chunks_mut(rows).enumerate().for_each(|(k, d)| {
        vectorised(
            #[inline(always)]
            || depth_of(render, k * rows, median_share, min_alpha, d),
        );
    });
    Ok(d)
}

/// The consistency of one render, all of whose images are there.
pub(super) struct Consistency<'a> {
    pub render: &'a Render,
    pub camera: &'a PinholeCamera,
    pub mask: Option<&'a [u8]>,
    /// Σ of the mask.
    pub area: f64,
    /// Factor of the derivative.
    pub factor: f32,
    /// Share of the median depth.
    pub r: f32,
    pub min_alpha: f32,
}

impl Consistency<'_> {
    /// Mean of 1 - N·n alpha; writes the factor times its derivative by N, depth, alpha and median depth.
    pub fn evaluate(&self, gradients: &mut RenderGradients) -> f64 {
        let (width, height, pixels) = (self.render.width, self.render.height, self.render.alpha.len());
        let row = RowWork {
            consistency: self,
            rays: Rays::new(self.camera),
            by_value: (f64::from(self.factor) / self.area) as f32,
        };
        gradients.normal = vec![[0.0; 3]; pixels];
        [gradients.depth, gradients.alpha, gradients.median_depth] = std::array::from_fn(|_| vec![0.0; pixels]);
        let rows = strip_rows(height);
        let strips = gradients.normal.par_chunks_mut(rows * width).zip(gradients.depth.par_chunks_mut(rows * width));
        let strips = strips.zip(gradients.alpha.par_chunks_mut(rows * width));
        let strips = strips.zip(gradients.median_depth.par_chunks_mut(rows * width)).enumerate();
        let agreements: Vec<f64> = strips
            .map_init(
                || Memory::new(width),
                |memory, (k, (((normal, depth), alpha), median))| {
                    let rows = k * rows..((k + 1) * rows).min(height);
                    row.strip(rows, memory, By { normal, depth, alpha, median })
                },
            )
            .collect();
        1.0 - agreements.iter().sum::<f64>() / self.area
    }
}

struct RowWork<'a> {
    consistency: &'a Consistency<'a>,
    rays: Rays,
    by_value: f32,
}

/// Rows of the derivative by the images of the render.
struct By<'a> {
    normal: &'a mut [[f32; 3]],
    depth: &'a mut [f32],
    alpha: &'a mut [f32],
    median: &'a mut [f32],
}

/// What a strip remembers: the last three rows, because only neighbours meet.
struct Memory {
    d: [Vec<f32>; 3],
    sent: [Sent; 3],
    /// w alpha of a row, then times N·n.
    agreement: Vec<f32>,
    /// N of a row, then the derivative by it, component by component.
    normal: [Vec<f32>; 3],
    by_d: Vec<f32>,
}

/// What the normals of a row send to the depths below, above, right and left of their pixels.
struct Sent {
    below: Vec<f32>,
    above: Vec<f32>,
    right: Vec<f32>,
    left: Vec<f32>,
}

impl Memory {
    fn new(width: usize) -> Self {
        let row = || vec![0.0; width];
        let sent = || Sent { below: row(), above: row(), right: row(), left: row() };
        Self {
            d: std::array::from_fn(|_| row()),
            sent: std::array::from_fn(|_| sent()),
            agreement: row(),
            normal: std::array::from_fn(|_| row()),
            by_d: row(),
        }
    }
}

impl RowWork<'_> {
    /// The derivative in some rows; gives Σ w alpha N·n over them.
    fn strip(&self, rows: Range<usize>, memory: &mut Memory, by: By<'_>) -> f64 {
        let Consistency { render, r, min_alpha, .. } = *self.consistency;
        let (width, height) = (render.width, render.height);
        let at = |row: usize| (row - rows.start) * width..(row + 1 - rows.start) * width;
        let mut total = 0.0;
        // Each step lags one row behind the one before, whose next row it needs.
        for front in rows.start.saturating_sub(2)..rows.end + 2 {
            if front < height {
                let d = &mut memory.d[front % 3];
                vectorised(
                    #[inline(always)]
                    || depth_of(render, front * width, r, min_alpha, d),
                );
            }
            let Some(middle) = front.checked_sub(1) else { continue };
            if middle + 1 >= rows.start {
                let agreement = self.agree(middle, memory);
                if rows.contains(&middle) {
                    total += agreement;
                    let [x, y, z] = &memory.normal;
                    let by_normal = x.iter().zip(y).zip(z).map(|((x, y), z)| [*x, *y, *z]);
                    by.normal[at(middle)].iter_mut().zip(by_normal).for_each(|(by, g)| *by = g);
                }
            }
            let Some(back) = middle.checked_sub(1) else { continue };
            if rows.contains(&back) {
                gather(back, memory);
                let (depth, alpha) = (&mut by.depth[at(back)], &mut by.alpha[at(back)]);
                self.through_depth(back, &memory.by_d, depth, alpha, &mut by.median[at(back)]);
            }
        }
        total
    }

    /// Σ w alpha N·n of a row, the derivative by N, and what goes to the neighbours' depths. The first row, the last and
    /// any outside have no normals.
    fn agree(&self, row: usize, memory: &mut Memory) -> f64 {
        let Consistency { render, mask, .. } = self.consistency;
        let (width, height) = (render.width, render.height);
        let Memory { d, sent, agreement, normal, .. } = memory;
        let sent = &mut sent[row % 3];
        if row == 0 || row + 1 >= height || width < 3 {
            let Sent { below, above, right, left } = sent;
            [below, above, right, left].into_iter().chain(normal).for_each(|row| row.fill(0.0));
            return 0.0;
        }
        let at = row * width..(row + 1) * width;
        let [x, y, z] = normal.each_mut().map(Vec::as_mut_slice);
        vectorised(
            #[inline(always)]
            || {
                agreement.copy_from_slice(&render.alpha[at.clone()]);
                if let Some(mask) = mask {
                    agreement.iter_mut().zip(&mask[at.clone()]).for_each(|(a, m)| *a *= unit(*m));
                }
                for (((x, y), z), n) in x.iter_mut().zip(&mut *y).zip(&mut *z).zip(&render.normal[at.clone()]) {
                    [*x, *y, *z] = *n;
                }
                for edge in [0, width - 1] {
                    [agreement[edge], x[edge], y[edge], z[edge]] = [0.0; 4];
                }
                let neighbours = Neighbours::new(&d[(row - 1) % 3], &d[row % 3], &d[(row + 1) % 3], &self.rays, row);
                agree(&neighbours, self.by_value, agreement, [&mut *x, &mut *y, &mut *z], sent);
                sum(agreement)
            },
        )
    }

    /// From d = (1 - r) depth / alpha + r median to the three.
    fn through_depth(
        &self,
        row: usize,
        by_d: &[f32],
        by_depth: &mut [f32],
        by_alpha: &mut [f32],
        by_median: &mut [f32],
    ) {
        let Consistency { render, r, min_alpha, .. } = *self.consistency;
        let n = by_d.len();
        let (depth, alpha) = (&render.depth[row * n..][..n], &render.alpha[row * n..][..n]);
        let (by_depth, by_alpha, by_median) = (&mut by_depth[..n], &mut by_alpha[..n], &mut by_median[..n]);
        vectorised(
            #[inline(always)]
            || {
                for i in 0..n {
                    let opaque = alpha[i] >= min_alpha;
                    let per_alpha = 1.0 / alpha[i];
                    let by_expected = if opaque { (1.0 - r) * by_d[i] * per_alpha } else { 0.0 };
                    by_depth[i] = by_expected;
                    by_alpha[i] = if opaque { -by_expected * depth[i] * per_alpha } else { 0.0 };
                    by_median[i] = if opaque { r * by_d[i] } else { 0.0 };
                }
            },
        );
    }
}

/// The pixels of a row but its first and its last: w alpha becomes w alpha N·n, N the derivative by it, and `sent` is
/// filled.
#[inline(always)]
fn agree(neighbours: &Neighbours<'_>, by_value: f32, agreement: &mut [f32], normal: [&mut [f32]; 3], sent: &mut Sent) {
    let n = neighbours.here.len();
    let Neighbours { per_fx, per_fy, .. } = *neighbours;
    let [x, y, z] = normal;
    let agreement = &mut inner_mut(agreement)[..n];
    let (x, y, z) = (&mut inner_mut(x)[..n], &mut inner_mut(y)[..n], &mut inner_mut(z)[..n]);
    let (below, above) = (&mut inner_mut(&mut sent.below)[..n], &mut inner_mut(&mut sent.above)[..n]);
    let (right, left) = (&mut inner_mut(&mut sent.right)[..n], &mut inner_mut(&mut sent.left)[..n]);
    for i in 0..n {
        let t = neighbours.tangents(i);
        let (rendered, n) = ([x[i], y[i], z[i]], t.c.map(|c| c * t.per_length));
        let w = agreement[i];
        agreement[i] = w * dot(rendered, n);
        [x[i], y[i], z[i]] = n.map(|n| -by_value * w * n);
        // Through the normalisation, then through the cross product.
        let by_n = rendered.map(|v| -by_value * w * v);
        let along = dot(n, by_n);
        let by_c = [0, 1, 2].map(|k: usize| t.per_length * (by_n[k] - along * n[k]));
        let (by_a, by_b) = (cross(t.b, by_c), cross(by_c, t.a));
        let (along_a, along_b) = (dot(t.ray, by_a), dot(t.ray, by_b));
        below[i] = per_fy * by_a[1] + along_a;
        above[i] = per_fy * by_a[1] - along_a;
        right[i] = per_fx * by_b[0] + along_b;
        left[i] = per_fx * by_b[0] - along_b;
    }
}

/// A row of the derivative by d: what the neighbours send here.
fn gather(row: usize, memory: &mut Memory) {
    let Memory { sent, by_d, .. } = memory;
    vectorised(
        #[inline(always)]
        || {
            by_d.copy_from_slice(&sent[(row + 1) % 3].above);
            if row > 0 {
                by_d.iter_mut().zip(&sent[(row - 1) % 3].below).for_each(|(g, s)| *g += s);
            }
            by_d[1..].iter_mut().zip(&sent[row % 3].right).for_each(|(g, s)| *g += s);
            by_d.iter_mut().zip(&sent[row % 3].left[1..]).for_each(|(g, s)| *g += s);
        },
    );
}

/// The depth d of some pixels from number `first` on.
#[inline(always)]
fn depth_of(render: &Render, first: usize, r: f32, min_alpha: f32, d: &mut [f32]) {
    let at = first..first + d.len();
    let alpha = &render.alpha[at.clone()];
    let opaque = |alpha: f32| (alpha >= min_alpha) & (alpha > 0.0);
    for ((d, depth), alpha) in d.iter_mut().zip(&render.depth[at.clone()]).zip(alpha) {
        *d = if opaque(*alpha) { (1.0 - r) * depth / alpha } else { 0.0 };
    }
    if r > 0.0 {
        for ((d, median), alpha) in d.iter_mut().zip(&render.median_depth[at]).zip(alpha) {
            *d += if opaque(*alpha) { r * median } else { 0.0 };
        }
    }
}
