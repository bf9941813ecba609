//! A policy on disk: round trip, replacement, damage.
#![cfg(feature = "flex")]

use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use crate::common::{FRICTION, box_points, small, toy};
use drex_policy::{GraspPolicy, PredictedGrasp, Query, Result};
use proptest::prelude::*;

fn ask(policy: &GraspPolicy) -> Result<Vec<PredictedGrasp>> {
    policy.predict(&Query::new(&box_points(), 0.15, FRICTION))
}

fn trained(seed: u64) -> GraspPolicy {
    let options = small().with_epochs(2).with_seed(seed);
    GraspPolicy::train(&toy(9, &[0.1, 0.2]), &options, &mut |_| ControlFlow::Continue(())).unwrap().0
}

static SAVED: LazyLock<(GraspPolicy, Vec<u8>, String, Vec<u8>)> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let policy = trained(1);
    policy.save(folder.path()).unwrap();
    let weights = weights_in(folder.path());
    let name = weights.file_name().unwrap().to_str().unwrap().to_owned();
    (policy, fs::read(folder.path().join("policy.json")).unwrap(), name, fs::read(weights).unwrap())
});

fn weights_in(folder: &Path) -> PathBuf {
    let mut found: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    found.retain(|p| p.extension().is_some_and(|e| e == "safetensors"));
    assert_eq!(found.len(), 1, "{found:?}");
    found.remove(0)
}

/// The message of loading a folder with these two files.
fn refused(manifest: &[u8], weights: &[u8]) -> String {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("policy.json"), manifest).unwrap();
    fs::write(folder.path().join(&SAVED.2), weights).unwrap();
    GraspPolicy::load(folder.path()).unwrap_err().to_string()
}

#[test]
fn round_trip_is_exact_and_saving_twice_gives_the_same_bytes() {
    let (policy, manifest, _, weights) = &*SAVED;
    let folder = tempfile::tempdir().unwrap();
    let nested = folder.path().join("a/b");
    policy.save(&nested).unwrap();
    let back = GraspPolicy::load(&nested).unwrap();
    assert_eq!(&back, policy);
    assert_eq!(ask(&back).unwrap(), ask(policy).unwrap());
    assert_eq!(&fs::read(nested.join("policy.json")).unwrap(), manifest);
    assert_eq!(&fs::read(weights_in(&nested)).unwrap(), weights);
}

#[test]
fn the_file_tells_a_person_what_it_is() {
    let text = String::from_utf8(SAVED.1.clone()).unwrap();
    for word in [
        "\"hand\": \"toy_hand\"",
        "\"middle\"",
        "\"rad\"",
        "\"seed\": 1",
        "dataset_sha256",
        "\"thumb\"",
        "least_friction",
        "drex-policy 0",
    ] {
        assert!(text.contains(word), "'{word}' is missing in {text}");
    }
}

#[test]
fn a_new_policy_replaces_the_old_one() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("weights-mine.safetensors.txt"), "keep").unwrap();
    trained(1).save(folder.path()).unwrap();
    let old = weights_in(folder.path());
    trained(2).save(folder.path()).unwrap();
    assert_ne!(weights_in(folder.path()), old);
    assert_eq!(GraspPolicy::load(folder.path()).unwrap(), trained(2));
    assert!(folder.path().join("weights-mine.safetensors.txt").exists());
}

#[test]
fn damage_is_named() {
    let (_, manifest, name, weights) = &*SAVED;
    let text = String::from_utf8(manifest.clone()).unwrap();
    let with = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        refused(text.replacen(from, to, 1).as_bytes(), weights)
    };
    let mut flipped = weights.clone();
    let last = flipped.len() - 1;
    flipped[last] ^= 1;
    for (message, word) in [
        (refused(manifest, &flipped), "SHA-256"),
        (refused(manifest, &weights[..100]), "SHA-256"),
        (refused(b"", weights), "no JSON"),
        (refused(b"[1, 2]", weights), "not a policy"),
        (refused(&[0xff, 0xfe], weights), "UTF-8"),
        (with("\"version\": 2", "\"version\": 7"), "version is 7"),
        (with("\"hidden\": 24", "\"hidden\": 25"), "does not agree"),
        (with("\"joints\": 3", "\"joints\": 4"), "3 joint names"),
        (with("\"fingers\": 2", "\"fingers\": 3"), "2 finger names"),
        (with("\"rad\"", "\"deg\""), "units"),
        (with(name, "../../etc/passwd"), "no name"),
        (with("\"hand\"", "\"foot\""), "foot"),
        (with("\"least_mass_kg\": 0.1", "\"least_mass_kg\": -0.1"), "normalisation"),
    ] {
        assert!(message.contains(word), "'{word}' is missing in: {message}");
        assert!(message.contains("policy.json") || message.contains("safetensors"), "no file in: {message}");
    }
    let empty = tempfile::tempdir().unwrap();
    let message = GraspPolicy::load(empty.path()).unwrap_err().to_string();
    assert!(message.contains("policy.json"), "{message}");
}

#[test]
fn a_folder_that_cannot_be_written_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "not a folder").unwrap();
    let message = SAVED.0.save(&file.join("policy")).unwrap_err().to_string();
    assert!(message.contains("file"), "{message}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn arbitrary_manifests_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300), at in 0usize..3000, cut in any::<bool>()) {
        let mut manifest = SAVED.1.clone();
        if cut {
            manifest.truncate(at);
            manifest.extend(&bytes);
        } else {
            let at = at.min(manifest.len());
            let end = (at + bytes.len()).min(manifest.len());
            manifest[at..end].copy_from_slice(&bytes[..end - at]);
        }
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("policy.json"), manifest).unwrap();
        fs::write(folder.path().join(&SAVED.2), &SAVED.3).unwrap();
        // Whatever loads can be asked.
        if let Ok(policy) = GraspPolicy::load(folder.path()) {
            let _ = ask(&policy);
        }
    }
}
