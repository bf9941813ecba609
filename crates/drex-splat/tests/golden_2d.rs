//! Surfels against the golden arrays: images, counts, every gradient, the camera's motion.
#![allow(clippy::unwrap_used)]

mod support;

use drex_core::Pose;
use drex_splat::raster::{Cpu, DepthKind};
use drex_splat::{Gaussians, Kind, Label, PinholeCamera, Rasterizer, Render, RenderGradients, RenderOptions};
use nalgebra::Matrix4;
use support::Golden;

fn scene(golden: &Golden) -> Gaussians {
    let threes = |name: &str| golden.f32s(name).chunks(3).map(|c| [c[0], c[1], c[2]]).collect::<Vec<_>>();
    let means = threes("means");
    Gaussians {
        kind: Kind::Surfel,
        sh_degree: golden.scalar("sh_degree") as usize,
        rotations: golden.f32s("quats").chunks(4).map(|c| [c[0], c[1], c[2], c[3]]).collect(),
        log_scales: golden.f32s("log_scales").chunks(2).map(|c| [c[0], c[1], 0.0]).collect(),
        logit_opacities: golden.f32s("logit_opacities"),
        sh: golden.f32s("sh"),
        labels: vec![Label::OBJECT; means.len()],
        means,
    }
}

fn camera(golden: &Golden) -> PinholeCamera {
    let viewmat = Matrix4::from_row_slice(&golden.get("viewmat").values);
    let rotation = nalgebra::Rotation3::from_matrix(&viewmat.fixed_view::<3, 3>(0, 0).into_owned());
    let translation = nalgebra::Translation3::new(viewmat[(0, 3)], viewmat[(1, 3)], viewmat[(2, 3)]);
    let k = &golden.get("intrinsics").values;
    PinholeCamera {
        camera_from_world: Pose::from_parts(translation, rotation.into()),
        fx: k[0],
        fy: k[1],
        cx: k[2],
        cy: k[3],
        width: golden.scalar("width") as usize,
        height: golden.scalar("height") as usize,
    }
}

fn options(golden: &Golden, depth: DepthKind) -> RenderOptions {
    let mut options = RenderOptions::default();
    let background = golden.f32s("background");
    options.background = [background[0], background[1], background[2]];
    options.sh_degree = golden.scalar("sh_degree") as usize;
    options.centre_cutoff = golden.scalar("centre_cutoff").powi(2) as f32;
    options.depth = depth;
    options.count = true;
    options
}

/// Gradients of Σ weight · image, where the weighted depth is the quotient depth / alpha.
fn gradients(golden: &Golden, render: &Render, depth_weight: &str) -> RenderGradients {
    let threes = |name: &str| golden.f32s(name).chunks(3).map(|c| [c[0], c[1], c[2]]).collect::<Vec<_>>();
    let weight = golden.f32s(depth_weight);
    let mut alpha = golden.f32s("weight_alpha");
    let mut depth = vec![0.0; weight.len()];
    for (i, &w) in weight.iter().enumerate().filter(|(_, w)| **w != 0.0) {
        let a = render.alpha[i];
        depth[i] = w / a;
        alpha[i] -= w * render.depth[i] / (a * a);
    }
    RenderGradients {
        rgb: threes("weight_rgb"),
        alpha,
        depth,
        normal: threes("weight_normal"),
        distortion: if golden.has("weight_distortion") { golden.f32s("weight_distortion") } else { Vec::new() },
        ..RenderGradients::default()
    }
}

fn check(name: &str, depth: DepthKind) {
    let Some(golden) = Golden::load(name) else { return };
    let (scene, camera, options) = (scene(&golden), camera(&golden), options(&golden, depth));
    let (render, saved) = Cpu.forward(&scene, &camera, &options).unwrap();

    let counts = &golden.get("out_count").values;
    let off = counts.iter().zip(&render.count).filter(|(theirs, ours)| **theirs != f64::from(**ours)).count();
    assert_eq!(off, 0, "{name}: {off} pixels of {} have another count", counts.len());
    let all = |_: usize| true;
    let image = |key: &str, ours: &[f32], limit: f64| golden.compare(key, ours, limit, 1e-2, all);
    image("out_alpha", &render.alpha, 1e-4);
    image("out_rgb", render.rgb.as_flattened(), 1e-4);
    image("out_normal", render.normal.as_flattened(), 1e-4);
    image("out_median_depth", &render.median_depth, 1e-4);
    image("out_distortion", &render.distortion, 1e-3);
    let depth_key = if depth == DepthKind::Ray { "out_ray_depth_sum" } else { "out_depth_sum" };
    image(depth_key, &render.depth, 1e-4);

    let weight =
        if golden.has("weight_ray_depth_expected") { "weight_ray_depth_expected" } else { "weight_depth_expected" };
    if (weight == "weight_ray_depth_expected") != (depth == DepthKind::Ray) {
        return;
    }
    let limit = if golden.has("weight_distortion") { 1e-3 } else { 5e-4 };
    let g = gradients(&golden, &render, weight);
    let ours = Cpu.backward(&scene, &camera, &options, &render, &saved, &g).unwrap();
    let gradient = |key: &str, ours: &[f32]| golden.compare(key, ours, limit, 1e-2, all);
    gradient("grad_sh", &ours.sh);
    gradient("grad_logit_opacities", &ours.logit_opacities);
    gradient("grad_means", ours.means.as_flattened());
    let scales: Vec<f32> = ours.log_scales.iter().flat_map(|s| [s[0], s[1]]).collect();
    gradient("grad_log_scales", &scales);
    gradient("grad_quats", ours.rotations.as_flattened());
    gradient("grad_twist", &ours.twist.map(|x| x as f32));
    assert!(ours.log_scales.iter().all(|s| s[2] == 0.0));
}

#[test]
fn few_surfels_as_gsplat_draws_them() {
    check("2dgs_d", DepthKind::Centre);
}

#[test]
fn depth_along_the_ray() {
    check("2dgs_d", DepthKind::Ray);
    check("2dgs_e", DepthKind::Ray);
}

#[test]
fn few_surfels_as_the_paper_draws_them_with_distortion() {
    check("2dgs_d_paper", DepthKind::Ray);
}

#[test]
fn many_small_surfels() {
    check("2dgs_e", DepthKind::Centre);
}
