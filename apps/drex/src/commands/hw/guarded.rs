//! A hand behind a guard, and the guard itself: this program, started once more.

use std::path::Path;

use anyhow::Result;

use super::Driver;
use crate::cli::{GuardArgs, HandArg, LinkArgs};

/// Cycles that a program may be silent for, where that is longer than the usual heartbeat.
#[cfg(unix)]
const CYCLES: f64 = 3.0;

impl Driver {
    /// Connects a hand behind a guard that expects a sign of life within three of `rate_hz` cycles per second, 40 ms at least.
    ///
    /// # Errors
    /// As [`Driver::open`], and if the guard cannot be started.
    #[cfg(unix)]
    pub fn open_guarded(hand: HandArg, port: &Path, link: &LinkArgs, guard: &GuardArgs, rate_hz: f64) -> Result<Self> {
        use std::time::Duration;

        use drex_hw::allegro::AllegroHand;
        use drex_hw::can::{CanBus, Slcan};
        use drex_hw::dynamixel::Port;
        use drex_hw::guard::{GuardOptions, GuardedPort, SwitchOff};
        use drex_hw::leap::LeapHand;
        use drex_robot::Robot;

        use super::{allegro_options, is_interface, leap_options, version};

        if guard.no_guard {
            return Self::open(hand, port, link);
        }
        if hand == HandArg::Allegro && is_interface(port) {
            tracing::warn!(
                "a CAN interface has no guard: if this program is killed or hangs, the hand may go on pressing"
            );
            return Self::open(hand, port, link);
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
        let robot = Robot::bundled(hand.robot())?;
        Ok(match hand {
            HandArg::Leap => {
                let leap = leap_options(link);
                let off = SwitchOff::leap(&leap);
                let port: Box<dyn Port> = Box::new(GuardedPort::open(port, leap.baud, off, &options)?);
                Self::Leap(Box::new(LeapHand::connect(port, &robot, leap)?))
            }
            HandArg::Allegro => {
                let bus: Box<dyn CanBus> = Box::new(Slcan::open_guarded(port, version(link.allegro), &options)?);
                Self::Allegro(Box::new(AllegroHand::connect(bus, &robot, allegro_options(link))?))
            }
        })
    }

    /// There are no guards on this system.
    #[cfg(not(unix))]
    pub fn open_guarded(hand: HandArg, port: &Path, link: &LinkArgs, guard: &GuardArgs, _: f64) -> Result<Self> {
        if !guard.no_guard {
            anyhow::bail!("there is no guard on this system: give --no-guard");
        }
        Self::open(hand, port, link)
    }
}

/// Is the guard of the program at the standard input.
pub fn serve() -> Result<()> {
    #[cfg(unix)]
    return Ok(drex_hw::guard::serve()?);
    #[cfg(not(unix))]
    anyhow::bail!("there is no guard on this system");
}
