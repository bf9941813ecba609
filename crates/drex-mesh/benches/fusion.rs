//! Time of one fusion: a ball from 20 views of 320 x 240 pixels.
#![allow(missing_docs, clippy::unwrap_used)] // a benchmark

use criterion::{Criterion, criterion_group, criterion_main};
use drex_core::TriMesh;
use drex_core::mesh::convex_hull;
use drex_mesh::{DepthCamera, DepthMap, FusionOptions, cast_depth, fuse};
use nalgebra::{Isometry3, Point3, Vector3};

/// Points spread evenly over the unit sphere (Fibonacci).
fn directions(count: usize) -> Vec<Vector3<f64>> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..count)
        .map(|i| {
            let z = 1.0 - (2 * i + 1) as f64 / count as f64;
            let (sin, cos) = (golden * i as f64).sin_cos();
            Vector3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
        })
        .collect()
}

fn run(c: &mut Criterion) {
    let ball: TriMesh =
        convex_hull(&directions(500).iter().map(|d| Point3::from(d * 0.04)).collect::<Vec<_>>()).unwrap();
    let camera = DepthCamera { width_px: 320, height_px: 240, fx_px: 400.0, fy_px: 400.0, cx_px: 160.0, cy_px: 120.0 };
    let views: Vec<DepthMap> = directions(20)
        .iter()
        .map(|d| {
            let pose =
                Isometry3::face_towards(&Point3::from(d * 0.3), &Point3::origin(), &Vector3::new(1e-3, 0.0, -1.0));
            cast_depth(&ball, &camera, &pose)
        })
        .collect();
    let mut options = FusionOptions::default();
    options.background_is_empty = true;
    options.voxel_m = Some(1.5e-3);
    c.bench_function("fuse 20 views of a ball, 1.5 mm", |b| b.iter(|| fuse(&views, &options).unwrap()));
}

criterion_group!(benches, run);
criterion_main!(benches);
