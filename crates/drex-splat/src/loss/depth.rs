//! Depth given from outside: a map of an RGB-D camera or a depth estimator, or the points of a sparse model.

use super::photometric::sign;
use super::{check_image, check_render, weights};
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
    let mut known = sparse_pixels(render, target.sparse);
    if let Some(dense) = target.dense {
        let weight = weights(render, target.mask, target.name)?.0;
        let weight = |i: usize| weight.as_ref().map_or(1.0, |w| w[i]);
        known.extend(dense.iter().enumerate().map(|(i, z)| (i, *z, weight(i))).filter(|(_, _, w)| *w > 0.0));
    }
    known.retain(|(i, z, _)| z.is_finite() && *z > 0.0 && render.alpha[*i] >= options.min_alpha);
    let count: f64 = known.iter().map(|(_, _, w)| f64::from(*w)).sum();
    if count == 0.0 {
        return Ok(DepthLoss::default());
    }

    let per_value = (f64::from(options.weight) / count) as f32;
    let pixels = render.alpha.len();
    let mut loss = DepthLoss { count, ..Default::default() };
    let gradients = &mut loss.gradients;
    match options.source {
        DepthSource::Expected => (gradients.depth, gradients.alpha) = (vec![0.0; pixels], vec![0.0; pixels]),
        DepthSource::Median => gradients.median_depth = vec![0.0; pixels],
    }
    for (i, z, w) in known {
        let alpha = render.alpha[i];
        let ours = match options.source {
            DepthSource::Expected => render.depth[i] / alpha,
            DepthSource::Median => render.median_depth[i],
        };
        loss.l1 += f64::from(w) * f64::from((ours - z).abs()) / count;
        let g = per_value * w * sign(ours - z);
        match options.source {
            DepthSource::Expected => {
                gradients.depth[i] += g / alpha;
                gradients.alpha[i] -= g * ours / alpha;
            }
            DepthSource::Median => gradients.median_depth[i] += g,
        }
    }
    loss.value = f64::from(options.weight) * loss.l1;
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

/// Index, depth and weight of the pixels that sparse points fall in.
fn sparse_pixels(render: &Render, sparse: &[SparseDepth]) -> Vec<(usize, f32, f32)> {
    let inside = |p: &&SparseDepth| {
        (0.0..render.width as f32).contains(&p.pixel[0]) && (0.0..render.height as f32).contains(&p.pixel[1])
    };
    let index = |p: &SparseDepth| p.pixel[1] as usize * render.width + p.pixel[0] as usize;
    sparse.iter().filter(inside).map(|p| (index(p), p.depth, 1.0)).collect()
}
