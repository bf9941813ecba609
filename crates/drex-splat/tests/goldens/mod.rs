//! The golden cases as checks of any backend: counts, images, the derivative by every input.
#![allow(dead_code, clippy::unwrap_used, clippy::missing_panics_doc, missing_docs, unreachable_pub)] // shared by several test files

use drex_core::camera::PinholeCamera;
use drex_core::pose::pose_from_matrix;
use drex_splat::raster::DepthKind;
use drex_splat::{Gaussians, Kind, Label, Rasterizer, Render, RenderGradients, RenderOptions};

use crate::support::Golden;

/// Limit element by element, of the goldens' README.
const ELEMENT: f64 = 1e-2;

/// Checks a case of ellipsoids.
pub fn ellipsoids<R: Rasterizer>(raster: &R, name: &str) {
    let Some(golden) = Golden::load(name) else { return };
    let (scene, camera, mut options) = inputs(&golden, Kind::Ellipsoid);
    options.antialias = golden.scalar("antialias") != 0.0;
    let (render, saved) = raster.forward(&scene, &camera, &options).unwrap();
    check_count(&golden, &render);
    let limit = 1e-4;
    let compare = |name: &str, ours: &[f32]| golden.compare(name, ours, limit, ELEMENT, |_| true);
    compare("out_rgb", render.rgb.as_flattened());
    compare("out_alpha", &render.alpha);
    compare("out_depth_sum", &render.depth);
    compare("out_depth_expected", &expected_depth(&render));

    let gradients = gradients(&golden, &render, "weight_depth_expected");
    let ours = raster.backward(&scene, &camera, &options, &render, &saved, &gradients).unwrap();
    compare("grad_means", ours.means.as_flattened());
    compare("grad_quats", ours.rotations.as_flattened());
    compare("grad_log_scales", ours.log_scales.as_flattened());
    compare("grad_logit_opacities", &ours.logit_opacities);
    compare("grad_sh", &ours.sh);
    compare("grad_mean2d", ours.mean2d.as_flattened());
    compare("absgrad_mean2d", ours.abs_mean2d.as_flattened());
    compare("grad_twist", &ours.twist.map(|v| v as f32));
}

/// Checks a case of surfels: images with this kind of depth, and the gradients if the case's loss uses it.
pub fn surfels<R: Rasterizer>(raster: &R, name: &str, depth: DepthKind) {
    let Some(golden) = Golden::load(name) else { return };
    let (scene, camera, mut options) = inputs(&golden, Kind::Surfel);
    options.centre_cutoff = golden.scalar("centre_cutoff").powi(2) as f32;
    options.depth = depth;
    let (render, saved) = raster.forward(&scene, &camera, &options).unwrap();
    check_count(&golden, &render);
    let image = |name: &str, ours: &[f32], limit: f64| golden.compare(name, ours, limit, ELEMENT, |_| true);
    let (sum, quotient, weight) = match depth {
        DepthKind::Ray => ("out_ray_depth_sum", "out_ray_depth_expected", "weight_ray_depth_expected"),
        DepthKind::Centre => ("out_depth_sum", "out_depth_expected", "weight_depth_expected"),
    };
    image("out_rgb", render.rgb.as_flattened(), 1e-4);
    image("out_alpha", &render.alpha, 1e-4);
    image(sum, &render.depth, 1e-4);
    image(quotient, &expected_depth(&render), 1e-4);
    image("out_normal", render.normal.as_flattened(), 1e-4);
    image("out_median_depth", &render.median_depth, 1e-4);
    image("out_distortion", &render.distortion, 1e-3);

    if !golden.has(weight) {
        return;
    }
    let limit = if golden.has("weight_distortion") { 1e-3 } else { 5e-4 };
    let gradients = gradients(&golden, &render, weight);
    let ours = raster.backward(&scene, &camera, &options, &render, &saved, &gradients).unwrap();
    let compare = |name: &str, ours: &[f32]| golden.compare(name, ours, limit, ELEMENT, |_| true);
    let log_scales: Vec<f32> = ours.log_scales.iter().flat_map(|s| [s[0], s[1]]).collect();
    compare("grad_means", ours.means.as_flattened());
    compare("grad_quats", ours.rotations.as_flattened());
    compare("grad_log_scales", &log_scales);
    compare("grad_logit_opacities", &ours.logit_opacities);
    compare("grad_sh", &ours.sh);
    compare("grad_twist", &ours.twist.map(|v| v as f32));
    assert!(ours.log_scales.iter().all(|s| s[2] == 0.0));
}

/// Scene, camera and options of a case.
pub fn inputs(golden: &Golden, kind: Kind) -> (Gaussians, PinholeCamera, RenderOptions) {
    let means: Vec<[f32; 3]> = golden.f32s("means").as_chunks().0.to_vec();
    let axes = if kind == Kind::Surfel { 2 } else { 3 };
    let log_scales = golden.f32s("log_scales");
    let scene = Gaussians {
        kind,
        sh_degree: golden.scalar("sh_degree") as usize,
        rotations: golden.f32s("quats").as_chunks().0.to_vec(),
        log_scales: log_scales.chunks(axes).map(|s| [s[0], s[1], s.get(2).copied().unwrap_or(0.0)]).collect(),
        logit_opacities: golden.f32s("logit_opacities"),
        sh: golden.f32s("sh"),
        labels: vec![Label::OBJECT; means.len()],
        means,
    };
    let view = nalgebra::Matrix4::from_row_slice(&golden.get("viewmat").values);
    let k = &golden.get("intrinsics").values;
    let camera = PinholeCamera {
        camera_from_world: pose_from_matrix(&view).unwrap(),
        fx: k[0],
        fy: k[1],
        cx: k[2],
        cy: k[3],
        width: golden.scalar("width") as usize,
        height: golden.scalar("height") as usize,
    };
    let mut options = RenderOptions::default();
    options.background = golden.f32s("background").try_into().unwrap();
    options.sh_degree = scene.sh_degree;
    options.count = true;
    (scene, camera, options)
}

fn check_count(golden: &Golden, render: &Render) {
    let counts = &golden.get("out_count").values;
    let off = counts.iter().zip(&render.count).filter(|(theirs, ours)| **theirs != f64::from(**ours)).count();
    assert_eq!((off, counts.len()), (0, render.count.len()), "{}: pixels with another count of splats", golden.name);
}

fn expected_depth(render: &Render) -> Vec<f32> {
    render.depth.iter().zip(&render.alpha).map(|(d, a)| if *a > 0.0 { d / a } else { 0.0 }).collect()
}

/// Weights of the case's loss, led through expected depth = depth / alpha.
fn gradients(golden: &Golden, render: &Render, weight_of_depth: &str) -> RenderGradients {
    let of = |name: &str| if golden.has(name) { golden.f32s(name) } else { Vec::new() };
    let mut out = RenderGradients {
        rgb: of("weight_rgb").as_chunks().0.to_vec(),
        alpha: of("weight_alpha"),
        depth: vec![0.0; render.depth.len()],
        normal: of("weight_normal").as_chunks().0.to_vec(),
        distortion: of("weight_distortion"),
        ..RenderGradients::default()
    };
    for (i, &weight) in golden.get(weight_of_depth).values.iter().enumerate().filter(|(_, w)| **w != 0.0) {
        let (d, a) = (f64::from(render.depth[i]), f64::from(render.alpha[i]));
        out.depth[i] = (weight / a) as f32;
        out.alpha[i] -= (weight * d / (a * a)) as f32;
    }
    out
}
