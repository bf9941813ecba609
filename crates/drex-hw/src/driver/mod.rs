//! A hand of either kind on the bench: its setup and file, the connection, a run of a controller with its log.

mod grasp;
mod hand_file;
mod kind;
mod run;
mod scene;
mod setup;

use std::path::Path;
use std::time::Duration;

pub use grasp::{ContactRecord, GraspResult, grasp, grasp_emulated};
pub use hand_file::{HandFile, JointEntry};
pub use kind::{HandKind, Side};
pub use run::{Run, run_logged};
pub use scene::{allegro_scene, leap_scene};
pub use setup::{Setup, SetupOptions};

use crate::allegro::AllegroHand;
use crate::can::{CanBus, Slcan, is_interface};
use crate::dynamixel::{Port, SerialPort};
use crate::leap::table::MotorModel;
use crate::leap::{FindingKind, LeapHand, refuse_motion};
use crate::{Error, Hand, HandState, Result};

/// How often a hand is asked until all its joints have told where they are.
const ASKED: usize = 200;
/// Time between two of these questions.
const ASK_EVERY: Duration = Duration::from_millis(5);

/// How the guard of a hand is started: this program once more, as a process of its own.
#[derive(Debug, Clone, Copy)]
pub struct GuardSettings {
    /// Arguments with which this program calls [`crate::guard::serve`].
    pub arguments: &'static [&'static str],
    /// Longest time without a sign of life; `None`: three cycles, 40 ms at least.
    pub heartbeat: Option<Duration>,
}

/// A hand that is connected, without torque.
pub enum Driver {
    /// LEAP.
    Leap(Box<LeapHand<Box<dyn Port>>>),
    /// Allegro.
    Allegro(Box<AllegroHand<Box<dyn CanBus>>>),
}

impl Driver {
    /// Connects to a hand that is set up as `setup` says, without a guard, and refuses another one than its file is of.
    ///
    /// # Errors
    /// If the port cannot be opened or the hand is not as it has to be.
    pub fn connect(setup: &Setup, port: &Path) -> Result<Self> {
        match setup.hand {
            HandKind::Leap => Self::over_serial(setup, Box::new(SerialPort::open(port, setup.leap.baud)?)),
            HandKind::Allegro => Self::over_can(setup, open_can(port)?),
        }
    }

    /// The same with a LEAP hand on a port that is open.
    fn over_serial(setup: &Setup, port: Box<dyn Port>) -> Result<Self> {
        let hand = LeapHand::connect(port, &setup.robot, setup.leap.clone())?;
        let named = setup.file.as_ref().and_then(HandFile::motor_model);
        if let Some(model) = named.filter(|m| *m != hand.model()) {
            let what = format!("the hand has {} motors, its hand file says {}", hand.model().name(), model.name());
            return Err(Error::NotAllowed(what));
        }
        Ok(Self::Leap(Box::new(hand)))
    }

    /// The same with an Allegro hand on a bus that is open.
    ///
    /// # Errors
    /// If the hand is not as it has to be.
    pub fn over_can(setup: &Setup, bus: Box<dyn CanBus>) -> Result<Self> {
        let mut hand = AllegroHand::connect(bus, &setup.robot, setup.allegro.clone())?;
        if let Some(serial) = setup.file.as_ref().and_then(|f| f.serial.as_deref()) {
            hand.wait_for_reports()?;
            if let Some(other) = hand.serial().filter(|s| s != serial) {
                let what = format!("the hand has the serial number {other}, its hand file is of {serial}");
                return Err(Error::NotAllowed(what));
            }
        }
        Ok(Self::Allegro(Box::new(hand)))
    }

    /// Refuses to move a hand that is not as it should be, unless that is allowed by name; gives a warning if the cap in force is
    /// above what is recommended.
    ///
    /// # Errors
    /// With every finding that stops the motion.
    pub fn ready_to_move(&mut self, allowed: &[FindingKind]) -> Result<Option<String>> {
        if let Self::Leap(hand) = self {
            refuse_motion(hand.findings(), allowed)?;
        }
        Ok(self.cap_warning())
    }

    /// What a control loop drives.
    pub fn hand(&mut self) -> &mut dyn Hand {
        match self {
            Self::Leap(hand) => &mut **hand,
            Self::Allegro(hand) => &mut **hand,
        }
    }

    /// Where the joints are.
    ///
    /// # Errors
    /// If the hand cannot be reached, or a joint never answers.
    pub fn read(&mut self) -> Result<HandState> {
        let hand = self.hand();
        let mut state = HandState::new(hand.joints().len());
        for _ in 0..ASKED {
            hand.cycle(None, &mut state)?;
            if state.age.iter().all(|a| *a != u32::MAX) {
                return Ok(state);
            }
            std::thread::sleep(ASK_EVERY);
        }
        let silent = hand.joints().iter().zip(&state.age).filter(|(_, a)| **a == u32::MAX);
        let names: Vec<&str> = silent.map(|(n, _)| n.as_str()).collect();
        if names.len() == hand.joints().len() {
            let what = "nothing was heard of the hand: check its power, the cable and which generation it is";
            return Err(Error::NotAllowed(what.into()));
        }
        let what = format!("{} never said where they are: check power and cables", names.join(", "));
        Err(Error::NotAllowed(what))
    }

    /// Warning about a cap in force above what is recommended.
    pub fn cap_warning(&mut self) -> Option<String> {
        let model = self.model()?;
        let (_, cap) = cap_range(self.hand().effort_caps());
        cap_warning(model, cap)
    }

    /// Motors of a LEAP hand; `None` of an Allegro.
    pub fn model(&self) -> Option<MotorModel> {
        match self {
            Self::Leap(hand) => Some(hand.model()),
            Self::Allegro(_) => None,
        }
    }
}

/// Cycles that a program may be silent for, where that is longer than the usual heartbeat.
#[cfg(unix)]
const CYCLES: f64 = 3.0;

impl Driver {
    /// Connects a hand that is set up as `setup` says behind a guard that expects a sign of life within three of `rate_hz` cycles per
    /// second, 40 ms at least.
    ///
    /// # Errors
    /// As [`Driver::connect`], and if the guard cannot be started.
    #[cfg(unix)]
    pub fn guarded(setup: &Setup, port: &Path, guard: Option<&GuardSettings>, rate_hz: f64) -> Result<Self> {
        use std::time::Duration;

        use crate::can::Slcan;
        use crate::guard::{GuardOptions, GuardedPort, SwitchOff};

        let Some(guard) = guard else { return Self::connect(setup, port) };
        let options = GuardOptions::this_program(guard.arguments)?;
        let options = match guard.heartbeat {
            Some(heartbeat) => options.with_heartbeat(heartbeat),
            None => {
                let cycles = Duration::try_from_secs_f64(CYCLES / rate_hz).unwrap_or(Duration::MAX);
                let heartbeat = options.heartbeat.max(cycles);
                options.with_heartbeat(heartbeat)
            }
        };
        match setup.hand {
            HandKind::Leap => {
                let off = SwitchOff::leap(&setup.leap);
                Self::over_serial(setup, Box::new(GuardedPort::open(port, setup.leap.baud, off, &options)?))
            }
            HandKind::Allegro => {
                Self::over_can(setup, Box::new(Slcan::open_guarded(port, setup.allegro.version, &options)?))
            }
        }
    }

    /// There are no guards on this system.
    #[cfg(not(unix))]
    pub fn guarded(setup: &Setup, port: &Path, guard: Option<&GuardSettings>, _: f64) -> Result<Self> {
        if guard.is_some() {
            return Err(Error::NotAllowed("there is no guard on this system: drive the hand without one".into()));
        }
        Self::connect(setup, port)
    }
}

/// The CAN bus of an slcan adapter at a serial port, or of an interface of the kernel.
///
/// # Errors
/// If it cannot be opened, or this build has no interfaces of the kernel.
pub fn open_can(port: &Path) -> Result<Box<dyn CanBus>> {
    if !is_interface(port) {
        return Ok(Box::new(Slcan::open(port)?));
    }
    #[cfg(feature = "socketcan")]
    return Ok(Box::new(crate::can::SocketCan::open(&port.to_string_lossy())?));
    #[cfg(not(feature = "socketcan"))]
    Err(Error::NotAllowed(format!(
        "{} is no file: give the serial port of an slcan adapter, or build drex with the feature socketcan to use a CAN interface of that name",
        port.display()
    )))
}

/// Warning about a cap, mA, above what the authors of LEAP recommend.
pub fn cap_warning(model: MotorModel, cap_ma: f64) -> Option<String> {
    (cap_ma > model.recommended_cap_ma()).then(|| {
        format!(
            "warning: the cap of {cap_ma} mA is above the {} mA that the authors of LEAP recommend for the {}: it overheats or stops with an overload",
            model.recommended_cap_ma(),
            model.name()
        )
    })
}

/// Least and largest of the joints' caps.
pub fn cap_range(caps: &[f64]) -> (f64, f64) {
    (caps.iter().copied().fold(f64::INFINITY, f64::min), caps.iter().copied().fold(0.0, f64::max))
}
