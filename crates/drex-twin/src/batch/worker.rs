//! A process for each item: none can take another one down, and none outlives the process that started it.
//!
//! The worker reads its [`Request`] as one line of JSON and answers with one. Its standard input stays open for as long as its parent lives:
//! when it ends, the worker ends its whole process group at once, programs that it started included. What it was writing is done again.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use drex_core::fsutil;
use serde::{Deserialize, Serialize};

use super::journal::{Entry, Journal};
use super::row::RunRecord;
use super::runner::{Request, Runner};
use crate::error::Context;
use crate::{Error, Progress, Result, RunOptions};

/// Most that a worker may answer, bytes.
const LONGEST_ANSWER: u64 = 1 << 22;

/// How a program begins its last words when it gets no more memory.
const NO_MEMORY: &str = "memory allocation of ";

/// Makes the command of a worker, a program that calls [`answer_request`] at once.
pub type Program<'a> = &'a (dyn Fn() -> Command + Sync);

/// What a run of a batch has to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct Plan {
    /// Number of items to be done.
    pub todo: usize,
    /// Number of items that are up to date.
    pub current: usize,
    /// Number of items that failed before and are not tried again.
    pub failed_before: usize,
}

/// Hears what becomes of items; called from several threads.
pub trait Watch: Sync {
    /// It is known what is to be done.
    fn begins(&self, _plan: &Plan) {}

    /// An item ended.
    fn finished(&self, entry: &Entry);

    /// Somebody else works on an item, which is tried again when the others have ended; `message` says who.
    fn busy(&self, _name: &str, _message: &str) {}
}

/// What a worker tells.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Reply {
    /// The item ended.
    Finished(Box<Entry>),
    /// Somebody else works on it.
    Busy(String),
}

/// Does the requests, so many at a time, and notes in the journal what becomes of each. Returns the names of those that somebody else was
/// working on to the end, and who.
pub(super) fn work(
    requests: &[Request],
    jobs: usize,
    program: Program<'_>,
    logs: &Path,
    journal: &Journal,
    watch: &dyn Watch,
) -> Result<Vec<(String, String)>> {
    let mut left = do_each(requests.iter().collect(), jobs, program, logs, journal, watch)?;
    if !left.is_empty() {
        left = do_each(left.into_iter().map(|(r, _)| r).collect(), jobs, program, logs, journal, watch)?;
    }
    Ok(left.into_iter().map(|(request, who)| (request.item.name.clone(), who)).collect())
}

/// Does the requests once, and returns those that somebody else works on, with who that is.
fn do_each<'a>(
    requests: VecDeque<&'a Request>,
    jobs: usize,
    program: Program<'_>,
    logs: &Path,
    journal: &Journal,
    watch: &dyn Watch,
) -> Result<Vec<(&'a Request, String)>> {
    let (queue, busy) = (Mutex::new(requests), Mutex::new(Vec::new()));
    let next = || queue.lock().unwrap_or_else(PoisonError::into_inner).pop_front();
    let do_one = |request: &'a Request| -> Result<()> {
        match in_a_process(request, program, logs)? {
            Reply::Finished(entry) => {
                journal.append(std::slice::from_ref(&entry))?;
                watch.finished(&entry);
            }
            Reply::Busy(message) => {
                watch.busy(&request.item.name, &message);
                busy.lock().unwrap_or_else(PoisonError::into_inner).push((request, message));
            }
        }
        Ok(())
    };
    let one_after_the_other = || -> Result<()> {
        while let Some(request) = next() {
            // What has failed here, such as a disk that is full, would fail for the others too: they are left.
            do_one(request).inspect_err(|_| queue.lock().unwrap_or_else(PoisonError::into_inner).clear())?;
        }
        Ok(())
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..jobs).map(|_| scope.spawn(one_after_the_other)).collect();
        let results = threads.into_iter().map(|thread| thread.join().unwrap_or_else(|p| std::panic::resume_unwind(p)));
        // All of them, so that no item is left half done by the failure of another thread.
        results.collect::<Vec<_>>().into_iter().collect::<Result<()>>()
    })?;
    Ok(busy.into_inner().unwrap_or_else(PoisonError::into_inner))
}

/// Does one request in a process of its own. A process that ends without an answer is an item that failed.
fn in_a_process(request: &Request, program: Program<'_>, logs: &Path) -> Result<Reply> {
    let begun = Instant::now();
    let log = fsutil::output_path(logs, &format!("{}.log", request.item.name))?;
    log.parent().map_or(Ok(()), std::fs::create_dir_all).with_context(|| format!("cannot make {}", logs.display()))?;
    let file = File::create(&log).with_context(|| format!("cannot write {}", log.display()))?;
    let mut command = program();
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(file);
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    let mut child = command.spawn().with_context(|| format!("cannot start {:?}", command.get_program()))?;
    let mut line = serde_json::to_vec(request).map_err(Error::json)?;
    line.push(b'\n');
    let mut life_line = child.stdin.take();
    // A worker that ends before it has read says why in its status.
    let _ = life_line.as_mut().map(|pipe| pipe.write_all(&line));
    let mut said = Vec::new();
    if let Some(out) = child.stdout.take() {
        let _ = out.take(LONGEST_ANSWER).read_to_end(&mut said);
    }
    let waited = child.wait();
    end_group(&child);
    drop(life_line);
    let status = waited.with_context(|| format!("cannot wait for the worker of {}", request.item.name))?;
    Ok(serde_json::from_slice(&said).unwrap_or_else(|_| {
        let entry = request.failed(&without_an_answer(status, request, &log));
        Reply::Finished(Box::new(Entry { run: RunRecord::ending_now(begun), ..entry }))
    }))
}

/// Ends whatever a worker left running.
#[cfg(unix)]
fn end_group(worker: &Child) {
    if let Some(group) = i32::try_from(worker.id()).ok().and_then(rustix::process::Pid::from_raw) {
        // Mostly there is nothing left.
        let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
    }
}

#[cfg(not(unix))]
fn end_group(_worker: &Child) {}

/// Why a worker gave no answer.
fn without_an_answer(status: ExitStatus, request: &Request, log: &Path) -> String {
    let said = std::fs::read_to_string(log).unwrap_or_default();
    let last = said.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or_default();
    match (request.max_memory_bytes, last.strip_prefix("error: ")) {
        (Some(limit), _) if said.contains(NO_MEMORY) => format!(
            "it takes more than {:.2} GB of memory, which is the limit of an item; raise it with --max-memory GB",
            limit as f64 / f64::from(1 << 30)
        ),
        (_, Some(reason)) => reason.to_owned(),
        _ => format!("its process ended without an answer ({status}) and said last: {last}"),
    }
}

/// Does the one request that standard input holds and prints its answer: all that a worker process does. The process ends with its parent.
///
/// # Errors
/// If there is no request on standard input, or the answer cannot be printed.
pub fn answer_request(options: RunOptions, progress: &dyn Progress) -> Result<()> {
    let mut input = BufReader::new(std::io::stdin());
    let mut line = String::new();
    input.read_line(&mut line).context("cannot read the request")?;
    let request: Request = serde_json::from_str(&line)
        .map_err(Error::json)
        .context("standard input holds no request, which `drex batch` writes: run that instead")?;
    std::thread::Builder::new().name("parent".into()).spawn(move || end_with_parent(input))?;
    limit_memory(&request);
    let reply = match Runner::new(options).run(&request, progress) {
        Ok(entry) => Reply::Finished(Box::new(entry)),
        Err(error @ Error::Busy { .. }) => Reply::Busy(error.to_string()),
        Err(error) => return Err(error),
    };
    let mut reply = serde_json::to_vec(&reply).map_err(Error::json)?;
    reply.push(b'\n');
    std::io::stdout().write_all(&reply).context("nobody hears the answer")
}

/// Has the system refuse this process more address space (`RLIMIT_AS`) than the request allows, where it has such a limit: whatever asks for
/// more then ends with a message.
#[cfg(unix)]
fn limit_memory(request: &Request) {
    if let Some(bytes) = request.max_memory_bytes {
        let limit = rustix::process::Rlimit { current: Some(bytes), maximum: Some(bytes) };
        // Where that is not possible, or less is allowed anyway, the item is done without.
        let _ = rustix::process::setrlimit(rustix::process::Resource::As, limit);
    }
}

#[cfg(not(unix))]
fn limit_memory(_request: &Request) {}

/// Waits until nobody holds the other end, then ends this process and all that it started.
fn end_with_parent(mut input: impl Read) {
    let mut byte = [0];
    while input.read(&mut byte).is_ok_and(|read| read > 0) {}
    #[cfg(unix)]
    let _ = rustix::process::kill_current_process_group(rustix::process::Signal::KILL);
    std::process::exit(1);
}
