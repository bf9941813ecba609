//! What a program is told whose torque somebody else has taken off.

use std::time::{Duration, SystemTime};

/// The torque was taken off for the program, by the guard or because the guard had died. The port is of no more use.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{why}: {how}, {:.1} s ago; connect again", .since.elapsed().unwrap_or_default().as_secs_f64())]
pub struct TakenOver {
    why: String,
    how: String,
    confirmed: bool,
    since: SystemTime,
}

impl TakenOver {
    pub(crate) fn new(why: String, how: String, confirmed: bool, since: SystemTime) -> Self {
        Self { why, how, confirmed, since }
    }

    /// How long ago the torque was taken off, by the clock of the system.
    pub fn age(&self) -> Duration {
        self.since.elapsed().unwrap_or_default()
    }
}
