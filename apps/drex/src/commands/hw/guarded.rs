//! A hand behind a guard, and the guard itself: this program, started once more.

use std::path::Path;

use anyhow::Result;

use super::{Driver, Setup};
use crate::cli::GuardArgs;

/// Cycles that a program may be silent for, where that is longer than the usual heartbeat.
#[cfg(unix)]
const CYCLES: f64 = 3.0;

impl Driver {
    /// Connects a hand that is set up as `setup` says behind a guard that expects a sign of life within three of `rate_hz` cycles per
    /// second, 40 ms at least.
    ///
    /// # Errors
    /// As [`Driver::with`], and if the guard cannot be started.
    #[cfg(unix)]
    pub fn guarded(setup: &Setup, port: &Path, guard: &GuardArgs, rate_hz: f64) -> Result<Self> {
        use std::time::Duration;

        use drex_hw::can::Slcan;
        use drex_hw::guard::{GuardOptions, GuardedPort, SwitchOff};

        use crate::cli::HandArg;

        if guard.no_guard {
            return Self::with(setup, port);
        }
        let options = GuardOptions::this_program(["hw", "guard"])?;
        let options = match guard.heartbeat {
            Some(ms) => options.with_heartbeat(Duration::try_from_secs_f64(1e-3 * ms)?),
            None => {
                let cycles = Duration::try_from_secs_f64(CYCLES / rate_hz)?;
                let heartbeat = options.heartbeat.max(cycles);
                options.with_heartbeat(heartbeat)
            }
        };
        match setup.hand {
            HandArg::Leap => {
                let off = SwitchOff::leap(&setup.leap);
                Self::over_serial(setup, Box::new(GuardedPort::open(port, setup.leap.baud, off, &options)?))
            }
            HandArg::Allegro => {
                Self::over_can(setup, Box::new(Slcan::open_guarded(port, setup.allegro.version, &options)?))
            }
        }
    }

    /// There are no guards on this system.
    #[cfg(not(unix))]
    pub fn guarded(setup: &Setup, port: &Path, guard: &GuardArgs, _: f64) -> Result<Self> {
        if !guard.no_guard {
            anyhow::bail!("there is no guard on this system: give --no-guard");
        }
        Self::with(setup, port)
    }
}

/// Is the guard of the program at the standard input.
pub fn serve() -> Result<()> {
    #[cfg(unix)]
    return Ok(drex_hw::guard::serve()?);
    #[cfg(not(unix))]
    anyhow::bail!("there is no guard on this system");
}
