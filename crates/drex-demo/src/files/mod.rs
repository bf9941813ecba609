//! Demonstrations from and to files.

mod arrays;
mod hamer;
mod json;
mod mano;
mod normalize;
mod npz;
mod objects;
mod options;
mod order;
mod table;
mod write;

use std::path::Path;

use drex_core::{Error, Pose, Result, fsutil};
use nalgebra::{UnitQuaternion, Vector3};

pub use self::hamer::{CropCamera, crop_to_full};
pub use self::mano::{HandPose, ManoModel, ManoPose};
pub use self::options::{DemoUnit, KeyPointOrder, LoadOptions};
use crate::{Demonstration, HandFrame, KeyPoints, Side};

impl HandFrame {
    /// A frame from one line of JSON, as teleoperation sends them:
    /// `{"t": 0.033, "keypoints": [[x, y, z], null, …]}` with 21 points in OpenPose's order, metres. `null` and numbers that are
    /// not finite are points that were not seen. Also read: `wrist_rotation` (3 x 3, `source_from_wrist` of MANO), `object_pose`
    /// (3 x 4, 4 x 4, or x, y, z, qw, qx, qy, qz) and `score`. Without `t` the frame is at `(line_no - 1) / 30` seconds.
    ///
    /// # Errors
    /// If the line is not of that form; the message carries `line_no`, which counts from 1.
    pub fn from_json_line(line: &str, line_no: usize) -> Result<Self> {
        json::frame_of_line(Path::new("input"), line, line_no)
    }
}

impl Demonstration {
    /// Reads a recording by the ending of its name:
    ///
    /// - `.json`: `drex-hand-demo/1`; `hand_joints` with `object_poses` (DexYCB excerpts); one frame per line, as
    ///   [`HandFrame::from_json_line`] (also `.jsonl`);
    /// - `.npy`: n x 21 x 3, n x 63, or n x 25 x 3 and n x 25 x 7 of a Manus glove;
    /// - `.npz`: such arrays under their usual names, HaMeR's output, or MANO parameters (with [`LoadOptions::mano_model`]);
    /// - `.csv`: columns `wrist_x, wrist_y, wrist_z, thumb_cmc_x, …`.
    ///
    /// Pickled files are refused: they can run any code when they are opened.
    ///
    /// # Errors
    /// If the file cannot be read, is malformed (with line or frame), holds no frames, or its points make a hand only in another
    /// order or unit than stated.
    pub fn load(path: &Path, options: &LoadOptions) -> Result<Self> {
        if path.is_dir() {
            return Err(Error::content(path, None, "this is a folder", "give one file of a demonstration"));
        }
        Self::parse(path, &fsutil::read_bytes(path)?, options)
    }

    /// As [`Demonstration::load`], from memory; `path` gives the format and the name in messages.
    ///
    /// # Errors
    /// As [`Demonstration::load`].
    pub fn parse(path: &Path, bytes: &[u8], options: &LoadOptions) -> Result<Self> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        refuse_pickle(path, &extension, bytes)?;
        let raw = match extension.as_str() {
            "json" | "jsonl" | "ndjson" => json::read(path, bytes, options)?,
            "npy" => arrays::read_npy(path, bytes)?,
            "npz" => arrays::read_npz(path, bytes, options)?,
            "csv" => table::read(path, bytes)?,
            other => {
                let what = format!("demonstrations are not read from .{other}");
                return Err(Error::content(path, None, what, "give .json, .jsonl, .npy, .npz or .csv"));
            }
        };
        normalize::normalize(path, raw, options)
    }
}

/// Opening a pickle runs whatever program it holds.
fn refuse_pickle(path: &Path, extension: &str, bytes: &[u8]) -> Result<()> {
    let named = matches!(extension, "pkl" | "pickle" | "p" | "pt" | "pth");
    let marked = matches!(bytes, [0x80, 2..=5, ..]);
    if !(named || marked) {
        return Ok(());
    }
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let remedy = format!(
        "if you trust the file, convert it once: python -c \"import pickle, numpy; d = pickle.load(open('{name}', 'rb')); \
         d = d if isinstance(d, dict) else {{'keypoints': d}}; \
         numpy.savez('{name}.npz', **{{k: numpy.asarray(v, dtype=float) for k, v in d.items()}})\""
    );
    Err(Error::content(path, None, "a pickled file can run any program and is never opened", remedy))
}

/// What a reader found, before the options and the common checks.
#[derive(Debug, Default)]
struct RawDemonstration {
    source: Option<String>,
    side: Option<Side>,
    /// Frames that MediaPipe labelled (left, right).
    labels: (usize, usize),
    unit: Option<DemoUnit>,
    fps: Option<f64>,
    up: Option<Vector3<f64>>,
    /// The file names its points: their order needs no option.
    named: bool,
    notes: Vec<String>,
    frames: Vec<RawFrame>,
}

/// One frame as the file has it: the file's unit, order and hand.
#[derive(Debug, Clone)]
struct RawFrame {
    t_s: Option<f64>,
    points: KeyPoints,
    wrist: Option<UnitQuaternion<f64>>,
    object: Option<Pose>,
    score: Option<f64>,
}

impl RawFrame {
    fn new(points: KeyPoints) -> Self {
        Self { t_s: None, points, wrist: None, object: None, score: None }
    }
}
