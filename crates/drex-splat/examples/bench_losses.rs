//! Core-milliseconds of one evaluation of each loss with its derivative, and of one step of Adam:
//! `cargo run --release -p drex-splat --example bench_losses [THREADS]`. Processor time is read from `/proc` (Linux).
#![allow(clippy::print_stdout, clippy::unwrap_used)]

use std::hint::black_box;
use std::time::Instant;

use drex_core::camera::PinholeCamera;
use drex_splat::Render;
use drex_splat::loss::{
    DepthOptions, DepthTarget, Exposure, MaskMode, PhotometricOptions, SurfaceOptions, SurfaceTarget, Target, depth,
    photometric, surface,
};
use drex_splat::optim::{Moments, adam_step};

fn main() {
    let threads = std::env::args().nth(1).map_or(1, |n| n.parse().unwrap());
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().unwrap();
    // glibc gives freed memory back to the system above a threshold that follows the largest block ever freed. A block
    // this large keeps the images of every evaluation in the process, as they are in training: else their pages are
    // mapped anew each time, which costs up to as much as the losses.
    drop(black_box(vec![0_u8; 31 << 20]));
    println!("{threads} threads, core-ms (wall ms) an evaluation");
    for (width, height) in [(480, 360), (504, 504), (1920, 1080)] {
        images(width, height);
    }
    let n = 59 * 12_000;
    let (mut params, grads, mut moments) = (vec![0.1; n], vec![1e-4; n], Moments::new(59, 12_000));
    let mut t = 0;
    measure("Adam, 12 000 Gaussians of 59 numbers", || {
        t += 1;
        adam_step(&mut params, &grads, &mut moments, &[1e-3; 59], t).unwrap();
    });
}

fn images(width: usize, height: usize) {
    let n = width * height;
    let wave =
        |i: usize, k: usize| 0.5 + 0.4 * ((i % width) as f32 * 0.11 + (i / width) as f32 * 0.07 + k as f32).sin();
    let render = Render {
        width,
        height,
        rgb: (0..n).map(|i| [0, 1, 2].map(|k| wave(i, k))).collect(),
        alpha: (0..n).map(|i| wave(i, 3)).collect(),
        depth: (0..n).map(|i| wave(i, 3) * (2.0 + wave(i, 4))).collect(),
        normal: (0..n).map(|i| [0.1 * wave(i, 5), 0.1, -0.8]).collect(),
        median_depth: (0..n).map(|i| 2.0 + wave(i, 4)).collect(),
        distortion: vec![1e-4; n],
        count: vec![],
    };
    let photo: Vec<[u8; 3]> = (0..n).map(|i| [1, 2, 3].map(|k| (255.0 * wave(i, k)) as u8)).collect();
    let mask: Vec<u8> = (0..n).map(|i| if wave(i, 6) > 0.5 { 255 } else { 0 }).collect();
    let (w, h) = (width as f64, height as f64);
    let camera_from_world = drex_core::Pose::identity();
    let camera = PinholeCamera { camera_from_world, fx: w, fy: w, cx: w / 2.0, cy: h / 2.0, width, height };
    println!("{width} x {height}");
    let exposure = Exposure::default();
    for (name, mode, exposure, ignore_band) in [
        ("L1 and SSIM", MaskMode::Off, None, 0),
        ("the same, exposure", MaskMode::Off, Some(&exposure), 0),
        ("the same, masked", MaskMode::Masked, None, 0),
        ("the same, transparent, band 2 px", MaskMode::Transparent, None, 2),
    ] {
        let target = Target { name: "bench", rgb: &photo, mask: Some(&mask), exposure };
        let options = PhotometricOptions { mask: mode, ignore_band, ..Default::default() };
        measure(name, || drop(black_box(photometric(&render, &target, &options).unwrap())));
    }
    let target = SurfaceTarget { mask: Some(&mask), ..Default::default() };
    let options = SurfaceOptions { median_share: 0.5, ..Default::default() };
    measure("surface", || drop(black_box(surface(&render, &camera, &target, &options).unwrap())));
    let target = DepthTarget { dense: Some(&render.median_depth), ..Default::default() };
    measure("depth", || drop(black_box(depth(&render, &target, &DepthOptions::default()).unwrap())));
}

fn measure(name: &str, mut work: impl FnMut()) {
    (0..3).for_each(|_| work());
    let (cpu, wall) = (cpu_seconds(), Instant::now());
    let mut count = 0.0;
    while cpu_seconds() - cpu < 0.6 && wall.elapsed().as_secs_f64() < 20.0 {
        (0..5).for_each(|_| work());
        count += 5.0;
    }
    let (cpu, wall) = (cpu_seconds() - cpu, wall.elapsed().as_secs_f64());
    println!("  {name:40} {:7.2} ({:.2})", 1e3 * cpu / count, 1e3 * wall / count);
}

/// Processor seconds of all threads so far, in steps of a hundredth.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let ticks = stat.rsplit(") ").next().unwrap_or_default().split(' ').skip(11).take(2);
    ticks.filter_map(|t| t.parse::<f64>().ok()).sum::<f64>() / 100.0
}
