//! Structural similarity (Wang et al. 2004, eq. 13), its mean and its derivative by the first image.
//!
//! With a normalised Gaussian window G of 11 x 11 taps and σ = 1.5, zeros outside the image, per channel:
//!
//! ```text
//! μx = G*x   μy = G*y   σx² = G*x² - μx²   σy² = G*y² - μy²   σxy = G*xy - μx μy
//! S = A₁A₂ / (B₁B₂),   A₁ = 2 μx μy + C₁,   A₂ = 2 σxy + C₂,   B₁ = μx² + μy² + C₁,   B₂ = σx² + σy² + C₂
//! ```
//!
//! S needs x² and y² only as a sum, so four images are blurred. With P = ∂S/∂(G*x²) = -S/B₂, Q = ∂S/∂(G*xy) =
//! 2 A₁/(B₁B₂) and R = ∂S/∂μx, and because G is symmetric, ∂ΣS/∂x = G*R + 2x G*P + y G*Q: three more.
//!
//! The image is done in strips of rows. A strip runs down its rows once with the last eleven rows of every step at hand,
//! so that all that is between the images and the derivative stays in the cache.

use std::ops::Range;

use rayon::prelude::*;

use super::{check_image, strip_rows, sum, unit};
use crate::Result;
use drex_core::simd::vectorised;

/// Taps of the window to either side of its centre.
const REACH: usize = 5;
const TAPS: usize = 2 * REACH + 1;
const C1: f32 = 0.01 * 0.01;
const C2: f32 = 0.03 * 0.03;

/// Mean structural similarity of two images of values 0 to 1, row by row. With a mask (255 counts, 0 does not) it is a
/// weighted mean, but the windows of pixels that count see those that do not.
///
/// # Errors
/// If an image has another number of entries than `width * height`, or none.
pub fn ssim(image: &[[f32; 3]], target: &[[f32; 3]], mask: Option<&[u8]>, width: usize, height: usize) -> Result<f64> {
    check(image, target, mask, width, height)?;
    let mut unused = vec![(); width * height];
    let total = each_strip(image, target, mask, [width, height], Want::Map, &mut unused, |_, _, _| {});
    Ok(total / (3.0 * area(mask, width * height)))
}

/// As [`ssim`], with its derivative by `image`.
///
/// # Errors
/// As [`ssim`].
pub fn ssim_with_gradient(
    image: &[[f32; 3]],
    target: &[[f32; 3]],
    mask: Option<&[u8]>,
    width: usize,
    height: usize,
) -> Result<(f64, Vec<[f32; 3]>)> {
    check(image, target, mask, width, height)?;
    let per_value = 1.0 / (3.0 * area(mask, width * height));
    let mut gradient = vec![[0.0; 3]; image.len()];
    let write = |c: usize, g: &mut [f32; 3], by_x: f32| g[c] = by_x * per_value as f32;
    let total = each_strip(image, target, mask, [width, height], Want::Gradient, &mut gradient, write);
    Ok((total * per_value, gradient))
}

/// S of every pixel and channel.
///
/// # Errors
/// As [`ssim`].
pub fn ssim_map(image: &[[f32; 3]], target: &[[f32; 3]], width: usize, height: usize) -> Result<Vec<[f32; 3]>> {
    check(image, target, None, width, height)?;
    let mut map = vec![[0.0; 3]; image.len()];
    each_strip(image, target, None, [width, height], Want::Map, &mut map, |c, m, s| m[c] = s);
    Ok(map)
}

fn check(image: &[[f32; 3]], target: &[[f32; 3]], mask: Option<&[u8]>, width: usize, height: usize) -> Result<()> {
    check_image("the image of a similarity", image.len(), width, height)?;
    check_image("the target of a similarity", target.len(), width, height)?;
    check_image("the mask of a similarity", mask.map_or(image.len(), <[u8]>::len), width, height)
}

fn area(mask: Option<&[u8]>, pixels: usize) -> f64 {
    mask.map_or(pixels as f64, super::area)
}

/// Σ mask S, with `write(channel, entry of out, result)` for every pixel.
fn each_strip<T: Send>(
    image: &[[f32; 3]],
    target: &[[f32; 3]],
    mask: Option<&[u8]>,
    [width, height]: [usize; 2],
    want: Want,
    out: &mut [T],
    write: impl Fn(usize, &mut T, f32) + Sync,
) -> f64 {
    let rows = strip_rows(height);
    let strip = |strip: &mut Strip, (k, out): (usize, &mut [T])| {
        let first = k * rows;
        let fill = |c: usize, row: usize, x: &mut [f32], y: &mut [f32]| {
            let at = row * width..(row + 1) * width;
            x.iter_mut().zip(&image[at.clone()]).for_each(|(x, p)| *x = p[c]);
            y.iter_mut().zip(&target[at]).for_each(|(y, p)| *y = p[c]);
        };
        let mut total = 0.0;
        for c in 0..3 {
            let done = |row: usize, _: &[f32], _: &[f32], result: &mut [f32]| {
                let out = &mut out[(row - first) * width..][..width];
                out.iter_mut().zip(result).for_each(|(out, result)| write(c, out, *result));
            };
            let rows = first..(first + rows).min(height);
            total += strip.run(rows, mask, want, |row, x, y| fill(c, row, x, y), done);
        }
        total
    };
    let strips = out.par_chunks_mut(rows * width).enumerate();
    let sums: Vec<f64> = strips.map_init(|| Strip::new(width, height), strip).collect();
    sums.iter().sum()
}

/// What a strip computes of every pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Want {
    /// S.
    Map,
    /// ∂(Σ mask S)/∂x.
    Gradient,
}

/// The memory of a strip of one colour plane after the other.
pub(crate) struct Strip {
    width: usize,
    height: usize,
    /// Taps of the window from its centre outwards.
    window: [f32; REACH + 1],
    /// The last rows of x and y.
    x: Ring,
    y: Ring,
    /// The last rows of x, y, x² + y², xy, each blurred along the row.
    moments: Ring,
    /// The last rows of P, Q, R, each times the mask, blurred along the row.
    slopes: Ring,
    /// Rows with zeros on either side, before they are blurred.
    padded: Vec<f32>,
    /// A row of moments or slopes, blurred along the column too.
    blurred: Vec<f32>,
    /// Mask, S and mask times S of a row, then the derivative.
    weight: Vec<f32>,
    s: Vec<f32>,
    weighted: Vec<f32>,
}

impl Strip {
    /// For planes of `width * height` values, both at least 1.
    pub fn new(width: usize, height: usize) -> Self {
        let row = || vec![0.0; width];
        Self {
            width,
            height,
            window: window(),
            x: Ring::new(width),
            y: Ring::new(width),
            moments: Ring::new(4 * width),
            slopes: Ring::new(3 * width),
            padded: vec![0.0; 4 * (width + 2 * REACH)],
            blurred: vec![0.0; 4 * width],
            weight: vec![1.0; width],
            s: row(),
            weighted: row(),
        }
    }

    /// Gives Σ mask S over `rows` of a plane, and calls `done(row, x, y, result)` for each of them in order.
    /// `fill(row, x, y)` writes a row of both images.
    pub fn run(
        &mut self,
        rows: Range<usize>,
        mask: Option<&[u8]>,
        want: Want,
        mut fill: impl FnMut(usize, &mut [f32], &mut [f32]),
        mut done: impl FnMut(usize, &[f32], &[f32], &mut [f32]),
    ) -> f64 {
        let reach = if want == Want::Gradient { REACH } else { 0 };
        let inner = rows.start.saturating_sub(reach)..(rows.end + reach).min(self.height);
        let outer = inner.start.saturating_sub(REACH)..(inner.end + REACH).min(self.height);
        let mut total = 0.0;
        // Each step lags behind the one before by the rows its window needs below.
        for front in outer.start..rows.end + 2 * REACH {
            if outer.contains(&front) {
                fill(front, self.x.row_mut(front), self.y.row_mut(front));
                self.moments_of(front);
            }
            let Some(middle) = front.checked_sub(REACH) else { continue };
            if inner.contains(&middle) {
                let sum = self.similarity_of(middle, mask, want);
                if rows.contains(&middle) {
                    total += sum;
                    if want == Want::Map {
                        done(middle, self.x.row(middle), self.y.row(middle), &mut self.s);
                    }
                }
            }
            let Some(back) = middle.checked_sub(REACH) else { continue };
            if want == Want::Gradient && rows.contains(&back) {
                self.gradient_of(back);
                done(back, self.x.row(back), self.y.row(back), &mut self.s);
            }
        }
        total
    }

    fn moments_of(&mut self, row: usize) {
        let Self { width, window, x, y, moments, padded, .. } = self;
        vectorised(
            #[inline(always)]
            || {
                multiply(x.row(row), y.row(row), padded);
                blur_rows(padded, window, moments.row_mut(row), *width);
            },
        );
    }

    /// Σ mask S of the row; S is in `s` then.
    fn similarity_of(&mut self, row: usize, mask: Option<&[u8]>, want: Want) -> f64 {
        let Self { width, height, window, moments, slopes, padded, blurred, weight, s, weighted, .. } = self;
        let width = *width;
        vectorised(
            #[inline(always)]
            || {
                if let Some(mask) = mask {
                    weight.iter_mut().zip(&mask[row * width..]).for_each(|(w, m)| *w = unit(*m));
                }
                blur(moments.around(row, *height), window, blurred);
                similarity(blurred, weight, s, weighted, padded);
                if want == Want::Gradient {
                    blur_rows(padded, window, slopes.row_mut(row), width);
                }
                sum(weighted)
            },
        )
    }

    /// The derivative of the row, in `s`.
    fn gradient_of(&mut self, row: usize) {
        let Self { width, height, window, x, y, slopes, blurred, s, .. } = self;
        vectorised(
            #[inline(always)]
            || {
                let blurred = &mut blurred[..3 * *width];
                blur(slopes.around(row, *height), window, blurred);
                combine(x.row(row), y.row(row), blurred, s);
            },
        );
    }
}

/// The last rows of an image that runs by.
struct Ring {
    stride: usize,
    rows: Vec<f32>,
    zeros: Vec<f32>,
}

impl Ring {
    fn new(stride: usize) -> Self {
        Self { stride, rows: vec![0.0; TAPS * stride], zeros: vec![0.0; stride] }
    }

    #[inline(always)]
    fn row(&self, row: usize) -> &[f32] {
        &self.rows[row % TAPS * self.stride..][..self.stride]
    }

    #[inline(always)]
    fn row_mut(&mut self, row: usize) -> &mut [f32] {
        &mut self.rows[row % TAPS * self.stride..][..self.stride]
    }

    /// The rows from `REACH` above to `REACH` below `row`, zeros outside the image.
    #[inline(always)]
    fn around(&self, row: usize, height: usize) -> [&[f32]; TAPS] {
        std::array::from_fn(
            #[inline(always)]
            |k| match (row + k).checked_sub(REACH) {
                Some(at) if at < height => self.row(at),
                _ => &self.zeros,
            },
        )
    }
}

/// One-dimensional taps from the centre outwards; together, both sides, they sum to 1.
fn window() -> [f32; REACH + 1] {
    let taps: [f64; REACH + 1] = std::array::from_fn(|k| (-((k * k) as f64) / (2.0 * 1.5 * 1.5)).exp());
    let total = taps[0] + 2.0 * taps[1..].iter().sum::<f64>();
    taps.map(|tap| (tap / total) as f32)
}

/// Blurs each of several padded rows along itself.
#[inline(always)]
fn blur_rows(padded: &[f32], window: &[f32; REACH + 1], out: &mut [f32], width: usize) {
    for (padded, out) in padded.chunks_exact(width + 2 * REACH).zip(out.chunks_exact_mut(width)) {
        blur(
            std::array::from_fn(
                #[inline(always)]
                |k| &padded[k..],
            ),
            window,
            out,
        );
    }
}

/// `out[i]` = Σ over the taps k of window(k) rows[k][i].
#[inline(always)]
fn blur(rows: [&[f32]; TAPS], window: &[f32; REACH + 1], out: &mut [f32]) {
    let n = out.len();
    let [a5, a4, a3, a2, a1, centre, b1, b2, b3, b4, b5] = rows.map(
        #[inline(always)]
        |row| &row[..n],
    );
    let [g0, g1, g2, g3, g4, g5] = *window;
    for i in 0..n {
        let near = g0 * centre[i] + g1 * (a1[i] + b1[i]) + g2 * (a2[i] + b2[i]);
        let far = g3 * (a3[i] + b3[i]) + g4 * (a4[i] + b4[i]) + g5 * (a5[i] + b5[i]);
        out[i] = near + far;
    }
}

/// The padded rows x, y, x² + y², xy.
#[inline(always)]
fn multiply(x: &[f32], y: &[f32], padded: &mut [f32]) {
    let n = x.len();
    let y = &y[..n];
    let [px, py, squares, products] = padded_rows(padded, n);
    px.copy_from_slice(x);
    py.copy_from_slice(y);
    for i in 0..n {
        squares[i] = x[i] * x[i] + y[i] * y[i];
        products[i] = x[i] * y[i];
    }
}

/// S and weight S from the moments of a row, and the padded rows P, Q, R times the weight.
#[inline(always)]
fn similarity(moments: &[f32], weight: &[f32], s: &mut [f32], weighted: &mut [f32], padded: &mut [f32]) {
    let n = s.len();
    let (mx, rest) = moments.split_at(n);
    let (my, rest) = rest.split_at(n);
    let (squares, products) = rest.split_at(n);
    let (products, weight, weighted) = (&products[..n], &weight[..n], &mut weighted[..n]);
    let [p, q, r] = padded_rows(padded, n);
    for i in 0..n {
        let (mu_x, mu_y) = (mx[i], my[i]);
        let (xx_yy, xy) = (mu_x * mu_x + mu_y * mu_y, mu_x * mu_y);
        let (a1, a2) = (2.0 * xy + C1, 2.0 * (products[i] - xy) + C2);
        let (b1, b2) = (xx_yy + C1, squares[i] - xx_yy + C2);
        let (ib1, ib2) = (1.0 / b1, 1.0 / b2);
        let value = a1 * a2 * ib1 * ib2;
        let (dp, dq) = (-value * ib2, 2.0 * a1 * ib1 * ib2);
        let dr = 2.0 * (mu_y * a2 * ib2 - mu_x * value) * ib1 - 2.0 * mu_x * dp - mu_y * dq;
        s[i] = value;
        weighted[i] = weight[i] * value;
        p[i] = weight[i] * dp;
        q[i] = weight[i] * dq;
        r[i] = weight[i] * dr;
    }
}

/// G*R + 2x G*P + y G*Q.
#[inline(always)]
fn combine(x: &[f32], y: &[f32], slopes: &[f32], gradient: &mut [f32]) {
    let n = gradient.len();
    let (p, rest) = slopes.split_at(n);
    let (q, r) = rest.split_at(n);
    let (x, y, r) = (&x[..n], &y[..n], &r[..n]);
    for i in 0..n {
        gradient[i] = r[i] + 2.0 * x[i] * p[i] + y[i] * q[i];
    }
}

/// The parts of `N` padded rows inside the image.
#[inline(always)]
fn padded_rows<const N: usize>(padded: &mut [f32], width: usize) -> [&mut [f32]; N] {
    let mut rows = padded.chunks_exact_mut(width + 2 * REACH);
    std::array::from_fn(
        #[inline(always)]
        |_| match rows.next() {
            Some(row) => &mut row[REACH..REACH + width],
            None => &mut [],
        },
    )
}
