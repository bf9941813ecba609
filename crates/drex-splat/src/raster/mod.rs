//! Drawing Gaussians, and the derivative of a picture by them.
//!
//! [`Rasterizer`] has two halves: `forward` draws, `backward` takes the derivative of a loss by every pixel and gives it
//! by every parameter of every Gaussian, analytically. Backends share this file's types and nothing else.

mod cpu;
#[cfg(feature = "wgpu")]
mod gpu;
mod tiles;

pub use cpu::{Cpu, CpuSaved};
#[cfg(feature = "wgpu")]
pub use gpu::{Gpu, GpuSaved};
pub(crate) use tiles::{ScreenBox, TILE, Tiles};

use drex_core::camera::PinholeCamera;

use crate::{Gaussians, Result};

/// How a scene is drawn. The defaults are those of the papers.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RenderOptions {
    /// Colour behind everything, linear in the photos' values, 0 to 1.
    pub background: [f32; 3],
    /// Degree of the spherical harmonics used; a set of a lower degree is drawn with its own.
    pub sh_degree: usize,
    /// Splats whose centre is nearer than this are not drawn, scene units; nor are the pixels that meet a surfel nearer.
    pub near: f32,
    /// Opacity of one splat in one pixel stays below this; above, its derivative is zero.
    pub max_alpha: f32,
    /// Variance added to an ellipsoid's footprint along both axes, px² (EWA filter).
    pub blur: f32,
    /// Whether opacity is scaled by √(det Σ / det(Σ + blur)), so that the filter does not thicken small splats
    /// (Mip-Splatting). Ellipsoids only.
    pub antialias: bool,
    /// Squared distance (in standard deviations) of the box whose centre carries a surfel's screen-space floor: 9 in the
    /// 2DGS paper's code, 1 in gsplat's.
    pub centre_cutoff: f32,
    /// What a splat's depth is.
    pub depth: DepthKind,
    /// Whether surfels give normals, distortion and median depth too.
    pub geometry: bool,
    /// Near and far depth that the distortion's mapping m = far / (far - near) (1 - near / z) uses, scene units.
    pub distortion_range: [f32; 2],
    /// Fade a splat out between opacity 1.5/255 and 0.5/255 instead of cutting it at 1/255, so that finite differences
    /// hold. For tests.
    pub smooth_cutoff: bool,
    /// Whether [`Render::count`] is filled.
    pub count: bool,
}

/// What the depth of a splat at a pixel is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DepthKind {
    /// z of its centre.
    Centre,
    /// z where the pixel's ray meets the surfel; for ellipsoids the same as `Centre`.
    Ray,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            background: [0.0; 3],
            sh_degree: 3,
            near: 0.01,
            max_alpha: 0.999,
            blur: 0.3,
            antialias: false,
            centre_cutoff: 9.0,
            depth: DepthKind::Ray,
            geometry: true,
            distortion_range: [0.2, 100.0],
            smooth_cutoff: false,
            count: false,
        }
    }
}

/// Opacity under which a splat does not touch a pixel.
pub const MIN_ALPHA: f32 = 1.0 / 255.0;
/// A pixel stops before the splat that takes its transmittance to this or below.
pub const MIN_TRANSMITTANCE: f32 = 1e-4;

/// Images of one view, row by row from the upper left. w = T α is the weight of a splat in a pixel.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Render {
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Red, green, blue: Σ w c + (1 - alpha) background.
    pub rgb: Vec<[f32; 3]>,
    /// Σ w.
    pub alpha: Vec<f32>,
    /// Σ w z: divide by alpha for the expected depth.
    pub depth: Vec<f32>,
    /// Σ w n, camera frame, each normal facing the camera. Surfels with `geometry` only, else empty.
    pub normal: Vec<[f32; 3]>,
    /// z of the last splat met with T > 0.5, 0 where there is none. Surfels with `geometry` only, else empty.
    pub median_depth: Vec<f32>,
    /// Σ_{i<j} w_i w_j (m_i - m_j)² (2DGS, eq. 13). Surfels with `geometry` only, else empty.
    pub distortion: Vec<f32>,
    /// Splats that touch the pixel. With [`RenderOptions::count`] only, else empty.
    pub count: Vec<u32>,
}

/// Derivative of a loss by the images of [`Render`]. An empty vector is zero everywhere.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RenderGradients {
    /// By `rgb`.
    pub rgb: Vec<[f32; 3]>,
    /// By `alpha`.
    pub alpha: Vec<f32>,
    /// By `depth` (the sum, not the quotient).
    pub depth: Vec<f32>,
    /// By `normal`.
    pub normal: Vec<[f32; 3]>,
    /// By `median_depth`: goes to the one splat that gave it.
    pub median_depth: Vec<f32>,
    /// By `distortion`.
    pub distortion: Vec<f32>,
}

/// Derivative of a loss by the parameters of a set, one entry a Gaussian, and what densification asks for.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GaussianGradients {
    /// By the centres.
    pub means: Vec<[f32; 3]>,
    /// By the quaternions as they are stored, through their normalisation.
    pub rotations: Vec<[f32; 4]>,
    /// By the logarithms of the scales.
    pub log_scales: Vec<[f32; 3]>,
    /// By the logits of the opacities.
    pub logit_opacities: Vec<f32>,
    /// By the coefficients of the spherical harmonics, laid out as [`Gaussians::sh`]; unused degrees are zero.
    pub sh: Vec<f32>,
    /// By the projected centre with the shape held fixed, pixels (ellipsoids); for surfels the same with the whole
    /// splat moved in the image.
    pub mean2d: Vec<[f32; 2]>,
    /// As `mean2d`, with absolute values taken per pixel before summing (AbsGS).
    pub abs_mean2d: Vec<[f32; 2]>,
    /// Radius in the image (three standard deviations along the longest axis), pixels; 0 where the splat is not drawn.
    pub radius: Vec<f32>,
    /// By a small motion of the camera, (ρ, φ): camera_from_world' = exp((ρ, φ)^) camera_from_world.
    pub twist: [f64; 6],
}

/// A backend that draws and differentiates.
pub trait Rasterizer {
    /// What `forward` keeps for `backward`.
    type Saved;

    /// Draws `scene` as `camera` sees it.
    ///
    /// # Errors
    /// If the camera or an option is out of range, or the set is inconsistent; degenerate Gaussians are skipped.
    fn forward(
        &self,
        scene: &Gaussians,
        camera: &PinholeCamera,
        options: &RenderOptions,
    ) -> Result<(Render, Self::Saved)>;

    /// The derivative of a loss by every parameter, from its derivative by every pixel.
    ///
    /// `scene`, `camera` and `options` are those of the `forward` that gave `render` and `saved`.
    ///
    /// # Errors
    /// If a gradient image has another size than the render.
    fn backward(
        &self,
        scene: &Gaussians,
        camera: &PinholeCamera,
        options: &RenderOptions,
        render: &Render,
        saved: &Self::Saved,
        gradients: &RenderGradients,
    ) -> Result<GaussianGradients>;
}
