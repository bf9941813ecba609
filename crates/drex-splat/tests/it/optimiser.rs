//! Adam against its definition, moments that follow Gaussians, learning rates; pictures' measures.

use drex_splat::metrics::{Table, psnr, similarity};
use drex_splat::optim::{Moments, adam_step};

#[test]
fn adam_is_what_its_authors_wrote() {
    let n = 20_001; // more than one chunk, and not a whole one
    let start = |i: usize| (i as f32 * 0.37).sin();
    let mut params: Vec<f32> = (0..n).map(start).collect();
    let mut moments = Moments::new(1, n);
    let (mut theta, mut m, mut v) =
        ((0..n).map(|i| f64::from(start(i))).collect::<Vec<_>>(), vec![0.0; n], vec![0.0; n]);
    for t in 1..=20 {
        let grads: Vec<f32> = (0..n).map(|i| 1e-4 * ((i * t) as f32 * 0.11).cos()).collect();
        adam_step(&mut params, &grads, &mut moments, &[0.01], t as u32).unwrap();
        for i in 0..n {
            let g = f64::from(grads[i]);
            m[i] = 0.9 * m[i] + 0.1 * g;
            v[i] = 0.999 * v[i] + 0.001 * g * g;
            let (m_hat, v_hat) = (m[i] / (1.0 - 0.9_f64.powi(t as i32)), v[i] / (1.0 - 0.999_f64.powi(t as i32)));
            theta[i] -= 0.01 * m_hat / (v_hat.sqrt() + 1e-15);
        }
    }
    let worst = params.iter().zip(&theta).map(|(p, t)| (f64::from(*p) - t).abs()).fold(0.0, f64::max);
    assert!(worst < 1e-5, "{worst}");
}

#[test]
fn the_first_step_is_the_learning_rate_however_small_the_gradient() {
    let mut params = [1.0_f32; 3];
    let mut moments = Moments::new(3, 1);
    adam_step(&mut params, &[1e-9, -3.0, 0.0], &mut moments, &[0.1; 3], 1).unwrap();
    assert!((params[0] - 0.9).abs() < 1e-5 && (params[1] - 1.1).abs() < 1e-5 && params[2] == 1.0, "{params:?}");
}

#[test]
fn each_number_of_a_gaussian_has_its_rate() {
    let (mut params, mut moments) = (vec![0.0_f32; 30_000], Moments::new(3, 10_000));
    adam_step(&mut params, &vec![1.0; 30_000], &mut moments, &[0.1, 0.0, 0.3], 1).unwrap();
    assert!(
        params.as_chunks::<3>().0.iter().all(|p| (p[0] + 0.1).abs() < 1e-6 && p[1] == 0.0 && (p[2] + 0.3).abs() < 1e-6)
    );
}

#[test]
fn moments_follow_their_gaussians() {
    let mut moments = Moments::from_parts(2, (0..8).map(|v| v as f32).collect(), vec![1.0; 8]).unwrap();
    moments.retain(&[true, false, true]); // the fourth is not named: kept
    assert_eq!(moments.m(), [0.0, 1.0, 4.0, 5.0, 6.0, 7.0]);
    moments.append_zeros(1);
    moments.zero(1);
    moments.zero(77);
    assert_eq!(moments.m(), [0.0, 1.0, 0.0, 0.0, 6.0, 7.0, 0.0, 0.0]);
    assert_eq!(moments.v(), [1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]);
    assert!(Moments::from_parts(3, vec![0.0; 8], vec![0.0; 8]).is_err());
    assert!(Moments::from_parts(0, vec![], vec![]).is_err());
    let said = adam_step(&mut [0.0; 3], &[0.0; 3], &mut moments, &[0.1; 3], 7).unwrap_err().to_string();
    assert!(said.contains("step 7 of 3 parameters, 2 a Gaussian, has 3 gradients, 8 moments and 3 rates"), "{said}");
}

#[test]
fn moments_that_fade_become_zero_not_subnormal() {
    let (mut params, mut moments) = ([0.0_f32], Moments::new(1, 1));
    adam_step(&mut params, &[1e-6], &mut moments, &[0.1], 1).unwrap();
    for t in 2..2000 {
        adam_step(&mut params, &[0.0], &mut moments, &[0.1], t).unwrap();
        assert!(!moments.m()[0].is_subnormal());
    }
    assert_eq!(moments.m()[0], 0.0);
}

#[test]
fn measures_of_pictures() {
    let (width, height) = (16, 12);
    let a = vec![[0_u8, 100, 255]; width * height];
    let b = vec![[0.1_f32, 100.0 / 255.0, 7.0]; width * height]; // 7 is clamped to 1
    let wanted = -10.0 * (0.01_f64 / 3.0).log10();
    assert!((psnr(&a, &b).unwrap() - wanted).abs() < 1e-5);
    assert!((similarity(&a, &b, None, width, height).unwrap().psnr - wanted).abs() < 1e-5);
    let same = similarity(&a, &a, None, width, height).unwrap();
    assert!(same.psnr == f64::INFINITY && (same.ssim - 1.0).abs() < 1e-6);

    // Only what is inside the mask counts.
    let mut half = vec![[0.0, 100.0 / 255.0, 1.0]; width * height];
    let mut mask = vec![255_u8; width * height];
    half[..50].fill([1.0, 0.0, 0.5]);
    mask[..50].fill(0);
    let inside = similarity(&half, &a, Some(&mask), width, height).unwrap();
    assert!(inside.psnr > 120.0 && inside.ssim > 0.9999, "{inside:?}");
    assert!(similarity(&half, &a, Some(&[0; 192]), width, height).unwrap_err().to_string().contains("zero everywhere"));
    assert!(similarity(&half, &a, None, 5, height).is_err());
    assert!(psnr::<u8, u8>(&[], &[]).is_err());

    let mut table = Table::default();
    assert!(table.mean().is_none());
    table.push("DSC_0008.JPG", drex_splat::metrics::Similarity { psnr: 22.0, ssim: 0.9 }, 100);
    table.push("ä", drex_splat::metrics::Similarity { psnr: 25.0, ssim: 0.95 }, 100);
    let text = table.to_string();
    let lines: Vec<_> = text.lines().collect();
    assert_eq!(lines.len(), 4, "{text}");
    assert!(lines.iter().all(|l| l.chars().count() == lines[0].chars().count()), "{text}");
    assert!(lines[3].starts_with("mean") && lines[3].contains("23.50") && lines[3].ends_with(" 2"), "{text}");
}
