//! Time of dividing a cup into convex parts, and of scoring them.
#![allow(missing_docs, clippy::unwrap_used)] // a benchmark

use criterion::{Criterion, criterion_group, criterion_main};
use drex_core::TriMesh;
use drex_mesh::{PartitionOptions, convex_parts, union_distance};
use nalgebra::Point3;

/// A square cup of 80 mm with walls of 10 mm.
fn cup() -> TriMesh {
    let (outer, inner) = ([[-0.04, 0.0], [0.04, 0.06]], [[-0.03, 0.01], [0.03, 0.06]]);
    let corner = |b: [[f64; 2]; 2], i: usize| Point3::new(b[i & 1][0], b[i >> 1 & 1][0], b[i >> 2][1]);
    let vertices = (0..16).map(|i| corner(if i < 8 { outer } else { inner }, i % 8)).collect();
    let sides: [[u32; 4]; 5] = [[0, 2, 3, 1], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let mut faces = Vec::new();
    for [a, b, c, d] in sides {
        faces.extend([[a, b, c], [a, c, d], [a + 8, c + 8, b + 8], [a + 8, d + 8, c + 8]]);
    }
    for (a, b) in [(4, 5), (5, 7), (7, 6), (6, 4)] {
        faces.extend([[a, b, b + 8], [a, b + 8, a + 8]]);
    }
    TriMesh { vertices, faces }
}

fn run(c: &mut Criterion) {
    let mesh = cup();
    let options = PartitionOptions::default();
    let pieces = convex_parts(&mesh, &options).unwrap();
    let mut group = c.benchmark_group("partition");
    group.sample_size(10);
    group.bench_function("square cup", |b| b.iter(|| convex_parts(&mesh, &options).unwrap()));
    group.bench_function("score, 10,000 samples", |b| b.iter(|| union_distance(&mesh, &pieces, 10_000, 1).unwrap()));
    group.finish();
}

criterion_group!(benches, run);
criterion_main!(benches);
