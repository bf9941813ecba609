//! The kernels with every set of instructions this machine has, against plain arithmetic.
#![allow(clippy::unwrap_used)]

use pulp::Simd;
use rand::{RngExt, SeedableRng};

use super::super::lanes::PIXELS;
use super::forward::Splat;
use super::*;
use crate::{Kind, Label};

fn scene(n: usize) -> Gaussians {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    let mut between = |low: f32, high: f32| low + (high - low) * rng.random::<f32>();
    let mut scene = Gaussians::new(Kind::Surfel, 0);
    for k in 0..n {
        let z = 2.0 + 0.02 * k as f32;
        scene.means.push([z * between(-0.7, 0.7), z * between(-0.7, 0.7), z]);
        scene.rotations.push([between(0.5, 1.0), between(-0.5, 0.5), between(-0.5, 0.5), between(-1.0, 1.0)]);
        scene.log_scales.push([between(-3.5, -0.5), between(-3.5, -0.5), 0.0]);
        scene.logit_opacities.push(between(-4.0, 1.0));
        scene.sh.extend([between(-1.0, 1.0), between(-1.0, 1.0), between(-1.0, 1.0)]);
        scene.labels.push(Label::OBJECT);
    }
    scene
}

/// Sums, blocks and records of one tile, drawn and differentiated.
fn run<S: Simd>(simd: S, options: &RenderOptions) -> (Box<TileSums>, Vec<u16>, Vec<Record>) {
    let camera = PinholeCamera {
        camera_from_world: drex_core::Pose::identity(),
        fx: 14.0,
        fy: 16.0,
        cx: 8.0,
        cy: 8.0,
        width: TILE,
        height: TILE,
    };
    let view = View::new(&camera, options);
    let scene = scene(120);
    let projected: Vec<Projected> =
        (0..scene.len()).filter_map(|i| view.project(&scene, i)).map(|(projected, _)| projected).collect();
    let list: Vec<u32> = (0..projected.len() as u32).collect();
    let (mut sums, mut blocks, mut splats) = (Box::new(TileSums::ZERO), vec![0; list.len()], Vec::<Splat>::new());
    let tile = Draw {
        projected: &projected,
        list: &list,
        corner: [0.0; 2],
        scratch: &mut splats,
        blocks: &mut blocks,
        rules: view.rules(),
        sums: &mut sums,
    };
    Simd::vectorize(simd, tile);
    let wave = |k: f32| Plane(std::array::from_fn(|p| (k * p as f32).sin()));
    let gradients = TileGradients {
        rgb: [wave(0.11), wave(0.07), wave(0.19)],
        alpha: wave(0.05),
        depth: wave(0.13),
        normal: [wave(0.17), wave(0.03), wave(0.23)],
        median: wave(0.29),
        distortion: wave(0.31),
    };
    let mut records = vec![Record::default(); list.len()];
    let tile = Differentiate {
        splats: &splats,
        blocks: &blocks,
        rules: view.rules(),
        sums: &sums,
        gradients: &gradients,
        records: &mut records,
    };
    Simd::vectorize(simd, tile);
    (sums, blocks, records)
}

#[test]
fn every_set_of_instructions_gives_the_same_tile() {
    for (geometry, smooth_cutoff) in [(true, false), (true, true), (false, false)] {
        let options = RenderOptions { geometry, smooth_cutoff, ..RenderOptions::default() };
        let plain = run(pulp::Scalar::new(), &options);
        assert!(plain.0.count.0.iter().sum::<f32>() > 5.0 * PIXELS as f32, "many splats a pixel");
        let compare = |name: &str, (sums, blocks, records): (Box<TileSums>, Vec<u16>, Vec<Record>)| {
            assert_eq!(plain.0.count.0, sums.count.0, "{name}");
            assert_eq!(plain.0.median_at.0, sums.median_at.0, "{name}");
            assert_eq!(plain.1, blocks, "{name}");
            for p in 0..PIXELS {
                let near =
                    |a: &Plane, b: &Plane| assert!((a.0[p] - b.0[p]).abs() <= 1e-5 * (1.0 + a.0[p].abs()), "{name}");
                near(&plain.0.alpha, &sums.alpha);
                near(&plain.0.depth, &sums.depth);
                near(&plain.0.m2, &sums.m2);
                near(&plain.0.rgb[1], &sums.rgb[1]);
                near(&plain.0.normal[2], &sums.normal[2]);
            }
            for (a, b) in plain.2.iter().zip(&records) {
                let near = |a: &[f32], b: &[f32]| {
                    let size = a.iter().fold(0.1, |s: f32, v| s.max(v.abs()));
                    a.iter().zip(b).for_each(|(x, y)| assert!((x - y).abs() <= 1e-4 * size, "{name}: {x} {y}"));
                };
                near(&a.m, &b.m);
                near(&a.abs, &b.abs);
                near(&a.colour, &b.colour);
                near(&a.normal, &b.normal);
                near(&[a.log_opacity, a.depth], &[b.log_opacity, b.depth]);
            }
        };
        #[cfg(target_arch = "x86_64")]
        {
            if let Some(v3) = pulp::x86::V3::try_new() {
                compare("AVX2", run(v3, &options));
            }
            if let Some(v4) = pulp::x86::V4::try_new() {
                compare("AVX-512", run(v4, &options));
            }
        }
        #[cfg(target_arch = "aarch64")]
        if let Some(neon) = pulp::aarch64::Neon::try_new() {
            compare("NEON", run(neon, &options));
        }
    }
}
