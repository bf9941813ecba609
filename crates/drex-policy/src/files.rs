//! A policy on disk: `policy.json`, which a person can read, and the weights it names.

use std::path::Path;

use drex_core::fsutil::{hex, read_bytes, read_text, write_atomic};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::policy::Card;
use crate::weights::Weights;
use crate::{Error, GraspPolicy, Result};

/// Name of the file that makes a folder a policy.
const MANIFEST: &str = "policy.json";
/// Says what the file is.
const FORMAT: &str = "drex-policy";
/// Raised when the meaning of a field or of a weight changes.
const VERSION: u32 = 2;

/// `policy.json`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Manifest {
    format: String,
    version: u32,
    /// Version of this crate that wrote it.
    written_by: String,
    /// For the reader; fixed by the version.
    units: Units,
    weights_file: String,
    weights_sha256: String,
    policy: Card,
}

#[derive(PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Units {
    joints: String,
    length: String,
    mass: String,
    friction: String,
    #[serde(rename = "squeeze")]
    grip_force: String,
    wrist: String,
}

impl Units {
    fn of_this_version() -> Self {
        Self {
            joints: "rad".into(),
            length: "m".into(),
            mass: "kg".into(),
            friction: "coefficient between finger and object".into(),
            grip_force: "N, sum of normal forces".into(),
            wrist: "object_from_base, in the frame of the object's points".into(),
        }
    }
}

impl GraspPolicy {
    /// Writes `policy.json` and the weights it names (safetensors) into `folder`, which is made if missing. An earlier policy there is
    /// replaced in one step: whenever the process dies, the folder holds the old policy or the new one.
    ///
    /// # Errors
    /// [`Error::Core`] if a file cannot be written.
    pub fn save(&self, folder: &Path) -> Result<()> {
        let weights = self.weights.to_bytes();
        let hash = sha256_hex(&weights);
        // Named by content: new weights never touch the old ones, and renaming the manifest switches from one to the other.
        let file = format!("weights-{}.safetensors", &hash[..16]);
        let manifest = Manifest {
            format: FORMAT.into(),
            version: VERSION,
            written_by: concat!("drex-policy ", env!("CARGO_PKG_VERSION")).into(),
            units: Units::of_this_version(),
            weights_file: file.clone(),
            weights_sha256: hash,
            policy: self.card.clone(),
        };
        let mut json = serde_json::to_vec_pretty(&manifest).map_err(|e| Error::Backend { what: e.to_string() })?;
        json.push(b'\n');
        write_atomic(&folder.join(&file), &weights)?;
        write_atomic(&folder.join(MANIFEST), &json)?;
        remove_other_weights(folder, &file);
        Ok(())
    }

    /// Reads what [`save`](Self::save) wrote.
    ///
    /// # Errors
    /// [`Error::Core`] if a file cannot be read, [`Error::File`] if it is damaged, of another version, or if weights and `policy.json`
    /// do not belong together. No content panics.
    pub fn load(folder: &Path) -> Result<Self> {
        let path = folder.join(MANIFEST);
        let again = "train the policy again";
        let manifest: serde_json::Value = serde_json::from_str(&read_text(&path)?).map_err(|e| {
            Error::file(&path, format!("no JSON (line {}, column {}: {e})", e.line(), e.column()), again)
        })?;
        // Format and version come first: a file of another version has other fields, and the version is what to tell the user.
        if manifest.get("format").and_then(|f| f.as_str()) != Some(FORMAT) {
            return Err(Error::file(
                &path,
                format!("not a policy (no \"format\": \"{FORMAT}\")"),
                "check that this is the right folder",
            ));
        }
        if manifest.get("version").and_then(|v| v.as_u64()) != Some(u64::from(VERSION)) {
            let found = manifest.get("version").map_or("missing".to_owned(), ToString::to_string);
            let what = format!("format version is {found}, this program reads version {VERSION}");
            return Err(Error::file(&path, what, "use the program that wrote it, or train the policy again"));
        }
        let manifest: Manifest =
            serde_json::from_value(manifest).map_err(|e| Error::file(&path, e.to_string(), again))?;
        if manifest.units != Units::of_this_version() {
            return Err(Error::file(&path, "the units are not rad, m, kg and N", again));
        }
        check_card(&manifest.policy).map_err(|what| Error::file(&path, what, again))?;
        if !is_weights_name(&manifest.weights_file) {
            let what = format!("weights_file '{}' is no name that a policy's weights have", manifest.weights_file);
            return Err(Error::file(&path, what, again));
        }
        let weights_path = folder.join(&manifest.weights_file);
        let bytes = read_bytes(&weights_path)?;
        if sha256_hex(&bytes) != manifest.weights_sha256 {
            let what = "the content is not what policy.json was written for (SHA-256 differs)";
            return Err(Error::file(&weights_path, what, "copy the whole folder again, or train the policy again"));
        }
        let weights = Weights::from_bytes(manifest.policy.network, &bytes)
            .map_err(|what| Error::file(&weights_path, what, again))?;
        Ok(Self { card: manifest.policy, weights })
    }
}

/// Weights of an earlier policy serve nobody once the manifest names others. If they cannot be removed, nothing is wrong but space.
fn remove_other_weights(folder: &Path, keep: &str) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let Some(name) = name.to_str() else { continue };
        if is_weights_name(name) && name != keep {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

/// Exactly the names that [`GraspPolicy::save`] gives: nothing else is ever read or removed.
fn is_weights_name(name: &str) -> bool {
    let hash = name.strip_prefix("weights-").and_then(|n| n.strip_suffix(".safetensors"));
    hash.is_some_and(|h| h.len() == 16 && h.bytes().all(|b| b.is_ascii_hexdigit()))
}

/// Whether the fields agree with each other, and sizes are sizes a policy has.
pub(crate) fn check_card(card: &Card) -> Result<(), String> {
    card.training.validate().map_err(|e| format!("policy.training: {e}"))?;
    let network = card.network;
    let joints = card.joint_names.len();
    if joints == 0 || joints != network.joints || joints != card.joint_limits_rad.len() {
        let limits = card.joint_limits_rad.len();
        return Err(format!("{joints} joint names, {limits} joint limits and a network for {} joints", network.joints));
    }
    let limits = card.joint_names.iter().zip(&card.joint_limits_rad);
    for (name, (lower, upper)) in limits {
        if !(lower.is_finite() && upper.is_finite() && lower <= upper) {
            return Err(format!("joint '{name}': limits ({lower}, {upper}) rad are no interval"));
        }
    }
    if card.fingers.is_empty() || card.fingers.len() != network.fingers {
        return Err(format!("{} finger names and a network for {} fingers", card.fingers.len(), network.fingers));
    }
    let t = &card.training;
    let as_trained = network.hidden == t.hidden && network.frequencies == t.frequencies && card.points == t.points;
    if !as_trained || network.modes == 0 || network.modes > t.modes {
        return Err("policy.network does not agree with policy.training".into());
    }
    if !card.normalisation.is_sound() {
        return Err("policy.normalisation holds an interval that is empty or not positive".into());
    }
    Ok(())
}

pub(crate) fn sha256_hex(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}
