//! Writing `drex-hand-demo/1`.

use std::path::Path;

use drex_core::{Error, Result, fsutil};
use nalgebra::Point3;
use serde::Serialize;

use super::json::FORMAT;
use super::order::NAMES;
use crate::{Demonstration, Side};

#[derive(Serialize)]
struct DemoFile<'d> {
    format: &'static str,
    hand: Side,
    units: &'static str,
    joint_names: [&'static str; crate::KEYPOINTS],
    source: &'d str,
    #[serde(skip_serializing_if = "Option::is_none")]
    up: Option<[f64; 3]>,
    frames: Vec<FrameFile>,
}

#[derive(Serialize)]
struct FrameFile {
    t: f64,
    keypoints: Vec<Option<[f64; 3]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    wrist_rotation: Option<[[f64; 3]; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    object_pose_3x4: Option<[[f64; 4]; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    score: Option<f64>,
}

impl Demonstration {
    /// Writes the demonstration as `drex-hand-demo/1`, in one step. Points that were not seen are `null`.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save_json(&self, path: &Path) -> Result<()> {
        let frames = self.frames.iter().map(|f| FrameFile {
            t: f.t_s,
            keypoints: f.points.iter().map(|p| p.map(|p: Point3<f64>| p.coords.into())).collect(),
            wrist_rotation: f.source_from_mano_wrist.map(|r| {
                let m = r.to_rotation_matrix();
                std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
            }),
            object_pose_3x4: f.source_from_object.map(|pose| {
                let m = pose.to_homogeneous();
                std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
            }),
            score: f.score,
        });
        let file = DemoFile {
            format: FORMAT,
            hand: self.side,
            units: "m",
            joint_names: NAMES,
            source: &self.source,
            up: self.up.map(|u| u.into_inner().into()),
            frames: frames.collect(),
        };
        let mut text = serde_json::to_string(&file)
            .map_err(|e| Error::value(format!("the demonstration cannot be written: {e}"), "check its numbers"))?;
        text.push('\n');
        fsutil::write_atomic(path, text.as_bytes())
    }
}
