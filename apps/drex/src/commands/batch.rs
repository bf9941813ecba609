//! `drex batch`: many twins, or many meshes to find grasps for.

use std::path::Path;
use std::process::{Command, ExitCode};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use anyhow::{Context, Result};
use drex_twin::batch::{Batch, BatchOptions, Entry, Plan, Row, Status, Table, Watch, answer_request};
use drex_twin::{Progress, RunOptions};
use serde_json::{Map, json};

use crate::BUSY;
use crate::cli::{BatchArgs, BatchCommand, BatchPlace, Common};
use crate::ui::Ui;

/// Failures that are printed; all are in the table.
const FAILURES_SHOWN: usize = 10;
/// Part of the machine's memory that all items together may take unless somebody says how much.
const SHARE_OF_MEMORY: f64 = 0.8;

/// Runs what is asked for and answers with counts and the table's place.
pub fn run(args: &BatchArgs, common: &Common, ui: &Ui) -> Result<ExitCode> {
    match &args.command {
        Some(BatchCommand::Item) => {
            answer_request(run_options(), ui)?;
            Ok(ExitCode::SUCCESS)
        }
        Some(BatchCommand::Merge(place)) => {
            let batch = open(place)?;
            let table = batch.table()?;
            let results = table.write(batch.out())?;
            answer(&table, &results, ui)
        }
        Some(BatchCommand::Report(place)) => {
            let batch = open(place)?;
            let page = drex_report::write_batch(&batch, &batch.table()?)?;
            ui.answer(&json!({ "report": page }), page.display().to_string())?;
            Ok(ExitCode::SUCCESS)
        }
        None => work(args, common, ui),
    }
}

fn open(place: &BatchPlace) -> Result<Batch> {
    let items = place.items.as_deref().context("no folder or list is given")?;
    Ok(Batch::open(items, place.out.as_deref())?)
}

/// Twins with their reports.
fn run_options() -> RunOptions {
    RunOptions::default().with_picture(drex_report::write_picture).with_report(drex_report::write)
}

fn work(args: &BatchArgs, common: &Common, ui: &Ui) -> Result<ExitCode> {
    let batch = open(&args.place)?;
    let cores = common.threads.map_or_else(|| std::thread::available_parallelism().map_or(1, usize::from), usize::from);
    let jobs = args.jobs.map_or(cores, usize::from);
    let mut options = BatchOptions::default();
    options.stages = (!args.stages.is_empty()).then(|| args.stages.iter().map(|s| s.name().to_owned()).collect());
    options.seed = common.seed;
    options.jobs = jobs;
    options.shard = args.shard;
    options.retry_failed = args.retry_failed;
    options.run = run_options();

    let program = std::env::current_exe().context("the program does not know where it lies")?;
    let limit_gb = common.max_memory.or_else(|| share_of_memory(jobs));
    options.max_memory_bytes = limit_gb.map(|gb| (gb * f64::from(1 << 30)) as u64);
    let worker = || {
        let mut command = Command::new(&program);
        command.args(["batch", "item", "--threads", &(cores / jobs).max(1).to_string()]);
        for (option, limit) in [("--max-memory", limit_gb), ("--max-seconds", common.max_seconds)] {
            command.args(limit.iter().flat_map(|limit| [option.to_owned(), limit.to_string()]));
        }
        command
    };
    let lines = Lines { ui, begun: Instant::now(), todo: AtomicUsize::new(0), done: AtomicUsize::new(0) };
    let summary = batch.run(&options, &worker, &lines)?;
    ui.end();
    for (name, message) in &summary.busy {
        ui.note(format!("{name} was not done: {message}"));
    }
    if summary.plan.failed_before > 0 {
        ui.note(format!("{} failed before; --retry-failed tries them again", summary.plan.failed_before));
    }
    let status = answer(&summary.table, &summary.results, ui)?;
    let failed = summary.table.rows.iter().any(|r| r.status == Status::Failed);
    Ok(if failed || summary.busy.is_empty() { status } else { ExitCode::from(BUSY) })
}

/// Answers with counts, the failures, and where the table is.
fn answer(table: &Table, results: &Path, ui: &Ui) -> Result<ExitCode> {
    let count = |status| table.rows.iter().filter(|r| r.status == status).count();
    let [done, failed, pending] = [Status::Done, Status::Failed, Status::Pending].map(count);
    let failures = || table.rows.iter().filter(|r| r.status == Status::Failed);
    let mut text = String::new();
    for row in failures().take(FAILURES_SHOWN) {
        text += &format!("failed  {}: {}\n", row.name, row.error);
    }
    if failed > FAILURES_SHOWN {
        text += &format!("failed  {} more\n", failed - FAILURES_SHOWN);
    }
    text += &format!("{done} of {} done, {failed} failed, {pending} not done yet\n", table.rows.len());
    text += &format!("{}", results.display());
    let reasons: Map<_, _> = failures().map(|r| (r.name.clone(), json!(r.error))).collect();
    ui.answer(
        &json!({ "items": table.rows.len(), "done": done, "failed": failed, "pending": pending, "failures": reasons,
                 "results": results }),
        text,
    )?;
    Ok(if failed + pending == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Prints a line for each item that ends.
struct Lines<'a> {
    ui: &'a Ui,
    begun: Instant,
    todo: AtomicUsize,
    done: AtomicUsize,
}

impl Watch for Lines<'_> {
    fn begins(&self, plan: &Plan) {
        self.todo.store(plan.todo, Ordering::Relaxed);
        if plan.current > 0 {
            self.ui.note(format!("{} are up to date", plan.current));
        }
        self.ui.begin("batch", Some(plan.todo as u64));
    }

    fn finished(&self, entry: &Entry) {
        let done = 1 + self.done.fetch_add(1, Ordering::Relaxed);
        let todo = self.todo.load(Ordering::Relaxed);
        let left = self.begun.elapsed().as_secs_f64() / done as f64 * todo.saturating_sub(done) as f64;
        let left = duration(left);
        let row = &entry.row;
        self.ui.note(format!("[{done}/{todo}, {left} left] {}: {}, {:.1} s", row.name, found(row), entry.run.seconds));
        self.ui.at(done as u64, &format!("{left} left"));
    }

    fn busy(&self, name: &str, message: &str) {
        self.ui.note(format!("{name} comes later: {message}"));
    }
}

/// The part of this machine's memory that an item may take while others run, GB; none where the system does not tell.
fn share_of_memory(jobs: usize) -> Option<f64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kb: f64 = line.split_whitespace().next()?.parse().ok()?;
    Some(SHARE_OF_MEMORY * kb / f64::from(1 << 20) / jobs as f64)
}

/// What was found, in a few words.
fn found(row: &Row) -> String {
    if row.status == Status::Failed {
        return format!("failed: {}", row.error);
    }
    let mut words = Vec::new();
    match (row.mass_kg, row.mass_low_kg, row.mass_high_kg) {
        (Some(mass), Some(low), Some(high)) => {
            words.push(format!("{:.0} g ({:.0} to {:.0})", 1e3 * mass, 1e3 * low, 1e3 * high));
        }
        (Some(mass), ..) => words.push(format!("{:.0} g", 1e3 * mass)),
        _ => {}
    }
    if let Some(force) = row.grip_force_n {
        words.push(format!("grip {force:.1} N"));
    }
    match (row.held, row.trials) {
        (Some(held), Some(trials)) => words.push(format!("held {held} of {trials}")),
        _ if row.verdict == "none" => words.push("no grasp holds".into()),
        _ => {}
    }
    if words.is_empty() { "done".into() } else { words.join(", ") }
}

/// Seconds as a person says them.
fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 90.0 => format!("{s:.0} s"),
        s if s < 5400.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}
