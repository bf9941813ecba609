//! What makes surfels a surface (2DGS, Huang et al. 2024, section 4.2): normals that agree with the depth, eq. 14, and
//! little distortion along the ray, eq. 13; and normals given from outside.
//!
//! All frames are the camera's. With the depth d of pixel (x, y) and its ray ρ = ((x - cx)/fx, (y - cy)/fy, 1), the
//! surface point is p = d ρ, and the normal of the depth
//!
//! ```text
//! a = p(x, y+1) - p(x, y-1)    b = p(x+1, y) - p(x-1, y)    c = a × b    n = c / |c|   (faces the camera)
//! ```
//!
//! a and b are taken as (d⁺ - d⁻) ρ + (d⁺ + d⁻) (0, 1/fy, 0) and the like, which keeps the digits that the difference of
//! two far points would lose.

use rayon::prelude::*;

use super::photometric::sign;
use super::{BAND, check_image, check_render, sum, weights};
use crate::{Error, PinholeCamera, Render, RenderGradients, Result};

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
    let (weight, area) = weights(render, target.mask, target.name)?;
    let weight = weight.as_deref();
    let mut loss = SurfaceLoss::default();
    if options.consistency > 0.0 {
        loss.consistency = consistency(render, camera, options, weight, area, &mut loss.gradients);
    }
    if options.distortion > 0.0 {
        let g = (f64::from(options.distortion) / area) as f32;
        loss.gradients.distortion = match weight {
            Some(weight) => weight.iter().map(|w| w * g).collect(),
            None => vec![g; render.distortion.len()],
        };
        let weighted = |(d, g): (&f32, &f32)| f64::from(*d) * f64::from(*g);
        let total: f64 = render.distortion.iter().zip(&loss.gradients.distortion).map(weighted).sum();
        loss.distortion = total / f64::from(options.distortion);
    }
    if let (true, Some(given)) = (options.normals > 0.0, target.normals) {
        loss.normals = given_normals(render, given, options.normals, weight, &mut loss.gradients);
    }
    loss.value = f64::from(options.consistency) * loss.consistency
        + f64::from(options.distortion) * loss.distortion
        + f64::from(options.normals) * loss.normals;
    Ok(loss)
}

/// The depth d of a surface, z in the camera frame, row by row, from the share r of the median depth; 0 where the
/// render is less opaque than `min_alpha`.
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
    let opaque = |alpha: f32| alpha >= min_alpha && alpha > 0.0;
    pulp::Arch::new().dispatch(|| {
        for ((d, depth), alpha) in d.iter_mut().zip(&render.depth).zip(&render.alpha) {
            *d = if opaque(*alpha) { (1.0 - median_share) * depth / alpha } else { 0.0 };
        }
        if median_share > 0.0 {
            for ((d, median), alpha) in d.iter_mut().zip(&render.median_depth).zip(&render.alpha) {
                *d += if opaque(*alpha) { median_share * median } else { 0.0 };
            }
        }
    });
    Ok(d)
}

/// Unit normals of a depth map (z, row by row, 0 where unknown), camera frame, facing the camera; zero at the image's
/// border and where a neighbour's depth is unknown.
///
/// # Errors
/// If the map's size is not the camera's.
pub fn depth_normals(depth: &[f32], camera: &PinholeCamera) -> Result<Vec<[f32; 3]>> {
    let (width, height) = (camera.width, camera.height);
    check_image("a depth map", depth.len(), width, height)?;
    let rays = Rays::new(camera);
    let mut normals = vec![[0.0; 3]; depth.len()];
    inner_rows(&mut normals, width, 1).for_each(|(row, normals)| {
        pulp::Arch::new().dispatch(|| {
            let d = Stencil::new(depth, row, width);
            for x in 1..width - 1 {
                let t = tangents(&d, &rays, x, row);
                normals[x] = t.c.map(|c| c * t.per_length);
            }
        });
    });
    Ok(normals)
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

/// Mean of 1 - N·n alpha; adds its derivative, times its factor, by N, depth, alpha and median depth.
fn consistency(
    render: &Render,
    camera: &PinholeCamera,
    options: &SurfaceOptions,
    weight: Option<&[f32]>,
    area: f64,
    gradients: &mut RenderGradients,
) -> f64 {
    let (width, pixels) = (render.width, render.alpha.len());
    let by_value = (f64::from(options.consistency) / area) as f32;
    let (r, min_alpha) = (options.median_share, options.min_alpha);
    let depth = surface_depth(render, r, min_alpha).unwrap_or_default();
    let rays = Rays::new(camera);
    gradients.normal = vec![[0.0; 3]; pixels];

    // Row by row: what a pixel's normal sends to the depth below, above, right and left of it.
    let mut sent = vec![0.0; 4 * pixels];
    let agreements: Vec<f64> = inner_rows(&mut gradients.normal, width, 1)
        .zip(inner_rows(&mut sent, width, 4))
        .map_init(
            || vec![0.0; width],
            |agreement, ((row, by_normal), (_, sent))| {
                let at = row * width..(row + 1) * width;
                let (normal, alpha) = (&render.normal[at.clone()], &render.alpha[at.clone()]);
                let weight = weight.map(|w| &w[at]);
                pulp::Arch::new().dispatch(|| {
                    let d = Stencil::new(&depth, row, width);
                    agree(&d, &rays, row, normal, alpha, weight, by_value, agreement, by_normal, sent);
                    sum(agreement)
                })
            },
        )
        .collect();

    [gradients.depth, gradients.alpha, gradients.median_depth] = std::array::from_fn(|_| vec![0.0; pixels]);
    let images = gradients.depth.par_chunks_mut(width).zip(gradients.alpha.par_chunks_mut(width));
    let images = images.zip(gradients.median_depth.par_chunks_mut(width));
    images.enumerate().with_min_len(BAND).for_each_init(
        || vec![0.0; width],
        |by_d, (row, ((by_depth, by_alpha), by_median))| {
            let at = row * width..(row + 1) * width;
            let (depth, alpha) = (&render.depth[at.clone()], &render.alpha[at]);
            pulp::Arch::new().dispatch(|| {
                gather(&sent, row, width, by_d);
                for i in 0..width {
                    let (a, g) = (alpha[i], by_d[i]);
                    let opaque = a >= min_alpha;
                    let by_expected = if opaque { (1.0 - r) * g / a } else { 0.0 };
                    by_depth[i] = by_expected;
                    by_alpha[i] = if opaque { -by_expected * depth[i] / a } else { 0.0 };
                    by_median[i] = if opaque { r * g } else { 0.0 };
                }
            });
        },
    );
    1.0 - agreements.iter().sum::<f64>() / area
}

/// A row of w alpha N·n, of the derivative by N, and of what goes to the neighbours' depths.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "a row of each of the images of the formula")]
fn agree(
    d: &Stencil<'_>,
    rays: &Rays,
    row: usize,
    normal: &[[f32; 3]],
    alpha: &[f32],
    weight: Option<&[f32]>,
    by_value: f32,
    agreement: &mut [f32],
    by_normal: &mut [[f32; 3]],
    sent: &mut [f32],
) {
    let width = agreement.len();
    let (below, rest) = sent.split_at_mut(width);
    let (above, rest) = rest.split_at_mut(width);
    let (right, left) = rest.split_at_mut(width);
    let (left, normal, alpha) = (&mut left[..width], &normal[..width], &alpha[..width]);
    let by_normal = &mut by_normal[..width];
    // The weight of a pixel's alpha first, so that the long loop below has no branch.
    agreement.copy_from_slice(alpha);
    agreement.iter_mut().zip(weight.unwrap_or_default()).for_each(|(a, w)| *a *= w);
    (agreement[0], agreement[width - 1]) = (0.0, 0.0);
    for x in 1..width - 1 {
        let t = tangents(d, rays, x, row);
        let (big_n, n) = (normal[x], t.c.map(|c| c * t.per_length));
        let w = agreement[x];
        agreement[x] = w * dot(big_n, n);
        by_normal[x] = n.map(|n| -by_value * w * n);
        // Through the normalisation, then through the cross product.
        let by_n = big_n.map(|v| -by_value * w * v);
        let along = dot(n, by_n);
        let by_c: [f32; 3] = std::array::from_fn(|k| t.per_length * (by_n[k] - along * n[k]));
        let (by_a, by_b) = (cross(t.b, by_c), cross(by_c, t.a));
        let ray = [rays.x[x], rays.y[row], 1.0];
        let (along_a, along_b) = (dot(ray, by_a), dot(ray, by_b));
        below[x] = rays.per_fy * by_a[1] + along_a;
        above[x] = rays.per_fy * by_a[1] - along_a;
        right[x] = rays.per_fx * by_b[0] + along_b;
        left[x] = rays.per_fx * by_b[0] - along_b;
    }
}

/// A row of the derivative by d: what the four neighbours send here.
#[inline(always)]
fn gather(sent: &[f32], row: usize, width: usize, by_d: &mut [f32]) {
    // Nothing comes from outside the image: the part is empty there.
    let part = |row: Option<usize>, k: usize| {
        let start = row.map_or(sent.len(), |row| ((4 * row + k) * width).min(sent.len()));
        &sent[start..(start + width).min(sent.len())]
    };
    by_d.fill(0.0);
    by_d.iter_mut().zip(part(row.checked_sub(1), 0)).for_each(|(g, s)| *g += s);
    by_d.iter_mut().zip(part(Some(row + 1), 1)).for_each(|(g, s)| *g += s);
    by_d[1..].iter_mut().zip(part(Some(row), 2)).for_each(|(g, s)| *g += s);
    by_d.iter_mut().zip(&part(Some(row), 3)[1..]).for_each(|(g, s)| *g += s);
}

/// Mean of 1 - N·m + |N - m|₁ where m is given; adds its derivative by N times `factor`.
fn given_normals(
    render: &Render,
    given: &[[f32; 3]],
    factor: f32,
    weight: Option<&[f32]>,
    gradients: &mut RenderGradients,
) -> f64 {
    let known = |i: usize| given[i].iter().any(|m| *m != 0.0) && given[i].iter().all(|m| m.is_finite());
    let weight_at = |i: usize| if known(i) { weight.map_or(1.0, |w| w[i]) } else { 0.0 };
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

/// The rays of the pixels' centres.
struct Rays {
    /// (x - cx) / fx of every column.
    x: Vec<f32>,
    /// (y - cy) / fy of every row.
    y: Vec<f32>,
    per_fx: f32,
    per_fy: f32,
}

impl Rays {
    fn new(camera: &PinholeCamera) -> Self {
        Self {
            x: (0..camera.width).map(|x| ((x as f64 + 0.5 - camera.cx) / camera.fx) as f32).collect(),
            y: (0..camera.height).map(|y| ((y as f64 + 0.5 - camera.cy) / camera.fy) as f32).collect(),
            per_fx: (1.0 / camera.fx) as f32,
            per_fy: (1.0 / camera.fy) as f32,
        }
    }
}

/// Three rows of a depth map.
struct Stencil<'a> {
    above: &'a [f32],
    here: &'a [f32],
    below: &'a [f32],
}

impl<'a> Stencil<'a> {
    /// `row` has a row above and one below.
    #[inline(always)]
    fn new(depth: &'a [f32], row: usize, width: usize) -> Self {
        let at = |row: usize| &depth[row * width..(row + 1) * width];
        Self { above: at(row - 1), here: at(row), below: at(row + 1) }
    }
}

/// The differences a and b of surface points, their cross product, and 1 / its length: 0 where there is no normal.
struct Tangents {
    a: [f32; 3],
    b: [f32; 3],
    c: [f32; 3],
    per_length: f32,
}

#[inline(always)]
fn tangents(d: &Stencil<'_>, rays: &Rays, x: usize, row: usize) -> Tangents {
    let (below, above, right, left) = (d.below[x], d.above[x], d.here[x + 1], d.here[x - 1]);
    let (rx, ry) = (rays.x[x], rays.y[row]);
    let (da, db) = (below - above, right - left);
    let a = [da * rx, da * ry + (below + above) * rays.per_fy, da];
    let b = [db * rx + (right + left) * rays.per_fx, db * ry, db];
    let c = cross(a, b);
    let squared = dot(c, c);
    let known = (below > 0.0) & (above > 0.0) & (right > 0.0) & (left > 0.0) & (d.here[x] > 0.0) & (squared > 0.0);
    Tangents { a, b, c, per_length: if known { 1.0 / squared.sqrt() } else { 0.0 } }
}

#[inline(always)]
fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The rows of an image (`stride` values a pixel) that have a row above and one below, with their numbers; none where
/// the image is narrower than three pixels.
fn inner_rows<T: Send>(
    image: &mut [T],
    width: usize,
    stride: usize,
) -> impl IndexedParallelIterator<Item = (usize, &mut [T])> {
    let height = if width < 3 { 0 } else { image.len() / (width * stride) };
    let inner = if height < 3 { &mut [] } else { &mut image[stride * width..(height - 1) * stride * width] };
    inner.par_chunks_mut(stride * width).enumerate().map(|(i, row)| (i + 1, row)).with_min_len(BAND)
}
