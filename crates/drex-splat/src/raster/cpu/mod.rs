//! Drawing on the processor: SIMD within a tile, threads over tiles, every sum in a fixed order.

mod ellipsoid;
pub(crate) mod lanes;
pub(crate) mod sh;
mod surfel;

use drex_core::camera::PinholeCamera;

use super::{GaussianGradients, Rasterizer, Render, RenderGradients, RenderOptions};
use crate::{Error, Gaussians, Kind, Result};

/// The backend that needs nothing but a processor. Uses the current rayon pool; the bytes of its results do not depend
/// on the number of threads.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cpu;

/// What [`Cpu`] keeps from `forward` for `backward`.
#[derive(Debug, Clone)]
pub struct CpuSaved {
    kept: Kept,
    /// Gaussians, image width and height: `backward` has to be given the same.
    shape: [usize; 3],
}

#[derive(Debug, Clone)]
enum Kept {
    Ellipsoids(ellipsoid::Saved),
    Surfels(surfel::Saved),
}

impl Rasterizer for Cpu {
    type Saved = CpuSaved;

    fn forward(
        &self,
        scene: &Gaussians,
        camera: &PinholeCamera,
        options: &RenderOptions,
    ) -> Result<(Render, CpuSaved)> {
        scene.check()?;
        camera.check()?;
        check_options(options)?;
        let (render, kept) = match scene.kind {
            Kind::Ellipsoid => {
                let (render, saved) = ellipsoid::forward(scene, camera, options)?;
                (render, Kept::Ellipsoids(saved))
            }
            Kind::Surfel => {
                let (render, saved) = surfel::forward(scene, camera, options)?;
                (render, Kept::Surfels(saved))
            }
        };
        Ok((render, CpuSaved { kept, shape: [scene.len(), camera.width, camera.height] }))
    }

    fn backward(
        &self,
        scene: &Gaussians,
        camera: &PinholeCamera,
        options: &RenderOptions,
        render: &Render,
        saved: &CpuSaved,
        gradients: &RenderGradients,
    ) -> Result<GaussianGradients> {
        scene.check()?;
        check_shape(saved.shape, [scene.len(), camera.width, camera.height])?;
        check_shape(saved.shape, [scene.len(), render.width, render.height])?;
        check_gradients(render, gradients)?;
        match &saved.kept {
            Kept::Ellipsoids(saved) => ellipsoid::backward(scene, camera, options, saved, gradients),
            Kept::Surfels(saved) => surfel::backward(scene, camera, options, render, saved, gradients),
        }
    }
}

pub(super) fn check_options(options: &RenderOptions) -> Result<()> {
    let wrong = |what: String, remedy: &str| Err(Error::Option { what, remedy: remedy.into() });
    if !options.background.iter().all(|c| c.is_finite()) {
        return wrong(format!("background {:?}", options.background), "give finite numbers");
    }
    if !(options.max_alpha > super::MIN_ALPHA && options.max_alpha < 1.0) {
        return wrong(format!("max_alpha {}", options.max_alpha), "give a number between 1/255 and 1, such as 0.999");
    }
    if !(options.near > 0.0 && options.near.is_finite()) {
        return wrong(format!("near {}", options.near), "give a positive depth in scene units");
    }
    if !(options.blur >= 0.0 && options.blur.is_finite()) {
        return wrong(format!("blur {}", options.blur), "give a variance in px², such as 0.3");
    }
    if !(options.centre_cutoff > 0.0 && options.centre_cutoff.is_finite()) {
        return wrong(format!("centre_cutoff {}", options.centre_cutoff), "give 1 or 9");
    }
    let [near, far] = options.distortion_range;
    if !(near > 0.0 && far > near && far.is_finite()) {
        return wrong(format!("distortion_range {near} to {far}"), "give two positive depths, the nearer first");
    }
    Ok(())
}

pub(super) fn check_shape(forward: [usize; 3], backward: [usize; 3]) -> Result<()> {
    if forward == backward {
        return Ok(());
    }
    let name = |[n, width, height]: [usize; 3]| format!("{n} Gaussians in {width} x {height} pixels");
    Err(Error::Option {
        what: format!("backward is given {}, forward drew {}", name(backward), name(forward)),
        remedy: "give both passes the same set, camera and render".into(),
    })
}

/// Surfels only: ellipsoids have no such images, and their gradients count for nothing.
pub(super) fn check_geometry(options: &RenderOptions, gradients: &RenderGradients) -> Result<()> {
    let by_geometry = [gradients.normal.len(), gradients.median_depth.len(), gradients.distortion.len()];
    if !options.geometry && by_geometry.iter().any(|len| *len > 0) {
        return Err(Error::Option {
            what: "a gradient by normal, median depth or distortion of surfels drawn without geometry".into(),
            remedy: "set `geometry`, or leave these gradients empty".into(),
        });
    }
    Ok(())
}

pub(super) fn check_gradients(render: &Render, gradients: &RenderGradients) -> Result<()> {
    let pixels = render.width * render.height;
    let lengths = [
        ("rgb", gradients.rgb.len()),
        ("alpha", gradients.alpha.len()),
        ("depth", gradients.depth.len()),
        ("normal", gradients.normal.len()),
        ("median_depth", gradients.median_depth.len()),
        ("distortion", gradients.distortion.len()),
    ];
    match lengths.iter().find(|(_, len)| *len != 0 && *len != pixels) {
        None => Ok(()),
        Some((name, len)) => Err(Error::Option {
            what: format!("the gradient by {name} has {len} pixels, the render {pixels}"),
            remedy: "give one entry a pixel, or none for zero everywhere".into(),
        }),
    }
}

/// No number where there was none, and no larger one than single precision holds: then sums over Gaussians stay finite.
pub(crate) fn bounded(x: f64) -> f64 {
    if x.is_nan() { 0.0 } else { x.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) }
}
