//! Drawing and its derivative on a made-up cloud. `examples/bench_raster.rs` measures core-seconds on real scenes.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "../tests/scenes/mod.rs"]
mod scenes;

use criterion::{Criterion, criterion_group, criterion_main};
use drex_splat::{Cpu, Rasterizer, RenderGradients, RenderOptions};

fn ellipsoids(c: &mut Criterion) {
    let scene = scenes::cloud(4000, 3, 1);
    let camera = scenes::camera(480, 360);
    let options = RenderOptions::default();
    let (render, saved) = Cpu.forward(&scene, &camera, &options).unwrap();
    let gradients =
        RenderGradients { rgb: render.rgb.iter().map(|c| c.map(|v| v - 0.5)).collect(), ..RenderGradients::default() };
    let mut group = c.benchmark_group("ellipsoids, 4000, 480x360");
    group.sample_size(20);
    group.bench_function("forward", |b| b.iter(|| Cpu.forward(&scene, &camera, &options).unwrap()));
    group.bench_function("backward", |b| {
        b.iter(|| Cpu.backward(&scene, &camera, &options, &render, &saved, &gradients).unwrap());
    });
    group.finish();
}

criterion_group!(benches, ellipsoids);
criterion_main!(benches);
