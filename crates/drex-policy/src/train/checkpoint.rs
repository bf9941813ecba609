//! The whole state of a training run in one file: weights, Adam's moments, how far it is, and what it is about.
//!
//! Random numbers need no place in it: those of an epoch depend on the seed and the epoch alone.

use std::path::{Path, PathBuf};

use drex_core::fsutil::{read_bytes, write_atomic};
use serde::{Deserialize, Serialize};

use super::rollout::{Second, Tally};
use super::{Split, Trainer, Weights, same_hand};
use crate::adam::Adam;
use crate::files::{check_card, sha256_hex};
use crate::policy::Card;
use crate::{Dataset, EpochStats, Error, GraspPolicy, Result, RolloutStats, tensors};

const FORMAT: &str = "drex-policy checkpoint";
const VERSION: u32 = 2;

/// The text beside the arrays.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Note {
    format: String,
    version: u32,
    state: State,
    /// Of the JSON of `state` followed by all arrays, in hexadecimal.
    sha256: String,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct State {
    policy: Card,
    steps: i32,
    curve: Vec<EpochStats>,
    rollouts: Vec<RolloutStats>,
    tallies: Vec<Vec<Tally>>,
    /// Whether the weights of the end of the first phase are among the arrays.
    anchored: bool,
    seconds: f64,
}

pub(super) fn path(folder: &Path) -> PathBuf {
    folder.join("checkpoint.safetensors")
}

pub(super) fn save(trainer: &Trainer<'_>, folder: &Path) -> Result<()> {
    let layout = trainer.policy.weights.layout;
    let (first, second, steps) = trainer.adam.state();
    let mut arrays = trainer.policy.weights.named("");
    for (prefix, moments) in [("adam.first.", first), ("adam.second.", second)] {
        let named = layout.arrays().into_iter().zip(moments);
        arrays.extend(named.map(|((name, shape), v)| (format!("{prefix}{name}"), shape, v.as_slice())));
    }
    if let Some(anchor) = &trainer.second.anchor {
        arrays.extend(anchor.named("anchor."));
    }
    let state = State {
        policy: trainer.policy.card.clone(),
        steps,
        curve: trainer.curve.clone(),
        rollouts: trainer.second.curve.clone(),
        tallies: trainer.second.tallies.clone(),
        anchored: trainer.second.anchor.is_some(),
        seconds: trainer.seconds,
    };
    let sha256 = digest(&state, arrays.iter().map(|a| a.2))?;
    let note = Note { format: FORMAT.into(), version: VERSION, state, sha256 };
    let note = serde_json::to_string(&note).map_err(|e| Error::Backend { what: e.to_string() })?;
    write_atomic(&path(folder), &tensors::to_bytes(&arrays, Some(&note)))?;
    Ok(())
}

pub(super) fn load<'a>(data: &'a Dataset, folder: &Path) -> Result<Trainer<'a>> {
    let path = path(folder);
    let bytes = read_bytes(&path)?;
    let again = "remove it and train from the start, or copy it again";
    let wrong = |what: String| Error::file(&path, what, again);
    let note = tensors::note(&bytes).map_err(wrong)?;
    let note: serde_json::Value =
        serde_json::from_str(&note).map_err(|e| wrong(format!("its description is no JSON ({e})")))?;
    // Format and version come first: a file of another version has other fields.
    if note.get("format").and_then(|f| f.as_str()) != Some(FORMAT) {
        return Err(wrong(format!("not a checkpoint (no \"format\": \"{FORMAT}\")")));
    }
    if note.get("version").and_then(|v| v.as_u64()) != Some(u64::from(VERSION)) {
        let found = note.get("version").map_or("missing".to_owned(), ToString::to_string);
        return Err(wrong(format!("format version is {found}, this program reads version {VERSION}")));
    }
    let Note { state, sha256, .. } = serde_json::from_value(note).map_err(|e| wrong(e.to_string()))?;
    check_card(&state.policy).map_err(wrong)?;
    let layout = state.policy.network;
    let prefixes = ["", "adam.first.", "adam.second.", "anchor."];
    let used = if state.anchored { 4 } else { 3 };
    let mut expected = Vec::new();
    for prefix in &prefixes[..used] {
        expected.extend(layout.arrays().into_iter().map(|(name, shape)| (format!("{prefix}{name}"), shape)));
    }
    let mut arrays = tensors::from_bytes(&expected, &bytes).map_err(wrong)?;
    if digest(&state, arrays.iter().map(Vec::as_slice))? != sha256 {
        return Err(wrong("the content is not what was written (SHA-256 differs)".into()));
    }

    same_hand((&state.policy.hand, &state.policy.joint_names), (&data.hand, &data.joint_names))?;
    if state.policy.dataset_sha256 != data.sha256() {
        let what = "the checkpoint was made with other demonstrations".to_owned();
        return Err(Error::file(&path, what, "give the same demonstrations, or remove it and train from the start"));
    }
    let modes = layout.modes;
    if state.tallies.len() != data.objects.len() || state.tallies.iter().any(|t| t.len() != modes) {
        return Err(wrong("the tallies of the rollouts do not fit objects and modes".into()));
    }
    let count = layout.arrays().len();
    let mut take = || arrays.drain(..count).collect::<Vec<_>>();
    let weights = Weights { layout, arrays: take() };
    let (first, second) = (take(), take());
    let anchor = state.anchored.then(|| Weights { layout, arrays: take() });
    let options = &state.policy.training;
    let split = Split::new(data, options.hold_out_every, options.seed);
    let mut trainer = Trainer::around(data, split, GraspPolicy { card: state.policy, weights });
    trainer.adam = Adam::from_state(first, second, state.steps);
    trainer.curve = state.curve;
    trainer.second = Second { anchor, curve: state.rollouts, tallies: state.tallies };
    trainer.seconds = state.seconds;
    Ok(trainer)
}

fn digest<'a>(state: &State, arrays: impl Iterator<Item = &'a [f32]>) -> Result<String> {
    let mut bytes = serde_json::to_vec(state).map_err(|e| Error::Backend { what: e.to_string() })?;
    arrays.for_each(|a| bytes.extend(a.iter().flat_map(|v| v.to_le_bytes())));
    Ok(sha256_hex(&bytes))
}
