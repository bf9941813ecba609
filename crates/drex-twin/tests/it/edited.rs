//! Files that a stage wrote and somebody changed, damaged or removed since: they are named and made again.

use std::fs;
use std::path::Path;

use drex_twin::Stage;

use crate::common::{made, run, run_until, template};
use crate::support::{assert_same_folder, edit};

/// A file, what happens to it, and the stage that makes it again.
type Case = (&'static str, fn(&Path), &'static str);

const CASES: &[Case] = &[
    ("mass.json", |file| edit(file, "\"mass_kg\":", "\"mass_kg\": 1"), "identify"),
    ("mass.json", |file| cut(file), "identify"),
    ("asset/object.xml", |file| edit(file, "<mujoco", "<!-- by hand --><mujoco"), "asset"),
    ("mesh/visual.obj", |file| fs::remove_file(file).unwrap(), "asset"),
    ("grasps/wrist_fits.json", |file| edit(file, "\"accepted\": true", "\"accepted\": false"), "grasps"),
    ("policy/network/policy.json", |file| cut(file), "train"),
    ("policy/evaluation.json", |file| fs::write(file, "").unwrap(), "evaluate"),
];

fn cut(file: &Path) {
    let bytes = fs::read(file).unwrap();
    fs::write(file, &bytes[..bytes.len() / 2]).unwrap();
}

#[test]
fn what_was_altered_is_named_and_made_again_as_it_was() {
    for (name, alter, stage) in CASES {
        let (_dir, twin) = made();
        alter(&twin.join(name));
        let (done, said) = run(&twin).unwrap();
        assert_eq!(done.stages_run, [*stage], "{name}: {said}");
        let note = format!("{stage} is made again: edited, damaged or removed since it was made: {name}");
        assert!(said.contains(&note), "{name}: {said}");
        assert_same_folder(&twin, template());
    }
}

#[test]
fn an_edit_is_not_mentioned_where_an_input_changed_too() {
    let (_dir, twin) = made();
    edit(&twin.join("policy/training.json"), "{", "{ ");
    edit(&twin.join("twin.toml"), "epochs = 5", "epochs = 6");
    let (done, said) = run_until(&twin, Stage::Train).unwrap();
    assert_eq!(done.stages_run, ["train"]);
    assert!(!said.contains("edited"), "the stage would have been made again anyway: {said}");
}
