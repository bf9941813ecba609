//! The loop on a thread of its own.

use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use super::cycle::run_published;
use super::{ControlOptions, Controller, EStop, LoopReport, LoopStats, StopReason};
use crate::{Clock, Error, Hand, HandState, Result, SystemClock};

/// A loop that runs on its own thread; dropping it stops it and waits until the torque is off.
pub struct ControlLoop<H, B> {
    estop: EStop,
    cancel: EStop,
    published: Arc<Mutex<LoopStats>>,
    thread: Option<JoinHandle<(H, B, LoopReport)>>,
}

impl<H: Hand + 'static, B: Controller + 'static> ControlLoop<H, B> {
    /// Starts the loop.
    ///
    /// # Errors
    /// [`Error::Thread`] if the system gives no thread; the hand is then dropped.
    pub fn start(hand: H, controller: B, options: ControlOptions) -> Result<Self> {
        Self::start_with_clock(hand, controller, options, SystemClock::default())
    }

    /// The same with another clock, such as an emulator's.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn start_with_clock(
        mut hand: H,
        mut controller: B,
        options: ControlOptions,
        clock: impl Clock + 'static,
    ) -> Result<Self> {
        let (estop, cancel) = (options.estop.clone(), options.cancel.clone());
        let published = Arc::new(Mutex::new(LoopStats::default()));
        let seen = published.clone();
        let work = move || {
            let report = run_published(&mut hand, &mut controller, &clock, options, &seen);
            (hand, controller, report)
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

    /// Waits until it has ended; the hand and the controller come back, unless what panicked was beyond saving.
    pub fn wait(mut self) -> (Option<(H, B)>, LoopReport) {
        let joined = self.thread.take().map(JoinHandle::join);
        match joined {
            Some(Ok((hand, controller, report))) => (Some((hand, controller)), report),
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
        stop_reason: StopReason::Panicked("the thread of the loop".into()),
        torque_off: Err(Error::value("nobody knows whether the torque is off", "switch the hand's power off")),
        off_took: Duration::ZERO,
        stats: LoopStats::default(),
        unrecorded: 0,
        state: HandState::default(),
        faults: Vec::new(),
    }
}
