//! Losses against goldens, against an independent evaluation in double precision and its finite differences, and
//! against what they must not depend on.

use drex_core::camera::PinholeCamera;
use drex_splat::loss::{
    DepthOptions, DepthSource, DepthTarget, Exposure, MaskMode, PhotometricOptions, SparseDepth, SurfaceOptions,
    SurfaceTarget, Target, depth, depth_normals, photometric, ssim, ssim_map, ssim_with_gradient, surface,
};
use drex_splat::{Render, RenderGradients};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::support::Golden;

const WIDTH: usize = 21;
const HEIGHT: usize = 17;
const PIXELS: usize = WIDTH * HEIGHT;

fn triples(flat: &[f32]) -> Vec<[f32; 3]> {
    flat.as_chunks().0.to_vec()
}

#[test]
fn ssim_agrees_with_the_golden() {
    let Some(golden) = Golden::load("ssim") else { return };
    let [height, width, _] = golden.get("image").shape[..] else { panic!() };
    let (image, target) = (triples(&golden.f32s("image")), triples(&golden.f32s("target")));
    let map = ssim_map(&image, &target, width, height).unwrap();
    golden.compare("ssim_map", map.as_flattened(), 1e-3, 1e-2, |_| true);
    let (value, gradient) = ssim_with_gradient(&image, &target, None, width, height).unwrap();
    golden.compare("grad_ssim", gradient.as_flattened(), 1e-3, 1e-2, |_| true);
    assert!((value - golden.scalar("ssim")).abs() < 1e-5, "{value}");
    assert_eq!(value, ssim(&image, &target, None, width, height).unwrap());
}

#[test]
fn l1_with_ssim_agrees_with_the_golden() {
    // The golden's target is not of bytes; the loss takes photos. A byte is at most 1/510 away, and the derivative by the
    // sign of the difference must not see that: so compare value and map with the rounded target computed here.
    let Some(golden) = Golden::load("ssim") else { return };
    let [height, width, _] = golden.get("image").shape[..] else { panic!() };
    let photo: Vec<[u8; 3]> =
        triples(&golden.f32s("target")).iter().map(|p| p.map(|v| (v * 255.0).round() as u8)).collect();
    let render = Render {
        width,
        height,
        rgb: triples(&golden.f32s("image")),
        alpha: vec![1.0; width * height],
        ..Default::default()
    };
    let target = Target { name: "golden", rgb: &photo, mask: None, exposure: None };
    let loss = photometric(&render, &target, &PhotometricOptions::default()).unwrap();
    assert!((loss.value - golden.scalar("loss_l1_dssim")).abs() < 2e-3, "{}", loss.value);
    assert!((loss.l1 - golden.scalar("l1")).abs() < 2e-3, "{}", loss.l1);
    let rounded: Vec<[f32; 3]> = photo.iter().map(|p| p.map(|v| f32::from(v) / 255.0)).collect();
    let (value, gradient) = ssim_with_gradient(&render.rgb, &rounded, None, width, height).unwrap();
    let per_value = 0.8 / (3 * width * height) as f32;
    for (i, (g, s)) in loss.gradients.rgb.as_flattened().iter().zip(gradient.as_flattened()).enumerate() {
        let off = render.rgb.as_flattened()[i] - rounded.as_flattened()[i];
        let sign = if off == 0.0 { 0.0 } else { off.signum() };
        assert!((g - (per_value * sign - 0.2 * s)).abs() < 1e-4 * per_value, "{i}");
    }
    assert!((loss.ssim - value).abs() < 1e-12);
}

/// A render, a photo and a mask that look like nothing but have all values.
struct Case {
    render: Render,
    photo: Vec<[u8; 3]>,
    mask: Vec<u8>,
    camera: PinholeCamera,
    rng: ChaCha8Rng,
}

fn case(seed: u64) -> Case {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let photo: Vec<[u8; 3]> = (0..PIXELS).map(|_| [0; 3].map(|_: i32| rng.random_range(30..220))).collect();
    // Away from the photo's values, where the L1 has its kink.
    let rgb = photo.iter().map(|p| p.map(|v| f32::from(v) / 255.0 + [-0.1, 0.08][rng.random_range(0..2)])).collect();
    let mask = (0..PIXELS).map(|i| if (i % WIDTH) > 6 && i / WIDTH > 4 && i / WIDTH < 14 { 255 } else { 0 }).collect();
    let alpha: Vec<f32> = (0..PIXELS).map(|_| rng.random_range(0.3..0.95)).collect();
    let z: Vec<f32> = (0..PIXELS).map(|_| rng.random_range(1.9..2.1)).collect();
    let normal = (0..PIXELS).map(|_| [0.3, 0.3, -0.8].map(|n: f32| n + rng.random_range(-0.2..0.2))).collect();
    let render = Render {
        width: WIDTH,
        height: HEIGHT,
        rgb,
        depth: alpha.iter().zip(&z).map(|(a, z)| a * z).collect(),
        median_depth: z.iter().map(|z| z + rng.random_range(-0.05..0.05)).collect(),
        distortion: (0..PIXELS).map(|_| rng.random_range(0.0..1e-4)).collect(),
        alpha,
        normal,
        count: vec![],
    };
    let camera = PinholeCamera {
        camera_from_world: drex_core::Pose::identity(),
        fx: 30.0,
        fy: 26.0,
        cx: 8.3,
        cy: 9.9,
        width: WIDTH,
        height: HEIGHT,
    };
    Case { render, photo, mask, camera, rng }
}

/// Compares a derivative with central differences of `loss`, which is evaluated in double precision; `entry` is the
/// value that is moved.
fn check_gradient(name: &str, ours: &[f32], values: &[f32], loss: impl Fn(&[f64]) -> f64) {
    assert_eq!(ours.len(), values.len(), "{name}");
    let mut at: Vec<f64> = values.iter().map(|v| f64::from(*v)).collect();
    let largest = ours.iter().fold(0.0_f32, |m, g| m.max(g.abs()));
    assert!(largest > 0.0, "{name}: no derivative at all");
    for i in (0..values.len()).step_by(7) {
        let (here, h) = (at[i], 1e-6);
        let mut moved = |to: f64| {
            at[i] = to;
            loss(&at)
        };
        let difference = (moved(here + h) - moved(here - h)) / (2.0 * h);
        moved(here);
        let off = (difference - f64::from(ours[i])).abs();
        let allowed = 1e-3 * difference.abs() + 2e-5 * f64::from(largest);
        assert!(off < allowed, "{name}[{i}]: ours {}, differences {difference}", ours[i]);
    }
}

/// Mean SSIM straight from its definition, the window as a square, weighted.
fn plain_ssim(x: &[f64], y: &[f64], weight: &[f64]) -> f64 {
    let tap = |d: i64| (-((d * d) as f64) / 4.5).exp();
    let norm: f64 = (-5..=5).map(tap).sum();
    let mut total = 0.0;
    for (i, w) in weight.iter().enumerate() {
        let (px, py) = ((i % WIDTH) as i64, (i / WIDTH) as i64);
        for c in 0..3 {
            let mut m = [0.0; 5];
            for dy in -5..=5 {
                for dx in -5..=5 {
                    let (qx, qy) = (px + dx, py + dy);
                    if (0..WIDTH as i64).contains(&qx) && (0..HEIGHT as i64).contains(&qy) {
                        let q = 3 * (qy as usize * WIDTH + qx as usize) + c;
                        let g = tap(dx) * tap(dy) / (norm * norm);
                        let terms = [x[q], y[q], x[q] * x[q], y[q] * y[q], x[q] * y[q]];
                        m.iter_mut().zip(terms).for_each(|(m, t)| *m += g * t);
                    }
                }
            }
            let [mx, my, xx, yy, xy] = m;
            let (c1, c2) = (1e-4, 9e-4);
            let (sx, sy, sxy) = (xx - mx * mx, yy - my * my, xy - mx * my);
            total += w * (2.0 * mx * my + c1) * (2.0 * sxy + c2) / ((mx * mx + my * my + c1) * (sx + sy + c2));
        }
    }
    total / (3.0 * weight.iter().sum::<f64>())
}

fn plain_photometric(rgb: &[f64], y: &[f64], weight: &[f64]) -> f64 {
    let x: Vec<f64> = (0..rgb.len()).map(|i| weight[i / 3] * rgb[i] + (1.0 - weight[i / 3]) * y[i]).collect();
    let l1: f64 = x.iter().zip(y).map(|(x, y)| (x - y).abs()).sum::<f64>() / (3.0 * weight.iter().sum::<f64>());
    0.8 * l1 + 0.2 * (1.0 - plain_ssim(&x, y, weight))
}

fn units(bytes: &[u8]) -> Vec<f64> {
    bytes.iter().map(|b| f64::from(*b) / 255.0).collect()
}

#[test]
fn the_masked_loss_and_its_derivative() {
    let mut case = case(1);
    case.mask[8 * WIDTH + 10] = 100; // a share
    let target = Target { name: "p", rgb: &case.photo, mask: Some(&case.mask), exposure: None };
    let options = PhotometricOptions { mask: MaskMode::Masked, ..Default::default() };
    let loss = photometric(&case.render, &target, &options).unwrap();
    let (y, weight) = (units(case.photo.as_flattened()), units(&case.mask));
    let plain = |rgb: &[f64]| plain_photometric(rgb, &y, &weight);
    let rgb = case.render.rgb.as_flattened();
    let value = plain(&rgb.iter().map(|v| f64::from(*v)).collect::<Vec<_>>());
    assert!((loss.value - value).abs() < 1e-6, "{} {value}", loss.value);
    check_gradient("masked rgb", loss.gradients.rgb.as_flattened(), rgb, plain);

    // What is outside changes nothing, to the last bit.
    let mut other = case.render.clone();
    (0..PIXELS).filter(|i| case.mask[*i] == 0).for_each(|i| other.rgb[i] = [9.0, -3.0, 0.5]);
    assert_eq!(loss, photometric(&other, &target, &options).unwrap());
    assert!((0..PIXELS).filter(|i| case.mask[*i] == 0).all(|i| loss.gradients.rgb[i] == [0.0; 3]));
}

#[test]
fn the_transparent_loss_and_its_derivative() {
    let case = case(2);
    let background = [0.9, 0.1, 0.55];
    let options = PhotometricOptions { mask: MaskMode::Transparent, background, alpha: 0.1, ..Default::default() };
    let exposure = Exposure { matrix: [[1.1, 0.05, -0.02, 0.01], [0.02, 0.9, 0.03, 0.0], [-0.03, 0.01, 1.05, -0.02]] };
    let target = Target { name: "p", rgb: &case.photo, mask: Some(&case.mask), exposure: Some(&exposure) };
    let loss = photometric(&case.render, &target, &options).unwrap();
    let m = units(&case.mask);
    let behind = exposure.apply(background);
    let y: Vec<f64> = (0..3 * PIXELS)
        .map(|i| m[i / 3] * f64::from(case.photo[i / 3][i % 3]) / 255.0 + (1.0 - m[i / 3]) * f64::from(behind[i % 3]))
        .collect();
    let plain = |rgb: &[f64], matrix: &[f64], alpha: &[f64]| {
        let exposed: Vec<f64> = (0..rgb.len())
            .map(|i| {
                let (p, row) = (&rgb[i / 3 * 3..][..3], &matrix[4 * (i % 3)..][..4]);
                row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3]
            })
            .collect();
        let off: f64 = alpha.iter().zip(&m).map(|(a, m)| (a - m).abs()).sum();
        plain_photometric(&exposed, &y, &vec![1.0; PIXELS]) + 0.1 * off / PIXELS as f64
    };
    let wide = |v: &[f32]| v.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
    let (rgb, alpha) = (case.render.rgb.as_flattened(), &case.render.alpha);
    let matrix = exposure.matrix.as_flattened();
    let value = plain(&wide(rgb), &wide(matrix), &wide(alpha));
    assert!((loss.value - value).abs() < 1e-6, "{} {value}", loss.value);
    let (wide_rgb, wide_matrix, wide_alpha) = (wide(rgb), wide(matrix), wide(alpha));
    check_gradient("rgb", loss.gradients.rgb.as_flattened(), rgb, |v| plain(v, &wide_matrix, &wide_alpha));
    check_gradient("alpha", &loss.gradients.alpha, alpha, |v| plain(&wide_rgb, &wide_matrix, v));
    let by_matrix = loss.exposure.unwrap();
    check_gradient("exposure", by_matrix.as_flattened(), matrix, |v| plain(&wide_rgb, v, &wide_alpha));
}

#[test]
fn the_band_at_the_rim_does_not_count() {
    let case = case(3);
    let options = PhotometricOptions { mask: MaskMode::Transparent, ignore_band: 2, ..Default::default() };
    let target = Target { name: "p", rgb: &case.photo, mask: Some(&case.mask), exposure: None };
    let loss = photometric(&case.render, &target, &options).unwrap();
    for i in 0..PIXELS {
        let (x, y) = ((i % WIDTH) as i64, (i / WIDTH) as i64);
        let inside = |x: i64, y: i64| x > 6 && y > 4 && y < 14;
        let near = (-2..=2).any(|dy| {
            (-2..=2).any(|dx| {
                let (qx, qy) = (x + dx, y + dy);
                (0..WIDTH as i64).contains(&qx) && (0..HEIGHT as i64).contains(&qy) && inside(qx, qy) != inside(x, y)
            })
        });
        assert_eq!(near, loss.gradients.rgb[i] == [0.0; 3], "{x} {y}");
        assert_eq!(near, loss.gradients.alpha[i] == 0.0, "{x} {y}");
    }
    let wide = PhotometricOptions { ignore_band: 1000, ..options };
    let said = photometric(&case.render, &target, &wide).unwrap_err().to_string();
    assert!(said.contains("no pixel of p counts"), "{said}");
}

/// 1 - N·n alpha straight from its definition; `weight_alpha` is the alpha that is held constant.
fn plain_consistency(case: &Case, r: f64, normal: &[f64], depth: &[f64], alpha: &[f64], median: &[f64]) -> f64 {
    let camera = &case.camera;
    let point = |x: usize, y: usize| {
        let i = y * WIDTH + x;
        camera.ray([x as f64 + 0.5, y as f64 + 0.5]) * ((1.0 - r) * depth[i] / alpha[i] + r * median[i])
    };
    let weight = units(&case.mask);
    let mut total = 0.0;
    for i in 0..PIXELS {
        let (x, y) = (i % WIDTH, i / WIDTH);
        let mut agreement = 0.0;
        if (1..WIDTH - 1).contains(&x) && (1..HEIGHT - 1).contains(&y) {
            let (a, b) = (point(x, y + 1) - point(x, y - 1), point(x + 1, y) - point(x - 1, y));
            let n = a.cross(&b).normalize();
            let held = f64::from(case.render.alpha[i]);
            agreement = held * (normal[3 * i] * n.x + normal[3 * i + 1] * n.y + normal[3 * i + 2] * n.z);
        }
        total += weight[i] * (1.0 - agreement);
    }
    total / weight.iter().sum::<f64>()
}

#[test]
fn normals_that_agree_with_depth() {
    let case = case(4);
    for r in [0.0, 0.4, 1.0] {
        let options = SurfaceOptions { distortion: 0.0, median_share: r, ..Default::default() };
        let target = SurfaceTarget { mask: Some(&case.mask), ..Default::default() };
        let loss = surface(&case.render, &case.camera, &target, &options).unwrap();
        let wide = |v: &[f32]| v.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
        let values =
            [case.render.normal.as_flattened(), &case.render.depth, &case.render.alpha, &case.render.median_depth];
        let at = values.map(wide);
        let plain = |k: usize, moved: &[f64]| {
            let mut v = [&at[0][..], &at[1], &at[2], &at[3]];
            v[k] = moved;
            0.05 * plain_consistency(&case, f64::from(r), v[0], v[1], v[2], v[3])
        };
        let value = plain(0, &at[0]);
        assert!((loss.value - value).abs() < 1e-6 * value.abs(), "{} {value}", loss.value);
        let g = &loss.gradients;
        check_gradient("normal", g.normal.as_flattened(), values[0], |v| plain(0, v));
        if r < 1.0 {
            check_gradient("depth", &g.depth, values[1], |v| plain(1, v));
            check_gradient("alpha", &g.alpha, values[2], |v| plain(2, v));
        }
        if r > 0.0 {
            check_gradient("median", &g.median_depth, values[3], |v| plain(3, v));
        }
    }
}

#[test]
fn normals_of_a_plane_and_of_a_hole() {
    let mut case = case(5);
    // n·p = -1.5 for a plane that faces the camera.
    let n = nalgebra::Vector3::new(0.3, -0.2, -0.9_f64).normalize();
    let z = |i: usize| {
        let ray = case.camera.ray([(i % WIDTH) as f64 + 0.5, (i / WIDTH) as f64 + 0.5]);
        (-1.5 / n.dot(&ray)) as f32
    };
    let mut depth: Vec<f32> = (0..PIXELS).map(z).collect();
    let hole = 8 * WIDTH + 9;
    depth[hole] = 0.0;
    let normals = depth_normals(&depth, &case.camera).unwrap();
    let touches = [hole, hole - 1, hole + 1, hole - WIDTH, hole + WIDTH];
    for (i, ours) in normals.iter().enumerate() {
        let (x, y) = (i % WIDTH, i / WIDTH);
        if x == 0 || y == 0 || x == WIDTH - 1 || y == HEIGHT - 1 || touches.contains(&i) {
            assert_eq!(*ours, [0.0; 3]);
        } else {
            (0..3).for_each(|k| assert!((f64::from(ours[k]) - n[k]).abs() < 1e-5, "{x} {y}: {ours:?} {n:?}"));
        }
    }
    // A render of that plane with its normals agrees with itself.
    case.render.alpha.fill(1.0);
    case.render.normal = vec![[n.x as f32, n.y as f32, n.z as f32]; PIXELS];
    case.render.depth.copy_from_slice(&depth);
    let mut mask = vec![0; PIXELS];
    (3..6).for_each(|y| mask[y * WIDTH + 3..][..12].fill(255));
    let target = SurfaceTarget { mask: Some(&mask), ..Default::default() };
    let options = SurfaceOptions { median_share: 0.0, ..Default::default() };
    let loss = surface(&case.render, &case.camera, &target, &options).unwrap();
    assert!(loss.consistency.abs() < 1e-6, "{}", loss.consistency);
}

#[test]
fn distortion_and_given_normals() {
    let mut case = case(6);
    let mut given: Vec<[f32; 3]> =
        (0..PIXELS).map(|_| [0.6, 0.0, -0.8].map(|n: f32| n + case.rng.random_range(-0.1..0.1))).collect();
    given[3] = [0.0; 3];
    given[4] = [f32::NAN; 3];
    let options = SurfaceOptions { consistency: 0.0, distortion: 10.0, normals: 0.3, ..Default::default() };
    let target = SurfaceTarget { name: "p", mask: Some(&case.mask), normals: Some(&given) };
    let loss = surface(&case.render, &case.camera, &target, &options).unwrap();
    let weight = units(&case.mask);
    let area: f64 = weight.iter().sum();
    let distortion = |d: &[f64]| 10.0 * d.iter().zip(&weight).map(|(d, w)| d * w).sum::<f64>() / area;
    check_gradient("distortion", &loss.gradients.distortion, &case.render.distortion, distortion);
    let normals = |n: &[f64]| {
        let of = |i: usize| -> f64 {
            (0..3)
                .map(|k| {
                    let m = f64::from(given[i][k]);
                    (n[3 * i + k] - m).abs() - n[3 * i + k] * m
                })
                .sum()
        };
        0.3 * (0..PIXELS).filter(|i| weight[*i] > 0.0).map(|i| 1.0 + of(i)).sum::<f64>() / area
    };
    check_gradient("normal", loss.gradients.normal.as_flattened(), case.render.normal.as_flattened(), normals);
    let wide: Vec<f64> = case.render.normal.as_flattened().iter().map(|v| f64::from(*v)).collect();
    assert!((0.3 * loss.normals - normals(&wide)).abs() < 1e-6);
    assert!(loss.gradients.normal[3] == [0.0; 3] && loss.gradients.normal[4] == [0.0; 3]);
}

#[test]
fn depths_dense_and_sparse() {
    let mut case = case(7);
    case.render.alpha[40] = 0.01;
    let mut given: Vec<f32> = (0..PIXELS).map(|_| case.rng.random_range(1.5..2.5)).collect();
    (given[0], given[1], given[2]) = (0.0, f32::NAN, -1.0);
    let sparse = [
        SparseDepth { pixel: [10.2, 5.9], depth: 1.7 },
        SparseDepth { pixel: [-0.1, 5.0], depth: 1.7 },
        SparseDepth { pixel: [5.0, f32::NAN], depth: 1.7 },
        SparseDepth { pixel: [21.0, 5.0], depth: 1.7 },
    ];
    let target = DepthTarget { name: "p", dense: Some(&given), sparse: &sparse, mask: None };
    let options = DepthOptions { weight: 0.7, ..Default::default() };
    let mut known: Vec<(usize, f64)> =
        given.iter().map(|z| f64::from(*z)).enumerate().skip(3).filter(|(i, _)| *i != 40).collect();
    known.push((5 * WIDTH + 10, f64::from(1.7_f32)));
    let wide = |v: &[f32]| v.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
    let (d, a) = (wide(&case.render.depth), wide(&case.render.alpha));
    let plain = |d: &[f64], a: &[f64]| {
        0.7 * known.iter().map(|(i, z)| (d[*i] / a[*i] - z).abs()).sum::<f64>() / known.len() as f64
    };
    let loss = depth(&case.render, &target, &options).unwrap();
    assert_eq!(loss.count, known.len() as f64);
    assert!((loss.value - plain(&d, &a)).abs() < 1e-7);
    check_gradient("depth", &loss.gradients.depth, &case.render.depth, |v| plain(v, &a));
    check_gradient("alpha", &loss.gradients.alpha, &case.render.alpha, |v| plain(&d, v));

    let options = DepthOptions { source: DepthSource::Median, ..options };
    let loss = depth(&case.render, &target, &options).unwrap();
    let plain = |m: &[f64]| 0.7 * known.iter().map(|(i, z)| (m[*i] - z).abs()).sum::<f64>() / known.len() as f64;
    check_gradient("median", &loss.gradients.median_depth, &case.render.median_depth, plain);
    let nothing = depth(&case.render, &DepthTarget::default(), &options).unwrap();
    assert_eq!((nothing.value, nothing.gradients), (0.0, RenderGradients::default()));
}

#[test]
fn the_same_bytes_with_any_number_of_threads() {
    let case = case(8);
    let exposure = Exposure { matrix: [[0.9, 0.1, 0.0, 0.0], [0.0, 1.1, 0.0, 0.1], [0.0, 0.0, 1.0, 0.0]] };
    let target = Target { name: "p", rgb: &case.photo, mask: Some(&case.mask), exposure: Some(&exposure) };
    let all = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let options = PhotometricOptions { mask: MaskMode::Transparent, ignore_band: 1, ..Default::default() };
            let photometric = photometric(&case.render, &target, &options).unwrap();
            let options = SurfaceOptions { median_share: 0.3, ..Default::default() };
            (photometric, surface(&case.render, &case.camera, &SurfaceTarget::default(), &options).unwrap())
        })
    };
    let one = all(1);
    [2, 3, 8].into_iter().for_each(|threads| assert_eq!(one, all(threads)));
}

#[test]
fn what_cannot_be_compared_is_named() {
    let case = case(9);
    let black = vec![0; PIXELS];
    let target = Target { name: "left/07.jpg", rgb: &case.photo, mask: Some(&black), exposure: None };
    for mask in [MaskMode::Masked, MaskMode::Transparent] {
        let options = PhotometricOptions { mask, ..Default::default() };
        let said = photometric(&case.render, &target, &options).unwrap_err().to_string();
        assert!(said.contains("left/07.jpg") && said.contains("zero everywhere"), "{said}");
        let said = photometric(&case.render, &Target { mask: None, ..target }, &options).unwrap_err().to_string();
        assert!(said.contains("left/07.jpg") && said.contains("has no mask"), "{said}");
        let said = photometric(&case.render, &Target { mask: Some(&[1]), ..target }, &options).unwrap_err().to_string();
        assert!(said.contains("mask of left/07.jpg: 1 entries for an image of 21 x 17"), "{said}");
    }
    let options = PhotometricOptions { lambda: f32::NAN, ..Default::default() };
    assert!(photometric(&case.render, &target, &options).is_err());
    assert!(photometric(&Render::default(), &Target { rgb: &[], ..target }, &PhotometricOptions::default()).is_err());
    assert!(ssim(&[[0.0; 3]], &[[0.0; 3]], Some(&[]), 1, 1).is_err());
    assert!(ssim(&[], &[], None, usize::MAX, usize::MAX).is_err());

    let options = SurfaceOptions::default();
    let mut flat = case.render.clone();
    flat.normal.clear();
    let said = surface(&flat, &case.camera, &SurfaceTarget::default(), &options).unwrap_err().to_string();
    assert!(said.contains("normals of a render: 0 entries"), "{said}");
    let masked = SurfaceTarget { name: "a.png", mask: Some(&black), normals: None };
    assert!(surface(&case.render, &case.camera, &masked, &options).unwrap_err().to_string().contains("a.png"));
    let target = DepthTarget { name: "a.png", dense: Some(&[1.0]), ..Default::default() };
    assert!(depth(&case.render, &target, &DepthOptions::default()).unwrap_err().to_string().contains("a.png"));
}

proptest::proptest! {
    /// Any size and any values: no panic, and equal images have similarity one and no slope.
    #[test]
    fn any_size_and_any_values(width in 1..40_usize, height in 1..40_usize, values in proptest::collection::vec(proptest::num::f32::ANY, 1..50)) {
        let n = width * height;
        let at = |i: usize| values[i % values.len()];
        let plane = |step: usize| (0..n).map(|i| at(step * i)).collect::<Vec<f32>>();
        let triple = |step: usize| (0..n).map(|i| [at(i), at(step * i), at(i + step)]).collect::<Vec<_>>();
        let render = Render {
            width, height, rgb: triple(2), alpha: plane(1), depth: plane(3), normal: triple(5), median_depth: plane(7), distortion: plane(2), count: vec![],
        };
        let camera = PinholeCamera { camera_from_world: drex_core::Pose::identity(), fx: 10.0, fy: 11.0, cx: 3.0, cy: 4.0, width, height };
        let photo = vec![[7, 100, 200]; n];
        let target = Target { name: "p", rgb: &photo, mask: Some(&vec![255; n]), exposure: None };
        for mask in [MaskMode::Off, MaskMode::Masked, MaskMode::Transparent] {
            photometric(&render, &target, &PhotometricOptions { mask, ignore_band: width / 2, ..Default::default() }).unwrap();
        }
        surface(&render, &camera, &SurfaceTarget { normals: Some(&triple(3)), ..Default::default() }, &SurfaceOptions::default()).unwrap();
        depth(&render, &DepthTarget { dense: Some(&plane(4)), ..Default::default() }, &DepthOptions::default()).unwrap();

        let equal = Render { rgb: photo.iter().map(|p| p.map(|v| f32::from(v) / 255.0)).collect(), ..render };
        let loss = photometric(&equal, &target, &PhotometricOptions::default()).unwrap();
        assert!(loss.l1 == 0.0 && (loss.ssim - 1.0).abs() < 1e-5, "{} {}", loss.l1, loss.ssim);
        assert!(loss.gradients.rgb.as_flattened().iter().all(|g| g.abs() < 1e-3 / n as f32));
    }
}
