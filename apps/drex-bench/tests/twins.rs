//! Twin folders of `drex-bench twins`: the same for the same seed, whole or broken as they say.
#![allow(clippy::unwrap_used, missing_docs)] // tests: a panic is the report

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use drex_bench::twins::{Fault, MASS_RANGE_KG, SyntheticTwin};
use drex_core::TriMesh;
use drex_twin::{RunOptions, Stage, Twin, recordings};

/// Runs `drex-bench twins` and answers its rows.
fn make(out: &Path, seed: &str, count: &str, threads: &str) -> Vec<serde_json::Value> {
    let run = Command::new(env!("CARGO_BIN_EXE_drex-bench"))
        .args(["twins", "--json", "--broken", "2", "--seed", seed, "--count", count, "--threads", threads, "--out"])
        .arg(out)
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    serde_json::from_slice(&run.stdout).unwrap()
}

/// Every file below a folder by its path there.
fn tree(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut out = BTreeMap::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(at) = folders.pop() {
        for entry in fs::read_dir(at).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                out.insert(path.strip_prefix(folder).unwrap().display().to_string(), fs::read(&path).unwrap());
            }
        }
    }
    out
}

#[test]
fn the_same_seed_writes_the_same_bytes_whatever_the_number_and_the_threads() {
    let folder = tempfile::tempdir().unwrap();
    let made = |to: &str, seed, count, threads| {
        let out = folder.path().join(to);
        let rows = make(&out, seed, count, threads);
        (rows.iter().map(|r| r["twin"].as_str().unwrap().to_owned()).collect::<Vec<_>>(), tree(&out))
    };
    let (names, three) = made("three", "5", "3", "1");
    assert_eq!(names, ["twin-000", "twin-001", "twin-002", "broken-0", "broken-1"]);
    let files = "truth.json twin.toml scan/tin.obj push/tilt/push.toml push/tilt/poses.csv push/tilt/force.csv demos/grasps.json";
    assert!(files.split(' ').all(|file| three.contains_key(&format!("twin-002/{file}"))));
    assert_eq!(three.len(), 5 * files.split(' ').count());
    assert_eq!(three, made("again", "5", "3", "2").1);
    let (_, mut fewer) = made("two", "5", "2", "2");
    fewer.extend(three.iter().filter(|(path, _)| path.starts_with("twin-002")).map(|(p, b)| (p.clone(), b.clone())));
    assert_eq!(fewer, three);
    let (_, other) = made("other", "6", "3", "2");
    // Twins of a seed differ, and so do those of another seed, in each of their files.
    for file in files.split(' ') {
        assert_ne!(three[&format!("twin-000/{file}")], three[&format!("twin-001/{file}")], "{file}");
        assert_ne!(three[&format!("twin-000/{file}")], other[&format!("twin-000/{file}")], "{file}");
    }
}

#[test]
fn whole_twins_open_with_a_closed_mesh_a_push_and_demonstrations() {
    let folder = tempfile::tempdir().unwrap();
    for number in 0..8 {
        let made = SyntheticTwin::new(3, number).unwrap();
        made.write(folder.path()).unwrap();
        assert!((MASS_RANGE_KG[0]..=MASS_RANGE_KG[1]).contains(&made.mass_kg) && made.fault.is_none());
        // It tips and comes back to rest on its base.
        assert!((2.0..20.0).contains(&made.largest_lean_rad.to_degrees()), "{} rad", made.largest_lean_rad);

        let twin = Twin::open(&folder.path().join(&made.name)).unwrap();
        assert_eq!(twin.manifest.name, made.name);
        let pushes = recordings(&twin).unwrap();
        assert_eq!((pushes.len(), pushes[0].track.len()), (1, 48));
        let last = pushes[0].track.poses().last().unwrap();
        assert!(last.rotation.angle().to_degrees() < 5.0, "{}", last.rotation.angle());
        assert!(twin.path(&twin.manifest.grasps.as_ref().unwrap().file).is_file());
        twin.hand().unwrap();

        let mesh = TriMesh::read(&twin.path(&twin.manifest.object.mesh)).unwrap();
        let truth: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(twin.path("truth.json")).unwrap()).unwrap();
        assert_eq!((truth["mass_kg"].as_f64(), truth["friction"].as_f64()), (Some(made.mass_kg), Some(made.friction)));
        let volume_cm3 = 1e6 * mesh.mass_properties(1.0).unwrap().mass_kg;
        assert!((volume_cm3 - truth["volume_cm3"].as_f64().unwrap()).abs() < 0.05, "{volume_cm3} {truth}");
        let size = mesh.bounds().map(|(low, high)| high - low).unwrap();
        assert!((0..3).all(|i| (size[i] - made.size_m[i]).abs() < 2e-6), "{size} {:?}", made.size_m);
    }
}

#[test]
fn broken_twins_are_refused_by_file_and_fault() {
    let folder = tempfile::tempdir().unwrap();
    let words = |fault| match fault {
        Fault::CutMesh => ["scan/tin.obj, line", "face needs three corners"],
        Fault::MissingColumn => ["force.csv", "no column fz"],
        Fault::MissingMesh => ["scan/can.obj", "No such file"],
        Fault::NoToml => ["twin.toml, line", "expected `]`"],
        Fault::NegativeFriction => ["twin.toml", "friction = -0.5"],
        Fault::NanPose => ["poses.csv, line", "`NaN` is not finite"],
        Fault::ClocksApart => ["force.csv", "do not overlap"],
        Fault::UnknownJoint => ["grasps.json", "no joint \"thumb_tip\""],
        other => panic!("{other:?}"),
    };
    for number in 0..Fault::ALL.len() as u32 {
        let made = SyntheticTwin::broken(3, number).unwrap();
        let fault = made.fault.unwrap();
        assert_eq!(fault, Fault::ALL[number as usize]);
        made.write(folder.path()).unwrap();
        let opened = Twin::open(&folder.path().join(&made.name));
        let run = opened.and_then(|mut twin| twin.run(&RunOptions::default().until(Stage::Grasps), &()));
        let message = chain(&run.unwrap_err());
        assert!(words(fault).iter().all(|word| message.contains(word)), "{fault:?}: {message}");
    }
    // The faults take turns, on tins that differ.
    let again = SyntheticTwin::broken(3, Fault::ALL.len() as u32).unwrap();
    assert_eq!(again.fault, Some(Fault::ALL[0]));
    assert_ne!(again.mass_kg, SyntheticTwin::broken(3, 0).unwrap().mass_kg);
}

/// An error with all that caused it.
fn chain(error: &dyn std::error::Error) -> String {
    match error.source() {
        Some(cause) => format!("{error}: {}", chain(cause)),
        None => error.to_string(),
    }
}
