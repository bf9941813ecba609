//! The emergency stop.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Stops a loop, from any thread, within one cycle: torque off, and no way back but a new loop. Clones are the same button.
#[derive(Debug, Clone, Default)]
pub struct EStop(Arc<AtomicBool>);

impl EStop {
    /// A button that nobody has pressed.
    pub fn new() -> Self {
        Self::default()
    }

    /// Presses it.
    pub fn stop(&self) {
        self.0.store(true, Ordering::Release);
    }

    /// Whether somebody pressed it.
    pub fn is_stopped(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

/// Lets SIGINT (Ctrl-C), SIGTERM, SIGHUP (a closed terminal, a dropped ssh) and SIGQUIT (Ctrl-\) press `estop`, instead of ending the
/// program with the torque on.
///
/// # Errors
/// [`crate::Error::Signals`] if the system refuses.
#[cfg(unix)]
pub fn stop_on_signals(estop: &EStop) -> crate::Result<()> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};
    for signal in [SIGINT, SIGTERM, SIGHUP, SIGQUIT] {
        signal_hook::flag::register(signal, estop.0.clone()).map_err(crate::Error::Signals)?;
    }
    Ok(())
}
