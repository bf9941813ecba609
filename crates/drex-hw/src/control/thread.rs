//! The loop on a thread of its own.

use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use super::cycle::run_published;
use super::{Behaviour, ControlOptions, EStop, Ended, LoopReport, LoopStats};
use crate::{Clock, Error, Hand, HandState, Result, SystemClock};

/// A loop that runs on its own thread; dropping it stops it and waits until the torque is off.
pub struct ControlLoop<H, B> {
    estop: EStop,
    cancel: EStop,
    published: Arc<Mutex<LoopStats>>,
    thread: Option<JoinHandle<(H, B, LoopReport)>>,
}

impl<H: Hand + 'static, B: Behaviour + 'static> ControlLoop<H, B> {
    /// Starts the loop.
    ///
    /// # Errors
    /// [`Error::Thread`] if the system gives no thread; the hand is then dropped.
    pub fn start(hand: H, behaviour: B, options: ControlOptions) -> Result<Self> {
        Self::start_with_clock(hand, behaviour, options, SystemClock::default())
    }

    /// The same with another clock, such as an emulator's.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn start_with_clock(
        mut hand: H,
        mut behaviour: B,
        options: ControlOptions,
        clock: impl Clock + 'static,
    ) -> Result<Self> {
        let (estop, cancel) = (options.estop.clone(), options.cancel.clone());
        let published = Arc::new(Mutex::new(LoopStats::default()));
        let seen = published.clone();
        let work = move || {
            let report = run_published(&mut hand, &mut behaviour, &clock, options, &seen);
            (hand, behaviour, report)
        };
        let thread = std::thread::Builder::new().name("drex-control".into()).spawn(work).map_err(Error::Thread)?;
        Ok(Self { estop, cancel, published, thread: Some(thread) })
    }

    /// The emergency stop of this loop, and of all that were given the same.
    pub fn estop(&self) -> EStop {
        self.estop.clone()
    }

    /// Whether it still runs.
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|t| !t.is_finished())
    }

    /// Timing so far, as of some cycles ago.
    pub fn stats(&self) -> LoopStats {
        *self.published.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until it has ended; the hand and the behaviour come back, unless what panicked was beyond saving.
    pub fn wait(mut self) -> (Option<(H, B)>, LoopReport) {
        let joined = self.thread.take().map(JoinHandle::join);
        match joined {
            Some(Ok((hand, behaviour, report))) => (Some((hand, behaviour)), report),
            _ => (None, lost_report()),
        }
    }
}

impl<H, B> Drop for ControlLoop<H, B> {
    fn drop(&mut self) {
        self.cancel.stop();
        if let Some(thread) = self.thread.take() {
            // The loop itself does not panic; a hand that panics while it is dropped has told so on stderr.
            let _ = thread.join();
        }
    }
}

/// For a thread that ended without a report: the hand panicked outside of its cycle.
fn lost_report() -> LoopReport {
    LoopReport {
        ended: Ended::Panicked("the thread of the loop".into()),
        torque_off: Err(Error::value("nobody knows whether the torque is off", "switch the hand's power off")),
        off_took: Duration::ZERO,
        stats: LoopStats::default(),
        unrecorded: 0,
        state: HandState::default(),
        troubles: Vec::new(),
    }
}
