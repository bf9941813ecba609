//! What makes surfels a surface (2DGS, Huang et al. 2024, section 4.2): normals that agree with the depth, eq. 14, and
//! little distortion along the ray, eq. 13; and normals given from outside.

use drex_core::camera::PinholeCamera;

use super::consistency::Consistency;
use super::normals::dot;
use super::photometric::sign;
use super::{area_that_counts, check_image, check_render, sum_with, unit};
use crate::{Error, Render, RenderGradients, Result};

/// What a render is compared with; nothing is needed.
#[derive(Debug, Clone, Copy, Default)]
pub struct SurfaceTarget<'a> {
    /// The photo's name, for messages.
    pub name: &'a str,
    /// 255 on the object, 0 elsewhere: restricts all terms, and they are means over its area.
    pub mask: Option<&'a [u8]>,
    /// Unit normals of the surface, camera frame, facing the camera; zero where unknown. From a normal estimator.
    pub normals: Option<&'a [[f32; 3]]>,
}

/// Factors of the terms.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceOptions {
    /// Of mean(1 - N·n alpha), N the rendered normal, n that of the depth. 0.05 in the paper.
    pub consistency: f32,
    /// Of mean(distortion). 1000 in the paper for bounded scenes, 100 for unbounded ones.
    pub distortion: f32,
    /// Of mean(1 - N·m + |N - m|₁), m the normals given.
    pub normals: f32,
    /// Share r of the median depth in d = (1 - r) depth / alpha + r median: 1 for an object, 0 for a whole scene.
    pub median_share: f32,
    /// Where the render is less opaque it has no surface: the depth there gives no normal.
    pub min_alpha: f32,
}

impl Default for SurfaceOptions {
    fn default() -> Self {
        Self { consistency: 0.05, distortion: 1000.0, normals: 0.05, median_share: 1.0, min_alpha: 0.05 }
    }
}

/// A loss, its terms and its derivative.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SurfaceLoss {
    /// Sum of the terms times their factors.
    pub value: f64,
    /// Mean of 1 - N·n alpha; pixels without a normal of the depth count as 1.
    pub consistency: f64,
    /// Mean distortion.
    pub distortion: f64,
    /// Mean of 1 - N·m + |N - m|₁ over the pixels with a given normal; 0 where none is given.
    pub normals: f64,
    /// Derivative of `value` by `normal`, `depth`, `alpha`, `median_depth` and `distortion`. The factor alpha of n is
    /// held constant, as in the paper's code: else the render would fade out rather than turn.
    pub gradients: RenderGradients,
}

/// The surface losses of a render of surfels with `geometry`.
///
/// # Errors
/// If sizes differ (a render without geometry has empty images), an option is out of range, or the mask is zero
/// everywhere.
pub fn surface(
    render: &Render,
    camera: &PinholeCamera,
    target: &SurfaceTarget<'_>,
    options: &SurfaceOptions,
) -> Result<SurfaceLoss> {
    check(render, camera, target, options)?;
    let area = area_that_counts(render, target.mask, target.name)?;
    let mut loss = SurfaceLoss::default();
    if options.consistency > 0.0 {
        let (factor, r, min_alpha) = (options.consistency, options.median_share, options.min_alpha);
        let consistency = Consistency { render, camera, mask: target.mask, area, factor, r, min_alpha };
        loss.consistency = consistency.evaluate(&mut loss.gradients);
    }
    if options.distortion > 0.0 {
        let g = (f64::from(options.distortion) / area) as f32;
        loss.gradients.distortion = match target.mask {
            Some(mask) => mask.iter().map(|m| unit(*m) * g).collect(),
            None => vec![g; render.distortion.len()],
        };
        let total = sum_with(&render.distortion, &loss.gradients.distortion, |d, g| d * g);
        loss.distortion = total / f64::from(options.distortion);
    }
    if let (true, Some(given)) = (options.normals > 0.0, target.normals) {
        loss.normals = given_normals(render, given, target.mask, options.normals, &mut loss.gradients);
    }
    loss.value = f64::from(options.consistency) * loss.consistency
        + f64::from(options.distortion) * loss.distortion
        + f64::from(options.normals) * loss.normals;
    Ok(loss)
}

fn check(render: &Render, camera: &PinholeCamera, target: &SurfaceTarget<'_>, options: &SurfaceOptions) -> Result<()> {
    camera.check()?;
    check_image("the camera's image of a render", render.alpha.len(), camera.width, camera.height)?;
    check_render(render, "the opacity of a render", render.alpha.len())?;
    check_render(render, "the depth of a render", render.depth.len())?;
    check_render(render, "the normals of a render", render.normal.len())?;
    check_render(render, "the median depth of a render", render.median_depth.len())?;
    check_render(render, "the distortion of a render", render.distortion.len())?;
    if let Some(normals) = target.normals {
        check_render(render, &format!("the normals given for {}", target.name), normals.len())?;
    }
    let factors = [options.consistency, options.distortion, options.normals];
    if factors.iter().any(|f| !(*f >= 0.0 && f.is_finite()))
        || !(0.0..=1.0).contains(&options.median_share)
        || !(options.min_alpha > 0.0)
    {
        return Err(Error::Option {
            what: format!("a surface loss has {options:?}"),
            remedy: "give factors of at least 0, a share of the median from 0 to 1, and a least opacity above 0".into(),
        });
    }
    Ok(())
}

/// Mean of 1 - N·m + |N - m|₁ where m is given; adds its derivative by N times `factor`.
fn given_normals(
    render: &Render,
    given: &[[f32; 3]],
    mask: Option<&[u8]>,
    factor: f32,
    gradients: &mut RenderGradients,
) -> f64 {
    let known = |i: usize| given[i].iter().any(|m| *m != 0.0) && given[i].iter().all(|m| m.is_finite());
    let weight_at = |i: usize| if known(i) { mask.map_or(1.0, |mask| unit(mask[i])) } else { 0.0 };
    let area: f64 = (0..given.len()).map(|i| f64::from(weight_at(i))).sum();
    if area == 0.0 {
        return 0.0;
    }
    gradients.normal.resize(given.len(), [0.0; 3]);
    let mut total = 0.0;
    for (i, (n, m)) in render.normal.iter().zip(given).enumerate() {
        let w = weight_at(i);
        if w > 0.0 {
            let l1: f32 = (0..3).map(|k| (n[k] - m[k]).abs()).sum();
            total += f64::from(w) * f64::from(1.0 - dot(*n, *m) + l1);
            let g = (f64::from(factor) * f64::from(w) / area) as f32;
            (0..3).for_each(|k| gradients.normal[i][k] += g * (sign(n[k] - m[k]) - m[k]));
        }
    }
    total / area
}
