//! Weighing without a simulator, where the motion is affine in 1/m: a body in flight, and a body that tips about an edge that sticks.
//!
//! In flight the centre of mass obeys c̈ = u/m + g. Tipping about an edge E by θ, J θ̈ = (1/m) M(u) + g r(θ) with J the inertia about
//! the edge per mass, M the moment of the force about it and r the lever of the centre of mass; friction and normal force act at E and drop out.
//! Integrated twice over a stretch of the track, both are linear in 1/m, the position and the velocity at its start: least squares,
//! reweighed against outliers. The answer is rough (it sees neither take-off nor landing) and independent of any model of
//! contact: a start for the estimate and a check of it.

use drex_core::trajectory::PoseNoise;
use drex_core::{Object, Pose};
use drex_recording::{Drive, ForceProfile, PushRecording, SupportBox, TrackFrame};
use nalgebra::{DMatrix, DVector, Point3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};

use crate::checks::support_top;

/// Frames that a stretch must have.
const MIN_FRAMES: usize = 5;
/// Step of the integrals, seconds.
const STEP_S: f64 = 1e-3;
/// Least lean that counts as tipping, radians.
const LEAST_LEAN: f64 = 0.02;
/// Least height that counts as flight, metres.
const LEAST_HEIGHT_M: f64 = 4e-3;
/// Points this close to the lowest one stand, metres.
const FLAT_M: f64 = 2e-3;
/// Directions that an edge is sought in on each side of the lean, half a degree apart.
const NORMALS: i32 = 80;
/// Squared deviation (in standard deviations) from which on a frame counts as suspicious.
const CAUCHY: f64 = 9.0;
/// Standard deviation of log mass beyond which the answer is not worth giving.
const WORST_SD: f64 = 0.5;

/// A mass from a closed form.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ClosedForm {
    /// Which one.
    pub kind: ClosedFormKind,
    /// The mass, kg.
    pub mass_kg: f64,
    /// Standard deviation of its logarithm from the scatter of the poses alone.
    pub sd_log_mass: f64,
    /// Frames of the track that it uses.
    pub frames: usize,
}

/// Motions with a closed form.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClosedFormKind {
    /// The object is in the air.
    Flight,
    /// It leans on an edge.
    Tipping,
}

/// One component of a motion over a stretch of the track: y(t) = y0 + v0 t + known(t) + by_mass(t)/m.
struct Stretch {
    times_s: Vec<f64>,
    /// Observed minus known.
    rest: Vec<f64>,
    by_mass: Vec<f64>,
    sd: f64,
}

/// The mass of a pushed object from the stretches of its track in which it flies or, if there are none, tips; `offset_s` is the
/// clock of the track minus that of the force. `None` where neither happens, or tells nothing.
pub(crate) fn closed_form(
    recording: &PushRecording,
    object: &Object,
    noise: &PoseNoise,
    offset_s: f64,
) -> Option<ClosedForm> {
    let Drive::Force(force) = &recording.drive else { return None };
    if recording.track_frame != TrackFrame::World {
        return None;
    }
    let track = Track {
        times_s: recording.track.times_s().iter().map(|t| t - offset_s).collect(),
        poses: recording.track.poses(),
        start: recording.initial_pose.or(recording.track.poses().first().copied())?,
    };
    let flight = flight(&track, recording, object, force, noise);
    let (kind, stretches) = match flight.is_empty() {
        false => (ClosedFormKind::Flight, flight),
        true => (ClosedFormKind::Tipping, tipping(&track, recording, object, force, noise)),
    };
    solve(kind, &stretches)
}

struct Track<'a> {
    times_s: Vec<f64>,
    poses: &'a [Pose],
    start: Pose,
}

fn flight(
    track: &Track<'_>,
    recording: &PushRecording,
    object: &Object,
    force: &ForceProfile,
    noise: &PoseNoise,
) -> Vec<Stretch> {
    let above = |pose: &Pose| {
        let (lo, hi) = object.bounds_at(pose)?;
        Some(lo.z - support_top(&recording.support, &lo, &hi))
    };
    let Some(ground) = above(&track.start) else { return Vec::new() };
    let heights: Vec<f64> = track.poses.iter().map(|p| above(p).map_or(0.0, |h| h - ground)).collect();
    // Noise of the rotation lowers the lowest point too.
    let least = LEAST_HEIGHT_M + 3.0 * noise.position_m.hypot(0.25 * object.size_m() * noise.rotation_rad);
    let mut out = Vec::new();
    for run in runs(&heights, least) {
        let times = &track.times_s[run.clone()];
        let pushed = twice_integrated(times, |t| held(&force.times_s, &force.forces_n, t));
        for axis in 0..3 {
            let fall = |t: f64| 0.5 * recording.gravity[axis] * (t - times[0]).powi(2);
            let com = |p: &Pose| (p * object.mass_properties.center_of_mass)[axis];
            out.push(Stretch {
                times_s: times.to_vec(),
                rest: times.iter().zip(&track.poses[run.clone()]).map(|(t, p)| com(p) - fall(*t)).collect(),
                by_mass: pushed.iter().map(|b| b[axis]).collect(),
                sd: noise.position_m,
            });
        }
    }
    out
}

fn tipping(
    track: &Track<'_>,
    recording: &PushRecording,
    object: &Object,
    force: &ForceProfile,
    noise: &PoseNoise,
) -> Vec<Stretch> {
    let up = -recording.gravity.normalize();
    let turn = |p: &Pose| {
        let w = (p.rotation * track.start.rotation.inverse()).scaled_axis();
        w - up * w.dot(&up)
    };
    let turns = smoothed(&track.poses.iter().map(turn).collect::<Vec<_>>());
    let mean: Vector3<f64> = turns.iter().map(|w| w * w.norm()).sum();
    let Some(axis) = mean.try_normalize(1e-9) else { return Vec::new() };
    let Some(lever) = Lever::new(track, recording, object, force.point_in_object, &axis, &up) else {
        return Vec::new();
    };
    let leans: Vec<f64> = turns.iter().map(|w| w.dot(&axis)).collect();
    let least = LEAST_LEAN.max(2.5 * noise.rotation_rad);
    let gravity = recording.gravity.norm();
    let mut out = Vec::new();
    // Beyond the critical lean it falls over, and soon onto something else.
    let critical = (-lever.center.0).atan2(lever.center.1);
    let leaning: Vec<f64> = leans.iter().map(|l| if *l < critical { *l } else { 0.0 }).collect();
    for run in runs(&leaning, least) {
        let times = &track.times_s[run.clone()];
        let lean_at = |t: f64| interpolate(&track.times_s, &leans, t);
        let terms = twice_integrated(times, |t| {
            let f = held(&force.times_s, &force.forces_n, t);
            let (along, high) = lever.turned(&lever.force_point, lean_at(t));
            let torque = held(&force.times_s, &force.torques_nm, t).dot(&lever.direction.cross(&-up));
            let moment = high * f.dot(&lever.direction) - along * f.dot(&up) + torque;
            let (r, _) = lever.turned(&lever.center, lean_at(t));
            Vector3::new(moment, gravity * r, 0.0) / lever.inertia
        });
        out.push(Stretch {
            times_s: times.to_vec(),
            rest: track.poses[run].iter().zip(&terms).map(|(p, b)| turn(p).dot(&axis) - b.y).collect(),
            by_mass: terms.iter().map(|b| b.x).collect(),
            sd: noise.rotation_rad,
        });
    }
    out
}

/// What tips, in the plane across the edge: coordinates along the lean and up, from the edge.
struct Lever {
    direction: Vector3<f64>,
    center: (f64, f64),
    force_point: (f64, f64),
    /// About the edge, per mass, m².
    inertia: f64,
}

impl Lever {
    fn new(
        track: &Track<'_>,
        recording: &PushRecording,
        object: &Object,
        force_point: Point3<f64>,
        axis: &Vector3<f64>,
        up: &Vector3<f64>,
    ) -> Option<Self> {
        let (lo, hi) = object.bounds_at(&track.start)?;
        let top = support_top(&recording.support, &lo, &hi);
        let bottom: Vec<Vector3<f64>> =
            object.corners().map(|p| (track.start * p).coords).filter(|p| p.z < lo.z + FLAT_M).collect();
        let under = recording.support.boxes.iter().filter(|b| (b.center_m[2] + b.half_m[2] - top).abs() < FLAT_M);
        let reaches = |n: &Vector3<f64>| {
            let foot = bottom.iter().map(|p| p.dot(n)).fold(f64::NEG_INFINITY, f64::max);
            let reach = |b: &SupportBox| (0..2).map(|i| b.center_m[i] * n[i] + b.half_m[i] * n[i].abs()).sum::<f64>();
            under.clone().map(reach).fold(foot, f64::min)
        };
        // The edge is where the way from the centre in the direction of the lean leaves the foot or what it stands on.
        let lean = axis.cross(up);
        let c = (track.start * object.mass_properties.center_of_mass).coords;
        let normals = (-NORMALS..=NORMALS).map(|k| {
            let n = Rotation3::new(up * (f64::from(k) * 0.5_f64.to_radians())) * lean;
            ((reaches(&n) - c.dot(&n)) / n.dot(&lean), n)
        });
        let (_, direction) = normals.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let (edge, axis) = (reaches(&direction), up.cross(&direction));
        let place = |p: Point3<f64>| {
            let w = track.start * p;
            (w.coords.dot(&direction) - edge, w.coords.dot(up) - top)
        };
        let center = place(object.mass_properties.center_of_mass);
        let in_body = track.start.rotation.inverse() * axis;
        let about_center = in_body.dot(&(object.mass_properties.inertia * in_body)) / object.mass_properties.mass_kg;
        let inertia = about_center + center.0 * center.0 + center.1 * center.1;
        (edge.is_finite() && inertia > 0.0).then_some(Self {
            direction,
            center,
            force_point: place(force_point),
            inertia,
        })
    }

    /// Where a point of the object is at a lean.
    fn turned(&self, point: &(f64, f64), lean: f64) -> (f64, f64) {
        let (s, c) = lean.sin_cos();
        (c * point.0 + s * point.1, c * point.1 - s * point.0)
    }
}

/// Least squares over all stretches: 1/m is common to them.
fn solve(kind: ClosedFormKind, stretches: &[Stretch]) -> Option<ClosedForm> {
    let frames: usize = stretches.iter().map(|s| s.times_s.len()).sum();
    let n = 1 + 2 * stretches.len();
    if stretches.is_empty() || frames <= n {
        return None;
    }
    let (mut a, mut y) = (DMatrix::zeros(frames, n), DVector::zeros(frames));
    let mut row = 0;
    for (k, s) in stretches.iter().enumerate() {
        for ((t, rest), b) in s.times_s.iter().zip(&s.rest).zip(&s.by_mass) {
            a[(row, 0)] = b / s.sd;
            a[(row, 1 + 2 * k)] = 1.0 / s.sd;
            a[(row, 2 + 2 * k)] = (t - s.times_s[0]) / s.sd;
            y[row] = rest / s.sd;
            row += 1;
        }
    }
    let mut weights = DVector::from_element(frames, 1.0);
    let mut found = None;
    for _ in 0..12 {
        let weighted = DMatrix::from_fn(frames, n, |i, j| a[(i, j)] * weights[i]);
        let inverse = (a.transpose() * &weighted).cholesky()?.inverse();
        let x = &inverse * (weighted.transpose() * &y);
        let r = &y - &a * &x;
        weights = r.map(|r| 1.0 / (1.0 + r * r / CAUCHY));
        let square: f64 = r.iter().zip(&weights).map(|(r, w)| w * r * r).sum();
        let excess = (square / (weights.sum() - n as f64).max(1.0)).max(1.0);
        found = Some((x[0], (inverse[(0, 0)] * excess).sqrt()));
    }
    let (inverse_mass, sd) = found?;
    let sd_log_mass = sd / inverse_mass;
    let good = inverse_mass > 0.0 && sd_log_mass < WORST_SD;
    let used = if kind == ClosedFormKind::Flight { frames / 3 } else { frames };
    good.then_some(ClosedForm { kind, mass_kg: 1.0 / inverse_mass, sd_log_mass, frames: used })
}

/// Stretches of frames that are all above `least`.
fn runs(values: &[f64], least: f64) -> Vec<std::ops::Range<usize>> {
    let (mut out, mut from) = (Vec::new(), None);
    for k in 0..=values.len() {
        match (from, values.get(k).is_some_and(|v| *v > least)) {
            (None, true) => from = Some(k),
            (Some(a), false) => {
                if k - a >= MIN_FRAMES {
                    out.push(a..k);
                }
                from = None;
            }
            _ => {}
        }
    }
    out
}

/// Each entry replaced by the median, per component, of itself and its neighbours.
fn smoothed(x: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let median = |a: f64, b: f64, c: f64| a.max(b).min(a.min(b).max(c));
    (0..x.len())
        .map(|k| {
            let (a, c) = (x[k.saturating_sub(1)], x[(k + 1).min(x.len() - 1)]);
            Vector3::from_fn(|i, _| median(a[i], x[k][i], c[i]))
        })
        .collect()
}

/// The sample that holds at time t.
fn held(times_s: &[f64], samples: &[Vector3<f64>], t: f64) -> Vector3<f64> {
    let k = times_s.partition_point(|x| *x <= t);
    k.checked_sub(1).and_then(|k| samples.get(k)).copied().unwrap_or_default()
}

fn interpolate(times_s: &[f64], values: &[f64], t: f64) -> f64 {
    let k = times_s.partition_point(|x| *x <= t).clamp(1, times_s.len() - 1);
    let (a, b) = (times_s[k - 1], times_s[k]);
    let s = if b > a { ((t - a) / (b - a)).clamp(0.0, 1.0) } else { 0.0 };
    values[k - 1] + s * (values[k] - values[k - 1])
}

/// ∫∫ f from the first of `times_s` to each of them, by the midpoint rule.
fn twice_integrated(times_s: &[f64], f: impl Fn(f64) -> Vector3<f64>) -> Vec<Vector3<f64>> {
    let (mut once, mut twice) = (Vector3::zeros(), Vector3::zeros());
    let mut out = vec![twice];
    for w in times_s.windows(2) {
        let steps = ((w[1] - w[0]) / STEP_S).ceil().max(1.0);
        let h = (w[1] - w[0]) / steps;
        for k in 0..steps as usize {
            let a = f(w[0] + (k as f64 + 0.5) * h);
            twice += (once + a * (0.5 * h)) * h;
            once += a * h;
        }
        out.push(twice);
    }
    out
}
