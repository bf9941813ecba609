//! What is there where a hand knows an object from a scan and itself from a model: the surface is off by millimetres, the centre of mass by up to a
//! centimetre, the joints' friction and the drives' gains by up to a fifth, and commands act late.

use std::f64::consts::TAU;
use std::sync::Arc;

use anyhow::{Context, Result};
use drex_core::Object;
use drex_mesh::asset_from_mesh;
use drex_robot::{ActuatorKind, Robot};
use drex_trial::TrialOptions;
use nalgebra::{Point2, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::objects::ObjectSpec;

/// What distinguishes the seeds.
const SCAN_SEED: u64 = 0x7363_616e;
const HAND_SEED: u64 = 0x6861_6e64;
const CENTRE_SEED: u64 = 0x6365_6e74;
/// Waves of the error of a scan, how high each is, and their lengths, metres. Together they move a point by 1.2 mm, root mean square.
const WAVES: usize = 6;
const WAVE_M: f64 = 0.0007;
const WAVELENGTHS_M: std::ops::RangeInclusive<f64> = 0.03..=0.12;
/// Farthest that the centre of mass is off, metres, and how far it stays from the edge of what the object stands on.
const OFF_M: f64 = 0.010;
const EDGE_M: f64 = 0.002;
/// Part by which friction and gains are off at most.
const PART: f64 = 0.2;
/// Time until a command acts, s.
const LATENCY_S: f64 = 0.02;

/// The object as a scan has it, where it is: its surface is off by smooth waves, its centre of mass is that of one density.
pub fn scanned(spec: &ObjectSpec, object: &Object, seed: u64) -> Result<Object> {
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ SCAN_SEED);
    let direction = |random: &mut ChaCha8Rng| {
        let z = random.random_range(-1.0..1.0_f64);
        let (sin, cos) = random.random_range(0.0..TAU).sin_cos();
        let r = (1.0 - z * z).sqrt();
        Vector3::new(r * cos, r * sin, z)
    };
    let waves: Vec<(Vector3<f64>, Vector3<f64>, f64)> = (0..WAVES)
        .map(|_| {
            let along = direction(&mut random) * (TAU / random.random_range(WAVELENGTHS_M));
            (along, WAVE_M * direction(&mut random), random.random_range(0.0..TAU))
        })
        .collect();
    let mut mesh = spec.mesh.clone();
    for v in &mut mesh.vertices {
        let at = v.coords;
        *v += waves.iter().map(|(along, by, phase)| by * (along.dot(&at) + phase).sin()).sum::<Vector3<f64>>();
    }
    let at = || format!("scan of \"{}\"", spec.name);
    let asset = asset_from_mesh(&mesh, &spec.asset_options()).with_context(at)?;
    let mut scan = asset.to_object(&spec.name).with_context(at)?;
    scan.max_finger_n = object.max_finger_n;
    Ok(scan.with_rest_pose(object.world_from_object))
}

/// The object with its centre of mass elsewhere, where it still stands.
pub fn off_centre(object: &Object, seed: u64) -> Object {
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ CENTRE_SEED);
    let pose = object.world_from_object;
    let lowest = object.mesh.vertices.iter().map(|v| (pose * v).z).fold(f64::INFINITY, f64::min);
    let stands: Vec<Point2<f64>> =
        object.mesh.vertices.iter().map(|v| pose * v).filter(|p| p.z < lowest + 1e-3).map(|p| p.xy()).collect();
    let centre = pose * object.mass_properties.center_of_mass;
    let mut off = Vector3::zeros();
    for _ in 0..100 {
        let drawn = Vector3::from_fn(|_, _| random.random_range(-OFF_M..OFF_M));
        if drawn.norm() < OFF_M && over(&stands, &(centre + drawn).xy()) {
            off = drawn;
            break;
        }
    }
    let mut object = object.clone();
    object.mass_properties.center_of_mass = pose.inverse() * (centre + off);
    object
}

/// Whether a point is over what an object stands on, with room on all sides.
fn over(stands: &[Point2<f64>], point: &Point2<f64>) -> bool {
    // Some of it lies beyond the point in every direction.
    (0..32).all(|k| {
        let (sin, cos) = (TAU * f64::from(k) / 32.0).sin_cos();
        stands.iter().any(|p| (p.x - point.x) * cos + (p.y - point.y) * sin > EDGE_M)
    })
}

/// The hand with other friction and other gains in each of its joints.
pub fn disturbed(hand: &Robot, seed: u64) -> Arc<Robot> {
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ HAND_SEED);
    let mut part = || random.random_range(1.0 - PART..1.0 + PART);
    let mut hand = hand.clone();
    hand.joints.iter_mut().for_each(|j| j.friction_loss *= part());
    for a in &mut hand.actuators {
        if let ActuatorKind::Position { kp, kv } = &mut a.kind {
            let part = part();
            (*kp, *kv) = (*kp * part, *kv * part);
        }
    }
    Arc::new(hand)
}

/// Options of trials in which commands act late.
pub fn late() -> TrialOptions {
    let mut options = TrialOptions::default();
    options.latency_s = LATENCY_S;
    options
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::super::{Category, at_rest, graspable};
    use super::*;

    #[test]
    fn a_scan_is_where_the_object_is_and_what_is_off_centre_still_stands() {
        let mut moved = 0;
        for number in 0..5 {
            let spec = graspable(&Category::HELD_OUT, 11, number).unwrap();
            let object = at_rest(&spec, number).unwrap();
            let scan = scanned(&spec, &object, number).unwrap();
            let world = |o: &Object| o.mesh.vertices.iter().map(|v| o.world_from_object * v).collect::<Vec<_>>();
            let (true_at, scan_at) = (world(&object), world(&scan));
            assert_eq!(true_at.len(), scan_at.len(), "{}", spec.name);
            let most = true_at.iter().zip(&scan_at).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
            assert!(most > 2e-4 && most < WAVES as f64 * WAVE_M + 1e-9, "{}: {most}", spec.name);

            let centre = |o: &Object| o.mass_properties.center_of_mass;
            let off = (centre(&off_centre(&object, number)) - centre(&object)).norm();
            assert!(off <= OFF_M, "{}: {off}", spec.name);
            moved += usize::from(off > 1e-3);
        }
        assert!(moved >= 3, "{moved} of 5");
    }

    #[test]
    fn a_hand_is_off_by_a_fifth_at_most_and_every_seed_has_its_own() {
        for name in ["leap_right", "allegro_right"] {
            let hand = Robot::bundled(name).unwrap();
            let (one, another) = (disturbed(&hand, 1), disturbed(&hand, 2));
            assert_ne!(one.joints[3].friction_loss, another.joints[3].friction_loss);
            for (j, known) in one.joints.iter().zip(&hand.joints) {
                assert!((j.friction_loss / known.friction_loss - 1.0).abs() <= PART);
            }
            for (a, known) in one.actuators.iter().zip(&hand.actuators) {
                let (ActuatorKind::Position { kp, .. }, ActuatorKind::Position { kp: known, .. }) =
                    (a.kind, known.kind)
                else {
                    panic!("{name} has no position drives")
                };
                assert!(kp != known && (kp / known - 1.0).abs() <= PART);
            }
        }
    }
}
