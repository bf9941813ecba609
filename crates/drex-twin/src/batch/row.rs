//! A row of the table of results, and what it took to get it.

use std::time::{Instant, SystemTime, UNIX_EPOCH};

use drex_core::stats::median;
use drex_trial::wilson;
use serde::{Deserialize, Serialize};

use super::list::{FindTask, Item};
use super::search::SearchFile;
use crate::alone::host;
use crate::lock::made_by;
use crate::records::{EVALUATION, Evaluation, TRIAL, TrialFile, read_json};
use crate::{Result, Stage, Twin};

/// What became of an item.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// It cannot be done; [`Row::error`] says why.
    Failed,
    /// Nobody has done it yet.
    Pending,
    /// It is done.
    Done,
}

/// One item's results: the same, digit by digit, wherever and whenever they are made. Fields that its stages do not make are absent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The item's name.
    pub name: String,
    /// "twin", or "find" for a grasp that is looked for.
    pub task: String,
    /// What became of it.
    pub status: Status,
    /// Median of the mass, or the mass that was given, kg.
    pub mass_kg: Option<f64>,
    /// Lower end of its 95 % interval, kg.
    pub mass_low_kg: Option<f64>,
    /// Upper end of its 95 % interval, kg.
    pub mass_high_kg: Option<f64>,
    /// Where the mass comes from: "weighed", "identified", "bounded", "prior", or "given".
    pub mass_source: String,
    /// What the pushes can tell (`identified`, `only_mu_m`, `not_identifiable`), or whether a grasp was `found` or there is `none`.
    pub verdict: String,
    /// The hand.
    pub hand: String,
    /// Coefficient of friction between object and hand.
    pub friction: Option<f64>,
    /// Number of grasps that the network proposes.
    pub proposed: Option<usize>,
    /// Number of them that pass the evaluation at rest.
    pub passed: Option<usize>,
    /// Median of the grip forces that the trials commanded, sum of the normal forces, N.
    pub grip_force_n: Option<f64>,
    /// Number of simulated trials that held the object to the end.
    pub held: Option<usize>,
    /// Number of simulated trials.
    pub trials: Option<usize>,
    /// Share of the trials that held.
    pub success_rate: Option<f64>,
    /// Lower end of its 95 % interval (Wilson).
    pub success_low: Option<f64>,
    /// Upper end of its 95 % interval.
    pub success_high: Option<f64>,
    /// Seed of everything random.
    pub seed: u64,
    /// Program and version.
    pub program: String,
    /// Why it failed, with what to do; empty if it did not.
    pub error: String,
}

impl Row {
    /// The row of an item that nobody has done.
    pub(super) fn pending(item: &Item, seed: u64) -> Self {
        Self {
            name: item.name.clone(),
            task: item.task.name().to_owned(),
            status: Status::Pending,
            mass_kg: None,
            mass_low_kg: None,
            mass_high_kg: None,
            mass_source: String::new(),
            verdict: String::new(),
            hand: String::new(),
            friction: None,
            proposed: None,
            passed: None,
            grip_force_n: None,
            held: None,
            trials: None,
            success_rate: None,
            success_low: None,
            success_high: None,
            seed,
            program: made_by(),
            error: String::new(),
        }
    }

    /// The row of an item that cannot be done.
    pub(super) fn failed(item: &Item, seed: u64, error: String) -> Self {
        Self { status: Status::Failed, error, ..Self::pending(item, seed) }
    }

    /// What these stages made of a twin.
    pub(super) fn of_twin(item: &Item, twin: &Twin, stages: &[Stage]) -> Result<Self> {
        let mut row = Self { status: Status::Done, ..Self::pending(item, twin.seed) };
        row.friction = Some(twin.friction());
        if stages.contains(&Stage::Identify) {
            let mass = twin.mass()?;
            row.mass_kg = Some(mass.mass_kg);
            [row.mass_low_kg, row.mass_high_kg] = mass.ci95_kg.map(Some);
            row.mass_source = word(&mass.source);
            row.verdict = mass.identification.as_ref().map_or_else(String::new, |i| word(&i.verdict));
        }
        if stages.iter().any(|s| s.needs_grasps()) {
            row.hand = twin.manifest.grasps.as_ref().map_or_else(String::new, |g| g.hand.clone());
        }
        if stages.contains(&Stage::Evaluate) {
            let evaluation: Evaluation = read_json(&twin.path(EVALUATION))?;
            row.proposed = Some(evaluation.predicted.len());
            row.passed = Some(evaluation.predicted.iter().filter(|g| g.check.passed).count());
        }
        if stages.contains(&Stage::Trial) {
            let trial: TrialFile = read_json(&twin.path(TRIAL))?;
            row.grip_force_n = trial.commanded_n();
            row.tried(trial.held, trial.n, trial.interval);
        }
        Ok(row)
    }

    /// What became of a search for a grasp.
    pub(super) fn of_search(item: &Item, task: &FindTask, seed: u64, search: &SearchFile) -> Self {
        let mut row = Self { status: Status::Done, ..Self::pending(item, seed) };
        row.mass_kg = Some(task.mass_kg);
        row.mass_source = "given".to_owned();
        row.verdict = if search.grasp.is_some() { "found" } else { "none" }.to_owned();
        row.hand = task.hand.clone();
        row.friction = Some(search.friction);
        row.grip_force_n = search.grip_force_n;
        if let (Some(held), Some(verdicts)) = (search.held, &search.verdicts) {
            let interval = wilson(held, verdicts.len());
            row.tried(held, verdicts.len(), [interval.low, interval.high]);
        }
        row
    }

    fn tried(&mut self, held: usize, trials: usize, [low, high]: [f64; 2]) {
        (self.held, self.trials) = (Some(held), Some(trials));
        self.success_rate = Some(held as f64 / trials.max(1) as f64);
        (self.success_low, self.success_high) = (Some(low), Some(high));
    }
}

impl TrialFile {
    /// Median of the grip forces that were commanded, N; `None` if no grasp could be.
    pub fn commanded_n(&self) -> Option<f64> {
        median(self.rollouts.iter().filter(|r| r.proposal > 0).map(|r| r.grip_force_n))
    }
}

/// What the run of an item took: this differs from run to run and from machine to machine.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// When it ended, seconds since 1970.
    pub ended_unix_s: f64,
    /// Wall time, s.
    pub seconds: f64,
    /// Processor time of all threads, s, where the system tells.
    pub core_seconds: Option<f64>,
    /// Most memory that its process held, bytes, where the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// Number of worker threads.
    pub threads: usize,
    /// Name of the machine.
    pub host: String,
}

impl RunRecord {
    /// Of what was begun then and ends now, on this machine.
    pub(super) fn ending_now(begun: Instant) -> Self {
        let since = SystemTime::now().duration_since(UNIX_EPOCH);
        Self {
            ended_unix_s: since.map_or(0.0, |s| s.as_secs_f64()),
            seconds: begun.elapsed().as_secs_f64(),
            host: host(),
            ..Self::default()
        }
    }
}

/// The word that files use for a value of an enum without fields.
fn word(value: &impl Serialize) -> String {
    serde_json::to_value(value).ok().and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default()
}
