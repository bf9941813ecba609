//! The derivative of our own loss against differences of it, with the smooth cut-off that makes them valid.

use crate::scenes;

use drex_core::Pose;
use drex_core::camera::PinholeCamera;
use drex_splat::{Cpu, Gaussians, Rasterizer, Render, RenderGradients, RenderOptions};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

/// Agreement, relative to the largest derivative of the same kind.
const LIMIT: f64 = 1e-4;
/// A power of two, and the scene's numbers are multiples of it: sums are exact.
const STEP: f32 = 1.0 / 1024.0;

#[test]
fn plain() {
    check(&options());
}

#[test]
fn with_compensated_opacity() {
    let mut options = options();
    options.antialias = true;
    check(&options);
}

fn options() -> RenderOptions {
    let mut options = RenderOptions::default();
    options.smooth_cutoff = true;
    options.background = [0.3, 0.6, 0.1];
    options
}

fn check(options: &RenderOptions) {
    let scene = smooth_scene();
    let camera = scenes::camera(163, 121);
    let (render, saved) = Cpu.forward(&scene, &camera, options).unwrap();
    assert!(render.alpha.iter().all(|a| *a < 0.999), "no pixel may stop early");
    let weights = weights(&render);
    let ours = Cpu.backward(&scene, &camera, options, &render, &saved, &weights).unwrap();

    let loss = |scene: &Gaussians| loss(&Cpu.forward(scene, &camera, options).unwrap().0, &weights);
    let along = |h: f32, change: &dyn Fn(&mut Gaussians, f32)| {
        let at = |h: f32| {
            let mut moved = scene.clone();
            change(&mut moved, h);
            loss(&moved)
        };
        fourth_order(at, h)
    };
    let n = scene.len();
    let of = |h: f32, per: usize, change: &dyn Fn(&mut Gaussians, usize, usize, f32)| -> Vec<f64> {
        (0..n * per).map(|k| along(h, &|scene, h| change(scene, k / per, k % per, h))).collect()
    };
    compare("means", ours.means.as_flattened(), &of(STEP, 3, &|s, i, k, h| s.means[i][k] += h));
    compare("rotations", ours.rotations.as_flattened(), &of(4.0 * STEP, 4, &|s, i, k, h| s.rotations[i][k] += h));
    compare("log_scales", ours.log_scales.as_flattened(), &of(4.0 * STEP, 3, &|s, i, k, h| s.log_scales[i][k] += h));
    compare("logit_opacities", &ours.logit_opacities, &of(8.0 * STEP, 1, &|s, i, _, h| s.logit_opacities[i] += h));
    let stride = scene.sh_stride();
    compare("sh", &ours.sh, &of(8.0 * STEP, stride, &|s, i, k, h| s.sh[i * stride + k] += h));

    let twist: Vec<f64> = (0..6)
        .map(|k| {
            let at = |h: f32| {
                let camera = PinholeCamera {
                    camera_from_world: motion(k, f64::from(h)) * camera.camera_from_world,
                    ..camera.clone()
                };
                self::loss(&Cpu.forward(&scene, &camera, options).unwrap().0, &weights)
            };
            // The whole picture moves: many pixels' rounding, so several steps are averaged.
            let steps = [0.4, 0.45, 0.5, 0.55, 0.6].map(|part| part * STEP);
            steps.iter().map(|h| fourth_order(at, *h)).sum::<f64>() / steps.len() as f64
        })
        .collect();
    compare("twist", &ours.twist.map(|v| v as f32), &twist);
}

/// Few and large, so that single precision is enough; no pixel stops early, no colour is at its clamp.
fn smooth_scene() -> Gaussians {
    let mut scene = scenes::cloud(10, 2, 3);
    for i in 0..scene.len() {
        for k in 0..3 {
            scene.log_scales[i][k] = scene.log_scales[i][k].clamp(-2.0, -0.8) + [0.5, 0.0, -0.5][k];
        }
        scene.logit_opacities[i] = scene.logit_opacities[i].min(1.0);
    }
    for value in &mut scene.sh {
        *value *= 0.4;
    }
    let parts =
        [scene.means.as_flattened_mut(), scene.rotations.as_flattened_mut(), scene.log_scales.as_flattened_mut()];
    for value in parts.into_iter().flatten().chain(&mut scene.logit_opacities).chain(&mut scene.sh) {
        *value = (*value / STEP).round() * STEP;
    }
    scene
}

fn weights(render: &Render) -> RenderGradients {
    let wave = |i: usize, f: f32| (f * i as f32).sin();
    let pixels = 0..render.alpha.len();
    RenderGradients {
        rgb: pixels.clone().map(|i| [wave(i, 0.11), wave(i, 0.07), 0.5 + wave(i, 0.013)]).collect(),
        alpha: pixels.clone().map(|i| wave(i, 0.05)).collect(),
        depth: pixels.map(|i| 0.1 * wave(i, 0.017)).collect(),
        ..RenderGradients::default()
    }
}

fn loss(render: &Render, weights: &RenderGradients) -> f64 {
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
    dot(render.rgb.as_flattened(), weights.rgb.as_flattened())
        + dot(&render.alpha, &weights.alpha)
        + dot(&render.depth, &weights.depth)
}

fn fourth_order(at: impl Fn(f32) -> f64, h: f32) -> f64 {
    (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * f64::from(h))
}

/// exp(h eₖ^).
fn motion(k: usize, h: f64) -> Pose {
    let mut xi = [0.0; 6];
    xi[k] = h;
    Pose::from_parts(
        Translation3::new(xi[0], xi[1], xi[2]),
        UnitQuaternion::from_scaled_axis(Vector3::new(xi[3], xi[4], xi[5])),
    )
}

fn compare(name: &str, ours: &[f32], differences: &[f64]) {
    assert_eq!(ours.len(), differences.len());
    let largest = differences.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let worst = ours.iter().zip(differences).map(|(o, d)| (f64::from(*o) - d).abs()).fold(0.0, f64::max) / largest;
    eprintln!("{name}: {worst:.1e} of the largest, {largest:.2}");
    assert!(worst < LIMIT, "{name}: {worst:.2e} of the largest");
}
