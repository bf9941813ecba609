//! What a search for a grasp found, as a file.

use std::path::Path;

use drex_grasp::Grasp;
use drex_trial::Verdict;
use serde::{Deserialize, Serialize};

use crate::records::read_json;

/// Version of the file's layout.
pub(super) const SCHEMA: u32 = 1;

/// `grasps/NAME.json` of a batch: what a search found, and from what.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct SearchFile {
    pub(super) schema: u32,
    /// Digest of all that it depends on.
    pub(super) inputs_sha256: String,
    pub(super) mesh: String,
    pub(super) mass_kg: f64,
    pub(super) friction: f64,
    /// Absent if none holds; so is all that follows.
    pub(super) grasp: Option<Grasp>,
    pub(super) grip_force_n: Option<f64>,
    pub(super) held: Option<usize>,
    pub(super) verdicts: Option<Vec<Verdict>>,
}

impl SearchFile {
    /// The file at `path`, if it is there and was made from these inputs.
    pub(super) fn current(path: &Path, inputs_sha256: &str) -> Option<Self> {
        let file: Option<Self> = read_json(path).ok();
        file.filter(|file| file.schema == SCHEMA && file.inputs_sha256 == inputs_sha256)
    }
}
