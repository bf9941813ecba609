//! Many objects: a list of items, one process for each, one table.
//!
//! ```text
//! folder or list ─► items ─► shard ─► workers ──────► journal.jsonl ─► results.csv, runs.csv
//!                                     (processes)     a line per item   of all shards
//! ```
//!
//! [`Batch::open`] lists the items of a folder of twins or of a list file, [`Batch::run`] does those that are not done, each in a process of
//! its own, and [`Batch::table`] joins what shards have done. Whoever starts items in another way (a cluster's workers) takes
//! [`Batch::requests`], gives each to a [`Runner`] and what that answers to [`Batch::record`].

mod journal;
mod list;
mod row;
mod runner;
mod search;
mod table;
mod worker;

use std::path::{Path, PathBuf};

use rayon::prelude::*;

pub use self::journal::Entry;
use self::journal::{JOURNAL, Journal};
pub use self::list::{FindTask, Item, Shard, Task};
pub use self::row::{Row, RunRecord, Status};
pub use self::runner::{Request, Runner};
use self::table::LastEntries;
pub use self::table::{RESULTS, RUNS, Table};
pub use self::worker::{Plan, Program, Watch, answer_request};
use crate::{Result, RunOptions};

/// Folder of a batch's results in a folder of twins.
const FOLDER: &str = "batch";
/// Folder of what shards have done, in that of the results.
const SHARDS: &str = "shards";

/// The items of a folder or a list, and the folder of their results.
#[derive(Debug, Clone)]
pub struct Batch {
    items: Vec<Item>,
    base: PathBuf,
    out: PathBuf,
}

/// How a batch is run.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct BatchOptions {
    /// Names of the stages of twins that are asked for, with those that they need; all if absent.
    pub stages: Option<Vec<String>>,
    /// Seed in place of those of manifests and lists.
    pub seed: Option<u64>,
    /// Address space that the process of an item may take (`RLIMIT_AS`), bytes: its memory, and up to 64 MB more for each of its threads. Without a
    /// limit if absent.
    pub max_memory_bytes: Option<u64>,
    /// Number of items that are done at the same time.
    pub jobs: usize,
    /// The part of the items that is done; all if absent.
    pub shard: Option<Shard>,
    /// Whether items that failed before are tried again.
    pub retry_failed: bool,
    /// Who writes the reports of twins; stages are those above.
    pub run: RunOptions,
}

impl Default for BatchOptions {
    /// All stages of all items, one item at a time.
    fn default() -> Self {
        Self {
            stages: None,
            seed: None,
            max_memory_bytes: None,
            jobs: 1,
            shard: None,
            retry_failed: false,
            run: RunOptions::default(),
        }
    }
}

/// What a run of a batch did.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Summary {
    /// The results of all items of the batch, or of its shard.
    pub table: Table,
    /// The file of the results.
    pub results: PathBuf,
    /// What there was to do.
    pub plan: Plan,
    /// Names of the items that somebody else was working on to the end, with who that is.
    pub busy: Vec<(String, String)>,
}

impl Batch {
    /// Lists the items of `path`, a folder of twins or a list file. Results go to `out`; where that is left out, to the folder `batch` in a
    /// folder of twins, or to one beside the list that is named like it.
    ///
    /// # Errors
    /// If the folder or list cannot be read, names nothing, or two items would have the same name.
    pub fn open(path: &Path, out: Option<&Path>) -> Result<Self> {
        // Without a slash at its end.
        let path: PathBuf = path.components().collect();
        let (base, items) = list::items(&path)?;
        let beside = || if path.is_dir() { path.join(FOLDER) } else { path.with_extension(FOLDER) };
        Ok(Self { items, base, out: out.map_or_else(beside, Path::to_path_buf) })
    }

    /// The items, by name.
    pub fn items(&self) -> &[Item] {
        &self.items
    }

    /// The folder of the results.
    pub fn out(&self) -> &Path {
        &self.out
    }

    /// The folder that the names of items are relative to.
    pub fn base(&self) -> &Path {
        &self.base
    }

    /// What a worker needs for each item, of the shard if one is given.
    pub fn requests(&self, options: &BatchOptions) -> Vec<Request> {
        self.shard(options)
            .map(|item| Request {
                item: item.clone(),
                base: self.base.clone(),
                out: self.out.clone(),
                stages: options.stages.clone(),
                seed: options.seed,
                max_memory_bytes: options.max_memory_bytes,
            })
            .collect()
    }

    /// Does the items that are not done, so many at a time, each in a process that `program` makes. What failed before stays as it is unless
    /// [`BatchOptions::retry_failed`] is set. A run that is killed goes on where it was when it is started again.
    ///
    /// # Errors
    /// If a stage is unknown, the folder of the results cannot be written, or a worker cannot be started; [`Error::Busy`](crate::Error::Busy)
    /// if another run works with that folder. An item that fails is no error: its row says why.
    pub fn run(&self, options: &BatchOptions, program: Program<'_>, watch: &dyn Watch) -> Result<Summary> {
        options.stages.as_deref().map_or(Ok(Vec::new()), runner::stages)?;
        let folder = self.folder(options);
        let journal = Journal::open(&folder)?;
        let known = self.last_entries(options.shard)?;
        let (mut todo, mut plan) = (Vec::new(), Plan { todo: 0, current: 0, failed_before: 0 });
        let requests = self.requests(options);
        // One that cannot be read any more says so when it is done again.
        let is_current = |request: &Request| match known.get(&request.item.name) {
            Some((_, entry)) if entry.row.status == Status::Done => {
                request.is_current(&options.run).unwrap_or_default()
            }
            _ => false,
        };
        let current: Vec<bool> = requests.par_iter().map(is_current).collect();
        for (request, current) in requests.into_iter().zip(current) {
            let failed = known.get(&request.item.name).is_some_and(|(_, e)| e.row.status == Status::Failed);
            if current {
                plan.current += 1;
            } else if failed && !options.retry_failed {
                plan.failed_before += 1;
            } else {
                todo.push(request);
            }
        }
        plan.todo = todo.len();
        watch.begins(&plan);
        let busy = worker::work(&todo, options.jobs.max(1), program, &folder.join("logs"), &journal, watch)?;
        let items: Vec<Item> = self.shard(options).cloned().collect();
        let table = Table::of(&items, options.seed, self.last_entries(options.shard)?);
        let results = table.write(&folder)?;
        Ok(Summary { table, results, plan, busy })
    }

    /// Notes what became of items that were done elsewhere, as [`Batch::run`] does, and writes the tables of all items. Names that of the results.
    ///
    /// # Errors
    /// If the folder of the results cannot be written, or a journal not be read; [`Error::Busy`](crate::Error::Busy) if another run works with
    /// that folder.
    pub fn record(&self, entries: &[Entry]) -> Result<PathBuf> {
        let journal = Journal::open(&self.out)?;
        journal.append(entries)?;
        self.table()?.write(&self.out)
    }

    /// What is known of all items, whoever did them.
    ///
    /// # Errors
    /// If a journal cannot be read.
    pub fn table(&self) -> Result<Table> {
        Ok(Table::of(&self.items, None, self.last_entries(None)?))
    }

    fn shard<'a>(&'a self, options: &BatchOptions) -> impl Iterator<Item = &'a Item> {
        let shard = options.shard;
        self.items.iter().filter(move |item| shard.is_none_or(|s| s.has(&item.name)))
    }

    /// The folder for what is done with these options.
    fn folder(&self, options: &BatchOptions) -> PathBuf {
        options.shard.map_or_else(|| self.out.clone(), |shard| self.out.join(SHARDS).join(shard.folder()))
    }

    /// What a run goes on from: that of a shard from its own journal and the main one, that of the whole batch from all.
    fn last_entries(&self, shard: Option<Shard>) -> Result<LastEntries> {
        let shards = self.out.join(SHARDS);
        let mut folders = vec![self.out.clone()];
        match shard {
            Some(shard) => folders.push(shards.join(shard.folder())),
            None if shards.is_dir() => folders.extend(list::listed(&shards)?),
            None => {}
        }
        let mut last = LastEntries::new();
        for folder in folders {
            journal::read(&folder.join(JOURNAL), |entry| table::add(&mut last, entry))?;
        }
        Ok(last)
    }
}
