//! How far a render is from a photo: (1 - λ) L1 + λ (1 - SSIM) (Kerbl et al. 2023, eq. 7), and what a mask of the object
//! changes in it.

use std::borrow::Cow;

use drex_core::simd::vectorised;
use rayon::prelude::*;

use super::ssim::{Strip, Want};
use super::{Exposure, area, area_that_counts, check_render, empty_mask, strip_rows, sum_with, unit};
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
    let job = Job {
        width: render.width,
        height: render.height,
        exposed: &exposed,
        photo: target.rgb,
        blend: target.mask.filter(|_| transparent),
        background,
        weight: weight.as_deref(),
        area,
    };

    let (l1, ssim, rgb) = job.colours(options.lambda);
    let mut loss = PhotometricLoss { l1, ssim, ..Default::default() };
    loss.value = f64::from(1.0 - options.lambda) * l1 + f64::from(options.lambda) * (1.0 - ssim);
    loss.gradients.rgb = rgb;
    loss.exposure = target.exposure.map(|e| e.backward(&render.rgb, &mut loss.gradients.rgb));
    if let Some(mask) = job.blend {
        (loss.alpha, loss.gradients.alpha) = job.opacity(&render.alpha, mask, options.alpha);
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
        return Err(drex_core::Error::capture(
            format!("the photo {} has no mask, and training uses masks", target.name),
            "give it a mask, leave it out, or train without masks",
        )
        .into());
    }
    Ok(())
}

/// The weights of the pixels (255 is one, `None`: all one) and their sum.
fn weight_of<'a>(
    render: &Render,
    target: &Target<'a>,
    options: &PhotometricOptions,
) -> Result<(Option<Cow<'a, [u8]>>, f64)> {
    let all = (None, render.rgb.len() as f64);
    let (Some(mask), true) = (target.mask, options.mask != MaskMode::Off) else {
        return Ok(all);
    };
    let mask_area = area_that_counts(render, Some(mask), target.name)?;
    if options.mask == MaskMode::Masked {
        return Ok((Some(Cow::Borrowed(mask)), mask_area));
    }
    if options.ignore_band == 0 {
        return Ok(all);
    }
    let weight = off_rim(mask, render.width, options.ignore_band);
    match area(&weight) {
        0.0 => Err(empty_mask(target.name, "the band that is ignored at the mask's rim is too wide")),
        area => Ok((Some(Cow::Owned(weight)), area)),
    }
}

/// What is compared, all of the same size.
struct Job<'a> {
    width: usize,
    height: usize,
    exposed: &'a [[f32; 3]],
    photo: &'a [[u8; 3]],
    /// Where the photo is kept and where it becomes the background.
    blend: Option<&'a [u8]>,
    background: [f32; 3],
    weight: Option<&'a [u8]>,
    area: f64,
}

impl Job<'_> {
    /// L1, SSIM, and the derivative of (1 - λ) L1 - λ SSIM by the exposed colours.
    fn colours(&self, lambda: f32) -> (f64, f64, Vec<[f32; 3]>) {
        let (width, height) = (self.width, self.height);
        let per_value = 1.0 / (3.0 * self.area);
        let factors = [f64::from(1.0 - lambda) * per_value, f64::from(lambda) * per_value].map(|f| f as f32);
        let mut gradient = vec![[0.0; 3]; self.exposed.len()];
        let rows = strip_rows(height);
        let strip = |strip: &mut Strip, (k, gradient): (usize, &mut [[f32; 3]])| {
            let range = k * rows..((k + 1) * rows).min(height);
            let (mut l1, mut ssim) = (0.0, 0.0);
            for c in 0..3 {
                let done = |row: usize, x: &[f32], y: &[f32], s: &mut [f32]| {
                    l1 += self.slope(row, x, y, s, factors);
                    let gradient = &mut gradient[(row - k * rows) * width..][..width];
                    gradient.iter_mut().zip(s).for_each(|(g, s)| g[c] = *s);
                };
                ssim +=
                    strip.run(range.clone(), self.weight, Want::Gradient, |row, x, y| self.fill(c, row, x, y), done);
            }
            (l1, ssim)
        };
        let strips = gradient.par_chunks_mut(rows * width).enumerate();
        let sums: Vec<(f64, f64)> = strips.map_init(|| Strip::new(width, height), strip).collect();
        let (l1, ssim) = sums.iter().fold((0.0, 0.0), |(l1, ssim), of| (l1 + of.0, ssim + of.1));
        (l1 * per_value, ssim * per_value, gradient)
    }

    /// A row of one channel: x' and y.
    fn fill(&self, c: usize, row: usize, x: &mut [f32], y: &mut [f32]) {
        let at = row * self.width..(row + 1) * self.width;
        let background = self.background[c];
        vectorised(
            #[inline(always)]
            || {
                x.iter_mut().zip(&self.exposed[at.clone()]).for_each(|(x, rgb)| *x = rgb[c]);
                y.iter_mut().zip(&self.photo[at.clone()]).for_each(|(y, rgb)| *y = unit(rgb[c]));
                if let Some(blend) = self.blend {
                    for (y, m) in y.iter_mut().zip(&blend[at.clone()]) {
                        *y = unit(*m) * *y + (1.0 - unit(*m)) * background;
                    }
                }
                if let Some(weight) = self.weight {
                    for ((x, y), w) in x.iter_mut().zip(&*y).zip(&weight[at.clone()]) {
                        // Not by multiplication with zero: what does not count may be anything.
                        *x = if *w > 0 { unit(*w) * *x + (1.0 - unit(*w)) * y } else { *y };
                    }
                }
            },
        );
    }

    /// A row of one channel: ∂ΣwS/∂x' becomes the derivative w ((1 - λ) sign(x' - y) - λ ∂ΣwS/∂x') / (3 Σw); gives
    /// Σ |x' - y|, which is Σ w |x - y|.
    fn slope(&self, row: usize, x: &[f32], y: &[f32], s: &mut [f32], [by_l1, by_ssim]: [f32; 2]) -> f64 {
        vectorised(
            #[inline(always)]
            || {
                for ((s, x), y) in s.iter_mut().zip(x).zip(y) {
                    *s = by_l1 * sign(x - y) - by_ssim * *s;
                }
                if let Some(weight) = self.weight {
                    s.iter_mut().zip(&weight[row * self.width..]).for_each(|(s, w)| *s *= unit(*w));
                }
                sum_with(x, y, |x, y| (x - y).abs())
            },
        )
    }

    /// Mean |alpha - mask| over the pixels that count, and its derivative times `factor`.
    fn opacity(&self, alpha: &[f32], mask: &[u8], factor: f32) -> (f64, Vec<f32>) {
        let rows = strip_rows(self.height) * self.width;
        let by_value = (f64::from(factor) / self.area) as f32;
        let mut gradient = vec![0.0; alpha.len()];
        let strips = gradient.par_chunks_mut(rows).zip(alpha.par_chunks(rows)).zip(mask.par_chunks(rows));
        let sums: Vec<f64> = strips
            .enumerate()
            .map(|(k, ((gradient, alpha), mask))| {
                vectorised(
                    #[inline(always)]
                    || {
                        gradient.iter_mut().zip(alpha).zip(mask).for_each(|((g, a), m)| *g = a - unit(*m));
                        if let Some(weight) = self.weight {
                            // 0 or 255 here: all or nothing.
                            let weight = &weight[k * rows..];
                            gradient.iter_mut().zip(weight).for_each(|(g, w)| *g = if *w > 0 { *g } else { 0.0 });
                        }
                        let total = sum_with(gradient, gradient, |g, _| g.abs());
                        gradient.iter_mut().for_each(|g| *g = by_value * sign(*g));
                        total
                    },
                )
            })
            .collect();
        (sums.iter().sum::<f64>() / self.area, gradient)
    }
}

/// -1, 0 or 1; 0 for what is not a number.
#[inline(always)]
pub(crate) fn sign(v: f32) -> f32 {
    f32::from(u8::from(v > 0.0)) - f32::from(u8::from(v < 0.0))
}

/// 255 where the square of pixels up to `band` away lies wholly inside or wholly outside the mask, else 0.
fn off_rim(mask: &[u8], width: usize, band: usize) -> Vec<u8> {
    let inside: Vec<u8> = mask.iter().map(|m| u8::from(*m >= 128)).collect();
    let (least, most) = (extreme(&inside, width, band, u8::min), extreme(&inside, width, band, u8::max));
    least.iter().zip(&most).map(|(l, m)| if l == m { 255 } else { 0 }).collect()
}

/// The least or greatest value in the square of pixels up to `band` away.
fn extreme(values: &[u8], width: usize, band: usize, pick: impl Fn(u8, u8) -> u8) -> Vec<u8> {
    let mut along = values.to_vec();
    for (row, out) in values.chunks(width).zip(along.chunks_mut(width)) {
        (1..=band.min(width)).for_each(|d| spread(row, d, out, &pick));
    }
    let mut across = along.clone();
    (1..=band.min(values.len() / width)).for_each(|d| spread(&along, d * width, &mut across, &pick));
    across
}

/// Picks between each value and those `offset` before and after it, as far as there are any.
#[inline(always)]
fn spread(values: &[u8], offset: usize, out: &mut [u8], pick: impl Fn(u8, u8) -> u8) {
    let after = values.get(offset..).unwrap_or_default();
    out.iter_mut().zip(after).for_each(|(o, v)| *o = pick(*o, *v));
    let later = out.get_mut(offset..).unwrap_or_default();
    later.iter_mut().zip(values).for_each(|(o, v)| *o = pick(*o, *v));
}
