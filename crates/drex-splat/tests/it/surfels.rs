//! Surfels against finite differences, against the definition evaluated pixel by pixel, and against hostile input.

use crate::scenes;

use drex_core::Pose;
use drex_core::camera::PinholeCamera;
use drex_splat::{Cpu, GaussianGradients, Gaussians, Kind, Label, Rasterizer, Render, RenderGradients, RenderOptions};
use nalgebra::{Matrix3, Quaternion, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn random(seed: u64) -> impl FnMut(f64, f64) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    move |lo, hi| rng.random_range(lo..hi)
}

fn camera() -> PinholeCamera {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, -0.2, 0.05));
    let camera_from_world = Pose::from_parts(Translation3::new(0.1, -0.05, 0.3), rotation);
    PinholeCamera { camera_from_world, fx: 150.0, fy: 165.0, cx: 25.3, cy: 18.9, width: 48, height: 40 }
}

fn push(scene: &mut Gaussians, mean: [f64; 3], rotation: [f64; 4], log_scale: [f64; 2], logit: f64, sh: &[f32]) {
    scene.means.push(mean.map(|v| v as f32));
    scene.rotations.push(rotation.map(|v| v as f32));
    scene.log_scales.push([log_scale[0] as f32, log_scale[1] as f32, 0.0]);
    scene.logit_opacities.push(logit as f32);
    scene.sh.extend_from_slice(sh);
    scene.labels.push(Label::OBJECT);
}

/// `n` surfels of several pixels in front of [`camera`], none edge-on, in weak perspective.
fn scene(n: usize, seed: u64) -> Gaussians {
    let mut random = random(seed);
    let mut scene = Gaussians::new(Kind::Surfel, 1);
    for i in 0..n {
        let z = 6.0 + 0.5 * i as f64;
        let seen = Vector3::new(random(-0.12, 0.12) * z, random(-0.09, 0.09) * z, z);
        let mean = camera().camera_from_world.inverse() * nalgebra::Point3::from(seen);
        let turn = [random(0.8, 1.4), random(-0.4, 0.4), random(-0.4, 0.4), random(-0.9, 0.9)];
        let log_scale = [random(-1.4, -0.6), random(-1.4, -0.6)];
        let sh: Vec<f32> = (0..12).map(|_| random(-0.4, 0.4) as f32).collect();
        push(&mut scene, mean.coords.into(), turn, log_scale, random(-2.0, 0.8), &sh);
    }
    scene
}

fn options() -> RenderOptions {
    let mut options = RenderOptions::default();
    options.sh_degree = 1;
    options.background = [0.3, 0.1, 0.7];
    options.smooth_cutoff = true;
    // Of the box of 1 σ the centre is near the disc's, where the disc counts, so that the edge between both is not in play.
    options.centre_cutoff = 1.0;
    options.count = true;
    options
}

/// Weights of every image but the median depth: waves, longer than a step of the differences moves an edge.
fn weights(render: &Render, seed: u64) -> RenderGradients {
    let mut random = random(seed);
    let width = render.width;
    let mut wave = |amplitude: f64| -> Vec<f32> {
        let (a, b, c) = (random(-0.25, 0.25), random(-0.25, 0.25), random(-3.0, 3.0));
        let at = |i: usize| a * (i % width) as f64 + b * (i / width) as f64 + c;
        (0..render.alpha.len()).map(|i| (amplitude * at(i).sin()) as f32).collect()
    };
    let mut three = || {
        let [a, b, c] = [wave(1.0), wave(1.0), wave(1.0)];
        (0..a.len()).map(|i| [a[i], b[i], c[i]]).collect()
    };
    let (rgb, normal) = (three(), three());
    RenderGradients {
        rgb,
        normal,
        alpha: wave(1.0),
        depth: wave(0.3),
        median_depth: Vec::new(),
        distortion: wave(1000.0),
    }
}

fn loss(render: &Render, weights: &RenderGradients) -> f64 {
    let dot = |a: &[f32], b: &[f32]| -> f64 { a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum() };
    dot(render.rgb.as_flattened(), weights.rgb.as_flattened())
        + dot(&render.alpha, &weights.alpha)
        + dot(&render.depth, &weights.depth)
        + dot(render.normal.as_flattened(), weights.normal.as_flattened())
        + dot(&render.median_depth, &weights.median_depth)
        + dot(&render.distortion, &weights.distortion)
}

fn differentiate(
    scene: &Gaussians,
    camera: &PinholeCamera,
    options: &RenderOptions,
    weights: &RenderGradients,
) -> GaussianGradients {
    let (render, saved) = Cpu.forward(scene, camera, options).unwrap();
    Cpu.backward(scene, camera, options, &render, &saved, weights).unwrap()
}

/// Fourth-order central difference of `f` at 0. A power of two for `h` is added to a parameter without rounding.
fn slope(h: f64, f: impl Fn(f64) -> f64) -> f64 {
    (8.0 * (f(h) - f(-h)) - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)
}

/// The derivatives of one kind of parameter agree to `limit` of the largest.
fn assert_agree(what: &str, ours: &[f64], differences: &[f64], limit: f64) {
    let largest = differences.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    assert!(largest > 0.0, "{what}: nothing to compare");
    for (i, (a, b)) in ours.iter().zip(differences).enumerate() {
        assert!((a - b).abs() <= limit * largest, "{what}[{i}]: {a}, by differences {b}, largest {largest}");
    }
}

/// Every derivative of Σ weight · image against differences of that sum.
fn check_differences(scene: &Gaussians, camera: &PinholeCamera, options: &RenderOptions, weights: &RenderGradients) {
    let ours = differentiate(scene, camera, options, weights);
    let value =
        |scene: &Gaussians, camera: &PinholeCamera| loss(&Cpu.forward(scene, camera, options).unwrap().0, weights);
    type Field = fn(&mut Gaussians, usize) -> &mut f32;
    let fields: [(&str, usize, f64, &[f32], Field); 5] = [
        ("means", 3, 0.5f64.powi(9), ours.means.as_flattened(), |s, k| &mut s.means.as_flattened_mut()[k]),
        ("rotations", 4, 0.5f64.powi(10), ours.rotations.as_flattened(), |s, k| &mut s.rotations.as_flattened_mut()[k]),
        ("log_scales", 3, 0.5f64.powi(10), ours.log_scales.as_flattened(), |s, k| {
            &mut s.log_scales.as_flattened_mut()[k]
        }),
        ("logit_opacities", 1, 0.5f64.powi(7), &ours.logit_opacities, |s, k| &mut s.logit_opacities[k]),
        ("sh", 12, 0.5f64.powi(5), &ours.sh, |s, k| &mut s.sh[k]),
    ];
    for (what, stride, h, ours, field) in fields {
        assert_eq!(ours.len(), stride * scene.len());
        let differences: Vec<f64> = (0..ours.len())
            .map(|k| {
                slope(h, |d| {
                    let mut moved = scene.clone();
                    *field(&mut moved, k) += d as f32;
                    value(&moved, camera)
                })
            })
            .collect();
        let ours: Vec<f64> = ours.iter().map(|v| f64::from(*v)).collect();
        assert_agree(what, &ours, &differences, 1e-4);
    }
    let twist: Vec<f64> = (0..6)
        .map(|k| {
            slope(5e-4, |d| {
                let mut moved = camera.clone();
                let mut xi = [0.0; 6];
                xi[k] = d;
                moved.camera_from_world = exp(xi) * camera.camera_from_world;
                value(scene, &moved)
            })
        })
        .collect();
    assert_agree("twist", &ours.twist, &twist, 1e-4);
}

/// exp((ρ, φ)^) where one of both is zero.
fn exp(xi: [f64; 6]) -> Pose {
    Pose::from_parts(
        Translation3::new(xi[0], xi[1], xi[2]),
        UnitQuaternion::from_scaled_axis(Vector3::new(xi[3], xi[4], xi[5])),
    )
}

#[test]
fn every_derivative_agrees_with_differences() {
    let (scene, camera, options) = (scene(9, 5), camera(), options());
    let (render, _) = Cpu.forward(&scene, &camera, &options).unwrap();
    assert!(render.count.iter().any(|c| *c >= 4), "surfels overlap");
    check_differences(&scene, &camera, &options, &weights(&render, 6));
}

#[test]
fn median_depth_differentiates_by_the_surfel_that_gave_it() {
    let mut scene = Gaussians::new(Kind::Surfel, 1);
    for (z, logit) in [(6.0, -0.5), (7.0, 3.0), (8.0, 3.0)] {
        let mean = camera().camera_from_world.inverse() * nalgebra::Point3::new(0.1, 0.05, z);
        push(&mut scene, mean.coords.into(), [1.0, 0.2, -0.1, 0.3], [-0.6, -0.9], logit, &[0.1; 12]);
    }
    let (camera, options) = (camera(), options());
    let (render, saved) = Cpu.forward(&scene, &camera, &options).unwrap();
    // Only pixels that are half through the second for certain, and not yet before it.
    let two = Cpu.forward(&scene.filtered(|i| i < 2), &camera, &options).unwrap().0;
    let weight = |i: usize| 0.05 * (i % camera.width) as f32 - 1.3;
    let median_depth: Vec<f32> =
        (0..two.alpha.len()).map(|i| if two.alpha[i] > 0.6 { weight(i) } else { 0.0 }).collect();
    assert!(median_depth.iter().filter(|w| **w != 0.0).count() > 50);
    let weights = RenderGradients { median_depth, ..RenderGradients::default() };
    check_differences_of_geometry(&scene, &camera, &options, &weights);
    let ours = Cpu.backward(&scene, &camera, &options, &render, &saved, &weights).unwrap();
    assert_eq!((ours.means[0], ours.means[2]), ([0.0; 3], [0.0; 3]), "only the second gave it");
    assert!(ours.logit_opacities.iter().all(|g| *g == 0.0));
}

#[test]
fn surfels_smaller_than_a_pixel_differentiate_through_their_floor() {
    let mut scene = scene(6, 3);
    scene.log_scales.fill([-7.0, -7.5, 0.0]);
    scene.logit_opacities.fill(1.0);
    let (camera, options) = (camera(), options());
    let (render, _) = Cpu.forward(&scene, &camera, &options).unwrap();
    let weights = RenderGradients { depth: Vec::new(), distortion: Vec::new(), ..weights(&render, 2) };
    let ours = differentiate(&scene, &camera, &options, &weights);
    let differences: Vec<f64> = (0..18)
        .map(|k| {
            slope(0.5f64.powi(13), |d| {
                let mut moved = scene.clone();
                moved.means.as_flattened_mut()[k] += d as f32;
                loss(&Cpu.forward(&moved, &camera, &options).unwrap().0, &weights)
            })
        })
        .collect();
    let means: Vec<f64> = ours.means.as_flattened().iter().map(|v| f64::from(*v)).collect();
    // The fade at the rim takes a large part of so small a spot: less smooth than the rest.
    assert_agree("means", &means, &differences, 5e-4);
}

/// By means and rotations only.
fn check_differences_of_geometry(
    scene: &Gaussians,
    camera: &PinholeCamera,
    options: &RenderOptions,
    weights: &RenderGradients,
) {
    let ours = differentiate(scene, camera, options, weights);
    type Field = fn(&mut Gaussians, usize) -> &mut f32;
    let fields: [(&str, &[f32], Field); 2] = [
        ("means", ours.means.as_flattened(), |s, k| &mut s.means.as_flattened_mut()[k]),
        ("rotations", ours.rotations.as_flattened(), |s, k| &mut s.rotations.as_flattened_mut()[k]),
    ];
    for (what, ours, field) in fields {
        let differences: Vec<f64> = (0..ours.len())
            .map(|k| {
                slope(0.5f64.powi(5), |d| {
                    let mut moved = scene.clone();
                    *field(&mut moved, k) += d as f32;
                    loss(&Cpu.forward(&moved, camera, options).unwrap().0, weights)
                })
            })
            .collect();
        let ours: Vec<f64> = ours.iter().map(|v| f64::from(*v)).collect();
        assert_agree(what, &ours, &differences, 1e-4);
    }
}

#[test]
fn mean2d_is_the_motion_of_the_whole_splat_in_the_image() {
    for seed in 0..4 {
        let (scene, camera, options) = (scene(1, seed), camera(), options());
        let (render, _) = Cpu.forward(&scene, &camera, &options).unwrap();
        let weights = weights(&render, seed);
        let ours = differentiate(&scene, &camera, &options, &weights);
        let value = |cx: f64, cy: f64| {
            let moved = PinholeCamera { cx, cy, ..camera.clone() };
            loss(&Cpu.forward(&scene, &moved, &options).unwrap().0, &weights)
        };
        let x = slope(0.02, |d| value(camera.cx + d, camera.cy));
        let y = slope(0.02, |d| value(camera.cx, camera.cy + d));
        assert_agree("mean2d", &ours.mean2d[0].map(f64::from), &[x, y], 1e-4);
        for k in 0..2 {
            assert!(ours.abs_mean2d[0][k] >= ours.mean2d[0][k].abs() * 0.999);
        }
    }
}

#[test]
fn a_wall_is_flat_and_faces_the_camera() {
    let mut scene = Gaussians::new(Kind::Surfel, 0);
    push(&mut scene, [0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0], [6.0, 6.0], 2.0, &[0.0; 3]);
    let camera = PinholeCamera { camera_from_world: Pose::identity(), ..camera() };
    let mut options = RenderOptions::default();
    options.sh_degree = 0;
    let (render, _) = Cpu.forward(&scene, &camera, &options).unwrap();
    let opacity = scene.opacity(0);
    for i in 0..render.alpha.len() {
        assert!((render.alpha[i] - opacity).abs() < 1e-5);
        assert!((render.depth[i] / render.alpha[i] - 2.0).abs() < 1e-5);
        assert!((render.median_depth[i] - 2.0).abs() < 1e-5);
        assert_eq!(render.distortion[i], 0.0);
        assert!((render.normal[i][2] + opacity).abs() < 1e-5);
    }
}

/// Opacity of a surfel at a pixel by the paper's formulas (two planes through the ray), no bounds; None where it is not
/// drawn. With it: how far the pixel is from each cut, relative.
fn by_definition(scene: &Gaussians, camera: &PinholeCamera, x: f64, y: f64) -> (Option<[f64; 2]>, f64) {
    let [w, i, j, k] = scene.rotations[0].map(f64::from);
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
    let r = (camera.camera_from_world.rotation * turn).to_rotation_matrix().into_inner();
    let t = camera.camera_from_world * nalgebra::Point3::from(scene.means[0].map(f64::from));
    let s = scene.log_scales[0].map(|l| f64::from(l).exp());
    let h = Matrix3::from_columns(&[r.column(0) * s[0], r.column(1) * s[1], t.coords]);
    let intrinsics = Matrix3::new(camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0);
    let transform = intrinsics * h;
    let [tu, tv, tw] = [0, 1, 2].map(|i| transform.row(i).transpose());
    let p = (x * tw - tu).cross(&(y * tw - tv));
    let (u, v) = (p.x / p.z, p.y / p.z);
    let z = u * tw.x + v * tw.y + tw.z;
    let d = Vector3::new(9.0, 9.0, -1.0);
    let norm = d.dot(&tw.component_mul(&tw));
    let centre = [tu, tv].map(|a| d.dot(&a.component_mul(&tw)) / norm);
    let rho2 = 2.0 * ((x - centre[0]).powi(2) + (y - centre[1]).powi(2));
    let rho = if norm < 0.0 { rho2.min(u * u + v * v) } else { u * u + v * v };
    let alpha = (f64::from(scene.opacity(0)) * (-0.5 * rho).exp()).min(0.999);
    let near = 0.01;
    let far = 1e6 * t.z;
    let drawn = t.z > near && z > near && z < far && alpha >= 1.0 / 255.0;
    let margin = (alpha * 255.0 - 1.0).abs().min((z / near - 1.0).abs()).min((z / far - 1.0).abs());
    (drawn.then_some([alpha, z]), margin)
}

#[test]
fn no_pixel_is_lost_under_any_perspective() {
    let mut random = random(11);
    let (mut options, mut crossing, mut touched) = (RenderOptions::default(), 0, 0);
    options.sh_degree = 0;
    for _ in 0..600 {
        let camera = PinholeCamera { fx: 45.0, fy: 52.0, width: 70, height: 50, ..camera() };
        let z = 10f64.powf(random(-1.9, 1.0));
        let seen = nalgebra::Point3::new(random(-2.0, 2.0) * z, random(-2.0, 2.0) * z, z);
        let mean = camera.camera_from_world.inverse() * seen;
        let turn = [random(-1.0, 1.0), random(-1.0, 1.0), random(-1.0, 1.0), random(-1.0, 1.0)];
        let log_scale = [random(-6.0, 3.0), random(-6.0, 3.0)];
        let mut scene = Gaussians::new(Kind::Surfel, 0);
        push(&mut scene, mean.coords.into(), turn, log_scale, random(-5.0, 5.0), &[0.0; 3]);
        crossing += usize::from(log_scale[0].max(log_scale[1]).exp() > z);
        let (render, _) = Cpu.forward(&scene, &camera, &options).unwrap();
        for i in 0..render.alpha.len() {
            let (x, y) = ((i % 70) as f64 + 0.5, (i / 70) as f64 + 0.5);
            let (expected, margin) = by_definition(&scene, &camera, x, y);
            if margin < 1e-2 {
                continue;
            }
            let Some([alpha, z]) = expected else {
                assert_eq!(render.alpha[i], 0.0, "pixel {x}, {y} of {scene:?}");
                continue;
            };
            touched += 1;
            let (ours, depth) = (f64::from(render.alpha[i]), f64::from(render.depth[i]));
            assert!((ours - alpha).abs() < 2e-3 * alpha, "pixel {x}, {y}: {ours}, not {alpha}: {scene:?}");
            assert!((depth / ours - z).abs() < 1e-3 * z, "pixel {x}, {y}: depth {}, not {z}: {scene:?}", depth / ours);
        }
    }
    assert!(crossing > 100 && touched > 50_000, "{crossing} crossing, {touched} pixels");
}

#[test]
fn one_and_two_threads_give_the_same_bytes() {
    let (scene, camera, options) = (scene(60, 8), camera(), options());
    let run = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let (render, saved) = Cpu.forward(&scene, &camera, &options).unwrap();
            let mut weights = weights(&render, 9);
            weights.median_depth = weights.alpha.clone();
            let gradients = Cpu.backward(&scene, &camera, &options, &render, &saved, &weights).unwrap();
            (render, gradients)
        })
    };
    assert!(run(1) == run(2));
}

/// Draws, and differentiates what was drawn: every number is finite, or the set was refused.
fn gives_finite_numbers(scene: &Gaussians, near: f32) {
    let camera = PinholeCamera { camera_from_world: Pose::identity(), ..camera() };
    let mut options = options();
    (options.sh_degree, options.near) = (0, near);
    match Cpu.forward(scene, &camera, &options) {
        Err(error) => assert!(!error.to_string().is_empty()),
        Ok((render, saved)) => {
            let images = [
                render.rgb.as_flattened(),
                &render.alpha,
                &render.depth,
                render.normal.as_flattened(),
                &render.median_depth,
                &render.distortion,
            ];
            assert!(images.iter().all(|i| i.iter().all(|v| v.is_finite())), "images of {scene:?}");
            let mut weights = weights(&render, 1);
            weights.median_depth = weights.alpha.clone();
            let g = Cpu.backward(scene, &camera, &options, &render, &saved, &weights).unwrap();
            assert!(scenes::is_finite(&g), "gradients {g:?} of {scene:?}");
        }
    }
}

#[test]
fn a_gradient_too_large_for_a_number_does_not_spoil_the_camera() {
    let mut scene = Gaussians::new(Kind::Surfel, 0);
    push(&mut scene, [0.0, 0.0, 954658.2], [0.3611893, 0.5580763, 0.75398934, 1.0], [80.0; 2], 2.9, &[0.0, 0.0, 1e30]);
    gives_finite_numbers(&scene, 0.01);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn hostile_surfels_give_finite_numbers(
        surfels in prop::collection::vec(
            (
                prop::array::uniform3(prop_oneof![-3.0f32..3.0, -1e6f32..1e6, Just(0.0), Just(f32::MAX), Just(-1e30)]),
                prop::array::uniform4(prop_oneof![-1.0f32..1.0, Just(0.0), Just(1.0), -1e-30f32..1e-30, Just(1e30)]),
                prop::array::uniform3(prop_oneof![-4.0f32..1.0, Just(f32::NEG_INFINITY), Just(80.0), Just(f32::MAX), Just(-90.0)]),
                prop_oneof![-6.0f32..6.0, Just(f32::INFINITY), Just(f32::NEG_INFINITY), Just(100.0)],
                prop::array::uniform3(prop_oneof![-2.0f32..2.0, Just(1e30)]),
            ),
            1..12,
        ),
        near in prop_oneof![Just(0.01f32), Just(1e-20), Just(1.0)],
    ) {
        let mut scene = Gaussians::new(Kind::Surfel, 0);
        for (mean, rotation, log_scale, logit, sh) in surfels {
            scene.means.push(mean);
            scene.rotations.push(rotation);
            scene.log_scales.push(log_scale);
            scene.logit_opacities.push(logit);
            scene.sh.extend_from_slice(&sh);
            scene.labels.push(Label::OBJECT);
        }
        gives_finite_numbers(&scene, near);
    }
}
