//! Which program is the guard, and how patient it is.

use std::ffi::OsString;
use std::path::PathBuf;
use std::time::Duration;

use crate::{Error, Result};

/// Which program is the guard, and how patient it is.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct GuardOptions {
    /// The program that calls [`serve`](super::serve).
    pub program: PathBuf,
    /// What it is told on its command line.
    pub arguments: Vec<OsString>,
    /// Silence of a program with torque on after which the guard takes the torque off, and of a guard after which the program does.
    /// Every packet, and every wait for an answer, counts as a sign of life.
    pub heartbeat: Duration,
    /// How long the guard goes on trying to switch off a hand that cannot be reached or does not confirm it.
    pub patience: Duration,
}

impl Default for GuardOptions {
    /// `drex hw guard`, which has to be on the path.
    fn default() -> Self {
        Self::new("drex", ["hw", "guard"])
    }
}

impl GuardOptions {
    /// A guard by this program and arguments: 40 ms of silence, 10 s of patience.
    pub fn new<A: Into<OsString>>(program: impl Into<PathBuf>, arguments: impl IntoIterator<Item = A>) -> Self {
        Self {
            program: program.into(),
            arguments: arguments.into_iter().map(Into::into).collect(),
            heartbeat: Duration::from_millis(40),
            patience: Duration::from_secs(10),
        }
    }

    /// A guard by the running program itself, started anew with these arguments.
    ///
    /// # Errors
    /// [`Error::Guard`] if the system does not say which program is running.
    pub fn this_program<A: Into<OsString>>(arguments: impl IntoIterator<Item = A>) -> Result<Self> {
        let program = std::env::current_exe().map_err(|e| Error::Guard {
            what: format!("this program does not know its own file: {e}"),
            remedy: "name the program that is the guard".into(),
        })?;
        Ok(Self::new(program, arguments))
    }

    /// The same with another silence after which torque goes off, 10 ms to 10 s.
    pub fn with_heartbeat(mut self, silence: Duration) -> Self {
        self.heartbeat = silence;
        self
    }

    /// The same with another time for which an unreachable hand is tried, up to 10 minutes.
    pub fn with_patience(mut self, patience: Duration) -> Self {
        self.patience = patience;
        self
    }

    pub(super) fn check(&self) -> Result<()> {
        let (heartbeat, patience) = (self.heartbeat, self.patience);
        if !(Duration::from_millis(10)..=Duration::from_secs(10)).contains(&heartbeat) {
            return Err(Error::value(format!("a heartbeat of {} ms", heartbeat.as_millis()), "give 10 ms to 10 s"));
        }
        if patience > Duration::from_secs(600) {
            return Err(Error::value(format!("a guard that tries for {} s", patience.as_secs()), "give at most 600 s"));
        }
        Ok(())
    }
}
