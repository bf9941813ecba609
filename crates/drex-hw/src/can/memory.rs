//! Two ends of a bus in memory.

use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use super::{CanBus, CanFrame};
use crate::{Error, Result};

/// Frames that wait to be received; more are lost, as on an adapter that nobody reads.
const QUEUE: usize = 1024;

/// One end of a bus in memory.
#[derive(Debug)]
pub struct MemoryCan {
    to: SyncSender<CanFrame>,
    from: Receiver<CanFrame>,
}

impl MemoryCan {
    /// Two ends that hear each other.
    pub fn pair() -> (Self, Self) {
        let (to_b, from_a) = sync_channel(QUEUE);
        let (to_a, from_b) = sync_channel(QUEUE);
        (Self { to: to_b, from: from_b }, Self { to: to_a, from: from_a })
    }

    fn gone(&self) -> Error {
        Error::Port {
            port: self.name().into(),
            source: io::ErrorKind::BrokenPipe.into(),
            remedy: "keep the other end".into(),
        }
    }
}

impl CanBus for MemoryCan {
    fn name(&self) -> &str {
        "memory"
    }

    fn send(&mut self, frame: &CanFrame) -> Result<()> {
        match self.to.try_send(*frame) {
            Ok(()) | Err(TrySendError::Full(_)) => Ok(()),
            Err(TrySendError::Disconnected(_)) => Err(self.gone()),
        }
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<CanFrame>> {
        match self.from.recv_timeout(timeout) {
            Ok(frame) => Ok(Some(frame)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(self.gone()),
        }
    }
}
