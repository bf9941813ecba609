//! Hands that are opened behind a guard.

use std::path::{Path, PathBuf};

use drex_robot::Robot;

use super::{GuardOptions, GuardedPort, SwitchOff};
use crate::Result;
use crate::allegro::AllegroVersion;
use crate::can::{SLCAN_BAUD, Slcan};
use crate::leap::{LeapHand, LeapOptions};

impl LeapHand<GuardedPort> {
    /// Opens the hand at the serial port `path` behind a guard, which takes the torque off whatever becomes of this program.
    ///
    /// # Errors
    /// If the guard cannot be started, and those of [`LeapHand::open`].
    pub fn open_guarded(
        path: impl Into<PathBuf>,
        robot: &Robot,
        options: LeapOptions,
        guard: &GuardOptions,
    ) -> Result<Self> {
        let port = GuardedPort::open(path, options.baud, SwitchOff::leap(&options), guard)?;
        Self::connect(port, robot, options)
    }

    /// Process of the guard.
    pub fn guard_id(&mut self) -> u32 {
        self.port().guard_id()
    }
}

impl Slcan<GuardedPort> {
    /// Opens the adapter at a serial port, or a CAN interface of the kernel, behind a guard, which switches an Allegro hand of this
    /// version off whatever becomes of this program.
    ///
    /// # Errors
    /// If the guard cannot be started, and those of [`Slcan::open`].
    pub fn open_guarded(path: &Path, version: AllegroVersion, guard: &GuardOptions) -> Result<Self> {
        Self::over(GuardedPort::open(path, SLCAN_BAUD, SwitchOff::Allegro { version }, guard)?)
    }

    /// Process of the guard.
    pub fn guard_id(&self) -> u32 {
        self.port().guard_id()
    }
}
