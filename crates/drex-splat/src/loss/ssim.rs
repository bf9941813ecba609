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

use rayon::prelude::*;

use super::{BAND, check_image, sum};
use crate::Result;

/// Taps of the window to either side of its centre.
const REACH: usize = 5;
const TAPS: usize = 2 * REACH + 1;
const C1: f32 = 0.01 * 0.01;
const C2: f32 = 0.03 * 0.03;

/// Mean structural similarity of two images of values 0 to 1, row by row; `weight` (one a pixel, not negative) makes it
/// a weighted mean, for instance over a mask.
///
/// # Errors
/// If an image has another number of entries than `width * height`, or none.
pub fn ssim(
    image: &[[f32; 3]],
    target: &[[f32; 3]],
    weight: Option<&[f32]>,
    width: usize,
    height: usize,
) -> Result<f64> {
    let mut total = 0.0;
    each_channel(image, target, weight, width, height, |_, ssim, x, y, s| total += ssim.map(x, y, weight, s))?;
    Ok(total / (3.0 * area(weight, width * height)))
}

/// As [`ssim`], with its derivative by `image`.
///
/// # Errors
/// As [`ssim`].
pub fn ssim_with_gradient(
    image: &[[f32; 3]],
    target: &[[f32; 3]],
    weight: Option<&[f32]>,
    width: usize,
    height: usize,
) -> Result<(f64, Vec<[f32; 3]>)> {
    let per_value = 1.0 / (3.0 * area(weight, width.saturating_mul(height)));
    let (mut total, mut gradient) = (0.0, vec![[0.0; 3]; image.len()]);
    each_channel(image, target, weight, width, height, |c, ssim, x, y, s| {
        total += ssim.map(x, y, weight, s);
        ssim.gradient(x, y, s);
        gradient.iter_mut().zip(s).for_each(|(g, s)| g[c] = *s * per_value as f32);
    })?;
    Ok((total * per_value, gradient))
}

/// S of every pixel and channel.
///
/// # Errors
/// As [`ssim`].
pub fn ssim_map(image: &[[f32; 3]], target: &[[f32; 3]], width: usize, height: usize) -> Result<Vec<[f32; 3]>> {
    let mut map = vec![[0.0; 3]; image.len()];
    each_channel(image, target, None, width, height, |c, ssim, x, y, s| {
        ssim.map(x, y, None, s);
        map.iter_mut().zip(s).for_each(|(m, s)| m[c] = *s);
    })?;
    Ok(map)
}

fn each_channel(
    image: &[[f32; 3]],
    target: &[[f32; 3]],
    weight: Option<&[f32]>,
    width: usize,
    height: usize,
    mut work: impl FnMut(usize, &mut Ssim, &[f32], &[f32], &mut [f32]),
) -> Result<()> {
    check_image("the image of a similarity", image.len(), width, height)?;
    check_image("the target of a similarity", target.len(), width, height)?;
    check_image("the weight of a similarity", weight.map_or(image.len(), <[f32]>::len), width, height)?;
    let mut ssim = Ssim::new(width, height);
    let mut s = vec![0.0; image.len()];
    for c in 0..3 {
        let plane = |image: &[[f32; 3]]| image.iter().map(|p| p[c]).collect::<Vec<_>>();
        work(c, &mut ssim, &plane(image), &plane(target), &mut s);
    }
    Ok(())
}

fn area(weight: Option<&[f32]>, pixels: usize) -> f64 {
    weight.map_or(pixels as f64, sum)
}

/// The work of one colour plane after the other, with the memory it needs: seven numbers a pixel.
pub(crate) struct Ssim {
    width: usize,
    height: usize,
    /// Taps of the window from its centre outwards.
    window: [f32; REACH + 1],
    /// Row by row: x, y, x² + y², xy, each blurred along the row.
    moments: Vec<f32>,
    /// Row by row: P, Q, R, each times the weight, blurred along the row.
    slopes: Vec<f32>,
}

impl Ssim {
    /// For planes of `width * height` values, both at least 1.
    pub fn new(width: usize, height: usize) -> Self {
        let pixels = width * height;
        Self { width, height, window: window(), moments: vec![0.0; 4 * pixels], slopes: vec![0.0; 3 * pixels] }
    }

    /// Writes S of every pixel to `s` and gives Σ weight S.
    pub fn map(&mut self, x: &[f32], y: &[f32], weight: Option<&[f32]>, s: &mut [f32]) -> f64 {
        self.blur_moments(x, y);
        let (width, height, window, moments) = (self.width, self.height, &self.window, &self.moments);
        let zeros = vec![0.0; 4 * width];
        let ones = vec![1.0; width];
        let sums: Vec<f64> = s
            .par_chunks_mut(width)
            .zip(self.slopes.par_chunks_mut(3 * width))
            .enumerate()
            .with_min_len(BAND)
            .map_init(
                || (vec![0.0; 4 * width], vec![0.0; 3 * (width + 2 * REACH)], vec![0.0; width]),
                |(m, padded, weighted), (row, (s, slopes))| {
                    let weight = weight.map_or(ones.as_slice(), |w| &w[row * width..][..width]);
                    pulp::Arch::new().dispatch(|| {
                        blur(column(moments, &zeros, row, height), window, m);
                        similarity(m, weight, s, weighted, padded);
                        blur_rows(padded, window, slopes, width);
                        sum(weighted)
                    })
                },
            )
            .collect();
        sums.iter().sum()
    }

    /// Writes ∂(Σ weight S)/∂x, after [`Ssim::map`] of the same planes and weight.
    pub fn gradient(&self, x: &[f32], y: &[f32], gradient: &mut [f32]) {
        let (width, height) = (self.width, self.height);
        let zeros = vec![0.0; 3 * width];
        gradient.par_chunks_mut(width).enumerate().with_min_len(BAND).for_each_init(
            || vec![0.0; 3 * width],
            |blurred, (row, gradient)| {
                let (x, y) = (&x[row * width..][..width], &y[row * width..][..width]);
                pulp::Arch::new().dispatch(|| {
                    blur(column(&self.slopes, &zeros, row, height), &self.window, blurred);
                    let (p, rest) = blurred.split_at(width);
                    let (q, r) = rest.split_at(width);
                    combine(x, y, p, q, r, gradient);
                });
            },
        );
    }

    fn blur_moments(&mut self, x: &[f32], y: &[f32]) {
        let (width, window) = (self.width, &self.window);
        self.moments
            .par_chunks_mut(4 * width)
            .zip(x.par_chunks(width).zip(y.par_chunks(width)))
            .with_min_len(BAND)
            .for_each_init(
                || vec![0.0; 4 * (width + 2 * REACH)],
                |padded, (moments, (x, y))| {
                    pulp::Arch::new().dispatch(|| {
                        multiply(x, y, padded);
                        blur_rows(padded, window, moments, width);
                    });
                },
            );
    }
}

/// One-dimensional taps from the centre outwards; together, both sides, they sum to 1.
fn window() -> [f32; REACH + 1] {
    let taps: [f64; REACH + 1] = std::array::from_fn(|k| (-((k * k) as f64) / (2.0 * 1.5 * 1.5)).exp());
    let total = taps[0] + 2.0 * taps[1..].iter().sum::<f64>();
    taps.map(|tap| (tap / total) as f32)
}

/// The rows from `REACH` above to `REACH` below `row`, zeros outside the image.
#[inline(always)]
fn column<'a>(rows: &'a [f32], zeros: &'a [f32], row: usize, height: usize) -> [&'a [f32]; TAPS] {
    let stride = zeros.len();
    std::array::from_fn(|k| match (row + k).checked_sub(REACH) {
        Some(at) if at < height => &rows[at * stride..][..stride],
        _ => zeros,
    })
}

/// Blurs each of several padded rows along itself.
#[inline(always)]
fn blur_rows(padded: &[f32], window: &[f32; REACH + 1], out: &mut [f32], width: usize) {
    for (padded, out) in padded.chunks_exact(width + 2 * REACH).zip(out.chunks_exact_mut(width)) {
        blur(std::array::from_fn(|k| &padded[k..]), window, out);
    }
}

/// `out[i]` = Σ over the taps k of window(k) rows[k][i].
#[inline(always)]
fn blur(rows: [&[f32]; TAPS], window: &[f32; REACH + 1], out: &mut [f32]) {
    let n = out.len();
    let [a5, a4, a3, a2, a1, centre, b1, b2, b3, b4, b5] = rows.map(|row| &row[..n]);
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

#[inline(always)]
fn combine(x: &[f32], y: &[f32], p: &[f32], q: &[f32], r: &[f32], gradient: &mut [f32]) {
    let n = gradient.len();
    let (x, y, p, q, r) = (&x[..n], &y[..n], &p[..n], &q[..n], &r[..n]);
    for i in 0..n {
        gradient[i] = r[i] + 2.0 * x[i] * p[i] + y[i] * q[i];
    }
}

/// The parts of `N` padded rows inside the image.
#[inline(always)]
fn padded_rows<const N: usize>(padded: &mut [f32], width: usize) -> [&mut [f32]; N] {
    let mut rows = padded.chunks_exact_mut(width + 2 * REACH);
    std::array::from_fn(|_| match rows.next() {
        Some(row) => &mut row[REACH..REACH + width],
        None => &mut [],
    })
}
