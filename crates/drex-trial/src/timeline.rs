//! When what happens in a trial, and where the palm is then.

use drex_core::Pose;
use drex_diffsim::Path;
use nalgebra::{Translation3, Vector3};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;

use crate::{Error, Result};

/// Ends of the phases, s.
pub(crate) const APPROACHED_S: f64 = 0.5;
pub(crate) const CLOSED_S: f64 = 1.4;
pub(crate) const GRIPPED_S: f64 = 2.0;
pub(crate) const LIFTED_S: f64 = 4.0;
pub(crate) const HELD_S: f64 = 7.0;
pub(crate) const SHAKEN_S: f64 = HELD_S + SHAKES as f64 * SHAKE_S;
/// How high the hand lifts, m.
pub(crate) const LIFT_M: f64 = 0.2;
/// Shakes and the duration of one, s.
const SHAKES: usize = 6;
const SHAKE_S: f64 = 0.5;

/// The phases of a trial with the time at which each begins, s; the last one lasts to the end.
pub fn phases() -> [(f64, &'static str); 6] {
    [
        (0.0, "approach"),
        (APPROACHED_S, "close"),
        (CLOSED_S, "grip force"),
        (GRIPPED_S, "lift"),
        (LIFTED_S, "hold"),
        (HELD_S, "shake"),
    ]
}

/// The way of the palm: from `retreat` away onto the grasp, up, and shaken along three axes, each both ways, in random order and
/// with a random turn of the axes about the vertical.
pub(crate) fn palm_path(
    world_from_base: &Pose,
    retreat: &Vector3<f64>,
    shake_m_s2: f64,
    seed: u64,
    last_s: f64,
    dt_s: f64,
) -> Result<Path> {
    let shakes = directions(seed);
    let mut times = Vec::new();
    let mut poses = Vec::new();
    // A sample per step, straight between them: the velocity then changes by what the acceleration makes of it in a step.
    for i in 0..=(last_s / dt_s).ceil() as usize {
        let t = i as f64 * dt_s;
        let mut offset = retreat * (1.0 - smooth(t / APPROACHED_S));
        offset.z += LIFT_M * smooth((t - GRIPPED_S) / (LIFTED_S - GRIPPED_S));
        if t > HELD_S {
            let index = ((t - HELD_S) / SHAKE_S) as usize;
            if let Some(direction) = shakes.get(index) {
                offset += direction * shake((t - HELD_S) / SHAKE_S - index as f64, shake_m_s2);
            }
        }
        times.push(t);
        poses.push(Translation3::from(offset) * world_from_base);
    }
    Path::linear(&times, &poses).map_err(Error::from)
}

/// The quintic from 0 to 1 with no velocity and no acceleration at its ends: a bounded jerk.
fn smooth(s: f64) -> f64 {
    let s = s.clamp(0.0, 1.0);
    s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
}

/// Way out and back with no velocity and no acceleration at its ends: (1 - cos)², whose largest acceleration is `peak`.
fn shake(s: f64, peak: f64) -> f64 {
    let rate = 2.0 * PI / SHAKE_S;
    peak / (4.0 * rate * rate) * (1.0 - (2.0 * PI * s).cos()).powi(2)
}

/// Unit vectors along which the hand is shaken, one after the other.
fn directions(seed: u64) -> Vec<Vector3<f64>> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (sin, cos) = random.random_range(0.0..2.0 * PI).sin_cos();
    let axes = [Vector3::new(cos, sin, 0.0), Vector3::new(-sin, cos, 0.0), Vector3::z()];
    let mut all: Vec<Vector3<f64>> = axes.iter().flat_map(|a| [*a, -a]).collect();
    all.shuffle(&mut random);
    all
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn the_palm_lifts_and_is_shaken_with_the_stated_acceleration() {
        let grasp = Pose::translation(0.1, 0.0, 0.2);
        let path = palm_path(&grasp, &Vector3::new(0.0, 0.0, 0.1), 4.905, 3, SHAKEN_S, 2e-3).unwrap();
        let z = |t: f64| path.at(t).pose.translation.z;
        assert!((z(0.0) - 0.3).abs() < 1e-12 && (z(1.0) - 0.2).abs() < 1e-12);
        assert!((z(LIFTED_S) - 0.4).abs() < 1e-12 && (z(SHAKEN_S) - 0.4).abs() < 1e-9);
        let dt = 2e-3;
        let mut peaks = vec![0.0_f64; SHAKES];
        let mut before = path.at(HELD_S + 0.5 * dt).velocity;
        for i in 1..=(SHAKES as f64 * SHAKE_S / dt) as usize {
            let t = HELD_S + i as f64 * dt;
            let velocity = path.at(t + 0.5 * dt).velocity;
            let index = (((t - HELD_S) / SHAKE_S) as usize).min(SHAKES - 1);
            peaks[index] = peaks[index].max((velocity - before).norm() / dt);
            before = velocity;
        }
        assert!(peaks.iter().all(|p| (p / 4.905 - 1.0).abs() < 0.03), "{peaks:?}");
        // During the lift no more than the quintic has: 5.77 h / T².
        let rise = |t: f64| (path.at(t + 1.5 * dt).velocity.z - path.at(t + 0.5 * dt).velocity.z) / dt;
        let most = (0..1000).map(|i| rise(GRIPPED_S + f64::from(i) * 2e-3).abs()).fold(0.0, f64::max);
        assert!((most - 5.7735 * LIFT_M / 4.0).abs() < 0.01, "{most}");
    }

    #[test]
    fn shakes_go_both_ways_along_three_axes() {
        for seed in 0..20 {
            let all = directions(seed);
            assert!(all.len() == SHAKES && all.iter().sum::<Vector3<f64>>().norm() < 1e-12);
            assert!(all.iter().all(|d| (d.norm() - 1.0).abs() < 1e-12));
        }
        assert_ne!(directions(1), directions(2));
    }
}
