//! A changed input makes the stages again that depend on it, and no others.

use std::fs;
use std::path::Path;

use drex_sysid::MassSource;
use drex_twin::Stage;
use drex_twin::records::{MassFile, read_json};

use crate::common::{STAGES, made, run, run_until};
use crate::support::{edit, keep_demonstrations, small_twin};

/// What is changed of a twin that was run, how, and the stages that are made again.
type Case = (&'static str, fn(&Path), &'static [&'static str]);

/// Stages that take the mass, and all that follow.
const OF_MASS: &[&str] = &["identify", "asset", "train", "evaluate"];

const CASES: &[Case] = &[
    ("a comment and the name", |twin| manifest(twin, "name = \"tea tin\"", "name = \"tin of tea\" # green"), &[]),
    ("a file beside the twin", |twin| edit(&twin.join("truth.json"), "{", "{ "), &[]),
    ("the push, which nobody names", |twin| drop_last_line(&twin.join("push/tilt/poses.csv")), &[]),
    ("the mass", |twin| manifest(twin, "weighed_kg = 0.236", "weighed_kg = 0.25"), OF_MASS),
    ("the demonstrations", |twin| keep_demonstrations(twin, 1), &["grasps", "train", "evaluate"]),
    ("the training", |twin| manifest(twin, "epochs = 5", "epochs = 6"), &["train", "evaluate"]),
    ("the friction", |twin| manifest(twin, "friction = 0.5 ", "friction = 0.45 "), &STAGES),
];

fn manifest(twin: &Path, old: &str, new: &str) {
    edit(&twin.join("twin.toml"), old, new);
}

fn drop_last_line(file: &Path) {
    let text = fs::read_to_string(file).unwrap();
    let (kept, _) = text.trim_end().rsplit_once('\n').unwrap();
    fs::write(file, format!("{kept}\n")).unwrap();
}

fn lower_first_vertex(file: &Path) {
    let text = fs::read_to_string(file).unwrap();
    let line = text.lines().find(|line| line.starts_with("v ")).unwrap();
    let mut numbers: Vec<f64> = line[2..].split_whitespace().map(|n| n.parse().unwrap()).collect();
    numbers[2] *= 0.99;
    fs::write(file, text.replacen(line, &format!("v {} {} {}", numbers[0], numbers[1], numbers[2]), 1)).unwrap();
}

#[test]
fn a_change_makes_its_stages_again_and_no_others() {
    for (what, change, expected) in CASES {
        let (_dir, twin) = made();
        change(&twin);
        let (done, said) = run(&twin).unwrap();
        assert_eq!(done.stages_run, *expected, "{what}: {said}");
        let others: Vec<&str> = STAGES.into_iter().filter(|stage| !expected.contains(stage)).collect();
        assert_eq!(done.stages_current, others, "{what}");
        assert!(run(&twin).unwrap().0.stages_run.is_empty(), "{what}: what was made again is made a third time");
    }
}

#[test]
fn the_scan_and_the_seed_change_everything() {
    let changes: [fn(&Path); 2] = [
        // A hundredth off one corner.
        |twin| lower_first_vertex(&twin.join("scan/tin.obj")),
        |twin| manifest(twin, "seed = 1", "seed = 2"),
    ];
    for change in changes {
        let (_dir, twin) = made();
        change(&twin);
        assert_eq!(run_until(&twin, Stage::Grasps).unwrap().0.stages_run, STAGES[..3]);
    }
}

#[test]
fn a_changed_push_or_prior_weighs_the_object_again() {
    let (_dir, twin) = small_twin(2);
    let mass = || read_json::<MassFile>(&twin.join("mass.json")).unwrap();
    assert_eq!(run_until(&twin, Stage::Asset).unwrap().0.stages_run, ["identify", "asset"]);
    let whole = mass();
    assert_eq!(whole.source, MassSource::Identified);

    drop_last_line(&twin.join("push/tilt/poses.csv"));
    assert_eq!(run_until(&twin, Stage::Asset).unwrap().0.stages_run, ["identify", "asset"]);
    let shorter = mass();
    assert_ne!(shorter.ci95_kg, whole.ci95_kg, "a pose less is less evidence");

    manifest(&twin, "identify = [\"push/tilt\"]\nprior_kg = 0.5", "weighed_kg = 0.25");
    assert_eq!(run_until(&twin, Stage::Asset).unwrap().0.stages_run, ["identify", "asset"]);
    assert!((mass().mass_kg - 0.25).abs() < 1e-3 && mass().identification.is_none(), "{} kg", mass().mass_kg);
    assert!(fs::read_to_string(twin.join("asset/object.xml")).unwrap().contains("mass=\"0.25"));
}
