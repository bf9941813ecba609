//! The two tables of a batch: what was found, and what it took.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use drex_core::fsutil;
use serde::Serialize;

use super::journal::Entry;
use super::list::Item;
use super::row::{Row, RunRecord, Status};
use crate::{Error, Result};

/// Name of the table of results: a row per item, the same bytes wherever and whenever it is made.
pub const RESULTS: &str = "results.csv";
/// Name of the table of what it took: seconds, attempts, machine.
pub const RUNS: &str = "runs.csv";

/// The results of a batch, a row for every item, by name.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Table {
    /// What was found.
    pub rows: Vec<Row>,
    /// Of the items that have ended: how often they were tried, and what the last time took.
    pub runs: BTreeMap<String, (usize, RunRecord)>,
}

/// A row of the table [`RUNS`].
#[derive(Serialize)]
struct RunRow<'a> {
    name: &'a str,
    attempts: usize,
    seconds: f64,
    core_seconds: Option<f64>,
    peak_memory_bytes: Option<u64>,
    threads: usize,
    host: &'a str,
}

impl Table {
    /// A table of these rows, and what some of them took by their names.
    pub fn new(rows: Vec<Row>, runs: BTreeMap<String, (usize, RunRecord)>) -> Self {
        Self { rows, runs }
    }

    /// The last entry of each item in any journal, or a pending row where there is none.
    pub(super) fn of(items: &[Item], seed: Option<u64>, entries: &[Entry]) -> Self {
        let last = last(entries);
        let row = |item: &Item| match last.get(item.name.as_str()) {
            Some((_, entry)) => entry.row.clone(),
            None => Row::pending(item, item.seed(seed)),
        };
        let runs = items.iter().filter_map(|item| last.get(item.name.as_str()));
        Self {
            rows: items.iter().map(row).collect(),
            runs: runs.map(|(attempts, e)| (e.row.name.clone(), (*attempts, e.run.clone()))).collect(),
        }
    }

    /// Number of rows with this status.
    pub fn count(&self, status: Status) -> usize {
        self.rows.iter().filter(|r| r.status == status).count()
    }

    /// Writes [`RESULTS`] and [`RUNS`] into the folder, and names the first.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<PathBuf> {
        let runs = self.runs.iter().map(|(name, (attempts, run))| RunRow {
            name,
            attempts: *attempts,
            seconds: run.seconds,
            core_seconds: run.core_seconds,
            peak_memory_bytes: run.peak_memory_bytes,
            threads: run.threads,
            host: &run.host,
        });
        fsutil::write_atomic(&folder.join(RUNS), &csv(runs)?)?;
        let results = folder.join(RESULTS);
        fsutil::write_atomic(&results, &csv(self.rows.iter())?)?;
        Ok(results)
    }
}

/// The last entry of each name, with the number of its entries.
pub(super) fn last(entries: &[Entry]) -> BTreeMap<&str, (usize, &Entry)> {
    let mut last = BTreeMap::new();
    for entry in entries {
        let (attempts, known) = last.entry(entry.row.name.as_str()).or_insert((0, entry));
        *attempts += 1;
        if entry.run.ended_unix_s >= known.run.ended_unix_s {
            *known = entry;
        }
    }
    last
}

fn csv(mut rows: impl Iterator<Item = impl Serialize>) -> Result<Vec<u8>> {
    let failed = |e: &dyn std::fmt::Display| Error::Refused(format!("the table cannot be written: {e}"));
    let mut writer = csv::Writer::from_writer(Vec::new());
    rows.try_for_each(|row| writer.serialize(row)).map_err(|e| failed(&e))?;
    writer.into_inner().map_err(|e| failed(&e))
}
