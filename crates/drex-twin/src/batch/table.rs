//! The two tables of a batch: what was found, and what it took.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry::{Occupied, Vacant};
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

/// By the names of items: how often each has ended, and the last of its entries in any journal.
pub(super) type LastEntries = BTreeMap<String, (usize, Entry)>;

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

    /// The last entry of each item, or a pending row where there is none.
    pub(super) fn of(items: &[Item], seed: Option<u64>, mut last: LastEntries) -> Self {
        let (mut rows, mut runs) = (Vec::with_capacity(items.len()), BTreeMap::new());
        for item in items {
            rows.push(match last.remove(&item.name) {
                Some((attempts, entry)) => {
                    runs.insert(item.name.clone(), (attempts, entry.run));
                    entry.row
                }
                None => Row::pending(item, item.seed(seed)),
            });
        }
        Self { rows, runs }
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

/// Takes account of one more entry.
pub(super) fn add(last: &mut LastEntries, entry: Entry) {
    match last.entry(entry.row.name.clone()) {
        Vacant(place) => {
            place.insert((1, entry));
        }
        Occupied(mut place) => {
            let (attempts, known) = place.get_mut();
            *attempts += 1;
            if entry.run.ended_unix_s >= known.run.ended_unix_s {
                *known = entry;
            }
        }
    }
}

fn csv(mut rows: impl Iterator<Item = impl Serialize>) -> Result<Vec<u8>> {
    let failed = |e: &dyn std::fmt::Display| Error::Refused(format!("the table cannot be written: {e}"));
    let mut writer = csv::Writer::from_writer(Vec::new());
    rows.try_for_each(|row| writer.serialize(row)).map_err(|e| failed(&e))?;
    writer.into_inner().map_err(|e| failed(&e))
}
