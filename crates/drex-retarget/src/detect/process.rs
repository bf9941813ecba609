//! Running a command with a time limit.

use std::ffi::{OsStr, OsString};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How a command ended.
pub(super) enum Outcome {
    Done,
    /// Its status; none if a signal ended it.
    Failed(Option<i32>),
    NotStarted(std::io::Error),
    TimedOut,
}

/// Messages beyond this are not kept.
const MOST_MESSAGES: usize = 1 << 20;
/// A process started by the command may hold its messages open; they are not waited for longer than this.
const PATIENCE: Duration = Duration::from_secs(1);

/// Runs `program`, gives it `stdin`, and returns how it ended and what it said on standard error.
pub(super) fn run(program: &OsStr, args: &[OsString], stdin: Option<&str>, timeout: Duration) -> (Outcome, String) {
    let input = if stdin.is_some() { Stdio::piped() } else { Stdio::null() };
    let spawned = Command::new(program).args(args).stdin(input).stdout(Stdio::null()).stderr(Stdio::piped()).spawn();
    let mut child = match spawned {
        Ok(child) => child,
        Err(e) => return (Outcome::NotStarted(e), String::new()),
    };
    let messages = Arc::new(Mutex::new(Vec::new()));
    // A full pipe would stop the command: its messages are read while it runs.
    let reader = child.stderr.take().map(|mut stderr| {
        let messages = Arc::clone(&messages);
        std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(n @ 1..) = stderr.read(&mut buffer) {
                let mut all = messages.lock().unwrap_or_else(PoisonError::into_inner);
                if all.len() < MOST_MESSAGES {
                    all.extend_from_slice(&buffer[..n]);
                }
            }
        })
    });
    if let (Some(mut pipe), Some(text)) = (child.stdin.take(), stdin.map(str::to_owned)) {
        // A command that does not read its input ends early: then writing fails, and its status says why.
        std::thread::spawn(move || pipe.write_all(text.as_bytes()));
    }
    let outcome = wait(&mut child, timeout);
    if let Some(reader) = reader {
        let started = Instant::now();
        while !reader.is_finished() && started.elapsed() < PATIENCE {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
    let text = String::from_utf8_lossy(&messages.lock().unwrap_or_else(PoisonError::into_inner)).into_owned();
    (outcome, text)
}

fn wait(child: &mut Child, timeout: Duration) -> Outcome {
    let started = Instant::now();
    loop {
        match child.try_wait() {
            Ok(Some(status)) if status.success() => return Outcome::Done,
            Ok(Some(status)) => return Outcome::Failed(status.code()),
            Ok(None) if started.elapsed() < timeout => std::thread::sleep(Duration::from_millis(10)),
            Ok(None) => {
                // It may have ended by itself just now: then there is nothing to kill.
                let _ = child.kill();
                let _ = child.wait();
                return Outcome::TimedOut;
            }
            Err(e) => return Outcome::NotStarted(e),
        }
    }
}

/// A new folder that is removed with its value.
pub(super) struct TemporaryFolder(PathBuf);

impl TemporaryFolder {
    pub(super) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        // Nothing depends on it being gone.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Makes a folder of its own among the system's temporary files.
pub(super) fn temporary_folder() -> std::io::Result<TemporaryFolder> {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    loop {
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("drex-hands-{}-{number}", std::process::id()));
        match std::fs::create_dir(&path) {
            Ok(()) => return Ok(TemporaryFolder(path)),
            // Left over from a process of the same number.
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(e) => return Err(e),
        }
    }
}
