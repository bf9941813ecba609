//! Ellipsoids that no one should make: the picture and the derivative stay finite, or the error says what is wrong.

use crate::scenes;

use drex_splat::{Cpu, Error, Gaussians, Rasterizer, RenderGradients, RenderOptions};
use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_numbers_give_finite_results_or_a_named_error(
        numbers in prop::collection::vec((0..6usize, 0..16usize, hostile()), 1..12),
        antialias: bool,
        smooth_cutoff: bool,
        blur in prop::sample::select(vec![0.0, 1e-30, 0.3]),
    ) {
        let mut scene = scenes::cloud(6, 1, 5);
        for (i, field, value) in numbers {
            set(&mut scene, i, field, value);
        }
        let mut options = RenderOptions::default();
        (options.sh_degree, options.antialias, options.smooth_cutoff) = (1, antialias, smooth_cutoff);
        options.blur = blur;
        draw(&scene, &options);
    }
}

fn hostile() -> impl Strategy<Value = f32> {
    let special = [0.0, -0.0, 1e-45, 1e-20, 1e20, 80.0, -80.0, 300.0, f32::MAX, f32::MIN, f32::INFINITY, f32::NAN];
    prop_oneof![prop::sample::select(special.to_vec()), Just(f32::NEG_INFINITY), -20.0..20.0f32]
}

fn set(scene: &mut Gaussians, i: usize, field: usize, value: f32) {
    match field {
        0..3 => scene.means[i][field] = value,
        3..7 => scene.rotations[i][field - 3] = value,
        7..10 => scene.log_scales[i][field - 7] = value,
        10 => scene.logit_opacities[i] = value,
        11 => scene.rotations[i] = [0.0; 4],
        12 => scene.log_scales[i] = [value; 3],
        13 => scene.means[i] = [value; 3],
        _ => scene.sh[i * 12 + field - 14] = value,
    }
}

/// Draws and differentiates; whether the set was accepted.
fn draw(scene: &Gaussians, options: &RenderOptions) -> bool {
    let camera = scenes::camera(50, 34);
    let (render, saved) = match Cpu.forward(scene, &camera, options) {
        Ok(drawn) => drawn,
        Err(Error::Gaussians { what, .. }) => {
            assert!(what.starts_with("Gaussian"), "{what}");
            return false;
        }
        Err(other) => panic!("{other}"),
    };
    let pixels = [render.rgb.as_flattened(), &render.alpha, &render.depth];
    assert!(pixels.iter().all(|image| image.iter().all(|v| v.is_finite())), "{scene:?}");
    let gradients = RenderGradients {
        rgb: vec![[1.0, -0.5, 0.2]; render.rgb.len()],
        alpha: vec![0.3; render.rgb.len()],
        depth: vec![0.1; render.rgb.len()],
        ..RenderGradients::default()
    };
    let g = Cpu.backward(scene, &camera, options, &render, &saved, &gradients).unwrap();
    assert!(scenes::is_finite(&g), "{scene:?}");
    true
}

#[test]
fn a_number_that_is_not_finite_is_named() {
    let mut scene = scenes::cloud(6, 1, 5);
    scene.means[4][1] = f32::NAN;
    let error = Cpu.forward(&scene, &scenes::camera(50, 34), &low()).unwrap_err().to_string();
    assert!(error.contains("Gaussian 4"), "{error}");
}

#[test]
fn degenerate_ellipsoids_are_skipped_or_drawn_but_never_fatal() {
    for field in [0, 2, 7, 10, 11, 12] {
        for value in [0.0, 80.0, -80.0, 354.0, -1e30, 1e30, f32::MAX] {
            let mut scene = scenes::cloud(6, 1, 5);
            set(&mut scene, 2, field, value);
            assert!(draw(&scene, &low()), "field {field}, value {value}");
        }
    }
}

#[test]
fn thousands_of_huge_ellipsoids_are_drawn_in_time() {
    let mut scene = scenes::cloud(2000, 1, 5);
    scene.log_scales.fill([14.0; 3]);
    assert!(draw(&scene, &low()));
}

#[test]
fn an_empty_set_shows_the_background() {
    let mut options = low();
    options.background = [0.2, 0.4, 0.6];
    let scene = Gaussians::new(drex_splat::Kind::Ellipsoid, 1);
    let (render, saved) = Cpu.forward(&scene, &scenes::camera(50, 34), &options).unwrap();
    assert!(render.rgb.iter().all(|c| *c == [0.2, 0.4, 0.6]) && render.alpha.iter().all(|a| *a == 0.0));
    let gradients = RenderGradients { alpha: vec![1.0; render.alpha.len()], ..RenderGradients::default() };
    let g = Cpu.backward(&scene, &scenes::camera(50, 34), &options, &render, &saved, &gradients).unwrap();
    assert!(g.means.is_empty());
}

#[test]
fn a_gradient_of_another_size_is_refused() {
    let scene = scenes::cloud(6, 1, 5);
    let camera = scenes::camera(50, 34);
    let (render, saved) = Cpu.forward(&scene, &camera, &low()).unwrap();
    let gradients = RenderGradients { depth: vec![0.0; 7], ..RenderGradients::default() };
    let error = Cpu.backward(&scene, &camera, &low(), &render, &saved, &gradients).unwrap_err().to_string();
    assert!(error.contains("depth") && error.contains('7'), "{error}");
}

#[test]
fn a_backward_of_another_set_or_camera_is_refused() {
    let (scene, camera) = (scenes::cloud(6, 1, 5), scenes::camera(50, 34));
    let (render, saved) = Cpu.forward(&scene, &camera, &low()).unwrap();
    let refused = |scene: &Gaussians, width: usize| {
        let none = RenderGradients::default();
        Cpu.backward(scene, &scenes::camera(width, 34), &low(), &render, &saved, &none).unwrap_err().to_string()
    };
    let error = refused(&scenes::cloud(7, 1, 5), 50);
    assert!(error.contains("7 Gaussians") && error.contains("6 Gaussians"), "{error}");
    let error = refused(&scene, 51);
    assert!(error.contains("51 x 34"), "{error}");
}

fn low() -> RenderOptions {
    let mut options = RenderOptions::default();
    options.sh_degree = 1;
    options
}
