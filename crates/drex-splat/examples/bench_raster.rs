//! Time of drawing and of its derivative, in core-seconds (all threads together), so that other work on the machine
//! does not count.
//!
//! `DREX_SHARED=... cargo run --release -p drex-splat --example bench_raster [-- seconds per measurement [part of a name]]`
#![allow(clippy::unwrap_used, clippy::print_stdout)]

#[path = "../tests/support/mod.rs"]
mod support;

use std::path::Path;
use std::time::Instant;

use drex_core::camera::PinholeCamera;
use drex_core::capture::{Capture, CaptureOptions};
use drex_core::pose::pose_from_matrix;
use drex_splat::train::from_points;
use drex_splat::{Cpu, Gaussians, Kind, Rasterizer, RenderGradients, RenderOptions};
use rand::SeedableRng;
use rand::seq::SliceRandom;

fn main() {
    let seconds: f64 = std::env::args().nth(1).map_or(3.0, |s| s.parse().unwrap());
    let part = std::env::args().nth(2).unwrap_or_default();
    let Some(scans) = support::shared("scans") else { return };
    let cases = [
        ("mouse56 480x360", colmap(&scans.join("mouse56"), 0.5), true),
        ("alexander54 504x504", colmap(&scans.join("alexander54"), 0.5), true),
        ("surfels, mouse56 480x360", surfels(colmap(&scans.join("mouse56"), 0.5)), true),
        ("surfels, alexander54 504x504", surfels(colmap(&scans.join("alexander54"), 0.5)), true),
        ("garden, 100 k, 640x480", garden(&scans.join("garden_points/test_garden.npz")), false),
    ];
    println!("core-milliseconds a picture (wall in brackets)");
    for (name, (scene, cameras), train) in cases.iter().filter(|case| case.0.contains(&part)) {
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let line = pool.install(|| measure(scene, cameras, *train, seconds));
            println!("{name}, {} Gaussians, {threads} threads: {line}", scene.len());
        }
    }
}

fn measure(scene: &Gaussians, cameras: &[PinholeCamera], train: bool, seconds: f64) -> String {
    let mut options = RenderOptions::default();
    options.sh_degree = scene.sh_degree;
    let forward = timed(seconds, cameras, |camera| {
        Cpu.forward(scene, camera, &options).unwrap();
    });
    if !train {
        return format!("forward {forward}");
    }
    let both = timed(seconds, cameras, |camera| {
        let (render, saved) = Cpu.forward(scene, camera, &options).unwrap();
        // A gradient of the size of a photometric one.
        let pixels = render.rgb.len() as f32;
        let gradients = RenderGradients {
            rgb: render.rgb.iter().map(|c| c.map(|v| (v - 0.5) / pixels)).collect(),
            normal: render.normal.iter().map(|n| n.map(|v| v / pixels)).collect(),
            median_depth: render.median_depth.iter().map(|z| z / pixels).collect(),
            distortion: render.distortion.iter().map(|_| 1.0 / pixels).collect(),
            ..RenderGradients::default()
        };
        Cpu.backward(scene, camera, &options, &render, &saved, &gradients).unwrap();
    });
    format!("forward {forward}, forward and backward {both}")
}

/// Repeats until the time is over, camera by camera; CPU and wall milliseconds a call.
fn timed(seconds: f64, cameras: &[PinholeCamera], mut work: impl FnMut(&PinholeCamera)) -> String {
    work(&cameras[0]);
    let (start, cpu, mut calls) = (Instant::now(), cpu_seconds(), 0.0);
    while start.elapsed().as_secs_f64() < seconds {
        for camera in cameras {
            work(camera);
            calls += 1.0;
        }
    }
    let wall = start.elapsed().as_secs_f64();
    format!("{:.2} ({:.2})", 1e3 * (cpu_seconds() - cpu) / calls, 1e3 * wall / calls)
}

/// CPU time of all threads of this process.
fn cpu_seconds() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").unwrap();
    let nanoseconds = |task: std::fs::DirEntry| -> f64 {
        let text = std::fs::read_to_string(task.path().join("schedstat")).unwrap_or_default();
        text.split(' ').next().and_then(|s| s.parse().ok()).unwrap_or(0.0)
    };
    tasks.map(|task| nanoseconds(task.unwrap())).sum::<f64>() * 1e-9
}

/// The same as discs that face all ways.
fn surfels((mut scene, cameras): (Gaussians, Vec<PinholeCamera>)) -> (Gaussians, Vec<PinholeCamera>) {
    scene.kind = Kind::Surfel;
    for (i, q) in scene.rotations.iter_mut().enumerate() {
        let k = i as f32;
        *q = [0.1 + (0.37 * k).sin().abs(), (1.7 * k).sin(), (2.3 * k).cos(), (3.1 * k).sin()];
    }
    (scene, cameras)
}

fn garden(path: &Path) -> (Gaussians, Vec<PinholeCamera>) {
    let arrays = support::parse_npz(&std::fs::read(path).unwrap());
    let values = |name: &str| &arrays[name].values;
    let mut points: Vec<([f64; 3], [u8; 3])> = values("means3d")
        .chunks(3)
        .zip(values("colors").chunks(3))
        .map(|(p, c)| ([p[0], p[1], p[2]], [c[0] as u8, c[1] as u8, c[2] as u8]))
        .collect();
    points.shuffle(&mut rand_chacha::ChaCha8Rng::seed_from_u64(0));
    points.truncate(100_000);
    let (width, height) = (values("width")[0], values("height")[0]);
    let cameras = values("viewmats")
        .chunks(16)
        .zip(values("Ks").chunks(9))
        .map(|(view, k)| {
            let camera = PinholeCamera {
                camera_from_world: pose_from_matrix(&nalgebra::Matrix4::from_row_slice(view)).unwrap(),
                fx: k[0],
                fy: k[4],
                cx: k[2],
                cy: k[5],
                width: width as usize,
                height: height as usize,
            };
            camera.resized(640, 480)
        })
        .collect();
    let (points, colours): (Vec<_>, Vec<_>) = points.into_iter().unzip();
    (from_points(&points, &colours, Kind::Ellipsoid, 0, 0.5), cameras)
}

/// Sparse points and cameras of a scan, its pictures made smaller by `factor`.
fn colmap(folder: &Path, factor: f64) -> (Gaussians, Vec<PinholeCamera>) {
    let capture = Capture::load(folder, &CaptureOptions::default()).unwrap();
    let smaller = |side: usize| (side as f64 * factor) as usize;
    let camera = |i| {
        let camera = capture.pinhole(i, None).unwrap();
        camera.resized(smaller(camera.width), smaller(camera.height))
    };
    let (points, colours): (Vec<_>, Vec<_>) = capture.points.iter().map(|p| (p.position, p.rgb)).unzip();
    let scene = from_points(&points, &colours, Kind::Ellipsoid, 3, 0.1);
    (scene, (0..capture.views.len()).map(camera).collect())
}
