//! What a recording must be before it is worth simulating.

use drex_core::pose::pose_difference;
use drex_core::trajectory::PoseNoise;
use drex_core::{Object, Pose};
use drex_recording::{Drive, PushRecording, Support, SupportBox, TrackFrame};
use nalgebra::{Point3, Vector3};

use crate::{Result, SysidError};

/// Poses a track must have.
const MIN_POSES: usize = 10;
/// Sizes of things that stand on a table and are pushed, metres.
const SIZES_M: [f64; 2] = [2e-3, 3.0];
/// How far from its support an object at rest may start, metres: trackers are biased by a centimetre.
const GAP_M: f64 = 0.02;
/// Frames over which a start at rest is checked.
const FIRST_FRAMES: usize = 5;
/// Farthest that something at rest seems to go in these, metres, where noise allows no more.
const DRIFT_M: f64 = 5e-3;

/// Farthest outside the box around the object that a force on it may act, metres: what pushes is a fingertip wide.
const OUTSIDE_M: f64 = 0.01;

/// Refuses recordings that cannot be what they say they are.
pub(crate) fn recording(recording: &PushRecording, object: &Object, noise: &PoseNoise) -> Result<()> {
    let poses = recording.track.len();
    if poses < MIN_POSES {
        return Err(SysidError::TooFewPoses { push: recording.name.clone(), poses, needed: MIN_POSES });
    }
    let size = object.size_m();
    if !(SIZES_M[0]..=SIZES_M[1]).contains(&size) {
        return Err(SysidError::Object {
            what: format!("is {size:.3} m across"),
            remedy:
                "nothing of that size is pushed over a table: give the mesh in metres (millimetres are a thousandth)"
                    .into(),
        });
    }
    if recording.track_frame != TrackFrame::World {
        return Ok(());
    }
    if !acts(&recording.drive) && still(recording, noise) {
        return Err(refuse(
            recording,
            "nothing moves: neither the object nor what should push it".into(),
            "check that the files belong to this push and cover it",
        ));
    }
    if recording.starts_at_rest {
        stands(recording, object)?;
        if recording.initial_pose.is_none() {
            rests(recording, noise)?;
        }
    }
    Ok(())
}

/// How far outside the box around the object the recorded force acts, metres, if that is too far to be a push of it. Inside it a
/// hook or a rig may well act between the limbs of an object.
pub(crate) fn outside_m(recording: &PushRecording, object: &Object) -> Option<f64> {
    let Drive::Force(force) = &recording.drive else { return None };
    let (lo, hi) = object.bounds_at(&Pose::identity())?;
    let p = force.point_in_object;
    let distance_m = (lo - p).sup(&(p - hi)).sup(&Vector3::zeros()).norm();
    Some(distance_m).filter(|d| *d > OUTSIDE_M)
}

/// Whether anything is commanded to act.
fn acts(drive: &Drive) -> bool {
    match drive {
        Drive::Force(f) => f.forces_n.iter().chain(&f.torques_nm).any(|f| f.norm() > 0.0),
        Drive::Finger(f) => f.commands.iter().any(|c| *c != f.commands[0]),
        _ => false,
    }
}

/// Whether no pose differs from the first ones by more than noise and a few outliers explain.
fn still(recording: &PushRecording, noise: &PoseNoise) -> bool {
    let poses = recording.track.poses();
    let Some(first) = poses.first() else { return true };
    let far = |p: &Pose| {
        let d = pose_difference(first, p);
        d.fixed_rows::<3>(0).norm() > 8.0 * noise.position_m || d.fixed_rows::<3>(3).norm() > 8.0 * noise.rotation_rad
    };
    !poses.windows(2).any(|w| far(&w[0]) && far(&w[1]))
}

/// The start pose must put the object on its support, or the middle one of the first poses.
fn stands(recording: &PushRecording, object: &Object) -> Result<()> {
    let first = recording.track.poses().iter().take(FIRST_FRAMES);
    let starts = recording.initial_pose.as_ref().map_or(first.collect(), |start| vec![start]);
    let mut bounds: Vec<_> = starts.iter().filter_map(|p| object.bounds_at(p)).collect();
    bounds.sort_by(|a, b| a.0.z.total_cmp(&b.0.z));
    let Some((lo, hi)) = bounds.get(bounds.len() / 2) else { return Ok(()) };
    let table = recording.support.table_height_m;
    let highest = support_top(&recording.support, lo, hi);
    let millimetres = |x: f64| format!("{:.0} mm", 1e3 * x);
    let what = if lo.z > highest + GAP_M {
        format!("the object starts at rest {} above what it should stand on", millimetres(lo.z - highest))
    } else if lo.z < table - GAP_M {
        format!("the object starts {} deep in the table", millimetres(table - lo.z))
    } else {
        return Ok(());
    };
    Err(refuse(
        recording,
        what,
        "check table_height_m, the start pose, the frame of the track and the mesh's unit and origin",
    ))
}

/// The highest thing under an outline: it holds what stands there.
pub(crate) fn support_top(support: &Support, lo: &Point3<f64>, hi: &Point3<f64>) -> f64 {
    let under =
        |b: &&SupportBox| (0..2).all(|i| lo[i] <= b.center_m[i] + b.half_m[i] && hi[i] >= b.center_m[i] - b.half_m[i]);
    let tops = support.boxes.iter().filter(under).map(|b| b.center_m[2] + b.half_m[2]);
    tops.fold(support.table_height_m, f64::max)
}

/// The first poses must be those of an object at rest, one outlier aside: they are the start of the simulation.
fn rests(recording: &PushRecording, noise: &PoseNoise) -> Result<()> {
    let n = FIRST_FRAMES.min(recording.track.len());
    let (times, poses) = (&recording.track.times_s()[..n], &recording.track.poses()[..n]);
    let span = times[n - 1] - times[0];
    // How far a line through all but one of the frames goes, as a share of what noise allows.
    let without = |left_out: usize| {
        let kept = || times.iter().zip(poses).enumerate().filter(|(k, _)| *k != left_out).map(|(_, row)| row);
        let mean_t = kept().map(|(t, _)| t).sum::<f64>() / (n - 1) as f64;
        let spread: f64 = kept().map(|(t, _)| (t - mean_t).powi(2)).sum();
        let slope: Vector3<f64> = kept().map(|(t, p)| p.translation.vector * ((t - mean_t) / spread)).sum();
        let moved = slope.norm() * span;
        (moved, moved / (6.0 * noise.position_m / spread.sqrt() * span).max(DRIFT_M))
    };
    let least = (0..n).map(without).min_by(|a, b| a.1.total_cmp(&b.1));
    let Some((moved, _)) = least.filter(|(_, share)| *share > 1.0) else { return Ok(()) };
    Err(refuse(
        recording,
        format!(
            "the track has no rest segment: its object starts at rest but moves {:.0} mm in the first {n} poses",
            1e3 * moved
        ),
        "start the track before the push, or give the pose at rest as [start] pose",
    ))
}

fn refuse(recording: &PushRecording, what: String, remedy: &str) -> SysidError {
    SysidError::Recording { push: recording.name.clone(), what, remedy: remedy.into() }
}
