//! Time, as the drivers see it: the system's, or that of an emulator.

use std::time::{Duration, Instant};

/// A clock that never goes back.
pub trait Clock: Send {
    /// Time since some moment in the past.
    fn now(&self) -> Duration;

    /// Waits until this clock shows `then`; at once if it is past.
    fn wait_until(&self, then: Duration) {
        std::thread::sleep(then.saturating_sub(self.now()));
    }
}

/// The system's clock, from the moment it was made.
#[derive(Debug, Clone, Copy)]
pub struct SystemClock(Instant);

impl Default for SystemClock {
    fn default() -> Self {
        Self(Instant::now())
    }
}

impl Clock for SystemClock {
    fn now(&self) -> Duration {
        self.0.elapsed()
    }
}

impl<C: Clock + ?Sized> Clock for Box<C> {
    fn now(&self) -> Duration {
        (**self).now()
    }

    fn wait_until(&self, then: Duration) {
        (**self).wait_until(then);
    }
}
