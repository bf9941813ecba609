//! Long work beside the interpreter: other Python threads run on, Ctrl-C is heard, progress is told.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use pyo3::prelude::*;

use crate::failure::{Result, refused};

/// How often signals are looked at.
const TICK: Duration = Duration::from_millis(30);
/// As much as a main thread has.
const STACK_BYTES: usize = 8 << 20;

/// Which part of the work is done, from 0 to 1.
#[derive(Debug, Clone, Default)]
pub(crate) struct Part(Arc<AtomicU64>);

impl Part {
    /// Sets it.
    pub(crate) fn set(&self, part: f64) {
        self.0.store(part.to_bits(), Ordering::Relaxed);
    }

    fn get(&self) -> f64 {
        f64::from_bits(self.0.load(Ordering::Relaxed))
    }
}

/// Does `work` in a thread of its own while this one hears signals and calls `progress` with the part that is done.
///
/// An exception in between (`KeyboardInterrupt`, or one of `progress`) ends the call at once. The libraries cannot be stopped
/// half way: their thread goes on to its end, and its result is dropped.
pub(crate) fn watched<T, W>(py: Python<'_>, progress: Option<&Bound<'_, PyAny>>, work: W) -> Result<T>
where
    T: Send + 'static,
    W: FnOnce(&Part) -> Result<T> + Send + 'static,
{
    let part = Part::default();
    let told = part.clone();
    let (send, mut receive) = channel();
    let thread = std::thread::Builder::new().name("drex".into()).stack_size(STACK_BYTES);
    let worker = match thread.spawn(move || {
        // Nobody receives any more where the call was interrupted.
        let _ = send.send(work(&told));
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
