//! How far a render is from a photo: (1 - λ) L1 + λ (1 - SSIM) (Kerbl et al. 2023, eq. 7), and what a mask of the object
//! changes in it.

use std::borrow::Cow;

use rayon::prelude::*;

use super::ssim::Ssim;
use super::{BAND, Exposure, check_render, empty_mask, sum, unit, weights};
use crate::{Error, Render, RenderGradients, Result};

/// A photo to compare with, as large as the render.
#[derive(Debug, Clone, Copy)]
pub struct Target<'a> {
    /// The photo's name, for messages.
    pub name: &'a str,
    /// Colours, row by row.
    pub rgb: &'a [[u8; 3]],
    /// 255 on the object, 0 elsewhere; values between are shares. Needed unless the mode is [`MaskMode::Off`].
    pub mask: Option<&'a [u8]>,
    /// Map of the render's colours to this photo's.
    pub exposure: Option<&'a Exposure>,
}

/// What the mask of an object does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskMode {
    /// Nothing: every pixel counts.
    #[default]
    Off,
    /// Pixels outside do not count, and the loss is a mean over the mask's area: what is outside stays free.
    Masked,
    /// The photo has the render's background outside, and the render's opacity is drawn to the mask: nothing is outside.
    Transparent,
}

/// How a render is compared with a photo.
#[derive(Debug, Clone, PartialEq)]
pub struct PhotometricOptions {
    /// Share λ of 1 - SSIM, 0 to 1.
    pub lambda: f32,
    /// What the mask does.
    pub mask: MaskMode,
    /// The colour behind the render (`RenderOptions::background`): for [`MaskMode::Transparent`] only.
    pub background: [f32; 3],
    /// Weight of mean |alpha - mask|: for [`MaskMode::Transparent`] only.
    pub alpha: f32,
    /// Pixels this near to the mask's rim (value 128, along rows and columns) do not count, px, because masks are wrong
    /// there first: for [`MaskMode::Transparent`] only.
    pub ignore_band: usize,
}

impl Default for PhotometricOptions {
    fn default() -> Self {
        Self { lambda: 0.2, mask: MaskMode::Off, background: [0.0; 3], alpha: 0.1, ignore_band: 0 }
    }
}

/// A loss, its parts and its derivatives.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PhotometricLoss {
    /// (1 - λ) `l1` + λ (1 - `ssim`) + weight of `alpha` times `alpha`.
    pub value: f64,
    /// Mean absolute difference over the pixels that count and the channels.
    pub l1: f64,
    /// Mean structural similarity over the pixels that count and the channels.
    pub ssim: f64,
    /// Mean |alpha - mask| over the pixels that count; 0 unless the mode is [`MaskMode::Transparent`].
    pub alpha: f64,
    /// Derivative of `value` by the render's `rgb` and `alpha`.
    pub gradients: RenderGradients,
    /// Derivative of `value` by the exposure's matrix, if there is one.
    pub exposure: Option<[[f32; 4]; 3]>,
}

/// Compares `render` with `target`.
///
/// With weights w (all one, or the mask), photo y and render x: the pixels that do not count are given the photo's
/// values, x' = w x + (1 - w) y, so that they say nothing through the window of the SSIM either; L1 and SSIM are means
/// weighted with w. With [`MaskMode::Transparent`] y = m photo + (1 - m) background, where the exposure maps the
/// background too but is not differentiated through it.
///
/// # Errors
/// If sizes differ, an option is out of range, the mode needs a mask and there is none, or no pixel counts.
pub fn photometric(render: &Render, target: &Target<'_>, options: &PhotometricOptions) -> Result<PhotometricLoss> {
    check(render, target, options)?;
    let transparent = options.mask == MaskMode::Transparent;
    let exposed = match target.exposure {
        Some(exposure) => Cow::Owned(exposure.apply_all(&render.rgb)),
        None => Cow::Borrowed(&render.rgb),
    };
    let background = target.exposure.map_or(options.background, |exposure| exposure.apply(options.background));
    let (weight, area) = weight_of(render, target, options)?;

    let (l1, ssim, rgb) = colours(render, &exposed, target, options, weight.as_deref(), area, background);
    let mut loss = PhotometricLoss { l1, ssim, ..Default::default() };
    loss.value = f64::from(1.0 - options.lambda) * l1 + f64::from(options.lambda) * (1.0 - ssim);
    loss.gradients.rgb = rgb;
    loss.exposure = target.exposure.map(|e| e.backward(&render.rgb, &mut loss.gradients.rgb, render.width));
    if let (true, Some(mask)) = (transparent, target.mask) {
        (loss.alpha, loss.gradients.alpha) = opacity(render, mask, options.alpha, weight.as_deref(), area);
        loss.value += f64::from(options.alpha) * loss.alpha;
    }
    Ok(loss)
}

fn check(render: &Render, target: &Target<'_>, options: &PhotometricOptions) -> Result<()> {
    check_render(render, "the colours of a render", render.rgb.len())?;
    check_render(render, "the opacity of a render", render.alpha.len())?;
    check_render(render, &format!("the photo {}", target.name), target.rgb.len())?;
    if !((0.0..=1.0).contains(&options.lambda) && (0.0..f32::INFINITY).contains(&options.alpha)) {
        return Err(Error::Option {
            what: format!("the share of SSIM is {}, the weight of the opacity {}", options.lambda, options.alpha),
            remedy: "give a share from 0 to 1 and a weight of at least 0".into(),
        });
    }
    if options.mask != MaskMode::Off && target.mask.is_none() {
        return Err(Error::Capture {
            what: format!("the photo {} has no mask, and training uses masks", target.name),
            remedy: "give it a mask, leave it out, or train without masks".into(),
        });
    }
    Ok(())
}

/// The weights of the pixels (`None`: all one) and their sum.
fn weight_of(render: &Render, target: &Target<'_>, options: &PhotometricOptions) -> Result<(Option<Vec<f32>>, f64)> {
    let all = (None, render.rgb.len() as f64);
    match (options.mask, target.mask) {
        (MaskMode::Off, _) | (_, None) => Ok(all),
        (MaskMode::Masked, mask) => weights(render, mask, target.name),
        (MaskMode::Transparent, Some(mask)) => {
            weights(render, Some(mask), target.name)?; // refuses what is wrong with the mask
            if options.ignore_band == 0 {
                return Ok(all);
            }
            let weight = off_rim(mask, render.width, options.ignore_band);
            match sum(&weight) {
                0.0 => Err(empty_mask(target.name, "the band that is ignored at the mask's rim is too wide")),
                area => Ok((Some(weight), area)),
            }
        }
    }
}

/// L1, SSIM, and the derivative of their sum by the exposed colours.
fn colours(
    render: &Render,
    exposed: &[[f32; 3]],
    target: &Target<'_>,
    options: &PhotometricOptions,
    weight: Option<&[f32]>,
    area: f64,
    background: [f32; 3],
) -> (f64, f64, Vec<[f32; 3]>) {
    let (width, pixels) = (render.width, exposed.len());
    let blend = target.mask.filter(|_| options.mask == MaskMode::Transparent);
    let per_value = 1.0 / (3.0 * area);
    let by_l1 = (f64::from(1.0 - options.lambda) * per_value) as f32;
    let by_ssim = (f64::from(options.lambda) * per_value) as f32;

    let mut ssim = Ssim::new(width, render.height);
    let [mut x, mut y, mut s] = std::array::from_fn(|_| vec![0.0; pixels]);
    let mut gradient = vec![[0.0; 3]; pixels];
    let (mut l1, mut similarity) = (0.0, 0.0);
    for c in 0..3 {
        let rows = x.par_chunks_mut(width).zip(y.par_chunks_mut(width)).enumerate().with_min_len(BAND);
        let sums: Vec<f64> = rows
            .map(|(row, (x, y))| {
                let at = row * width..(row + 1) * width;
                let (exposed, photo) = (&exposed[at.clone()], &target.rgb[at.clone()]);
                let (blend, weight) = (blend.map(|m| &m[at.clone()]), weight.map(|w| &w[at]));
                pulp::Arch::new().dispatch(|| channel(c, exposed, photo, blend, background[c], weight, x, y))
            })
            .collect();
        l1 += sums.iter().sum::<f64>();
        similarity += ssim.map(&x, &y, weight, &mut s);
        ssim.gradient(&x, &y, &mut s);
        let rows = gradient.par_chunks_mut(width).enumerate().with_min_len(BAND);
        rows.for_each(|(row, gradient)| {
            let at = row * width..(row + 1) * width;
            let (x, y, s) = (&x[at.clone()], &y[at.clone()], &s[at.clone()]);
            let weight = weight.map(|w| &w[at]);
            pulp::Arch::new().dispatch(|| slope(c, x, y, s, weight, [by_l1, by_ssim], gradient));
        });
    }
    (l1 * per_value, similarity * per_value, gradient)
}

/// A row of one channel: x' and y; gives Σ |x' - y| = Σ w |x - y|.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "a row of each of the images of the formula")]
fn channel(
    c: usize,
    exposed: &[[f32; 3]],
    photo: &[[u8; 3]],
    blend: Option<&[u8]>,
    background: f32,
    weight: Option<&[f32]>,
    x: &mut [f32],
    y: &mut [f32],
) -> f64 {
    for (((x, y), exposed), photo) in x.iter_mut().zip(&mut *y).zip(exposed).zip(photo) {
        *x = exposed[c];
        *y = unit(photo[c]);
    }
    for (y, m) in y.iter_mut().zip(blend.unwrap_or_default()) {
        *y = unit(*m) * *y + (1.0 - unit(*m)) * background;
    }
    for ((x, y), w) in x.iter_mut().zip(&*y).zip(weight.unwrap_or_default()) {
        *x = w * *x + (1.0 - w) * y;
    }
    let mut lanes = [0.0_f64; 8];
    for (i, (x, y)) in x.iter().zip(&*y).enumerate() {
        lanes[i % 8] += f64::from((x - y).abs());
    }
    lanes.iter().sum()
}

/// Channel c of a row of the derivative: w ((1 - λ) sign(x' - y) - λ ∂ΣwS/∂x') / (3 Σw).
#[inline(always)]
fn slope(
    c: usize,
    x: &[f32],
    y: &[f32],
    s: &[f32],
    weight: Option<&[f32]>,
    [by_l1, by_ssim]: [f32; 2],
    gradient: &mut [[f32; 3]],
) {
    for (((g, x), y), s) in gradient.iter_mut().zip(x).zip(y).zip(s) {
        g[c] = by_l1 * sign(x - y) - by_ssim * s;
    }
    for (g, w) in gradient.iter_mut().zip(weight.unwrap_or_default()) {
        g[c] *= w;
    }
}

/// Mean |alpha - mask| over the pixels that count, and its derivative times `factor`.
fn opacity(render: &Render, mask: &[u8], factor: f32, weight: Option<&[f32]>, area: f64) -> (f64, Vec<f32>) {
    let width = render.width;
    let by_value = (f64::from(factor) / area) as f32;
    let mut gradient = vec![0.0; render.alpha.len()];
    let rows = gradient.par_chunks_mut(width).zip(render.alpha.par_chunks(width)).zip(mask.par_chunks(width));
    let sums: Vec<f64> = rows
        .enumerate()
        .with_min_len(BAND)
        .map(|(row, ((gradient, alpha), mask))| {
            let weight = weight.map_or(&[][..], |w| &w[row * width..][..width]);
            pulp::Arch::new().dispatch(|| {
                for ((g, a), m) in gradient.iter_mut().zip(alpha).zip(mask) {
                    *g = a - unit(*m);
                }
                for (g, w) in gradient.iter_mut().zip(weight) {
                    *g *= w;
                }
                let mut lanes = [0.0_f64; 8];
                for (i, g) in gradient.iter().enumerate() {
                    lanes[i % 8] += f64::from(g.abs());
                }
                // Weights are zero or one here, so the sign tells which pixels count.
                for g in gradient.iter_mut() {
                    *g = by_value * sign(*g);
                }
                lanes.iter().sum::<f64>()
            })
        })
        .collect();
    (sums.iter().sum::<f64>() / area, gradient)
}

/// -1, 0 or 1; 0 for what is not a number.
#[inline(always)]
pub(crate) fn sign(v: f32) -> f32 {
    f32::from(u8::from(v > 0.0)) - f32::from(u8::from(v < 0.0))
}

/// 1 where the square of pixels up to `band` away lies wholly inside or wholly outside the mask, else 0.
fn off_rim(mask: &[u8], width: usize, band: usize) -> Vec<f32> {
    let inside: Vec<u8> = mask.iter().map(|m| u8::from(*m >= 128)).collect();
    let extreme = |pick: fn(u8, u8) -> u8| {
        let mut along = inside.clone();
        for (row, out) in inside.chunks(width).zip(along.chunks_mut(width)) {
            (1..=band).for_each(|d| spread(row, d, out, pick));
        }
        let mut across = along.clone();
        (1..=band).for_each(|d| spread(&along, d.saturating_mul(width), &mut across, pick));
        across
    };
    let (least, most) = (extreme(u8::min), extreme(u8::max));
    least.iter().zip(&most).map(|(l, m)| f32::from(u8::from(l == m))).collect()
}

/// Picks between each value and those `offset` before and after it, as far as there are any.
fn spread(values: &[u8], offset: usize, out: &mut [u8], pick: impl Fn(u8, u8) -> u8) {
    let after = values.get(offset..).unwrap_or_default();
    out.iter_mut().zip(after).for_each(|(o, v)| *o = pick(*o, *v));
    let later = out.get_mut(offset..).unwrap_or_default();
    later.iter_mut().zip(values).for_each(|(o, v)| *o = pick(*o, *v));
}
