//! The kernels with every set of instructions this machine has, against each other and against plain arithmetic.
#![allow(clippy::unwrap_used)]

use pulp::{Simd, WithSimd};
use rand::{RngExt, SeedableRng};

use super::super::lanes::{BLOCK, Lanes, place};
use super::forward::Broadcast;
use super::*;

const LEAST: f32 = -7.994_353_4;

/// Needles and discs of all sizes about a tile at the image's corner, nearest first.
fn splats(n: usize) -> Vec<Splat> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
    let mut between = |low: f32, high: f32| low + (high - low) * rng.random::<f32>();
    (0..n)
        .map(|k| {
            let (long, short) = (between(-0.5, 4.0).exp(), between(-0.6, 1.5).exp());
            let (sin, cos) = between(0.0, 3.2).sin_cos();
            let xx = (long * cos).powi(2) + (short * sin).powi(2);
            let yy = (long * sin).powi(2) + (short * cos).powi(2);
            let xy = (long * long - short * short) * sin * cos;
            let det = (long * short).powi(2);
            let k2 = (0.5 * std::f32::consts::LOG2_E).sqrt();
            Splat {
                mean: [between(-12.0, 28.0), between(-12.0, 28.0)],
                whiten: [(yy / det).sqrt(), -xy / (det * yy).sqrt(), 1.0 / yy.sqrt()].map(|w| k2 * w),
                valley: [xy / yy, xy / xx],
                log2_opacity: between(-6.0, -0.01),
                colour: [between(0.0, 1.0), between(0.0, 1.0), between(0.0, 1.0)],
                depth: 1.0 + k as f32,
            }
        })
        .collect()
}

struct Blocks<'a>(&'a Splat);

impl WithSimd for Blocks<'_> {
    type Output = u16;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> u16 {
        Broadcast::new(simd, self.0).blocks(Lanes::splat(simd, LEAST))
    }
}

#[test]
fn no_touched_block_is_left_out_and_few_others_are_taken() {
    let (mut touched, mut taken) = (0, 0);
    for splat in splats(3000) {
        let mut blocks = 0u16;
        for (x, y) in (0..256).map(|i| (i % 16, i / 16)) {
            let [a, b, c] = splat.whiten.map(f64::from);
            let dx = f64::from(x as f32 + 0.5 - splat.mean[0]);
            let dy = f64::from(y as f32 + 0.5 - splat.mean[1]);
            if f64::from(splat.log2_opacity) - (a * dx + b * dy).powi(2) - (c * dy).powi(2) >= f64::from(LEAST) {
                blocks |= 1 << (place(x, y) / (BLOCK * BLOCK));
            }
        }
        let ours = Arch::new().dispatch(Blocks(&splat));
        assert_eq!(blocks & !ours, 0, "{splat:?}");
        assert_eq!(ours, Simd::vectorize(pulp::Scalar::new(), Blocks(&splat)));
        touched += blocks.count_ones();
        taken += ours.count_ones();
    }
    assert!(touched > 5000 && f64::from(taken) < 1.2 * f64::from(touched), "{taken} for {touched}");
}

/// One tile drawn and differentiated.
fn run<S: Simd>(simd: S, options: &RenderOptions) -> (Vec<f32>, Vec<Vec<u32>>, Vec<Sums>) {
    let splats = splats(120);
    let list: Vec<u32> = (0..120).collect();
    let mut rgb = vec![[0.0; 3]; 256];
    let (mut alpha, mut depth, mut count) = (vec![0.0; 256], vec![0.0; 256], vec![0; 256]);
    let tile = forward::DrawTile { splats: &splats, list: &list, corner: (0, 0), options };
    let drawn = Simd::vectorize(simd, tile);
    fn rows<T>(image: &mut [T]) -> Vec<&mut [T]> {
        image.chunks_mut(16).collect()
    }
    drawn.write([0.2; 3], &mut rows(&mut rgb), &mut rows(&mut alpha), &mut rows(&mut depth), &mut rows(&mut count));
    let gradients = RenderGradients {
        rgb: rgb.iter().map(|c| c.map(|v| v - 0.5)).collect(),
        alpha: alpha.clone(),
        ..RenderGradients::default()
    };
    let camera = PinholeCamera {
        camera_from_world: drex_core::Pose::identity(),
        fx: 16.0,
        fy: 16.0,
        cx: 8.0,
        cy: 8.0,
        width: 16,
        height: 16,
    };
    let mut sums = vec![Sums::default(); 120];
    let incoming = backward::Incoming::read(&gradients, [0.2; 3], &camera, (0, 0));
    let tile = backward::DifferentiateTile {
        splats: &splats,
        list: &list,
        corner: (0, 0),
        options,
        end: &drawn.end,
        incoming: &incoming,
        sums: &mut sums,
    };
    Simd::vectorize(simd, tile);
    let values = rgb.into_flattened().into_iter().chain(alpha).chain(depth).collect();
    let blocks = drawn.end.blocks.iter().map(|b| u32::from(*b)).collect();
    (values, vec![count, blocks], sums)
}

#[test]
fn every_set_of_instructions_gives_the_same_tile() {
    let mut options = RenderOptions { count: true, ..RenderOptions::default() };
    for smooth_cutoff in [false, true] {
        options.smooth_cutoff = smooth_cutoff;
        let plain = run(pulp::Scalar::new(), &options);
        assert!(plain.1[0].iter().any(|c| *c > 10) && plain.2.iter().any(|s| s.moments[0] != 0.0));
        let compare = |name: &str, other: (Vec<f32>, Vec<Vec<u32>>, Vec<Sums>)| {
            assert_eq!(plain.1, other.1, "{name}");
            let near = |a: f32, b: f32, scale: f32| assert!((a - b).abs() <= 2e-5 * scale, "{name}: {a} {b}");
            plain.0.iter().zip(&other.0).for_each(|(a, b)| near(*a, *b, a.abs().max(1.0)));
            for (a, b) in plain.2.iter().zip(&other.2) {
                let size = |m: &[f32]| m.iter().fold(1e-3, |s: f32, v| s.max(v.abs()));
                a.moments.iter().zip(&b.moments).for_each(|(x, y)| near(*x, *y, size(&a.moments) + size(&a.colour)));
                a.colour.iter().zip(&b.colour).for_each(|(x, y)| near(*x, *y, size(&a.colour)));
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
