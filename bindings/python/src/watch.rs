//! Long work beside the interpreter: other Python threads run on, Ctrl-C is heard, progress is told.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use pyo3::prelude::*;

use crate::failure::{Result, refused};

/// How often signals are looked at.
const TICK: Duration = Duration::from_millis(30);
/// As much as a main thread has.
pub(crate) const STACK_BYTES: usize = 8 << 20;

/// What the work and the call that waits for it say to each other.
#[derive(Debug, Default)]
struct Shared {
    part: AtomicU64,
    notes: Mutex<Vec<String>>,
    stopped: AtomicBool,
}

/// How far the work is, and whether it is to go on.
#[derive(Debug, Clone, Default)]
pub(crate) struct Part(Arc<Shared>);

impl Part {
    /// Sets which part of the work is done, from 0 to 1; it never falls.
    pub(crate) fn set(&self, part: f64) {
        // Numbers that are not negative have the order of their bits.
        self.0.part.fetch_max(part.max(0.0).to_bits(), Ordering::Relaxed);
    }

    /// Says something worth reading.
    pub(crate) fn note(&self, text: &str) {
        self.0.notes.lock().unwrap_or_else(PoisonError::into_inner).push(text.to_owned());
    }

    /// Whether nobody waits any more.
    pub(crate) fn is_stopped(&self) -> bool {
        self.0.stopped.load(Ordering::Relaxed)
    }

    /// The same for loops that a callback ends.
    pub(crate) fn flow(&self) -> ControlFlow<()> {
        if self.is_stopped() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn get(&self) -> f64 {
        f64::from_bits(self.0.part.load(Ordering::Relaxed))
    }

    fn notes(&self) -> Vec<String> {
        std::mem::take(&mut *self.0.notes.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Stops the work when the call that waits for it ends.
struct Stop(Part);

impl Drop for Stop {
    fn drop(&mut self) {
        self.0.0.stopped.store(true, Ordering::Relaxed);
    }
}

/// Does `work` in a thread of its own while this one hears signals and calls `progress` with the part that is done.
///
/// An exception in between (`KeyboardInterrupt`, or one of `progress`) ends the call at once, and stops work that asks the [`Part`].
/// Other work cannot be stopped half way: its thread goes on to its end, and its result is dropped.
pub(crate) fn watched<T, W>(py: Python<'_>, progress: Option<&Bound<'_, PyAny>>, work: W) -> Result<T>
where
    T: Send + 'static,
    W: FnOnce(&Part) -> Result<T> + Send + 'static,
{
    watched_with_notes(py, progress, None, work)
}

/// [`watched`], which calls `note` with what the work says.
pub(crate) fn watched_with_notes<T, W>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    note: Option<&Bound<'_, PyAny>>,
    work: W,
) -> Result<T>
where
    T: Send + 'static,
    W: FnOnce(&Part) -> Result<T> + Send + 'static,
{
    let part = Part::default();
    let own = part.clone();
    let _stop = Stop(part.clone());
    let (send, mut receive) = channel();
    let thread = std::thread::Builder::new().name("drex".into()).stack_size(STACK_BYTES);
    let worker = match thread.spawn(move || {
        // Nobody receives any more where the call was interrupted.
        let _ = send.send(work(&own));
    }) {
        Ok(worker) => worker,
        Err(error) => return refused(format!("no thread could be started: {error}; close other programs")),
    };
    let mut last = None;
    loop {
        let answer;
        (receive, answer) = py.detach(move || {
            let answer = receive.recv_timeout(TICK);
            (receive, answer)
        });
        py.check_signals()?;
        if let Some(note) = note {
            part.notes().into_iter().try_for_each(|text| note.call1((text,)).map(drop))?;
        }
        if let Some(progress) = progress {
            let now = part.get();
            if last != Some(now) {
                progress.call1((now,))?;
                last = Some(now);
            }
        }
        match answer {
            Ok(result) => return result,
            Err(RecvTimeoutError::Timeout) => {}
            // The thread ended without a word: it panicked, and the panic becomes a PanicException.
            Err(RecvTimeoutError::Disconnected) => match worker.join() {
                Err(panic) => std::panic::resume_unwind(panic),
                Ok(()) => return refused("the work ended without an answer; report this"),
            },
        }
    }
}
