//! Depth given from outside: a map of an RGB-D camera or a depth estimator, or the points of a sparse model.

use super::photometric::sign;
use rayon::prelude::*;

use super::{area_that_counts, check_image, check_render, strip_rows, sum, unit};
use crate::{Error, Render, RenderGradients, Result};

/// Which depth of a render is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthSource {
    /// The mean along the ray, `depth / alpha`.
    #[default]
    Expected,
    /// The depth where the transmittance falls to one half. Surfels only.
    Median,
}

/// The depth of one pixel.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SparseDepth {
    /// Where in the image, pixels; the centre of the first pixel is (0.5, 0.5). Points outside do not count.
    pub pixel: [f32; 2],
    /// z in the camera frame, scene units.
    pub depth: f32,
}

/// Depths to compare with; both kinds may be given.
#[derive(Debug, Clone, Copy, Default)]
pub struct DepthTarget<'a> {
    /// The photo's name, for messages.
    pub name: &'a str,
    /// z of every pixel, row by row, scene units; unknown where it is not finite or not positive.
    pub dense: Option<&'a [f32]>,
    /// z of some pixels.
    pub sparse: &'a [SparseDepth],
    /// Restricts the dense depths; values between 0 and 255 are weights.
    pub mask: Option<&'a [u8]>,
}

/// How depth is compared.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthOptions {
    /// Factor of the loss.
    pub weight: f32,
    /// Which depth of the render.
    pub source: DepthSource,
    /// Where the render is less opaque it has no depth, and nothing is said about it.
    pub min_alpha: f32,
}

impl Default for DepthOptions {
    fn default() -> Self {
        Self { weight: 1.0, source: DepthSource::Expected, min_alpha: 0.05 }
    }
}

/// A loss, its part and its derivative.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DepthLoss {
    /// Weight times `l1`.
    pub value: f64,
    /// Mean |depth - given depth| over the pixels where both are known, scene units; 0 where there are none.
    pub l1: f64,
    /// Number (or sum of weights) of those pixels.
    pub count: f64,
    /// Derivative of `value` by `depth` and `alpha`, or by `median_depth`.
    pub gradients: RenderGradients,
}

/// Compares the depth of `render` with `target`.
///
/// # Errors
/// If sizes differ, an option is out of range, the mask is zero everywhere, or the render has no median depth.
pub fn depth(render: &Render, target: &DepthTarget<'_>, options: &DepthOptions) -> Result<DepthLoss> {
    check(render, target, options)?;
    let mut weight = dense_weights(render, target, options)?;
    let sparse = sparse_pixels(render, target.sparse, options);
    let count = sum(&weight) + sparse.len() as f64;
    if count == 0.0 {
        return Ok(DepthLoss::default());
    }

    let mut loss = DepthLoss { count, ..Default::default() };
    let per_value = (f64::from(options.weight) / count) as f32;
    let ours = |i: usize| match options.source {
        DepthSource::Expected => render.depth[i] / render.alpha[i],
        DepthSource::Median => render.median_depth[i],
    };
    // From here on `weight` becomes the derivative by our depth.
    let rows = strip_rows(render.height) * render.width;
    let strips = weight.par_chunks_mut(rows).zip(target.dense.unwrap_or_default().par_chunks(rows)).enumerate();
    let sums: Vec<f64> = strips
        .map(|(k, (weight, given))| {
            let mut total = 0.0;
            for (i, (w, z)) in weight.iter_mut().zip(given).enumerate().filter(|(_, (w, _))| **w > 0.0) {
                let off = ours(k * rows + i) - z;
                total += f64::from(*w) * f64::from(off.abs());
                *w *= per_value * sign(off);
            }
            total
        })
        .collect();
    let mut total: f64 = sums.iter().sum();
    for (i, z) in sparse {
        let off = ours(i) - z;
        total += f64::from(off.abs());
        weight[i] += per_value * sign(off);
    }
    loss.l1 = total / count;
    loss.value = f64::from(options.weight) * loss.l1;
    match options.source {
        DepthSource::Expected => {
            let by = |g: f32, value: f32, alpha: f32| if g == 0.0 { 0.0 } else { g * value / alpha };
            let pixels = weight.iter().zip(&render.depth).zip(&render.alpha);
            loss.gradients.alpha = pixels.map(|((g, depth), alpha)| by(*g, -depth / alpha, *alpha)).collect();
            loss.gradients.depth = weight.iter().zip(&render.alpha).map(|(g, alpha)| by(*g, 1.0, *alpha)).collect();
        }
        DepthSource::Median => loss.gradients.median_depth = weight,
    }
    Ok(loss)
}

fn check(render: &Render, target: &DepthTarget<'_>, options: &DepthOptions) -> Result<()> {
    check_render(render, "the opacity of a render", render.alpha.len())?;
    match options.source {
        DepthSource::Expected => check_render(render, "the depth of a render", render.depth.len())?,
        DepthSource::Median => check_render(render, "the median depth of a render", render.median_depth.len())?,
    }
    let dense = target.dense.map_or(render.alpha.len(), <[f32]>::len);
    check_image(&format!("the depth map of {}", target.name), dense, render.width, render.height)?;
    if !(options.weight >= 0.0 && options.weight.is_finite() && options.min_alpha > 0.0) {
        return Err(Error::Option {
            what: format!("the weight of a depth loss is {}, its least opacity {}", options.weight, options.min_alpha),
            remedy: "give a weight of at least 0 and an opacity above 0".into(),
        });
    }
    Ok(())
}

/// Weight of every pixel: that of the mask where both depths are known, else 0.
fn dense_weights(render: &Render, target: &DepthTarget<'_>, options: &DepthOptions) -> Result<Vec<f32>> {
    let Some(dense) = target.dense else {
        return Ok(vec![0.0; render.alpha.len()]);
    };
    area_that_counts(render, target.mask, target.name)?; // refuses what is wrong with the mask
    let known = |(z, alpha): (&f32, &f32)| f32::from(u8::from(is_depth(*z) & (*alpha >= options.min_alpha)));
    let mut weight: Vec<f32> = dense.iter().zip(&render.alpha).map(known).collect();
    weight.iter_mut().zip(target.mask.unwrap_or_default()).for_each(|(w, m)| *w *= unit(*m));
    Ok(weight)
}

/// Index and depth of the pixels that sparse points fall in and that the render covers.
fn sparse_pixels(render: &Render, sparse: &[SparseDepth], options: &DepthOptions) -> Vec<(usize, f32)> {
    let inside = |p: &&SparseDepth| {
        (0.0..render.width as f32).contains(&p.pixel[0]) && (0.0..render.height as f32).contains(&p.pixel[1])
    };
    let index = |p: &SparseDepth| p.pixel[1] as usize * render.width + p.pixel[0] as usize;
    let pixels = sparse.iter().filter(inside).map(|p| (index(p), p.depth));
    pixels.filter(|(i, z)| is_depth(*z) && render.alpha[*i] >= options.min_alpha).collect()
}

fn is_depth(z: f32) -> bool {
    (z > 0.0) & (z < f32::INFINITY)
}
