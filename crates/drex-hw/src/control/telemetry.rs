//! What happened in each cycle, handed from the loop to whoever writes it down, without waiting and without allocating.

use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

use crate::{HandCommand, HandState};

/// One cycle.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sample {
    /// When the state was read, s since the first cycle.
    pub time_s: f64,
    /// How much later than planned the cycle began, s.
    pub late_s: f64,
    /// What the controller was doing.
    pub phase: &'static str,
    /// What was sent.
    pub command: HandCommand,
    /// What was read after it.
    pub state: HandState,
}

/// The loop's end: samples go round between the two ends, so that there are as many as there were at the beginning.
#[derive(Debug)]
pub struct Recorder {
    full: SyncSender<Sample>,
    empty: Receiver<Sample>,
    lost: u64,
}

/// The reader's end.
#[derive(Debug)]
pub struct Telemetry {
    full: Receiver<Sample>,
    empty: SyncSender<Sample>,
}

/// Telemetry for a hand of `joints` joints, with room for `cycles` cycles that nobody has read yet; later ones are lost until somebody does.
pub fn telemetry(joints: usize, cycles: usize) -> (Recorder, Telemetry) {
    let cycles = cycles.max(1);
    let (full_in, full_out) = sync_channel(cycles);
    let (empty_in, empty_out) = sync_channel(cycles);
    for _ in 0..cycles {
        let sample = Sample { command: HandCommand::new(joints), state: HandState::new(joints), ..Sample::default() };
        // There is room for all of them, and the other end is here.
        let _ = empty_in.try_send(sample);
    }
    (Recorder { full: full_in, empty: empty_out, lost: 0 }, Telemetry { full: full_out, empty: empty_in })
}

impl Recorder {
    /// Hands a cycle over, or counts it as lost if the reader is behind or gone.
    pub(super) fn record(&mut self, fill: impl FnOnce(&mut Sample)) {
        match self.empty.try_recv() {
            Ok(mut sample) => {
                fill(&mut sample);
                self.lost += u64::from(self.full.try_send(sample).is_err());
            }
            Err(_) => self.lost += 1,
        }
    }

    /// Cycles that found no room.
    pub(super) fn lost(&self) -> u64 {
        self.lost
    }
}

impl Telemetry {
    /// Shows the next cycle to `look`, and returns what it says; `Ok(None)` if none came within `wait`.
    ///
    /// # Errors
    /// [`std::sync::mpsc::RecvError`] when the loop has ended and all was read.
    pub fn next<T>(
        &mut self,
        wait: Duration,
        look: impl FnOnce(&Sample) -> T,
    ) -> Result<Option<T>, std::sync::mpsc::RecvError> {
        match self.full.recv_timeout(wait) {
            Ok(sample) => {
                let seen = look(&sample);
                // A loop that has ended needs no empty samples.
                let _ = self.empty.try_send(sample);
                Ok(Some(seen))
            }
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(std::sync::mpsc::RecvError),
        }
    }
}
