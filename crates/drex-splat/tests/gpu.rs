//! The backend on the GPU against the golden arrays, and against itself.
#![cfg(feature = "wgpu")]
#![allow(clippy::unwrap_used)]

mod goldens;
mod scenes;
mod support;

use std::sync::OnceLock;

use drex_core::camera::PinholeCamera;
use drex_splat::raster::{DepthKind, Gpu};
use drex_splat::{Cpu, Error, GaussianGradients, Gaussians, Kind, Rasterizer, Render, RenderGradients, RenderOptions};
use nalgebra::{Point3, Quaternion, UnitQuaternion, Vector3};

/// One GPU for all tests; without an adapter prints why and gives `None`, unless DREX_REQUIRE_GPU is set.
fn gpu() -> Option<&'static Gpu> {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    GPU.get_or_init(|| match Gpu::new() {
        Ok(gpu) => {
            eprintln!("drawing with {}", gpu.adapter_name());
            Some(gpu)
        }
        Err(e) => {
            assert!(std::env::var_os("DREX_REQUIRE_GPU").is_none(), "{e}");
            eprintln!("skipped: {e}");
            None
        }
    })
    .as_ref()
}

#[test]
fn smooth_ellipsoids() {
    let Some(gpu) = gpu() else { return };
    goldens::ellipsoids(gpu, "3dgs_a");
}

#[test]
fn smooth_ellipsoids_with_compensated_opacity() {
    let Some(gpu) = gpu() else { return };
    goldens::ellipsoids(gpu, "3dgs_a_antialias");
}

#[test]
fn dense_ellipsoids_that_stop_and_clamp() {
    let Some(gpu) = gpu() else { return };
    goldens::ellipsoids(gpu, "3dgs_b");
}

#[test]
fn ellipsoids_of_a_garden() {
    let Some(gpu) = gpu() else { return };
    goldens::ellipsoids(gpu, "3dgs_c_garden");
}

#[test]
fn few_surfels() {
    let Some(gpu) = gpu() else { return };
    goldens::surfels(gpu, "2dgs_d", DepthKind::Centre);
    goldens::surfels(gpu, "2dgs_d", DepthKind::Ray);
}

#[test]
fn few_surfels_with_distortion_in_the_loss() {
    let Some(gpu) = gpu() else { return };
    goldens::surfels(gpu, "2dgs_d_paper", DepthKind::Ray);
}

#[test]
fn many_small_surfels() {
    let Some(gpu) = gpu() else { return };
    goldens::surfels(gpu, "2dgs_e", DepthKind::Centre);
    goldens::surfels(gpu, "2dgs_e", DepthKind::Ray);
}

/// Limit between single precision on two machines, relative to the largest entry: sums in another order.
const AGREEMENT: f64 = 1e-4;

#[test]
fn agrees_with_the_processor_on_ellipsoids() {
    let Some(gpu) = gpu() else { return };
    let scene = scenes::cloud(3000, 3, 11);
    for (antialias, smooth_cutoff, sh_degree) in [(false, false, 3), (true, true, 1), (false, true, 0)] {
        let mut options = options();
        (options.antialias, options.smooth_cutoff, options.sh_degree) = (antialias, smooth_cutoff, sh_degree);
        agree(gpu, &scene, &scenes::camera(163, 121), &options);
    }
}

#[test]
fn agrees_with_the_processor_on_surfels() {
    let Some(gpu) = gpu() else { return };
    let camera = scenes::camera(163, 121);
    let scene = surfels_seen_from_the_front(3000, 12, &camera);
    for (depth, geometry, smooth_cutoff) in
        [(DepthKind::Ray, true, false), (DepthKind::Centre, false, true), (DepthKind::Ray, true, true)]
    {
        let mut options = options();
        (options.depth, options.geometry, options.smooth_cutoff) = (depth, geometry, smooth_cutoff);
        agree(gpu, &scene, &camera, &options);
    }
}

/// Discs that the camera's plane cuts, and long thin ones: none may lose a pixel to its bounds.
#[test]
fn surfels_round_the_camera() {
    let Some(gpu) = gpu() else { return };
    let mut camera = scenes::camera(163, 121);
    camera.camera_from_world.translation.vector.z = 0.3;
    let mut scene = surfels_seen_from_the_front(800, 13, &camera);
    for (i, scales) in scene.log_scales.iter_mut().enumerate() {
        *scales = [scales[0] + 1.0, scales[1] - (i % 4) as f32, 0.0];
    }
    agree(gpu, &scene, &camera, &options());
}

#[test]
fn the_same_bytes_again() {
    let Some(gpu) = gpu() else { return };
    for scene in [scenes::cloud(2000, 2, 21), surfels(2000, 22)] {
        let camera = scenes::camera(150, 100);
        let [a, b] = [(); 2].map(|()| draw(gpu, &scene, &camera, &options(), |_| true));
        assert!(a == b);
    }
}

#[test]
fn an_empty_set_shows_the_background() {
    let Some(gpu) = gpu() else { return };
    for kind in [Kind::Ellipsoid, Kind::Surfel] {
        let (render, gradients) = draw(gpu, &Gaussians::new(kind, 1), &scenes::camera(50, 34), &options(), |_| true);
        assert!(render.rgb.iter().all(|c| *c == options().background) && render.alpha.iter().all(|a| *a == 0.0));
        assert!(gradients.means.is_empty() && gradients.twist == [0.0; 6]);
    }
}

#[test]
fn degenerate_gaussians_give_finite_results_or_a_named_error() {
    let Some(gpu) = gpu() else { return };
    let special = [0.0, 1e-45, 1e20, 80.0, -80.0, -1e30, f32::MAX, f32::NEG_INFINITY, f32::NAN];
    for (field, value) in (0..15).flat_map(|field| special.map(|value| (field, value))) {
        for mut scene in [scenes::cloud(6, 1, 5), surfels(6, 5)] {
            set(&mut scene, field, value);
            match gpu.forward(&scene, &scenes::camera(50, 34), &options()) {
                Ok(_) => {
                    let (render, gradients) = draw(gpu, &scene, &scenes::camera(50, 34), &options(), |_| true);
                    for (name, values) in images(&render).into_iter().chain(parts(&gradients)) {
                        assert!(values.iter().all(|v| v.is_finite()), "{name}: field {field} is {value}");
                    }
                }
                Err(Error::Gaussians { what, .. }) => assert!(what.starts_with("Gaussian"), "{what}"),
                Err(other) => panic!("{other}"),
            }
        }
    }
}

#[test]
fn what_does_not_fit_is_named() {
    let Some(gpu) = gpu() else { return };
    // Images of a thousand megapixels are larger than a buffer of any adapter.
    let scene = scenes::cloud(1, 0, 5);
    let side = PinholeCamera::MAX_SIDE;
    let error = gpu.forward(&scene, &scenes::camera(side, side), &options()).unwrap_err().to_string();
    assert!(error.contains("bytes") && error.contains("holds at most"), "{error}");
}

#[test]
fn a_backward_pass_of_another_set_is_refused() {
    let Some(gpu) = gpu() else { return };
    let (scene, camera) = (scenes::cloud(20, 0, 5), scenes::camera(50, 34));
    let (render, saved) = gpu.forward(&scene, &camera, &options()).unwrap();
    let other = scenes::cloud(21, 0, 5);
    let gradients = RenderGradients::default();
    let error = gpu.backward(&other, &camera, &options(), &render, &saved, &gradients).unwrap_err().to_string();
    assert!(error.contains("21 Gaussians") && error.contains("20 Gaussians"), "{error}");
}

fn set(scene: &mut Gaussians, field: usize, value: f32) {
    match field {
        0..3 => scene.means[2][field] = value,
        3..7 => scene.rotations[2][field - 3] = value,
        7..10 => scene.log_scales[2][field - 7] = value,
        10 => scene.logit_opacities[2] = value,
        11 => scene.rotations[2] = [value; 4],
        12 => scene.log_scales[2] = [value; 3],
        13 => scene.means[2] = [value; 3],
        _ => scene.sh[2 * 12 + 1] = value,
    }
}

fn surfels(n: usize, seed: u64) -> Gaussians {
    Gaussians { kind: Kind::Surfel, ..scenes::cloud(n, 3, seed) }
}

/// Without those whose plane almost passes through the camera: where its ray meets them is not known to six digits.
fn surfels_seen_from_the_front(n: usize, seed: u64, camera: &PinholeCamera) -> Gaussians {
    let scene = surfels(n, seed);
    scene.filtered(|i| {
        let [w, x, y, z] = scene.rotations[i].map(f64::from);
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        let sight = Point3::from(scene.means[i].map(f64::from)) - camera.centre();
        (rotation * Vector3::z()).dot(&sight).abs() > 0.1 * sight.norm()
    })
}

fn options() -> RenderOptions {
    let mut options = RenderOptions::default();
    options.background = [0.2, 0.4, 0.6];
    options.count = true;
    options
}

/// Draws, and differentiates by a loss that looks at the pixels for which `counts` is true.
fn draw<R: Rasterizer>(
    raster: &R,
    scene: &Gaussians,
    camera: &PinholeCamera,
    options: &RenderOptions,
    counts: impl Fn(usize) -> bool,
) -> (Render, GaussianGradients) {
    let (render, saved) = raster.forward(scene, camera, options).unwrap();
    let wave = |f: f32, i: usize| if counts(i) { (f * i as f32).sin() } else { 0.0 };
    let image = |f: f32| (0..render.alpha.len()).map(|i| wave(f, i)).collect::<Vec<_>>();
    let threes = |f: f32| (0..render.alpha.len()).map(|i| [f, f + 0.3, f + 0.7].map(|f| wave(f, i))).collect();
    let surface = !render.normal.is_empty();
    let gradients = RenderGradients {
        rgb: threes(0.11),
        alpha: image(0.05),
        depth: image(0.017),
        normal: if surface { threes(0.07) } else { Vec::new() },
        median_depth: if surface { image(0.19) } else { Vec::new() },
        distortion: if surface { image(0.031) } else { Vec::new() },
    };
    let gradients = raster.backward(scene, camera, options, &render, &saved, &gradients).unwrap();
    (render, gradients)
}

fn agree(gpu: &Gpu, scene: &Gaussians, camera: &PinholeCamera, options: &RenderOptions) {
    // A splat at the cut, or a pixel that stops, may fall on the other side on another machine: such pixels are left out.
    let [ours, theirs] =
        [gpu.forward(scene, camera, options).unwrap().0, Cpu.forward(scene, camera, options).unwrap().0]
            .map(|render| render.count);
    let off = ours.iter().zip(&theirs).filter(|(a, b)| a != b).count();
    assert!(off <= ours.len() / 1000, "{off} pixels with another count");
    let same = |i: usize| ours[i] == theirs[i];
    let (render, by_ours) = draw(gpu, scene, camera, options, same);
    let (theirs, by_theirs) = draw(&Cpu, scene, camera, options, same);
    let pixels = render.alpha.len();
    for ((name, ours), (_, theirs)) in images(&render).into_iter().zip(images(&theirs)) {
        compare(scene.kind, name, &ours, &theirs, |i| same(i / (ours.len() / pixels)));
    }
    for ((name, ours), (_, theirs)) in parts(&by_ours).into_iter().zip(parts(&by_theirs)) {
        compare(scene.kind, name, &ours, &theirs, |_| true);
    }
    // A box whose corner alone is in the image may count as drawn or not.
    for (ours, theirs) in by_ours.radius.iter().zip(&by_theirs.radius).filter(|(a, b)| **a > 0.0 && **b > 0.0) {
        assert!((ours - theirs).abs() < 0.05 * theirs + 0.1, "radius {ours} {theirs}");
    }
}

fn compare(kind: Kind, name: &str, ours: &[f64], theirs: &[f64], counts: impl Fn(usize) -> bool) {
    assert_eq!(ours.len(), theirs.len(), "{name}");
    let largest = theirs.iter().fold(1e-30_f64, |m, v| m.max(v.abs()));
    let off = (0..ours.len()).filter(|&i| counts(i)).map(|i| (ours[i] - theirs[i]).abs()).fold(0.0, f64::max) / largest;
    eprintln!("{kind:?} {name}: {off:.1e} of the largest, {largest:.1e}");
    assert!(off < AGREEMENT, "{kind:?} {name}: {off:.1e} of the largest");
}

fn images(render: &Render) -> Vec<(&'static str, Vec<f64>)> {
    let doubles = |values: &[f32]| values.iter().map(|v| f64::from(*v)).collect();
    vec![
        ("rgb", doubles(render.rgb.as_flattened())),
        ("alpha", doubles(&render.alpha)),
        ("depth", doubles(&render.depth)),
        ("normal", doubles(render.normal.as_flattened())),
        ("median_depth", doubles(&render.median_depth)),
        ("distortion", doubles(&render.distortion)),
    ]
}

fn parts(gradients: &GaussianGradients) -> Vec<(&'static str, Vec<f64>)> {
    let doubles = |values: &[f32]| values.iter().map(|v| f64::from(*v)).collect();
    vec![
        ("means", doubles(gradients.means.as_flattened())),
        ("rotations", doubles(gradients.rotations.as_flattened())),
        ("log_scales", doubles(gradients.log_scales.as_flattened())),
        ("logit_opacities", doubles(&gradients.logit_opacities)),
        ("sh", doubles(&gradients.sh)),
        ("mean2d", doubles(gradients.mean2d.as_flattened())),
        ("abs_mean2d", doubles(gradients.abs_mean2d.as_flattened())),
        ("twist", gradients.twist.to_vec()),
    ]
}
