//! Scenes made of random numbers.
#![allow(dead_code, clippy::unwrap_used, clippy::missing_panics_doc, missing_docs, unreachable_pub)] // shared by several test files

use drex_core::camera::PinholeCamera;
use drex_core::pose::pose_from_wxyz;
use drex_splat::{GaussianGradients, Gaussians, Kind, Label};
use rand::{RngExt, SeedableRng};

/// `n` ellipsoids of many sizes, most of them in front of [`camera`].
pub fn cloud(n: usize, sh_degree: usize, seed: u64) -> Gaussians {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut scene = Gaussians::new(Kind::Ellipsoid, sh_degree);
    for _ in 0..n {
        let mut between = |low: f32, high: f32| low + (high - low) * rng.random::<f32>();
        scene.means.push([between(-1.2, 1.2), between(-0.9, 0.9), between(-0.8, 1.5)]);
        scene.rotations.push([1.0, between(-0.9, 0.9), between(-0.9, 0.9), between(-0.9, 0.9)]);
        let size = between(-4.5, -1.8);
        scene.log_scales.push([size + between(-0.8, 0.8), size + between(-0.8, 0.8), size + between(-0.8, 0.8)]);
        scene.logit_opacities.push(between(-1.5, 2.0));
        scene.labels.push(Label::OBJECT);
        for k in 0..scene.sh_stride() {
            scene.sh.push(between(-0.5, 0.5) * if k < 3 { 2.0 } else { 0.5 });
        }
    }
    scene
}

/// A camera two units from the cloud, off its axis, its principal point off the image's centre.
pub fn camera(width: usize, height: usize) -> PinholeCamera {
    let (w, h) = (width as f64, height as f64);
    PinholeCamera {
        camera_from_world: pose_from_wxyz([0.05, -0.1, 2.1], [0.99, 0.08, -0.1, 0.05]).unwrap(),
        fx: 0.9 * w,
        fy: 0.92 * w,
        cx: 0.47 * w,
        cy: 0.54 * h,
        width,
        height,
    }
}

/// Whether every number of the gradients is one.
pub fn is_finite(g: &GaussianGradients) -> bool {
    let parts = [
        g.means.as_flattened(),
        g.rotations.as_flattened(),
        g.log_scales.as_flattened(),
        &g.logit_opacities,
        &g.sh,
        g.mean2d.as_flattened(),
        g.abs_mean2d.as_flattened(),
        &g.radius,
    ];
    parts.iter().all(|part| part.iter().all(|v| v.is_finite())) && g.twist.iter().all(|v| v.is_finite())
}
