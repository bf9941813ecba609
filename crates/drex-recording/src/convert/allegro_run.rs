//! Logged runs of a robot hand that topples an object: a folder with `run.json`, the joint log and the log that
//! FoundationPose printed.
//!
//! The camera's pose in the world is unknown in this layout. The run may name the up direction of the resting object, the
//! direction of the push and how the mesh sits in the tracked frame; what it does not name is left to be found in the track.

use std::path::{Path, PathBuf};

use drex_core::pose::rotation_from_matrix;
use drex_core::{Error, Pose, Result, fsutil};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use serde::Deserialize;

use crate::clock::{format_utc_offset, parse_utc_offset};
use crate::{
    ClockConfig, ClockKind, FrameKind, HandConfig, PoseConfig, PushConfig, PushRecording, StartConfig, Support,
    TrackConfig, TrackFormat,
};

/// `run.json`.
#[derive(Deserialize)]
struct Run {
    object: String,
    mesh: PathBuf,
    hand: String,
    hand_base_pose_xyz_m: [f64; 3],
    hand_base_quat_wxyz: [f64; 4],
    table_height_m: f64,
    object_start_xyz_m_nominal: Option<[f64; 3]>,
    joint_clock: String,
    pose_clock: String,
    mass_prior_kg: Option<f64>,
    tracked_from_mesh: Option<TrackedFromMesh>,
    up_in_tracked_frame: Option<[f64; 3]>,
    topples_towards_in_tracked_frame: Option<[f64; 3]>,
}

#[derive(Deserialize)]
struct TrackedFromMesh {
    rotation_rows: [[f64; 3]; 3],
    translation_m: [f64; 3],
}

/// The run in the folder `run` as a `push.toml` whose paths start at that folder. `joint_names` are the joints of the
/// columns `position_0`, `position_1`, … of its joint log: `drex_robot::joint_order::ALLEGRO_ROS`. The meaning of the
/// run's own clocks and frames is spelled out.
///
/// # Errors
/// If `run.json` cannot be read or is malformed, a given `tracked_from_mesh` is no rotation, a clock is not understood, or the
/// hand is no Allegro hand.
pub fn push_config(run: &Path, joint_names: &[&str]) -> Result<PushConfig> {
    let folder = run;
    let run_json = folder.join("run.json");
    let run: Run = fsutil::from_json(&run_json, &fsutil::read_text(&run_json)?)?;
    let refuse = |what: String, remedy: &str| Error::content(&run_json, None, what, remedy);

    let tracked_from_mesh = match &run.tracked_from_mesh {
        None => None,
        Some(t) => {
            let rows = Matrix3::from_fn(|i, j| t.rotation_rows[i][j]);
            let rotation = rotation_from_matrix(&rows)
                .map_err(|e| refuse(format!("tracked_from_mesh: {e}"), "correct the matrix"))?;
            Some(Pose::from_parts(t.translation_m.into(), rotation))
        }
    };
    let rotation = tracked_from_mesh.map_or_else(UnitQuaternion::identity, |t| t.rotation);
    let up =
        match run.up_in_tracked_frame {
            None => None,
            Some(up) => Some(unit(up).ok_or_else(|| {
                refuse("up_in_tracked_frame is no direction".into(), "give a vector that is not zero")
            })?),
        };
    let push = match run.topples_towards_in_tracked_frame {
        None => None,
        Some(towards) => {
            let towards = Vector3::from(towards);
            let horizontal = towards - up.map_or_else(Vector3::zeros, |up| up * up.dot(&towards));
            let horizontal = unit(horizontal.into()).filter(|_| towards.amax() > 0.0).ok_or_else(|| {
                refuse("topples_towards_in_tracked_frame has no horizontal part".into(), "give a direction across up")
            })?;
            Some((rotation.inverse() * horizontal).into())
        }
    };
    if !run.joint_clock.starts_with("unix") {
        return Err(refuse(format!("joint_clock `{}` is not known", run.joint_clock), "give unix seconds"));
    }
    let utc_offset =
        parse_utc_offset(&run.pose_clock).map_err(|e| refuse(format!("pose_clock: {e}"), "name the time zone"))?;
    if !matches!(run.hand.as_str(), "allegro_right" | "allegro_left") {
        return Err(refuse(
            format!("the joint order of hand `{}` is not known here", run.hand),
            "write a push.toml with [hand] joint_names instead",
        ));
    }
    let track = TrackConfig {
        clock: ClockConfig {
            kind: ClockKind::LocalIso,
            utc_offset: Some(format_utc_offset(utc_offset)),
            offset_s: None,
        },
        up_in_mesh: up.map(|up| (rotation.inverse() * up).into()),
        push_in_mesh: push,
        tracked_from_mesh: tracked_from_mesh.as_ref().map(PoseConfig::from),
        ..TrackConfig::new("object_poses.txt", TrackFormat::FoundationPoseLog, FrameKind::Camera)
    };
    Ok(PushConfig {
        name: Some(match fsutil::absolute(folder).file_name() {
            Some(name) => name.to_string_lossy().into_owned(),
            None => run.object,
        }),
        mass_prior_kg: run.mass_prior_kg,
        support: Support { table_height_m: run.table_height_m, ..Support::default() },
        start: StartConfig {
            at_rest: true,
            nominal_position_m: run.object_start_xyz_m_nominal,
            ..StartConfig::default()
        },
        hand: Some(HandConfig {
            robot: run.hand,
            world_from_base: PoseConfig { position_m: run.hand_base_pose_xyz_m, quat_wxyz: run.hand_base_quat_wxyz },
            joints: "joint_states.csv".into(),
            joint_names: Some(joint_names.iter().map(|&n| n.to_owned()).collect()),
            clock: ClockConfig { kind: ClockKind::Unix, ..ClockConfig::default() },
        }),
        ..PushConfig::new(run.mesh, track)
    })
}

/// The run in the folder `run`, read where it stands.
///
/// # Errors
/// As [`push_config`] and [`PushConfig::load`].
pub fn load(run: &Path, joint_names: &[&str]) -> Result<PushRecording> {
    push_config(run, joint_names)?.load(run)
}

fn unit(v: [f64; 3]) -> Option<Vector3<f64>> {
    Vector3::from(v).try_normalize(1e-9).filter(|u| u.iter().all(|c| c.is_finite()))
}
