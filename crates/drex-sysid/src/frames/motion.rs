//! What a track does before anything is known of its frames: which frames are outliers, how long the object rests,
//! when it starts to move, and where it comes to rest again.

use std::ops::Range;

use drex_core::pose::{interpolate, pose_difference};
use drex_core::trajectory::TrackNoise;
use drex_core::{Pose, Trajectory};
use nalgebra::{UnitQuaternion, Vector3, Vector6};

use crate::{Result, SysidError};

/// Poses that a track must have.
const LEAST_POSES: usize = 10;
/// Poses that the rest before the push must have.
const LEAST_REST: usize = 5;
/// Standard deviations by which medians of five frames must leave the rest.
const SIGMAS: [f64; 3] = [6.0, 4.5, 3.5];

/// The parts of a track.
#[derive(Debug, Clone)]
pub(super) struct Motion {
    /// The track without its outliers.
    pub clean: Trajectory,
    /// Robust weight of each frame of the whole track, 0 to 1.
    pub weights: Vec<f64>,
    /// White noise per axis.
    pub noise: TrackNoise,
    /// Frames of `clean` at rest before the push.
    pub rest: Range<usize>,
    /// Mean pose of these.
    pub rest_pose: Pose,
    /// When the object starts to move, and the standard deviation of that, seconds.
    pub start_s: (f64, f64),
    /// Frames of `clean` at the end during which it rests again; may be empty.
    pub settled: Range<usize>,
}

impl Motion {
    /// Divides `track`.
    ///
    /// # Errors
    /// If the track has too few poses, does not begin at rest, or never moves.
    pub fn of(track: &Trajectory) -> Result<Self> {
        if track.len() < LEAST_POSES {
            return Err(SysidError::TooFewPoses { push: "track".into(), poses: track.len(), needed: LEAST_POSES });
        }
        let refuse = |what: String, remedy: &str| SysidError::Frames { what, remedy: remedy.into() };
        let weights = outlier_weights(track);
        let kept: Vec<usize> = (0..track.len()).filter(|&i| weights[i] > 0.1).collect();
        let pick = |i: &usize| (track.times_s()[*i], track.poses()[*i]);
        let (times, poses): (Vec<f64>, Vec<Pose>) = kept.iter().map(pick).unzip();
        let clean = Trajectory::from_samples(&times, &poses)?;
        let noise = clean.noise().ok_or_else(|| refuse("the track is all outliers".into(), "record again"))?;
        // A track that rocks all the time looks noisier than it is: what is not sure may still be there.
        let sigmas = SIGMAS.into_iter().find(|s| clean.leading_rest(&noise, *s) < clean.len()).unwrap_or(SIGMAS[0]);
        let still = clean.leading_rest(&noise, sigmas);
        let span = track.span_s().unwrap_or_default();
        if still >= clean.len() {
            return Err(refuse(
                format!("the object never moves beyond the tracker's noise between {:.3} and {:.3} s", span.0, span.1),
                "record a push that moves it",
            ));
        }
        let rest_pose = mean_pose(&poses[..still]);
        if still < LEAST_REST || !rests(&poses[..still], &rest_pose, &noise) {
            return Err(refuse(
                format!("the object already moves at the first pose ({:.3} s)", span.0),
                "start the track at least half a second before the push, or give the camera's pose",
            ));
        }
        let (start_s, first) = onset(&clean, still, &rest_pose, &noise);
        let back: Vec<f64> = times.iter().rev().map(|t| -t).collect();
        let turned: Vec<Pose> = poses.iter().rev().copied().collect();
        let calm = Trajectory::from_samples(&back, &turned)?.leading_rest(&noise, sigmas);
        let settled = clean.len() - calm.min(clean.len() - still)..clean.len();
        Ok(Self { rest: 0..first, rest_pose, start_s, settled, noise, weights, clean })
    }
}

/// Whether poses scatter about `mean` no more than a tracker's noise and drift explain.
fn rests(poses: &[Pose], mean: &Pose, noise: &TrackNoise) -> bool {
    let off: Vec<Vector6<f64>> = poses.iter().map(|p| pose_difference(mean, p)).collect();
    let white: Vec<f64> = noise.position_m.iter().chain(&noise.rotation_rad).copied().collect();
    let rms = |k: usize| (off.iter().map(|d| d[k] * d[k]).sum::<f64>() / poses.len() as f64).sqrt();
    (0..6).all(|k| rms(k) < 6.0 * white[k].max(if k < 3 { 1e-4 } else { 1e-3 }))
}

/// Weight of each frame: how well it lies between its neighbours, measured by how far these lie apart. A frame that
/// jumps away and back gets a small weight; fast motion does not.
fn outlier_weights(track: &Trajectory) -> Vec<f64> {
    let (t, p) = (track.times_s(), track.poses());
    let noise = track.noise();
    let (sp, sr) = noise.map_or((1e-3, 0.01), |n| (n.position_m.norm(), n.rotation_rad.norm()));
    let off = |i: usize, a: usize, b: usize| -> (f64, f64) {
        let s = (t[i] - t[a]) / (t[b] - t[a]);
        let d = pose_difference(&interpolate(&p[a], &p[b], s), &p[i]);
        let apart = pose_difference(&p[a], &p[b]);
        let part = |d: &Vector6<f64>, k: usize| d.fixed_rows::<3>(k).norm();
        let scale = |k: usize, noise: f64| (3.0 * noise.powi(2) + (0.5 * part(&apart, k)).powi(2)).sqrt().max(1e-9);
        (part(&d, 0) / scale(0, sp), part(&d, 3) / scale(3, sr))
    };
    (0..track.len())
        .map(|i| {
            // One pair alone would not see two outliers in a row.
            let pairs = [(1, 1), (2, 1), (1, 2)];
            let offs = pairs.iter().filter(|(a, b)| i >= *a && i + b < track.len()).map(|(a, b)| off(i, i - a, i + b));
            let worst = offs.map(|(a, b)| a.max(b)).fold(0.0, f64::max);
            1.0 / (1.0 + (worst / 4.0).powi(4))
        })
        .collect()
}

/// Robust mean of poses of an object at rest.
pub(super) fn mean_pose(poses: &[Pose]) -> Pose {
    let Some(first) = poses.first() else { return Pose::identity() };
    let middle = |mut v: Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v.get(v.len() / 2).copied().unwrap_or(0.0)
    };
    let mut center = *first;
    // Medians first, then means of what is within three median deviations, per axis.
    for round in 0..4 {
        let d: Vec<Vector6<f64>> = poses.iter().map(|p| pose_difference(&center, p)).collect();
        let step = Vector6::from_fn(|k, _| {
            let values: Vec<f64> = d.iter().map(|v| v[k]).collect();
            let median = middle(values.clone());
            if round < 2 {
                return median;
            }
            let spread = 3.0 * middle(values.iter().map(|v| (v - median).abs()).collect()) / 0.6745;
            let (sum, n) =
                values.iter().filter(|v| (*v - median).abs() <= spread).fold((0.0, 0), |(s, n), v| (s + v, n + 1));
            if n > 0 { sum / f64::from(n) } else { median }
        });
        center.translation.vector += step.fixed_rows::<3>(0);
        center.rotation *= UnitQuaternion::from_scaled_axis(Vector3::from(step.fixed_rows::<3>(3)));
    }
    center
}

/// When the motion starts, and its standard deviation: the size of the motion over the first frames, less what noise adds
/// to it, is carried back to zero along a line. Also the first frame that is no longer at rest.
fn onset(track: &Trajectory, still: usize, rest: &Pose, noise: &TrackNoise) -> ((f64, f64), usize) {
    let (t, p) = (track.times_s(), track.poses());
    // A tracker also drifts: the scatter about the mean of the rest counts, not only the white noise.
    let off: Vec<Vector6<f64>> = p[..still].iter().map(|p| pose_difference(rest, p)).collect();
    let white: Vec<f64> = noise.position_m.iter().chain(&noise.rotation_rad).copied().collect();
    let sd: Vec<f64> = (0..6)
        .map(|k| white[k].max((off.iter().map(|d| d[k] * d[k]).sum::<f64>() / still as f64).sqrt()).max(1e-9))
        .collect();
    let size = |i: usize| {
        let d = pose_difference(rest, &p[i]);
        ((0..6).map(|k| (d[k] / sd[k]).powi(2)).sum::<f64>() - 6.0).max(0.0).sqrt()
    };
    // `leading_rest` looks five frames ahead: the motion begins with the last run of frames beyond the noise after it.
    let first = (still..track.len()).find(|&i| (i..(i + 3).min(track.len())).all(|k| size(k) > 6.0)).unwrap_or(still);
    let step = track.median_step_s().unwrap_or(0.0);
    let rows: Vec<(f64, f64)> = (first..(first + 4).min(track.len())).map(|i| (t[i], size(i))).collect();
    let n = rows.len() as f64;
    let (mt, ms) = (rows.iter().map(|r| r.0).sum::<f64>() / n, rows.iter().map(|r| r.1).sum::<f64>() / n);
    let slope = rows.iter().map(|r| (r.0 - mt) * (r.1 - ms)).sum::<f64>()
        / rows.iter().map(|r| (r.0 - mt).powi(2)).sum::<f64>().max(1e-12);
    let earliest = t[first.saturating_sub(2)];
    let start = if slope > 0.0 { (mt - ms / slope).clamp(earliest, t[first]) } else { t[first] };
    ((start, step), first)
}
