//! The same bytes with any number of threads, and from one run to the next.
#![allow(clippy::unwrap_used)]

mod scenes;

use drex_core::camera::PinholeCamera;
use drex_splat::{Cpu, GaussianGradients, Gaussians, Rasterizer, Render, RenderGradients, RenderOptions};

#[test]
fn ellipsoids_do_not_depend_on_the_number_of_threads() {
    let scene = scenes::cloud(800, 3, 7);
    let camera = scenes::camera(203, 151);
    let [one, two, again, many] = [1, 2, 2, 7].map(|threads| run(&scene, &camera, threads));
    assert!(one.0.alpha.iter().any(|a| *a > 0.9) && one.1.means.iter().flatten().any(|g| *g != 0.0));
    assert!(one == two && two == again && two == many);
}

fn run(scene: &Gaussians, camera: &PinholeCamera, threads: usize) -> (Render, GaussianGradients) {
    let mut options = RenderOptions::default();
    options.count = true;
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
        let (render, saved) = Cpu.forward(scene, camera, &options).unwrap();
        let gradients = RenderGradients {
            rgb: render.rgb.iter().map(|c| c.map(|v| (17.0 * v).sin())).collect(),
            alpha: render.alpha.iter().map(|a| (5.0 * a).cos()).collect(),
            depth: render.depth.iter().map(|d| 0.01 * d).collect(),
            ..RenderGradients::default()
        };
        let gradients = Cpu.backward(scene, camera, &options, &render, &saved, &gradients).unwrap();
        (render, gradients)
    })
}
