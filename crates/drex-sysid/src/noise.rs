//! How noisy a track or a force record is, from itself.

use drex_core::Trajectory;
use drex_core::pose::pose_difference;
use drex_core::trajectory::PoseNoise;
use nalgebra::{Vector3, Vector6};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Two correct simulators of rigid contact differ by about this much where objects slide and rock; a cleaner track is
/// not worth more.
pub(crate) const FLOOR: PoseNoise = PoseNoise { position_m: 1e-3, rotation_rad: 0.01 };

/// Standard deviations of a track per axis, from its second differences: white noise of deviation s has second
/// differences of deviation s √6. Only the calmest third of the frames is looked at (motion adds to the differences),
/// and frames at uneven times are left out. Never below [`FLOOR`].
pub(crate) fn of_track(track: &Trajectory) -> PoseNoise {
    let (t, p) = (track.times_s(), track.poses());
    let mut steps: Vec<f64> = t.windows(2).map(|w| w[1] - w[0]).collect();
    steps.sort_by(f64::total_cmp);
    let usual = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
    let even =
        |k: usize| ((t[k] - t[k - 1]) / usual - 1.0).abs() < 0.1 && ((t[k + 1] - t[k]) / usual - 1.0).abs() < 0.1;
    let second: Vec<Vector6<f64>> = (1..t.len().saturating_sub(1))
        .filter(|&k| even(k))
        .map(|k| pose_difference(&p[k], &p[k + 1]) + pose_difference(&p[k], &p[k - 1]))
        .collect();
    if second.len() < 4 {
        return FLOOR;
    }
    let sd = |rows: [usize; 3]| {
        let mut sizes: Vec<f64> = second.iter().map(|d| rows.iter().map(|&r| d[r] * d[r]).sum::<f64>()).collect();
        sizes.sort_by(f64::total_cmp);
        // The lower third of chi-square with three degrees of freedom ends at 1.57; its sixth at 0.93.
        (sizes[sizes.len() / 6] / (0.93 * 6.0)).sqrt()
    };
    PoseNoise { position_m: sd([0, 1, 2]).max(FLOOR.position_m), rotation_rad: sd([3, 4, 5]).max(FLOOR.rotation_rad) }
}

/// Standard deviation of white noise on the samples of a force, newtons per axis, from third differences (which a
/// profile sampled much faster than it changes does not show); zero for a record without noise.
pub(crate) fn of_force(forces: &[Vector3<f64>]) -> f64 {
    if forces.len() < 8 {
        return 0.0;
    }
    let mut sizes: Vec<f64> = forces
        .windows(4)
        .flat_map(|w| (w[3] - w[2] * 3.0 + w[1] * 3.0 - w[0]).iter().map(|x| x * x).collect::<Vec<_>>())
        .collect();
    sizes.sort_by(f64::total_cmp);
    // Variance 1 + 9 + 9 + 1; the median of chi-square with one degree of freedom is 0.4549.
    (sizes[sizes.len() / 2] / (0.4549 * 20.0)).sqrt()
}

/// Standard deviation of numbers of which a few may be wild or follow a worse law, from their 80 % point; `None` of none.
pub(crate) fn spread(numbers: &[f64]) -> Option<f64> {
    let mut sizes: Vec<f64> = numbers.iter().map(|x| x.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    // 80 % of normal numbers are within 1.282 standard deviations.
    sizes.get(sizes.len() * 4 / 5).map(|s| s / 1.282)
}

/// [`of_force`], or zero where it is below a thousandth of the largest force: rounding, or the curvature of the profile.
pub(crate) fn significant(forces: &[Vector3<f64>]) -> f64 {
    let peak = forces.iter().map(Vector3::amax).fold(0.0, f64::max);
    Some(of_force(forces)).filter(|sd| *sd >= 1e-3 * peak).unwrap_or(0.0)
}

/// The record with every stretch that white noise of deviation `sd` explains set to zero, axis by axis: a sensor reads
/// noise while nothing is touched, and noise is no push. A stretch is seven samples; it stays if their sum or the sum
/// of their squares is too large for noise at about 1 in 10000.
pub(crate) fn without_idle(forces: &[Vector3<f64>], sd: f64) -> Vec<Vector3<f64>> {
    const HALF: usize = 3;
    let n = forces.len();
    if sd == 0.0 || n < 2 * HALF + 1 {
        return forces.to_vec();
    }
    let mut keep = vec![Vector3::from_element(false); n];
    for axis in 0..3 {
        for k in HALF..n - HALF {
            let window = &forces[k - HALF..=k + HALF];
            let sum: f64 = window.iter().map(|f| f[axis] / sd).sum();
            let squares: f64 = window.iter().map(|f| (f[axis] / sd).powi(2)).sum();
            // 4 sd of the sum; the 99.99 % point of chi-square with seven degrees of freedom is 29.9.
            if sum.abs() > 4.0 * (window.len() as f64).sqrt() || squares > 29.9 {
                for kept in &mut keep[k - HALF..=k + HALF] {
                    kept[axis] = true;
                }
            }
        }
    }
    forces.iter().zip(&keep).map(|(f, k)| f.zip_map(k, |x, k| if k { x } else { 0.0 })).collect()
}

/// A standard normal number.
pub(crate) fn normal(random: &mut ChaCha8Rng) -> f64 {
    drex_core::stats::normal_pair(random.random(), std::f64::consts::TAU * random.random::<f64>())[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use drex_core::Pose;

    /// Twelve uniform numbers less six: nearly normal with variance one.
    fn noisy(state: &mut u64) -> f64 {
        (0..12)
            .map(|_| {
                *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (*state >> 11) as f64 / (1_u64 << 53) as f64
            })
            .sum::<f64>()
            - 6.0
    }

    #[test]
    fn white_noise_on_a_motion_is_found() {
        let mut s = 7;
        let times: Vec<f64> = (0..60).map(|k| f64::from(k) / 30.0).collect();
        let poses: Vec<Pose> = times
            .iter()
            .map(|t| {
                let x = if *t > 1.0 { 2.0 * (t - 1.0).powi(2) } else { 0.0 };
                let n = Vector3::from_fn(|_, _| 0.002 * noisy(&mut s));
                let r = Vector3::from_fn(|_, _| 0.0175 * noisy(&mut s));
                Pose::new(n + Vector3::x() * x, r)
            })
            .collect();
        let noise = of_track(&Trajectory::from_samples(&times, &poses).unwrap());
        assert!((0.0012..0.0032).contains(&noise.position_m), "{noise:?}");
        assert!((0.011..0.028).contains(&noise.rotation_rad), "{noise:?}");
    }

    #[test]
    fn noise_of_a_force_is_found_and_a_clean_force_has_none() {
        let mut s = 3;
        let pulse =
            |k: i32| if (30..70).contains(&k) { (f64::from(k - 30) / 40.0 * std::f64::consts::PI).sin() } else { 0.0 };
        let clean: Vec<_> = (0..200).map(|k| Vector3::x() * pulse(k)).collect();
        assert!(of_force(&clean) < 1e-9);
        let noisy: Vec<_> = clean.iter().map(|f| f + Vector3::from_fn(|_, _| 0.04 * noisy(&mut s))).collect();
        assert!((of_force(&noisy) / 0.04 - 1.0).abs() < 0.2);
    }
}
