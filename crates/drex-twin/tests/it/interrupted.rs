//! A run after a run, and a run after one that did not end.

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use drex_twin::{Progress, RunOptions, Stage, Twin};

use crate::common::{LAST, STAGES, made, run, run_until, template, weighed_twin};
use crate::support::{assert_same_folder, tree};

#[test]
fn a_second_run_makes_nothing_and_writes_nothing() {
    let (_dir, twin) = made();
    let before = tree(&twin);
    let written = |name: &String| fs::metadata(twin.join(name)).unwrap().modified().unwrap();
    let times: Vec<_> = before.keys().map(written).collect();
    let (done, said) = run(&twin).unwrap();
    assert!(done.stages_run.is_empty(), "{said}");
    assert_eq!(done.stages_current, STAGES);
    // The lock and the timings are among them.
    assert_eq!(tree(&twin), before);
    assert_eq!(before.keys().map(written).collect::<Vec<_>>(), times);
}

/// Ends a run from within, as a kill does: nothing after the `left`-th sign of progress is done.
struct StopAfter<'a> {
    left: AtomicUsize,
    /// The notes that a stage is done.
    done: &'a Mutex<Vec<String>>,
}

impl StopAfter<'_> {
    fn tick(&self) {
        if self.left.fetch_update(Relaxed, Relaxed, |left| left.checked_sub(1)).is_err() {
            // Not a panic: nothing is printed.
            resume_unwind(Box::new("stopped"));
        }
    }
}

impl Progress for StopAfter<'_> {
    fn note(&self, text: &str) {
        if let Some((stage, _)) = text.split_once("  done in") {
            self.done.lock().unwrap().push(stage.trim().to_owned());
        }
        self.tick();
    }
    fn begin(&self, _: &str, _: Option<u64>) {
        self.tick();
    }
    fn at(&self, _: u64, _: &str) {
        self.tick();
    }
    fn step(&self) {
        self.tick();
    }
    fn end(&self) {
        self.tick();
    }
}

#[test]
fn a_run_that_was_stopped_goes_on_and_ends_with_the_same_bytes() {
    let (_dir, twin) = weighed_twin();
    let (mut stopped, done) = (0, Mutex::default());
    for signs in [0, 1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144] {
        let stop = StopAfter { left: AtomicUsize::new(signs), done: &done };
        let mut open = Twin::open(&twin).unwrap();
        match catch_unwind(AssertUnwindSafe(|| open.run(&RunOptions::default().until(LAST), &stop))) {
            Err(_) => stopped += 1,
            Ok(run) => {
                run.unwrap();
                break;
            }
        }
    }
    assert!(stopped >= 5, "{stopped} runs were stopped");
    assert_eq!(done.into_inner().unwrap(), STAGES, "each stage is made once over all runs");
    assert!(run(&twin).unwrap().0.stages_run.is_empty());
    assert_same_folder(&twin, template());
}

#[test]
fn a_stage_that_failed_is_where_the_next_run_begins() {
    let (_dir, twin) = weighed_twin();
    let demonstrations = fs::read(twin.join("demos/grasps.json")).unwrap();
    fs::write(twin.join("demos/grasps.json"), &demonstrations[..demonstrations.len() / 2]).unwrap();
    crate::common::fails_with(&twin, &["stage grasps", "grasps.json"]);
    assert!(!twin.join("grasps").exists(), "a stage that failed left files");
    fs::write(twin.join("demos/grasps.json"), demonstrations).unwrap();
    let (done, _) = run_until(&twin, Stage::Grasps).unwrap();
    assert_eq!((done.stages_current, done.stages_run), (vec!["identify", "asset"], vec!["grasps"]));
}

#[test]
fn what_a_kill_left_half_written_is_named_and_removed() {
    let (_dir, twin) = made();
    let left = ["mass.json.4711.tmp", "policy/execution.csv.part", "policy/network/policy.json.99.tmp"];
    left.iter().for_each(|name| fs::write(twin.join(name), "half").unwrap());
    fs::create_dir(twin.join(".asset.4711.tmp")).unwrap();
    let (done, said) = run(&twin).unwrap();
    for name in left.iter().chain(&[".asset.4711.tmp"]) {
        assert!(said.contains(&format!("removed {name}: a run that was stopped")), "{name}: {said}");
    }
    assert!(done.stages_run.is_empty(), "{said}");
    assert_same_folder(&twin, template());
}
