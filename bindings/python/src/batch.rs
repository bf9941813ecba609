//! Batches: the items of a folder or a list, done by whoever starts processes.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use drex_twin::batch::{self, BatchOptions, Entry, Request, Row, RunRecord};
use drex_twin::{RunOptions, Stage};
use pyo3::prelude::*;
use serde::{Deserialize, Serialize};

use crate::arrays::plain;
use crate::failure::{Result, refused};
use crate::twin::Run;
use crate::watch::{STACK_BYTES, watched_with_notes};

/// More threads than any machine has cores.
const MOST_THREADS: usize = 4096;

/// The items of a folder of twins or of a list, and the folder of their results (`Batch.open`); what `drex batch` works on.
///
/// Whoever does them elsewhere gives each of `requests` to a `Runner`, and the rows that it answers to `record`. `drex.ray` does so.
#[pyclass(module = "drex", frozen)]
pub(crate) struct Batch {
    inner: batch::Batch,
}

#[pymethods]
impl Batch {
    /// Lists the items of `path`, a folder of twins or a list file. Results go to `out`; if left out, to the folder "batch" in a folder of
    /// twins, or to one beside the list that is named like it.
    #[staticmethod]
    #[pyo3(signature = (path, out=None))]
    fn open(path: PathBuf, out: Option<PathBuf>) -> Result<Self> {
        Ok(Self { inner: batch::Batch::open(&path, out.as_deref())? })
    }

    /// Names of the items, sorted.
    #[getter]
    fn names(&self) -> Vec<&str> {
        self.inner.items().iter().map(|item| item.name.as_str()).collect()
    }

    /// The folder of the results.
    #[getter]
    fn out(&self) -> &Path {
        self.inner.out()
    }

    /// What a `Runner` needs for each item, in the order of `names`: texts that any process may be given which sees the same folders.
    ///
    /// `stages` are the names of those of twins that are asked for (all if left out), `seed` is used in place of those of manifests and lists.
    #[pyo3(signature = (stages=None, seed=None))]
    fn requests(&self, stages: Option<Vec<String>>, seed: Option<u64>) -> Result<Vec<String>> {
        stages.iter().flatten().try_for_each(|name| name.parse::<Stage>().map(drop))?;
        let mut options = BatchOptions::default();
        (options.stages, options.seed) = (stages, seed);
        self.inner.requests(&options).iter().map(|request| Ok(serde_json::to_string(request)?)).collect()
    }

    /// Notes in the journal of the folder `out` what became of items, and writes the tables results.csv and runs.csv of all items there, as
    /// `drex batch` does, which then finds these items done. `rows` are what `Runner.run` gave. Returns the file of the results.
    fn record(&self, py: Python<'_>, rows: &Bound<'_, PyAny>) -> Result<PathBuf> {
        let text: String = py.import("json")?.call_method1("dumps", (rows,))?.extract()?;
        let rows: Vec<FlatEntry> = serde_json::from_str(&text)
            .or_else(|e| refused(format!("these are no rows of a batch ({e}); give what Runner.run answered")))?;
        let entries: Vec<Entry> = rows.into_iter().map(Entry::from).collect();
        Ok(self.inner.record(&entries)?)
    }

    fn __repr__(&self) -> String {
        format!("Batch({} items, results in {})", self.inner.items().len(), self.inner.out().display())
    }
}

/// Does items of a batch in this process, and keeps the models of hands and the last mesh for the next ones.
///
/// It has `threads` threads of its own (one per core if left out), whatever the environment says; results do not depend on their number.
#[pyclass(module = "drex", frozen)]
pub(crate) struct Runner {
    inner: Arc<Mutex<batch::Runner>>,
    pool: Arc<rayon::ThreadPool>,
}

#[pymethods]
impl Runner {
    #[new]
    #[pyo3(signature = (threads=None))]
    fn new(threads: Option<usize>) -> Result<Self> {
        if let Some(wrong) = threads.filter(|threads| !(1..=MOST_THREADS).contains(threads)) {
            return refused(format!("threads = {wrong} is no number of threads; give 1 to {MOST_THREADS}"));
        }
        let cores = || std::thread::available_parallelism().map_or(1, usize::from);
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads.unwrap_or_else(cores))
            .thread_name(|number| format!("drex-{number}"))
            .stack_size(STACK_BYTES)
            .build()
            .or_else(|e| refused(format!("no threads could be started: {e}; close other programs")))?;
        let options = RunOptions::default().with_picture(drex_report::write_picture).with_report(drex_report::write);
        Ok(Self { inner: Arc::new(Mutex::new(batch::Runner::new(options))), pool: Arc::new(pool) })
    }

    /// Number of its threads.
    #[getter]
    fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// Does the item of `request`, one of `Batch.requests`, and returns its row: a dict with the columns of results.csv (None where one has no
    /// number) and of runs.csv. What cannot be done is a row with "status" "failed" and its reason in "error".
    ///
    /// `progress` and `note` are those of `Twin.run`. Ctrl-C, or an exception of these two, ends the call at once; the item at work stops as soon
    /// as it can, the next call waits for that, and doing the item again goes on from there.
    #[pyo3(signature = (request, progress=None, *, note=None))]
    fn run<'py>(
        &self,
        py: Python<'py>,
        request: &str,
        progress: Option<&Bound<'py, PyAny>>,
        note: Option<&Bound<'py, PyAny>>,
    ) -> Result<Bound<'py, PyAny>> {
        let request = parsed(request)?;
        let (runner, pool) = (Arc::clone(&self.inner), Arc::clone(&self.pool));
        let entry = watched_with_notes(py, progress, note, move |part| {
            // A runner whose item panicked has no more loaded than it had before.
            let mut guard = runner.lock().unwrap_or_else(PoisonError::into_inner);
            let runner = &mut *guard;
            Ok(pool.install(|| runner.run(&request, &Run(part)))?)
        })?;
        plain(py, &FlatEntry::from(entry))
    }

    /// The row of an item whose process ended without one, with the `reason`.
    #[staticmethod]
    fn failed<'py>(py: Python<'py>, request: &str, reason: &str) -> Result<Bound<'py, PyAny>> {
        plain(py, &FlatEntry::from(parsed(request)?.failed(reason)))
    }

    fn __repr__(&self) -> String {
        format!("Runner({} threads)", self.threads())
    }
}

fn parsed(request: &str) -> Result<Request> {
    serde_json::from_str(request)
        .or_else(|e| refused(format!("this is no request ({e}); Batch.requests makes them for this version of drex")))
}

/// An entry of a journal in one level: what Python calls a row.
#[derive(Serialize, Deserialize)]
struct FlatEntry {
    #[serde(flatten)]
    row: Row,
    #[serde(flatten)]
    run: RunRecord,
}

impl From<Entry> for FlatEntry {
    fn from(Entry { row, run }: Entry) -> Self {
        Self { row, run }
    }
}

impl From<FlatEntry> for Entry {
    fn from(FlatEntry { row, run }: FlatEntry) -> Self {
        Self { row, run }
    }
}
