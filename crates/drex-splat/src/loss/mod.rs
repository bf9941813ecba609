//! What training makes small, each loss with its analytic derivative by the images of a [`Render`].
//!
//! | module | loss |
//! |---|---|
//! | [`photometric`](mod@photometric) | L1 and SSIM against a photo, object masks, opacity against the mask |
//! | [`exposure`] | an affine map of the colours, one a photo |
//! | [`surface`](mod@surface) | normals that agree with depth, distortion, normals given from outside |
//! | [`depth`](mod@depth) | depth given from outside, dense or sparse |
//!
//! All sums are taken row by row and then over the rows in their order, so that a loss has the same value and the same
//! derivative, to the last bit, with any number of threads.

mod consistency;
pub mod depth;
pub mod exposure;
mod normals;
pub mod photometric;
pub mod ssim;
pub mod surface;

pub use consistency::surface_depth;
pub use depth::{DepthLoss, DepthOptions, DepthSource, DepthTarget, SparseDepth, depth};
pub use exposure::Exposure;
pub use normals::depth_normals;
pub use photometric::{MaskMode, PhotometricLoss, PhotometricOptions, Target, photometric};
pub use ssim::{ssim, ssim_map, ssim_with_gradient};
pub use surface::{SurfaceLoss, SurfaceOptions, SurfaceTarget, surface};

use crate::{Error, Render, RenderGradients, Result};

/// Rows that one task of a parallel loop does: about 90, in an even number of strips; it does not depend on the number of
/// threads.
pub(crate) fn strip_rows(height: usize) -> usize {
    height.div_ceil(2 * height.div_ceil(180).max(1)).max(1)
}

impl RenderGradients {
    /// Adds `other`, the derivative of another loss by the same images. An empty vector counts as zeros.
    pub fn add(&mut self, other: Self) {
        add(&mut self.rgb, other.rgb, |a, b| (0..3).for_each(|k| a[k] += b[k]));
        add(&mut self.alpha, other.alpha, |a, b| *a += b);
        add(&mut self.depth, other.depth, |a, b| *a += b);
        add(&mut self.normal, other.normal, |a, b| (0..3).for_each(|k| a[k] += b[k]));
        add(&mut self.median_depth, other.median_depth, |a, b| *a += b);
        add(&mut self.distortion, other.distortion, |a, b| *a += b);
    }
}

fn add<T: Copy>(ours: &mut Vec<T>, theirs: Vec<T>, plus: impl Fn(&mut T, T)) {
    if ours.is_empty() {
        *ours = theirs;
    } else {
        ours.iter_mut().zip(theirs).for_each(|(a, b)| plus(a, b));
    }
}

/// Σ of a row, in double precision and in an order that vectorises.
#[inline(always)]
pub(crate) fn sum(row: &[f32]) -> f64 {
    sum_with(row, row, |v, _| v)
}

/// Σ of a function of two rows of the same length, as [`sum`].
#[inline(always)]
pub(crate) fn sum_with(a: &[f32], b: &[f32], of: impl Fn(f32, f32) -> f32) -> f64 {
    const LANES: usize = 16;
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut lanes = [0.0_f64; LANES];
    for (a, b) in a.iter().zip(b) {
        for k in 0..LANES {
            lanes[k] += f64::from(of(a[k], b[k]));
        }
    }
    lanes.iter().sum::<f64>() + a_rest.iter().zip(b_rest).map(|(a, b)| f64::from(of(*a, *b))).sum::<f64>()
}

/// Refuses an image without pixels, and `entries` (of what `name` says) that are not one a pixel.
pub(crate) fn check_image(name: &str, entries: usize, width: usize, height: usize) -> Result<()> {
    if width.checked_mul(height) == Some(entries) && entries > 0 {
        return Ok(());
    }
    Err(Error::Option {
        what: format!("{name}: {entries} entries for an image of {width} x {height} pixels"),
        remedy: "give one entry a pixel, and at least one pixel".into(),
    })
}

/// As [`check_image`] for the images of a render.
pub(crate) fn check_render(render: &Render, name: &str, entries: usize) -> Result<()> {
    check_image(name, entries, render.width, render.height)
}

/// Σ of the mask's weights; the number of pixels without a mask.
///
/// # Errors
/// If the mask has another size than the render, or no pixel of it is set; `name` is the photo's.
pub(crate) fn area_that_counts(render: &Render, mask: Option<&[u8]>, name: &str) -> Result<f64> {
    let Some(mask) = mask else {
        return Ok((render.width * render.height) as f64);
    };
    check_render(render, &format!("the mask of {name}"), mask.len())?;
    match area(mask) {
        0.0 => Err(empty_mask(name, "the mask is zero everywhere")),
        area => Ok(area),
    }
}

/// Σ of a mask's weights: whole numbers, exact in any order.
pub(crate) fn area(mask: &[u8]) -> f64 {
    mask.iter().map(|m| u64::from(*m)).sum::<u64>() as f64 / 255.0
}

pub(crate) fn empty_mask(name: &str, why: &str) -> Error {
    drex_core::Error::capture(
        format!("no pixel of {name} counts: {why}"),
        "give a mask that is above zero on the object, or leave this photo out",
    )
    .into()
}

/// A byte of a photo or a mask as a number from 0 to 1.
#[inline(always)]
pub(crate) fn unit(byte: u8) -> f32 {
    f32::from(byte) / 255.0
}
