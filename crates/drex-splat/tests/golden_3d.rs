//! Ellipsoids against an independent float64 reference: images, and the derivative by every input.
#![allow(clippy::unwrap_used)]

mod support;

use drex_core::pose::pose_from_matrix;
use drex_splat::{Cpu, Gaussians, Kind, Label, PinholeCamera, Rasterizer, Render, RenderGradients, RenderOptions};
use support::Golden;

/// Limits of the goldens' README for single precision: of the largest entry, and element by element.
const LIMIT: f64 = 1e-4;
const ELEMENT: f64 = 1e-2;

#[test]
fn smooth_scene() {
    check("3dgs_a");
}

#[test]
fn smooth_scene_with_compensated_opacity() {
    check("3dgs_a_antialias");
}

#[test]
fn dense_scene_that_stops_and_clamps() {
    check("3dgs_b");
}

#[test]
fn garden() {
    check("3dgs_c_garden");
}

fn check(name: &str) {
    let Some(golden) = Golden::load(name) else { return };
    let (scene, camera, options) = inputs(&golden);
    let (render, saved) = Cpu.forward(&scene, &camera, &options).unwrap();
    check_images(&golden, &render);

    let gradients = gradients(&golden, &render);
    let ours = Cpu.backward(&scene, &camera, &options, &render, &saved, &gradients).unwrap();
    let all = |_| true;
    let compare = |name: &str, values: &[f32]| golden.compare(name, values, LIMIT, ELEMENT, all);
    compare("grad_means", ours.means.as_flattened());
    compare("grad_quats", ours.rotations.as_flattened());
    compare("grad_log_scales", ours.log_scales.as_flattened());
    compare("grad_logit_opacities", &ours.logit_opacities);
    compare("grad_sh", &ours.sh);
    compare("grad_mean2d", ours.mean2d.as_flattened());
    compare("absgrad_mean2d", ours.abs_mean2d.as_flattened());
    compare("grad_twist", &ours.twist.map(|v| v as f32));
}

fn inputs(golden: &Golden) -> (Gaussians, PinholeCamera, RenderOptions) {
    let rows = |name: &str| golden.f32s(name);
    let means: Vec<[f32; 3]> = rows("means").as_chunks().0.to_vec();
    let scene = Gaussians {
        kind: Kind::Ellipsoid,
        sh_degree: golden.scalar("sh_degree") as usize,
        rotations: rows("quats").as_chunks().0.to_vec(),
        log_scales: rows("log_scales").as_chunks().0.to_vec(),
        logit_opacities: rows("logit_opacities"),
        sh: rows("sh"),
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
    options.background = rows("background").try_into().unwrap();
    options.sh_degree = scene.sh_degree;
    options.antialias = golden.scalar("antialias") != 0.0;
    options.count = true;
    (scene, camera, options)
}

fn check_images(golden: &Golden, render: &Render) {
    let counts: Vec<f64> = render.count.iter().map(|&c| f64::from(c)).collect();
    assert!(counts == golden.get("out_count").values, "{}: the number of splats in a pixel", golden.name);
    let expected: Vec<f32> =
        render.depth.iter().zip(&render.alpha).map(|(d, a)| if *a > 0.0 { d / a } else { 0.0 }).collect();
    let images = [
        ("out_rgb", render.rgb.as_flattened()),
        ("out_alpha", &render.alpha),
        ("out_depth_sum", &render.depth),
        ("out_depth_expected", &expected),
    ];
    for (name, image) in images {
        golden.compare(name, image, LIMIT, ELEMENT, |_| true);
    }
}

/// Weights of the loss, led through expected depth = depth / alpha.
fn gradients(golden: &Golden, render: &Render) -> RenderGradients {
    let mut out = RenderGradients {
        rgb: golden.f32s("weight_rgb").as_chunks().0.to_vec(),
        alpha: golden.f32s("weight_alpha"),
        depth: vec![0.0; render.depth.len()],
        ..RenderGradients::default()
    };
    for (i, &weight) in golden.get("weight_depth_expected").values.iter().enumerate().filter(|(_, w)| **w != 0.0) {
        let (d, a) = (f64::from(render.depth[i]), f64::from(render.alpha[i]));
        out.depth[i] = (weight / a) as f32;
        out.alpha[i] -= (weight * d / (a * a)) as f32;
    }
    out
}
