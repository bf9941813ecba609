//! What a running stage tells whoever waits for it.

use std::ops::ControlFlow;
use std::sync::{Mutex, PoisonError};

/// Receives how far work is. All methods may be called from several threads.
///
/// The unit type hears nothing: `twin.run(&options, &())`.
pub trait Progress: Sync {
    /// Says something worth reading: what was done, skipped or assumed.
    fn note(&self, _text: &str) {}

    /// Work of `steps` steps begins, or of an unknown number of them. Work that was at hand before is done.
    fn begin(&self, _label: &str, _steps: Option<u64>) {}

    /// The work at hand is after step `done`; `message` says how it goes, or is empty.
    fn at(&self, _done: u64, _message: &str) {}

    /// One more step of the work at hand is done.
    fn step(&self) {}

    /// The work at hand is done.
    fn end(&self) {}

    /// So many stages of a run are behind it, of `total`.
    fn stages(&self, _done: usize, _total: usize) {}

    /// Whether to stop: asked before each stage and, in those that learn from trials, before each trial and epoch. The run then ends
    /// with [`Error::Stopped`](crate::Error::Stopped); what it has made stays, and another run goes on from there.
    fn is_stopped(&self) -> bool {
        false
    }
}

/// What [`Progress::is_stopped`] says, to loops that a callback ends.
pub(crate) fn flow(progress: &dyn Progress) -> ControlFlow<()> {
    if progress.is_stopped() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

impl Progress for () {}

/// Shows steps, each given by its stage's name, how many are done, and of how many, as work of these stages.
pub(crate) fn show_stages(progress: &dyn Progress) -> impl Fn(&'static str, usize, usize) + Sync + '_ {
    let shown = Mutex::new("");
    move |stage, done, total| {
        // A thread that panicked elsewhere left the name whole.
        let mut shown = shown.lock().unwrap_or_else(PoisonError::into_inner);
        if *shown != stage {
            *shown = stage;
            progress.begin(stage, Some(total as u64));
        }
        progress.at(done as u64, "");
    }
}
