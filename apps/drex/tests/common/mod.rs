//! Runs the built command line.
#![allow(dead_code, clippy::unwrap_used)] // a test helper: not every test uses all of it, and a panic is the report

use std::path::PathBuf;
use std::process::{Command, Output};

#[path = "../../../../crates/drex-twin/tests/support/mod.rs"]
mod support;

pub use support::*;

/// What a run of `drex` printed and how it ended.
pub struct Run {
    /// Exit status.
    pub code: i32,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

/// A heartbeat so long that a starved program keeps it.
pub const PATIENT: [&str; 2] = ["--heartbeat", "5000"];

/// Runs `drex` with these arguments.
pub fn drex<S: AsRef<std::ffi::OsStr>>(arguments: impl IntoIterator<Item = S>) -> Run {
    let output: Output =
        Command::new(env!("CARGO_BIN_EXE_drex")).args(arguments).env_remove("RUST_BACKTRACE").output().unwrap();
    Run {
        code: output.status.code().unwrap_or(-1),
        stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
        stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
    }
}

impl Run {
    /// The JSON object on stdout.
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|e| panic!("{e}: {}\n{}", self.stdout, self.stderr))
    }

    /// Asserts exit status 1 and that the message holds every one of `words`.
    pub fn fails_with(&self, words: &[&str]) {
        assert_eq!(self.code, 1, "stdout: {}\nstderr: {}", self.stdout, self.stderr);
        for word in words {
            assert!(self.stderr.contains(word), "`{word}` is missing in: {}", self.stderr);
        }
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
    }
}

/// Reference recordings, or a printed note that `test` is skipped.
pub fn shared_data(test: &str) -> Option<PathBuf> {
    let Some(root) = std::env::var_os("DREX_SHARED") else {
        eprintln!("skipped {test}: DREX_SHARED is not set");
        return None;
    };
    Some(PathBuf::from(root).join("data"))
}

/// A page without its scripts and what is embedded in base64.
pub fn text_of(html: &str) -> String {
    let mut text = String::new();
    for (i, part) in html.split("<script").enumerate() {
        text += if i == 0 { part } else { part.split_once("</script>").map_or("", |p| p.1) };
    }
    let mut told = String::new();
    for (i, part) in text.split(";base64,").enumerate() {
        told += if i == 0 { part } else { part.split_once('"').map_or("", |p| p.1) };
    }
    told
}
