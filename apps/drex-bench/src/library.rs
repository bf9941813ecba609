//! Grasps of one object by one hand, measured and kept in a file.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use drex_core::fsutil;
use drex_grasp::{Grasp, synthesize_grasps};
use drex_retarget::TargetHand;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::configurations::Configurations;
use crate::demonstrations::{self, DemonstrationOptions};
use crate::object::BenchObject;

/// What a library is made with.
#[derive(Debug, Clone, PartialEq)]
pub struct LibraryOptions {
    pub demonstrations: DemonstrationOptions,
    /// Candidates of [`synthesize_grasps`].
    pub candidates: usize,
}

impl Default for LibraryOptions {
    fn default() -> Self {
        Self { demonstrations: DemonstrationOptions::default(), candidates: 200_000 }
    }
}

/// `grasps/NAME.json`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Library {
    schema: u32,
    /// Of object, hand, options and program: another digest, other grasps.
    digest: String,
    pub object: String,
    pub hand: String,
    pub joint_names: Vec<String>,
    /// Friction at which they were measured.
    pub friction: f64,
    pub grasps: Vec<Grasp>,
}

/// The file of an object's library in the folder of the results, if there is one.
///
/// # Errors
/// If the object's name leads out of the folder.
pub fn file(out: Option<&Path>, object: &str) -> Result<Option<PathBuf>> {
    Ok(out.map(|out| fsutil::output_path(out, &format!("grasps/{object}.json"))).transpose()?)
}

/// Layout of the file; raised when grasps are made otherwise.
const SCHEMA: u32 = 5;

impl Library {
    /// The library of the file if it was made of the same things, else a new one, which is written there.
    ///
    /// # Errors
    /// If the hand cannot grasp at all, no grasp was found, or the file cannot be written.
    pub fn of(object: &BenchObject, hand: &TargetHand, options: &LibraryOptions, file: Option<&Path>) -> Result<Self> {
        let digest = digest(object, hand, options);
        if let Some(file) = file
            && let Ok(text) = fsutil::read_text(file)
            && let Ok(library) = serde_json::from_str::<Self>(&text)
            && library.digest == digest
        {
            return Ok(library);
        }
        let configurations = Configurations::of(hand, options.demonstrations.seed)?;
        let mut grasps = demonstrations::grasps(object, hand, &configurations, &options.demonstrations)?;
        // One library for all frictions that the hand will assume.
        let mut one = object.object.clone();
        one.friction = options.demonstrations.friction;
        grasps.extend(synthesize_grasps(&one, &hand.robot, options.candidates, options.demonstrations.seed)?);
        if grasps.is_empty() {
            bail!(
                "no grasp of \"{}\" was found for {}: it may be too large for the hand or too low over the table",
                object.spec.name,
                hand.robot.name
            );
        }
        let library = Self {
            schema: SCHEMA,
            digest,
            object: object.spec.name.clone(),
            hand: hand.robot.name.clone(),
            joint_names: hand.robot.joint_names().into_iter().map(str::to_owned).collect(),
            friction: options.demonstrations.friction,
            grasps,
        };
        if let Some(file) = file {
            fsutil::write_atomic(file, &serde_json::to_vec(&library)?)?;
        }
        Ok(library)
    }
}

fn digest(object: &BenchObject, hand: &TargetHand, options: &LibraryOptions) -> String {
    let mut hash = Sha256::new();
    hash.update(format!("{SCHEMA} {} {options:?} {:?}", hand.robot.name, object.object.table()));
    object.object.mesh.vertices.iter().flat_map(|v| v.iter()).for_each(|c| hash.update(c.to_bits().to_le_bytes()));
    object.object.mesh.faces.iter().flatten().for_each(|i| hash.update(i.to_le_bytes()));
    fsutil::hex(&hash.finalize())
}
