//! `drex hw`: hands on the bench.

mod calibrate;
mod drive;
mod emulate;
mod grasp;
mod guarded;
mod look;
mod scene;

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use drex_hw::allegro::{AllegroHand, AllegroOptions, AllegroVersion};
use drex_hw::can::{CanBus, Slcan};
use drex_hw::control::EStop;
use drex_hw::dynamixel::{Port, SerialPort};
use drex_hw::leap::{LeapHand, LeapOptions};
use drex_hw::{EffortUnit, Hand, HandState};
use drex_robot::Robot;

pub use drive::Run;
pub use grasp::{ContactRecord, Done, grasp, grasp_emulated};

use crate::cli::{AllegroArg, HandArg, HwCommand, LinkArgs};
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
        HwCommand::Move(args) => drive::move_to(args, ui),
        HwCommand::Record(args) => drive::record(args, ui),
        HwCommand::Calibrate(args) => calibrate::run(args, ui),
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
        let robot = Robot::bundled(hand.robot())?;
        Ok(match hand {
            HandArg::Leap => {
                let port: Box<dyn Port> = Box::new(SerialPort::open(port, link.baud)?);
                Self::Leap(Box::new(LeapHand::connect(port, &robot, leap_options(link))?))
            }
            HandArg::Allegro => {
                Self::Allegro(Box::new(AllegroHand::connect(can_bus(port)?, &robot, allegro_options(link))?))
            }
        })
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

/// The options of a LEAP hand.
pub fn leap_options(link: &LinkArgs) -> LeapOptions {
    let options = LeapOptions::right().with_baud(link.baud);
    match link.cap {
        Some(cap) => options.with_cap_ma(cap),
        None => options,
    }
}

/// The options of an Allegro hand.
pub fn allegro_options(link: &LinkArgs) -> AllegroOptions {
    let options = AllegroOptions::new(version(link.allegro));
    match link.cap {
        Some(cap) => {
            let wire = (cap * options.wire_per_nm).clamp(1.0, f64::from(i16::MAX));
            options.with_wire_cap(wire as i16)
        }
        None => options,
    }
}

fn version(allegro: AllegroArg) -> AllegroVersion {
    match allegro {
        AllegroArg::V3 => AllegroVersion::V3,
        AllegroArg::V4 => AllegroVersion::V4,
        AllegroArg::V5 => AllegroVersion::V5,
    }
}

/// Whether what is given as a port is no file, and so perhaps a CAN interface of the kernel.
fn is_interface(port: &Path) -> bool {
    port.components().count() == 1 && !port.exists()
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
