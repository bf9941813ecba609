//! Other programs, run to their end or to a time limit.

use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

/// How often it is looked whether the program has ended.
const LOOK_EVERY: Duration = Duration::from_millis(10);
/// A process that the program started may hold its output open; more lines are not waited for longer than this.
const PATIENCE: Duration = Duration::from_secs(1);
/// Bytes after which a line is cut: a program that ends no line may print for hours.
const LONGEST_LINE: u64 = 1 << 16;

/// Lines that may wait for `on_line`; a program that prints faster is held up.
const WAITING_LINES: usize = 1024;

/// How a program ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// By itself.
    Ended(ExitStatus),
    /// It was killed at the time limit.
    TimedOut,
}

/// Runs `command` for at most `limit`, gives it `input` (else nothing) on its standard input, and hands each line of the
/// outputs that `command` has piped to `on_line`; lines end with a newline or, in progress bars, a carriage return.
///
/// # Errors
/// If the program cannot be started or waited for.
pub fn run(
    mut command: Command,
    input: Option<&str>,
    limit: Duration,
    on_line: &mut dyn FnMut(&str),
) -> std::io::Result<Outcome> {
    let begun = Instant::now();
    let mut child = command.stdin(if input.is_some() { Stdio::piped() } else { Stdio::null() }).spawn()?;
    if let (Some(mut pipe), Some(text)) = (child.stdin.take(), input.map(str::to_owned)) {
        // A program that does not read its input ends early: then writing fails, and its status says why.
        std::thread::spawn(move || pipe.write_all(text.as_bytes()));
    }
    let (sender, lines) = mpsc::sync_channel(WAITING_LINES);
    let pipes: [Option<Box<dyn Read + Send>>; 2] =
        [child.stdout.take().map(|p| Box::new(p) as _), child.stderr.take().map(|p| Box::new(p) as _)];
    // A full pipe would stop the program. Nobody waits for these threads, as a pipe may stay open for ever.
    for pipe in pipes.into_iter().flatten() {
        let sender = sender.clone();
        std::thread::spawn(move || send_lines(pipe, &sender));
    }
    drop(sender);
    let outcome = loop {
        match lines.recv_timeout(LOOK_EVERY) {
            Ok(line) => on_line(&line),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => std::thread::sleep(LOOK_EVERY),
        }
        if let Some(status) = child.try_wait()? {
            break Outcome::Ended(status);
        }
        if begun.elapsed() >= limit {
            // It may have ended by itself just now: then there is nothing to kill.
            let _ = child.kill();
            child.wait()?;
            break Outcome::TimedOut;
        }
    };
    let until = Instant::now() + PATIENCE;
    while let Some(left) = until.checked_duration_since(Instant::now())
        && let Ok(line) = lines.recv_timeout(left)
    {
        on_line(&line);
    }
    Ok(outcome)
}

fn send_lines(pipe: Box<dyn Read + Send>, to: &mpsc::SyncSender<String>) {
    let mut reader = BufReader::new(pipe);
    let mut bytes = Vec::new();
    while let Ok(1..) = reader.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut bytes) {
        for line in String::from_utf8_lossy(&bytes).split(['\n', '\r']).filter(|l| !l.trim().is_empty()) {
            if to.send(line.to_owned()).is_err() {
                return; // nobody listens any more
            }
        }
        bytes.clear();
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    fn shell(script: &str, limit_s: f64) -> (Outcome, Vec<String>, Duration) {
        let mut command = Command::new("sh");
        command.args(["-c", script]).stdout(Stdio::piped()).stderr(Stdio::piped());
        let (begun, mut lines) = (Instant::now(), Vec::new());
        let limit = Duration::from_secs_f64(limit_s);
        let outcome = run(command, Some("given"), limit, &mut |line| lines.push(line.to_owned())).expect("starts");
        (outcome, lines, begun.elapsed())
    }

    #[test]
    fn lines_and_the_status_arrive() {
        let (outcome, mut lines, _) = shell("cat; echo; printf 'a\\rb\\n' >&2; exit 3", 60.0);
        lines.sort();
        assert_eq!(lines, ["a", "b", "given"]);
        assert!(matches!(outcome, Outcome::Ended(status) if status.code() == Some(3)), "{outcome:?}");
    }

    #[test]
    fn whatever_does_not_end_is_ended() {
        // Silent, talking for ever, with its outputs closed, with a child that holds them open.
        for script in ["exec sleep 600", "while :; do echo x; done", "exec >&- 2>&-; exec sleep 600", "sleep 30; :"] {
            let (outcome, _, took) = shell(script, 0.3);
            assert_eq!(outcome, Outcome::TimedOut, "{script}");
            assert!(took < Duration::from_secs(20), "{script}: {took:?}");
        }
        // What ended left a child that holds the pipes.
        let (outcome, lines, took) = shell("sleep 30 & echo done", 600.0);
        assert!(matches!(outcome, Outcome::Ended(status) if status.success()) && lines == ["done"], "{outcome:?}");
        assert!(took < Duration::from_secs(20), "{took:?}");
    }
}
