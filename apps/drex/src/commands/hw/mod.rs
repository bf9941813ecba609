//! `drex hw`: hands on the bench.

mod calibrate;
mod calibrate_zero;
mod caps;
mod drive;
mod emulate;
#[cfg(unix)]
mod fault;
mod grasp;
mod guarded;
mod hand_file;
mod look;
mod off;
mod scene;
mod setup;

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use drex_hw::allegro::AllegroHand;
use drex_hw::can::{CanBus, Slcan, is_interface};
use drex_hw::control::EStop;
use drex_hw::dynamixel::{Port, SerialPort};
use drex_hw::leap::{FindingKind, LeapHand, refuse_motion};
use drex_hw::{EffortUnit, Hand, HandState};

pub use caps::above_recommended;
pub use drive::Run;
pub use grasp::{ContactRecord, Done, grasp, grasp_emulated};
pub use setup::{Setup, kind};

use crate::cli::{AllowArgs, HandArg, HwCommand, LinkArgs};
use crate::ui::Ui;

/// How often a hand is asked until all its joints have told where they are.
const ASKED: usize = 200;
/// Time between two of these questions.
const ASK_EVERY: Duration = Duration::from_millis(5);

/// Does one of them.
pub fn run(command: &HwCommand, ui: &Ui) -> Result<()> {
    match command {
        HwCommand::Ping(args) => look::ping(args, ui),
        HwCommand::Status(args) => look::status(args, ui),
        HwCommand::Off(args) => off::off(args, ui),
        HwCommand::Release(args) => off::release(args, ui),
        HwCommand::Move(args) => drive::move_to(args, ui),
        HwCommand::Record(args) => drive::record(args, ui),
        HwCommand::Calibrate(args) => calibrate::run(args, ui),
        HwCommand::CalibrateZero(args) => calibrate_zero::run(args, ui),
        HwCommand::Emulate(args) => emulate::run(args, ui),
        HwCommand::Guard => guarded::serve(),
    }
}

/// A hand that is connected, without torque.
pub enum Driver {
    /// LEAP.
    Leap(Box<LeapHand<Box<dyn Port>>>),
    /// Allegro.
    Allegro(Box<AllegroHand<Box<dyn CanBus>>>),
}

impl Driver {
    /// Connects.
    ///
    /// # Errors
    /// If the port cannot be opened or the hand is not as it should be.
    pub fn open(hand: HandArg, port: &Path, link: &LinkArgs) -> Result<Self> {
        Self::with(&Setup::of(hand, link)?, port)
    }

    /// Connects to a hand that is set up as `setup` says, without a guard, and refuses another one than its file is of.
    ///
    /// # Errors
    /// As [`Driver::open`].
    pub fn with(setup: &Setup, port: &Path) -> Result<Self> {
        match setup.hand {
            HandArg::Leap => Self::over_serial(setup, Box::new(SerialPort::open(port, setup.leap.baud)?)),
            HandArg::Allegro => Self::over_can(setup, can_bus(port)?),
        }
    }

    /// The same with a LEAP hand on a port that is open.
    fn over_serial(setup: &Setup, port: Box<dyn Port>) -> Result<Self> {
        let hand = LeapHand::connect(port, &setup.robot, setup.leap.clone())?;
        let named = setup.file.as_ref().and_then(hand_file::HandFile::motor_model);
        if let Some(model) = named.filter(|m| *m != hand.model()) {
            bail!("the hand has {} motors, its hand file says {}", hand.model().name(), model.name());
        }
        Ok(Self::Leap(Box::new(hand)))
    }

    /// The same with an Allegro hand on a bus that is open.
    fn over_can(setup: &Setup, bus: Box<dyn CanBus>) -> Result<Self> {
        let mut hand = AllegroHand::connect(bus, &setup.robot, setup.allegro.clone())?;
        if let Some(serial) = setup.file.as_ref().and_then(|f| f.serial.as_deref()) {
            hand.wait_for_reports()?;
            if let Some(other) = hand.serial().filter(|s| s != serial) {
                bail!("the hand has the serial number {other}, its hand file is of {serial}");
            }
        }
        Ok(Self::Allegro(Box::new(hand)))
    }

    /// Refuses to move a hand that is not as it should be, unless that is allowed by name, and says how hard it may press.
    ///
    /// # Errors
    /// With every finding that stops the motion.
    pub fn ready_to_move(&mut self, allow: &AllowArgs, ui: &Ui) -> Result<()> {
        if let Self::Leap(hand) = self {
            let allowed: Vec<FindingKind> = allow.allow.iter().map(|a| FindingKind::from(*a)).collect();
            refuse_motion(hand.findings(), &allowed).map_err(|e| anyhow::anyhow!("{e} (--allow)"))?;
        }
        if let Some(warning) = self.cap_warning() {
            ui.note(warning);
        }
        Ok(())
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
            bail!("nothing was heard of the hand: check its power, the cable and which generation it is");
        }
        bail!("{} never said where they are: check power and cables", names.join(", "));
    }
}

/// An slcan adapter at a serial port, or an interface of the kernel.
fn can_bus(port: &Path) -> Result<Box<dyn CanBus>> {
    if !is_interface(port) {
        return Ok(Box::new(Slcan::open(port)?));
    }
    #[cfg(feature = "socketcan")]
    return Ok(Box::new(drex_hw::can::SocketCan::open(&port.to_string_lossy())?));
    #[cfg(not(feature = "socketcan"))]
    bail!(
        "{} is no file: give the serial port of an slcan adapter, or build drex with the feature socketcan to use a CAN interface of that name",
        port.display()
    );
}

/// How efforts of a hand are written.
pub fn unit(hand: &dyn Hand) -> &'static str {
    match hand.effort_unit() {
        EffortUnit::Milliampere => "mA",
        _ => "N m",
    }
}

/// A stop that Ctrl-C and SIGTERM press.
///
/// # Errors
/// If the system refuses.
pub fn stop_button() -> Result<EStop> {
    let stop = EStop::new();
    #[cfg(unix)]
    drex_hw::control::stop_on_signals(&stop)?;
    Ok(stop)
}

/// `name=rad,…` for joints of a hand.
fn angles(text: &str, names: &[String]) -> Result<Vec<(usize, f64)>> {
    text.split(',')
        .map(|part| {
            let (name, angle) = part.split_once('=').with_context(|| format!("\"{part}\" is not JOINT=RAD"))?;
            let joint = names.iter().position(|n| n == name.trim());
            let joint = joint
                .with_context(|| format!("there is no joint \"{}\"; there are {}", name.trim(), names.join(", ")))?;
            let angle: f64 = angle.trim().parse().with_context(|| format!("\"{angle}\" is no angle in rad"))?;
            if !angle.is_finite() {
                bail!("the angle of {name} is {angle}");
            }
            Ok((joint, angle))
        })
        .collect()
}
