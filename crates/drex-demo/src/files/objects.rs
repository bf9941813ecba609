//! Poses of the object.

use std::path::Path;

use drex_core::pose::{MAX_POSITION_M, pose_from_matrix, pose_from_wxyz, rotation_from_matrix};
use drex_core::{Error, Pose, Result, fsutil};
use drex_recording::readers::{FrameTimes, read_foundation_pose_folder, read_pose_csv};
use nalgebra::{Matrix3, Matrix4, UnitQuaternion};

use super::npz::{Npz, Table};
use super::options::ASSUMED_FPS;
use super::{DemoUnit, HandFrame};

/// Names under which arrays of object poses are found.
pub(super) const POSE_NAMES: [&str; 9] = [
    "source_from_object",
    "object_poses",
    "object_pose",
    "obj_poses",
    "obj_pose",
    "object_pose_4x4",
    "object_pose_3x4",
    "obj_trans",
    "poses",
];

/// A pose from 12 (3 x 4), 16 (4 x 4, row by row) or 7 numbers (x, y, z, qw, qx, qy, qz). `None` if one is not finite: the
/// object was not seen.
pub(super) fn pose_of(numbers: &[f64]) -> Result<Option<Pose>> {
    if !matches!(numbers.len(), 7 | 12 | 16) {
        return Err(Error::value(
            format!("{} numbers are no pose", numbers.len()),
            "give 3 x 4, 4 x 4, or x, y, z, qw, qx, qy, qz",
        ));
    }
    if numbers.iter().any(|v| !v.is_finite()) {
        return Ok(None);
    }
    if let [x, y, z, qw, qx, qy, qz] = *numbers {
        return pose_from_wxyz([x, y, z], [qw, qx, qy, qz]).map(Some);
    }
    let mut m = Matrix4::identity();
    for (i, v) in numbers.iter().enumerate() {
        m[(i / 4, i % 4)] = *v;
    }
    pose_from_matrix(&m).map(Some)
}

/// A rotation from 9 numbers (3 x 3, row by row), 3 (axis times angle) or 4 (w, x, y, z); `None` if one is not finite.
pub(super) fn rotation_of(numbers: &[f64]) -> Result<Option<UnitQuaternion<f64>>> {
    if numbers.iter().any(|v| !v.is_finite()) {
        return Ok(None);
    }
    match *numbers {
        [x, y, z] => Ok(Some(UnitQuaternion::from_scaled_axis(nalgebra::Vector3::new(x, y, z)))),
        [w, x, y, z] => pose_from_wxyz([0.0; 3], [w, x, y, z]).map(|p| Some(p.rotation)),
        _ if numbers.len() == 9 => rotation_from_matrix(&Matrix3::from_row_slice(numbers)).map(Some),
        _ => Err(Error::value(format!("{} numbers are no rotation", numbers.len()), "give a 3 x 3 matrix")),
    }
}

/// Gives each frame its object pose from the file or folder `path`; lengths are in `unit`.
pub(super) fn attach(path: &Path, unit: DemoUnit, fps: Option<f64>, frames: &mut [HandFrame]) -> Result<()> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let in_metres = |mut pose: Pose| {
        pose.translation.vector *= unit.metres();
        pose
    };
    if path.is_dir() || extension == "csv" {
        let track = if path.is_dir() {
            // Files are numbered by frame, so that any rate that both sides use will do.
            read_foundation_pose_folder(path, &FrameTimes::Fps(fps.unwrap_or(ASSUMED_FPS)))?
        } else {
            read_pose_csv(path)?
        };
        let numbered = path.is_dir().then(|| fps.unwrap_or(ASSUMED_FPS));
        for frame in frames.iter_mut() {
            let at = numbered.map_or(frame.t_s, |fps| frame.index as f64 / fps);
            frame.source_from_object = track.at(at).map(in_metres);
        }
    } else {
        let bytes = fsutil::read_bytes(path)?;
        let array = match extension.as_str() {
            "npy" => Table::from_npy(path, &bytes)?,
            "npz" => {
                let mut npz = Npz::open(path, &bytes)?;
                let name = npz.first_of(&POSE_NAMES).ok_or_else(|| {
                    Error::content(
                        path,
                        None,
                        format!("no object poses in {}", npz.listing()),
                        "name them object_poses",
                    )
                })?;
                npz.table(name)?
            }
            _ => {
                return Err(Error::content(
                    path,
                    None,
                    "object poses are read from .npy, .npz, .csv and folders of FoundationPose",
                    "convert the file",
                ));
            }
        };
        let poses = poses_of(path, &array)?;
        if frames.iter().any(|f| f.index >= poses.len()) {
            let what = format!("{} object poses for {} frames", poses.len(), frames.len());
            return Err(Error::content(path, None, what, "give one per frame of the recording"));
        }
        for frame in frames.iter_mut() {
            frame.source_from_object = poses[frame.index].map(in_metres);
        }
    }
    if frames.iter().all(|f| f.source_from_object.is_none()) {
        let what = "no object pose falls on a frame of the demonstration";
        return Err(Error::content(path, None, what, "check that both have the same clock or frame numbers"));
    }
    Ok(())
}

/// One pose per row of an array n x 4 x 4, n x 3 x 4 or n x 7.
pub(super) fn poses_of(path: &Path, array: &Table) -> Result<Vec<Option<Pose>>> {
    let rows = array.rows(path, &[&[4, 4], &[3, 4], &[7]], "object poses")?;
    let pose = |(i, row): (usize, &[f64])| {
        let refuse = |e| Error::at(path, None, at_frame(i, "object pose", e));
        pose_of(row).map_err(refuse)
    };
    rows.enumerate().map(pose).collect()
}

/// Refuses object positions that must be in another unit.
pub(super) fn check_positions(path: &Path, frames: &[HandFrame]) -> Result<()> {
    for frame in frames {
        if let Some(pose) = frame.source_from_object.filter(|p| p.translation.vector.amax() > MAX_POSITION_M) {
            let far = pose.translation.vector.amax();
            let what = format!("frame {}: the object is {far:.0} m from the origin", frame.index);
            return Err(Error::content(path, None, what, "state the unit: mm or cm"));
        }
    }
    Ok(())
}

/// `error` with the frame in front.
pub(super) fn at_frame(frame: usize, what: &str, error: Error) -> Error {
    match error {
        Error::Value { what: inner, remedy } => Error::value(format!("frame {frame}, {what}: {inner}"), remedy),
        other => other,
    }
}
