//! The pipeline: every stage whose inputs changed, in order.

use std::path::PathBuf;
use std::time::Instant;

use drex_core::fsutil;
use serde::Serialize;

use crate::error::{Context, refuse};
use crate::inputs::Stage;
use crate::timings::{self, Timing};
use crate::{Alone, Error, Progress, Result, Twin, stages};

/// Writes something about a twin and names the files; `drex_report::write` and `drex_report::write_picture` do.
pub type Reporter = fn(&Twin) -> Result<Vec<PathBuf>, Box<dyn std::error::Error + Send + Sync>>;

/// How far a twin is run.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct RunOptions {
    /// The stages that are looked at, with those that they need; `None` for all up to the last.
    pub stages: Option<Vec<Stage>>,
    /// The last stage that is done.
    pub last: Stage,
    /// Whether the last stage is done even if it is up to date.
    pub again: bool,
    /// Writer of the report; without one the stage [`Stage::Report`] is left out.
    pub report: Option<Reporter>,
    /// Writer of a first picture of the object, as soon as the stage [`Stage::Asset`] has made it.
    pub picture: Option<Reporter>,
}

impl Default for RunOptions {
    /// All stages, without a report or a picture.
    fn default() -> Self {
        Self { stages: None, last: Stage::Report, again: false, report: None, picture: None }
    }
}

impl RunOptions {
    /// The options with another last stage.
    #[must_use]
    pub fn until(mut self, last: Stage) -> Self {
        self.last = last;
        self
    }

    /// The options with these stages and those that they need, and no others.
    #[must_use]
    pub fn with_stages(mut self, stages: &[Stage]) -> Self {
        self.last = stages.iter().copied().max().unwrap_or(self.last);
        self.stages = Some(Stage::with_needed(stages));
        self
    }

    /// The options with the last stage done in any case.
    #[must_use]
    pub fn with_again(mut self, again: bool) -> Self {
        self.again = again;
        self
    }

    /// The options with a writer of the report.
    #[must_use]
    pub fn with_report(mut self, report: Reporter) -> Self {
        self.report = Some(report);
        self
    }

    /// The options with a writer of the first picture.
    #[must_use]
    pub fn with_picture(mut self, picture: Reporter) -> Self {
        self.picture = Some(picture);
        self
    }
}

/// What a run of the pipeline did.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct RunSummary {
    /// The twin's name.
    pub name: String,
    /// Stages that were made in this run.
    pub stages_run: Vec<&'static str>,
    /// Stages that were up to date.
    pub stages_current: Vec<&'static str>,
    /// Wall time, seconds.
    pub seconds: f64,
}

impl Twin {
    /// Does every stage up to and including the last one whose inputs changed, and skips the others.
    ///
    /// A run that is stopped goes on where it was when it is started again, and ends with the same bytes.
    ///
    /// # Errors
    /// If a stage fails; the message names the stage, what was wrong and what to do. [`Error::Busy`] if another process works on the
    /// folder, and [`Error::Stopped`] where `progress` stops the run.
    pub fn run(&mut self, options: &RunOptions, progress: &dyn Progress) -> Result<RunSummary> {
        let RunOptions { last, again, report, picture, .. } = *options;
        if last.needs_grasps() && self.manifest.grasps.is_none() {
            refuse!(
                "{} has no [grasps] section, so there is nothing to {}; name a file of demonstrated grasps there",
                self.path("twin.toml").display(),
                last.name()
            );
        }
        let _alone = self.begin(progress)?;
        let started = Instant::now();
        let mut summary =
            RunSummary { name: self.manifest.name.clone(), stages_run: vec![], stages_current: vec![], seconds: 0.0 };
        let asked = self.stages(options);
        for (place, stage) in asked.iter().copied().enumerate() {
            progress.stages(place, asked.len());
            if progress.is_stopped() {
                return Err(Error::Stopped);
            }
            let inputs = self.inputs(stage).with_context(|| format!("stage {}", stage.name()))?;
            let altered = self.lock.altered(stage.name(), &inputs);
            if altered.as_ref().is_some_and(Vec::is_empty) && !(again && stage == last) {
                progress.note(&format!("{:>10}  up to date", stage.name()));
                summary.stages_current.push(stage.name());
                continue;
            }
            if let Some(files) = altered.filter(|files| !files.is_empty()) {
                progress.note(&format!(
                    "{:>10}  {} is made again: edited, damaged or removed since it was made: {}",
                    "note",
                    stage.name(),
                    some_of(&files)
                ));
            }
            let begun = Instant::now();
            let made = self.make(stage, report, progress);
            // A stage that was stopped says so in one way or another.
            if made.is_err() && progress.is_stopped() {
                return Err(Error::Stopped);
            }
            let mut outputs = made.with_context(|| format!("stage {} of {}", stage.name(), self.root.display()))?;
            if let Some(write) = picture.filter(|_| stage == Stage::Asset) {
                // Nothing depends on it: a photo that cannot be read must not cost the asset.
                match write(self) {
                    Ok(pictures) => {
                        for file in &pictures {
                            progress.note(&format!("{:>10}  {}", "picture", file.display()));
                        }
                        outputs.extend(pictures);
                    }
                    Err(e) => progress.note(&format!("{:>10}  there is no first picture: {e}", "note")),
                }
            }
            let seconds = begun.elapsed().as_secs_f64();
            let removed = self.lock.record(stage.name(), inputs, self.seed, &outputs)?;
            if !removed.is_empty() {
                progress.note(&format!(
                    "{:>10}  removed what an earlier run made and this one did not: {}",
                    "note",
                    some_of(&removed)
                ));
            }
            let parts = self.parts.take();
            timings::record(&self.root, stage.name(), Timing { parts, ..Timing::of(seconds) })?;
            progress.note(&format!("{:>10}  done in {seconds:.1} s", stage.name()));
            summary.stages_run.push(stage.name());
        }
        progress.stages(asked.len(), asked.len());
        summary.seconds = started.elapsed().as_secs_f64();
        Ok(summary)
    }

    /// The stages that a run with these options looks at: those asked for that this twin has something for.
    pub fn stages(&self, options: &RunOptions) -> Vec<Stage> {
        let has = |stage: &Stage| match stage {
            Stage::Scan | Stage::Appearance => self.manifest.scan.is_some(),
            Stage::Report => options.report.is_some(),
            stage => self.manifest.grasps.is_some() || !stage.needs_grasps(),
        };
        let asked = options.stages.as_deref().unwrap_or(&Stage::ALL);
        asked.iter().copied().filter(|stage| *stage <= options.last && has(stage)).collect()
    }

    /// Whether a run with these options would find nothing to do.
    ///
    /// # Errors
    /// If an input cannot be read.
    pub fn is_current(&self, options: &RunOptions) -> Result<bool> {
        for stage in self.stages(options) {
            if !self.lock.is_current(stage.name(), &self.inputs(stage)?) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Says what is not as the last run left it, and removes what a run that did not end left half-written. Until the value
    /// is dropped no other process works on this folder.
    fn begin(&self, progress: &dyn Progress) -> Result<Alone> {
        self.lock.damage().iter().for_each(|damage| progress.note(&format!("{:>10}  {damage}", "note")));
        let alone = Alone::take(&self.file, &self.root)?;
        let folders = ["scan", "sfm", "splat", "depth", "mesh", "asset", "grasps", "policy"];
        let mut removed = fsutil::remove_unfinished(&self.root, false)?;
        for folder in folders {
            removed.extend(fsutil::remove_unfinished(&self.path(folder), true)?);
        }
        for path in removed {
            let what = path.strip_prefix(&self.root).unwrap_or(&path).display();
            progress.note(&format!(
                "{:>10}  removed {what}: a run that was stopped, or found the disk full, left it",
                "note"
            ));
        }
        Ok(alone)
    }

    fn make(&self, stage: Stage, report: Option<Reporter>, progress: &dyn Progress) -> Result<Vec<PathBuf>> {
        match stage {
            Stage::Scan => stages::scan::make(self, progress),
            Stage::Asset => stages::asset::make(self, progress),
            Stage::Identify => stages::identify::make(self, progress),
            Stage::Grasps => stages::grasps::make(self, progress),
            Stage::Train => stages::train::make(self, progress),
            Stage::Evaluate => stages::evaluate::make(self, progress),
            Stage::Trial => stages::trial::make(self, progress),
            Stage::Execute => stages::execute::make(self, progress),
            Stage::Appearance => stages::appearance::make(self, progress),
            Stage::Report => report.map_or(Ok(Vec::new()), |write| write(self).map_err(Error::Report)),
        }
    }
}

/// The first names of a list, and how many more there are.
fn some_of(names: &[String]) -> String {
    const SHOWN: usize = 3;
    let more = names.len().saturating_sub(SHOWN);
    let shown = names.iter().take(SHOWN).map(String::as_str).collect::<Vec<_>>().join(", ");
    if more > 0 { format!("{shown} and {more} more") } else { shown }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    /// Stops a run at its second stage.
    #[derive(Default)]
    struct StopAtSecond(AtomicUsize);

    impl Progress for StopAtSecond {
        fn stages(&self, done: usize, _total: usize) {
            self.0.store(done, Ordering::Relaxed);
        }

        fn is_stopped(&self) -> bool {
            self.0.load(Ordering::Relaxed) >= 1
        }
    }

    #[test]
    fn a_run_that_is_stopped_keeps_what_it_made_and_goes_on() {
        let dir = tempfile::tempdir().unwrap();
        for file in ["twin.toml", "scan/tin.obj", "push/tilt/push.toml", "push/tilt/poses.csv", "push/tilt/force.csv"] {
            let to = dir.path().join(file);
            std::fs::create_dir_all(to.parent().unwrap()).unwrap();
            std::fs::copy(format!("{}/data/tin/{file}", env!("CARGO_MANIFEST_DIR")), to).unwrap();
        }
        let mut twin = Twin::open(dir.path()).unwrap();
        assert!(twin.mass().is_err());
        let options = RunOptions::default().with_stages(&[Stage::Asset]);
        // Before the asset: the mass is known.
        assert!(matches!(twin.run(&options, &StopAtSecond::default()), Err(Error::Stopped)));
        assert!(twin.mass().is_ok() && !twin.path("asset").exists());
        let done = twin.run(&options, &()).unwrap();
        assert_eq!((done.stages_current, done.stages_run), (vec!["identify"], vec!["asset"]));
    }
}
