//! Twins that were run, and what a run says.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock};

use drex_twin::{Progress, Result, RunOptions, RunSummary, Stage, Twin};
use tempfile::TempDir;

use crate::support::{copy_of, edit, small_twin};

/// The last stage of the twins of these tests: what follows needs the same care and more time.
pub const LAST: Stage = Stage::Evaluate;
/// The stages up to it.
pub const STAGES: [&str; 5] = ["identify", "asset", "grasps", "train", "evaluate"];

/// Hears what a run says.
#[derive(Default)]
pub struct Notes(Mutex<Vec<String>>);

impl Progress for Notes {
    fn note(&self, text: &str) {
        self.0.lock().unwrap().push(text.to_owned());
    }
}

impl Notes {
    /// All notes, one per line.
    pub fn text(&self) -> String {
        self.0.lock().unwrap().join("\n")
    }
}

/// Opens the twin and runs it to [`LAST`]: what was done, and what was said.
pub fn run(twin: &Path) -> Result<(RunSummary, String)> {
    run_until(twin, LAST)
}

/// As [`run`], to another stage.
pub fn run_until(twin: &Path, last: Stage) -> Result<(RunSummary, String)> {
    let notes = Notes::default();
    let summary = Twin::open(twin)?.run(&RunOptions::default().until(last), &notes)?;
    Ok((summary, notes.text()))
}

/// The message of an error with all its causes, as the application prints it.
pub fn message(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |e| e.source());
    causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}

/// Asserts that a run fails, with these words in its message.
pub fn fails_with(twin: &Path, words: &[&str]) {
    let Err(error) = run(twin) else { panic!("the run of {} did not fail", twin.display()) };
    let message = message(&error);
    for word in words {
        assert!(message.contains(word), "`{word}` is missing in: {message}");
    }
}

/// A small twin whose object was put on a scale: identifying a push takes seconds.
pub fn weighed_twin() -> (TempDir, PathBuf) {
    let (dir, twin) = small_twin(2);
    edit(&twin.join("twin.toml"), "identify = [\"push/tilt\"]\nprior_kg = 0.5", "weighed_kg = 0.236");
    edit(&twin.join("twin.toml"), "epochs = 5", "epochs = 5\nmodes = 2");
    (dir, twin)
}

/// The folder of a weighed twin that was run to [`LAST`], once for all tests; copy it with [`made`] to change it.
pub fn template() -> &'static Path {
    static MADE: OnceLock<PathBuf> = OnceLock::new();
    MADE.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("small_twin");
        // That of an earlier run of the tests.
        if folder.exists() {
            std::fs::remove_dir_all(&folder).unwrap();
        }
        let (_dir, twin) = weighed_twin();
        assert_eq!(run(&twin).unwrap().0.stages_run, STAGES);
        crate::support::copy_tree(&twin, &folder);
        folder
    })
}

/// A copy of [`template`].
pub fn made() -> (TempDir, PathBuf) {
    copy_of(template())
}
