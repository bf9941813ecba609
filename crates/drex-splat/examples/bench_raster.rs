//! Time of drawing and of its derivative, in core-seconds (all threads together), so that other work on the machine
//! does not count.
//!
//! `DREX_SHARED=... cargo run --release -p drex-splat --example bench_raster [-- seconds per measurement [part of a name]]`
#![allow(clippy::unwrap_used, clippy::print_stdout)]

#[path = "../tests/support/mod.rs"]
mod support;

use std::path::Path;
use std::time::Instant;

use drex_core::pose::{pose_from_matrix, pose_from_wxyz};
use drex_splat::{Cpu, Gaussians, Kind, Label, PinholeCamera, Rasterizer, RenderGradients, RenderOptions};
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

/// Points with colours as Gaussians: round, as large as the distance to the three nearest.
fn from_points(points: &[([f32; 3], [u8; 3])], opacity: f32, sh_degree: usize) -> Gaussians {
    let mut scene = Gaussians::new(Kind::Ellipsoid, sh_degree);
    let spacing = nearest_three(&points.iter().map(|p| p.0).collect::<Vec<_>>());
    for ((mean, rgb), spacing) in points.iter().zip(spacing) {
        scene.means.push(*mean);
        scene.rotations.push([1.0, 0.0, 0.0, 0.0]);
        scene.log_scales.push([spacing.max(1e-7).ln(); 3]);
        scene.logit_opacities.push((opacity / (1.0 - opacity)).ln());
        let mut sh = vec![0.0; scene.sh_stride()];
        for c in 0..3 {
            sh[c] = (f32::from(rgb[c]) / 255.0 - 0.5) / 0.282_094_8;
        }
        scene.sh.extend(sh);
        scene.labels.push(Label::BACKGROUND);
    }
    scene
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

/// Root of the mean squared distance to the three nearest points, by a sweep along x.
fn nearest_three(points: &[[f32; 3]]) -> Vec<f32> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| points[a][0].total_cmp(&points[b][0]));
    let mut out = vec![0.0; points.len()];
    for (at, &i) in order.iter().enumerate() {
        let mut best = [f32::INFINITY; 3];
        let mut visit = |j: usize| {
            let d: f32 = (0..3).map(|k| (points[i][k] - points[j][k]).powi(2)).sum();
            if d < best[2] {
                best[2] = d;
                best.sort_by(f32::total_cmp);
            }
            (points[i][0] - points[j][0]).powi(2) < best[2]
        };
        let _ = order[at + 1..].iter().all(|&j| visit(j));
        let _ = order[..at].iter().rev().all(|&j| visit(j));
        out[i] = (best.iter().sum::<f32>() / 3.0).sqrt();
    }
    out
}

fn garden(path: &Path) -> (Gaussians, Vec<PinholeCamera>) {
    let arrays = support::parse_npz(&std::fs::read(path).unwrap());
    let values = |name: &str| &arrays[name].values;
    let mut points: Vec<([f32; 3], [u8; 3])> = values("means3d")
        .chunks(3)
        .zip(values("colors").chunks(3))
        .map(|(p, c)| ([p[0] as f32, p[1] as f32, p[2] as f32], [c[0] as u8, c[1] as u8, c[2] as u8]))
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
    (from_points(&points, 0.5, 0), cameras)
}

/// Points and cameras of a COLMAP model (PINHOLE, binary), the images made smaller by `factor`.
fn colmap(folder: &Path, factor: f64) -> (Gaussians, Vec<PinholeCamera>) {
    let read = |name: &str| Cursor(std::fs::read(folder.join("sparse/0").join(name)).unwrap(), 0);
    let mut file = read("cameras.bin");
    let mut intrinsics = std::collections::BTreeMap::new();
    for _ in 0..file.u64() {
        let (id, model) = (file.u32(), file.u32());
        assert_eq!(model, 1, "PINHOLE");
        let (width, height) = (file.u64() as usize, file.u64() as usize);
        intrinsics.insert(id, (width, height, [file.f64(), file.f64(), file.f64(), file.f64()]));
    }
    let mut file = read("images.bin");
    let mut cameras = Vec::new();
    for _ in 0..file.u64() {
        file.u32();
        let q = [file.f64(), file.f64(), file.f64(), file.f64()];
        let t = [file.f64(), file.f64(), file.f64()];
        let (width, height, [fx, fy, cx, cy]) = intrinsics[&file.u32()];
        while file.take::<1>() != [0] {}
        file.1 += 24 * file.u64() as usize;
        let camera_from_world = pose_from_wxyz(t, q).unwrap();
        let camera = PinholeCamera { camera_from_world, fx, fy, cx, cy, width, height };
        cameras.push(camera.resized((width as f64 * factor) as usize, (height as f64 * factor) as usize));
    }
    let mut file = read("points3D.bin");
    let mut points = Vec::new();
    for _ in 0..file.u64() {
        file.u64();
        let mean = [file.f64() as f32, file.f64() as f32, file.f64() as f32];
        points.push((mean, file.take::<3>()));
        file.f64();
        file.1 += 8 * file.u64() as usize;
    }
    (from_points(&points, 0.1, 3), cameras)
}

/// Bytes and a place in them.
struct Cursor(Vec<u8>, usize);

impl Cursor {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        self.1 += N;
        self.0[self.1 - N..self.1].try_into().unwrap()
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.take())
    }

    fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.take())
    }
}
