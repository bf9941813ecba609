//! Two runs at a time, and a `twin.lock` that is damaged or gone.

use std::fs;

use drex_twin::{Error, Stage};

use crate::common::{STAGES, fails_with, made, run, run_until, template, weighed_twin};
use crate::support::{assert_same_folder, edit, tree};

#[test]
fn two_runs_do_not_work_on_one_folder() {
    let (_dir, twin) = weighed_twin();
    let before = tree(&twin);
    let held = fs::File::open(twin.join("twin.toml")).unwrap();
    held.lock().unwrap();
    fails_with(&twin, &["another drex is at work on", "wait until it is done"]);
    assert!(matches!(run(&twin), Err(Error::Busy { folder, .. }) if folder == twin));
    assert_eq!(tree(&twin), before, "the run that was refused wrote something");
    drop(held);
    assert_eq!(run_until(&twin, Stage::Asset).unwrap().0.stages_run, ["identify", "asset"]);
}

#[test]
fn a_stage_whose_record_is_damaged_is_made_again_and_that_is_said() {
    let (_dir, twin) = made();
    edit(&twin.join("twin.lock"), "[stage.evaluate]\n", "[stage.evaluate]\nextra = {}\n");
    assert!(run(&twin).unwrap().0.stages_run.is_empty(), "an entry of a later version is no damage");
    let (_dir, twin) = made();
    edit(&twin.join("twin.lock"), "[stage.evaluate]\ninputs_sha256 = \"", "[stage.evaluate]\ninputs_sha256 = 7 # \"");
    let (done, said) = run(&twin).unwrap();
    assert!(said.contains("[stage.evaluate]") && said.contains("that stage is made again"), "{said}");
    assert_eq!(done.stages_run, ["evaluate"]);
    assert_same_folder(&twin, template());
}

#[test]
fn without_a_readable_lock_everything_is_made_again_as_it_was() {
    let (_dir, twin) = made();
    fs::write(twin.join("twin.lock"), "not toml [").unwrap();
    let (done, said) = run(&twin).unwrap();
    assert!(said.contains("twin.lock, line 1 is damaged") && said.contains("every stage is made again"), "{said}");
    assert_eq!(done.stages_run, STAGES);
    assert_same_folder(&twin, template());

    fs::remove_file(twin.join("twin.lock")).unwrap();
    let (done, said) = run_until(&twin, Stage::Asset).unwrap();
    assert_eq!(done.stages_run, ["identify", "asset"]);
    assert!(!said.contains("damaged"), "whoever deletes it wants that: {said}");
}
