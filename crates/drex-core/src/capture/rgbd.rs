//! RGB-D recordings in FoundationPose's layout: `cam_K.txt`, `rgb/`, `depth/` (16-bit PNG), and the pose of the object in the
//! camera for every frame. The world of such a capture is the object's frame: the object stands still in it.

use std::path::Path;

use super::assemble::{Posed, count, finish};
use super::companions::{Companions, PhotoFile, photos_under, size_of};
use super::{Capture, CaptureOptions, refuse};
use crate::camera::{Camera, CameraModel};
use crate::fsutil::read_text;
use crate::pose::parse_pose_matrix;
use crate::{Error, Result};

/// Where FoundationPose and its users put `camera_from_object`, one text file of 4 x 4 numbers a frame.
const POSES: [&str; 3] = ["annotated_poses", "ob_in_cam", "poses"];

/// Whether `folder` is such a recording.
pub(super) fn is_recording(folder: &Path) -> bool {
    folder.join("cam_K.txt").is_file() && folder.join("rgb").is_dir()
}

pub(super) fn load(folder: &Path, options: &CaptureOptions) -> Result<Capture> {
    let mut options = options.clone();
    options.depths.get_or_insert_with(|| folder.join("depth"));
    let poses = match &options.poses {
        Some(poses) => poses.clone(),
        None => match POSES.map(|name| folder.join(name)).into_iter().find(|p| p.is_dir()) {
            Some(poses) => poses,
            None => return without_poses(folder),
        },
    };
    let [fx, fy, cx, cy] = intrinsics(&folder.join("cam_K.txt"))?;
    let root = options.images.clone().unwrap_or_else(|| folder.join("rgb"));
    let (mut posed, mut unregistered) = (Vec::new(), Vec::new());
    for PhotoFile { name, path: photo } in photos_under(&root) {
        let pose = poses.join(Path::new(&name).with_extension("txt"));
        if !pose.is_file() {
            unregistered.push(name);
            continue;
        }
        let [width, height] = size_of(&photo)?;
        // K counts from the centre of the first pixel, our cameras from its corner.
        let lens = Camera::new(CameraModel::Pinhole, width as u32, height as u32, &[fx, fy, cx + 0.5, cy + 0.5])?;
        let camera_from_world = parse_pose_matrix(&pose, 1, &read_text(&pose)?)?;
        posed.push(Posed { name, photo, given: Companions::default(), lens, camera_from_world, keypoints: Vec::new() });
    }
    if posed.is_empty() {
        return refuse(
            format!("none of {} has a pose in {}", count(unregistered.len(), "frame"), poses.display()),
            "name the pose files like the frames: rgb/000000.png, 000000.txt",
        );
    }
    let mut notes = Vec::new();
    let views = finish(folder, posed, &options, &mut notes)?;
    Ok(Capture { folder: folder.into(), views, points: Vec::new(), unregistered, notes })
}

fn without_poses(folder: &Path) -> Result<Capture> {
    refuse(
        format!("{} has no poses of the object", folder.display()),
        "track the object and put FoundationPose's ob_in_cam folder there, or name the folder of the poses",
    )
}

/// fx, fy, cx, cy of the 3 x 3 matrix K, pixels; (0, 0) is the centre of the first pixel.
fn intrinsics(path: &Path) -> Result<[f64; 4]> {
    let text = read_text(path)?;
    let numbers: Vec<f64> = text.split_whitespace().map_while(|t| t.parse().ok()).collect();
    match numbers[..] {
        [fx, skew, cx, zero, fy, cy, _, _, one] if skew == 0.0 && zero == 0.0 && one == 1.0 => Ok([fx, fy, cx, cy]),
        _ => {
            let remedy = "write fx 0 cx, 0 fy cy, 0 0 1 in pixels";
            Err(Error::content(path, None, "no 3 x 3 camera matrix without skew", remedy))
        }
    }
}
