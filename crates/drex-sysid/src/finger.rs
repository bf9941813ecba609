//! The force of a compliant fingertip from its command and its encoder.
//!
//! On each axis (m + armature) q̈ = kp (command − q) − (kv + damping) q̇ − f, gravity compensated, so the force on the object is
//! f = kp (command − q) − (kv + damping) q̇ − (m + armature) q̈: known, without any model of the contact. Between two encoder
//! samples its mean follows from the differences of position and velocity, so that no impulse is lost.

use drex_core::push::{FingerPush, PushRecording};
use drex_diffsim::{ConvexPiece, ForcePoint};
use nalgebra::{Point3, Vector3};

use crate::noise;
use crate::problem::Action;

/// Standard deviation that a fingertip's encoder is credited with, metres.
const ENCODER_M: f64 = 1e-4;
/// Share of the peak force that its noise may reach; beyond, the finger is as good as rigid and its force unknown.
const LOUDEST: f64 = 0.3;

/// The force of the finger as a known force, or `None` where there is no encoder or it cannot resolve the force.
pub(crate) fn known_force(recording: &PushRecording, finger: &FingerPush, shape: &[ConvexPiece]) -> Option<Action> {
    let encoder = finger.encoder.as_ref()?;
    let n = encoder.times_s.len();
    if n < 3 || encoder.positions.len() != n || encoder.velocities.len() != n {
        return None;
    }
    let tip = &finger.impedance;
    let command = |t: f64| {
        let k = finger.command_times_s.partition_point(|&s| s <= t + 1e-9);
        finger.commands.get(k.saturating_sub(1)).copied()
    };
    let (mut forces_n, mut points) = (Vec::with_capacity(n), Vec::with_capacity(n));
    for k in 0..n {
        let (a, b) = (k.min(n - 2), k.min(n - 2) + 1);
        let dt = encoder.times_s[b] - encoder.times_s[a];
        let middle = nalgebra::center(&encoder.positions[a], &encoder.positions[b]);
        let velocity = (encoder.positions[b] - encoder.positions[a]) / dt;
        let acceleration = (encoder.velocities[b] - encoder.velocities[a]) / dt;
        let force = (command(encoder.times_s[a])? - middle) * tip.kp_n_m
            - velocity * (tip.kv_ns_m + tip.damping_ns_m)
            - acceleration * (tip.mass_kg + tip.armature_kg);
        forces_n.push(if k + 1 < n { force } else { Vector3::zeros() });
        points.push(contact_point(recording, shape, encoder.times_s[k], &encoder.positions[k], tip.radius_m)?);
    }
    if forces_n.iter().any(|f| f.iter().any(|x| !x.is_finite())) {
        return None;
    }
    let peak = forces_n.iter().map(Vector3::norm).fold(0.0, f64::max);
    let seen_n = noise::significant(&forces_n);
    let noise_n = seen_n.max(tip.kp_n_m * ENCODER_M);
    if noise_n > LOUDEST * peak {
        return None;
    }
    let forces_n = noise::without_idle(&forces_n, seen_n);
    Some(Action::Force { times_s: encoder.times_s.clone(), forces_n, noise_n, point: ForcePoint::World(points) })
}

/// Where the tip touches the object, or would: from its centre towards the face it is farthest in front of.
fn contact_point(
    recording: &PushRecording,
    shape: &[ConvexPiece],
    t: f64,
    center: &Point3<f64>,
    radius: f64,
) -> Option<Point3<f64>> {
    let (first, last) = recording.track.span_s()?;
    let pose = match recording.initial_pose {
        Some(start) if t < first => start,
        _ => recording.track.at(t.clamp(first, last))?,
    };
    let local = pose.inverse() * center;
    let front = |piece: &ConvexPiece| {
        piece.planes().iter().map(|(n, d)| (n.dot(&local.coords) - d, *n)).max_by(|a, b| a.0.total_cmp(&b.0))
    };
    let (_, normal) = shape.iter().filter_map(front).min_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(center - pose.rotation * normal * radius)
}
