//! What a command may take of the machine: memory and time, watched while it runs.

use std::time::{Duration, Instant};

use drex_core::budget;

use crate::cli::{BatchCommand, Command, Common};
use crate::commands::asset::is_scan;
use crate::ui::Ui;

/// How often memory and time are looked at.
const PERIOD: Duration = Duration::from_millis(20);
/// What a command that reads and judges one file may take, s.
const SECONDS_OF_ONE_FILE: f64 = 60.0;

/// Limits of one command; `None` is not watched.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Limits {
    bytes: Option<u64>,
    seconds: Option<f64>,
}

impl Limits {
    fn of(command: &Command, common: &Common) -> Self {
        let bytes = common.max_memory.map(|gb| (gb * f64::from(1 << 30)) as u64);
        let usual = Some(budget::DEFAULT_MAX_MEMORY);
        match command {
            // Nothing may end the program that moves a hand.
            Command::Hw(_) | Command::Deploy(_) => Self { bytes: None, seconds: None },
            // Its limits are those of each item, whose memory the system itself limits.
            Command::Batch(args) if matches!(args.command, Some(BatchCommand::Item)) => {
                Self { bytes: None, seconds: common.max_seconds }
            }
            Command::Batch(_) => Self { bytes: None, seconds: None },
            // They train or simulate for as long as is asked for, with what they need.
            Command::Sfm(_)
            | Command::Masks(_)
            | Command::Reconstruct(_)
            | Command::Train(_)
            | Command::Evaluate(_)
            | Command::Run(_)
            | Command::Report(_)
            | Command::Demo(_) => Self { bytes, seconds: common.max_seconds },
            // The asset of photos is trained.
            Command::Asset(args) if is_scan(&args.input) => Self { bytes, seconds: common.max_seconds },
            Command::Mesh(_) => {
                Self { bytes: bytes.or(usual), seconds: common.max_seconds.or(Some(SECONDS_OF_ONE_FILE)) }
            }
            _ => Self { bytes: bytes.or(usual), seconds: common.max_seconds },
        }
    }
}

/// Sets the limit of the readers, and starts a thread that ends the command with a message when it exceeds its own: whatever
/// a file makes of it, it answers or refuses. Memory is watched where `/proc` tells it.
///
/// # Errors
/// If the thread cannot be started.
pub fn watch(command: &Command, common: &Common, ui: &Ui) -> std::io::Result<()> {
    let limits = Limits::of(command, common);
    if let Some(gb) = common.max_memory {
        budget::set_max_memory((gb * f64::from(1 << 30)) as u64);
    }
    if limits == (Limits { bytes: None, seconds: None }) {
        return Ok(());
    }
    let (begin, ui) = (Instant::now(), ui.clone());
    let look = move || {
        loop {
            std::thread::sleep(PERIOD);
            let seconds = begin.elapsed().as_secs_f64();
            if let Some(reason) = exceeded(&limits, resident_bytes(), seconds) {
                ui.failed(&anyhow::anyhow!(reason));
                std::process::exit(1);
            }
        }
    };
    std::thread::Builder::new().name("limits".into()).spawn(look).map(drop)
}

/// Why the command must end, if it must.
fn exceeded(limits: &Limits, resident: Option<u64>, seconds: f64) -> Option<String> {
    let gb = |bytes: u64| bytes as f64 / f64::from(1 << 30);
    // How much more differs from run to run.
    if let Some(limit) = limits.bytes.filter(|&limit| resident.is_some_and(|bytes| bytes > limit)) {
        return Some(format!(
            "the command takes more than {:.2} GB of memory, which is its limit; give smaller files, or raise it with --max-memory GB",
            gb(limit)
        ));
    }
    let limit = limits.seconds.filter(|&l| seconds > l)?;
    Some(format!(
        "the command has taken {limit} s, which is its limit; give smaller files, or raise it with --max-seconds S"
    ))
}

/// Memory of this process that is in use, bytes; `None` where the system does not tell.
fn resident_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"))?;
    line.split_ascii_whitespace().next()?.parse::<u64>().ok().map(|kb| kb * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exceeding_a_limit_names_the_limit_and_the_option() {
        let limits = Limits { bytes: Some(1 << 30), seconds: Some(5.0) };
        assert_eq!(exceeded(&limits, Some(1 << 29), 4.9), None);
        assert_eq!(exceeded(&Limits { bytes: None, seconds: None }, Some(u64::MAX), 1e9), None);
        assert_eq!(exceeded(&limits, None, 4.9), None, "memory that is not known");
        let memory = exceeded(&limits, Some(3 << 29), 0.0).unwrap();
        assert!(memory.contains("1.00 GB") && memory.contains("--max-memory"), "{memory}");
        let time = exceeded(&limits, Some(0), 5.1).unwrap();
        assert!(time.contains("5 s") && time.contains("--max-seconds"), "{time}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_memory_of_this_process_is_known() {
        let bytes = resident_bytes().unwrap();
        assert!((1 << 20..1 << 36).contains(&bytes), "{bytes}");
    }
}
