//! What a hand is driven with: what somebody says before the hand file before the defaults.

use std::path::PathBuf;

use drex_robot::Robot;

use super::hand_file::HandFile;
use super::kind::{HandKind, Side};
use crate::allegro::{AllegroOptions, AllegroVersion};
use crate::leap::LeapOptions;
use crate::leap::table::MotorModel;
use crate::{Error, Result};

/// How a hand is driven, as far as somebody says; what is left out comes from the hand file, or is a default.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SetupOptions {
    /// Speed of the LEAP bus, bits per second.
    pub baud: Option<u32>,
    /// Generation of the Allegro hand.
    pub version: Option<AllegroVersion>,
    /// Largest effort of any joint: mA for LEAP, N m for Allegro.
    pub cap: Option<f64>,
    /// Path of the hand file.
    pub hand_file: Option<PathBuf>,
}

/// A hand and how it is driven.
pub struct Setup {
    /// Kind of the hand.
    pub hand: HandKind,
    /// Its model, left or right.
    pub robot: Robot,
    /// Options of a LEAP hand.
    pub leap: LeapOptions,
    /// Options of an Allegro hand.
    pub allegro: AllegroOptions,
    /// Most that the joints of an Allegro hand can be told, N m, order of the wire: the cap that somebody gave, or the vendor's.
    pub most_nm: [f64; 16],
    /// What the hand file says, if there is one.
    pub file: Option<HandFile>,
}

impl Setup {
    /// Setup of a hand of a kind; a right one unless the hand file says otherwise.
    ///
    /// # Errors
    /// If the hand file cannot be read or is of another hand, or a cap is above what the hand can take.
    pub fn of(hand: HandKind, options: &SetupOptions) -> Result<Self> {
        let file = options.hand_file.as_deref().map(HandFile::read).transpose()?;
        let side = file.as_ref().map_or(Side::Right, |f| f.side);
        Self::with(hand, side, file, options)
    }

    /// Setup of the hand with a model, such as the one that a grasp was made for.
    ///
    /// # Errors
    /// As [`Setup::of`], and if the hand file is of the other side or there is no driver.
    pub fn for_model(robot: &str, options: &SetupOptions) -> Result<Self> {
        let (hand, side) = HandKind::of_model(robot)?;
        let file = options.hand_file.as_deref().map(HandFile::read).transpose()?;
        if let Some(other) = file.as_ref().map(|f| f.side).filter(|s| *s != side) {
            let side = format!("{other:?}").to_lowercase();
            return Err(Error::NotAllowed(format!("the grasp is for {robot}, the hand file for a {side} hand")));
        }
        Self::with(hand, side, file, options)
    }

    fn with(hand: HandKind, side: Side, file: Option<HandFile>, options: &SetupOptions) -> Result<Self> {
        if let (Some(f), Some(path)) = (&file, &options.hand_file)
            && f.hand != hand
        {
            let what = format!("{} is of a hand {:?}, not {hand:?}", path.display(), f.hand);
            return Err(Error::NotAllowed(what));
        }
        let named = |e: Error| match &options.hand_file {
            Some(path) => Error::NotAllowed(format!("cannot use {}: {e}", path.display())),
            None => e,
        };
        let robot = Robot::bundled(hand.model(side))?;
        let mut leap = if side == Side::Left { LeapOptions::left() } else { LeapOptions::right() };
        let version = options.version.or(file.as_ref().and_then(|f| f.version));
        let mut allegro = AllegroOptions::new(version.unwrap_or(AllegroVersion::V4));
        match (&file, hand) {
            (Some(f), HandKind::Leap) => leap = f.apply_to_leap(leap).map_err(named)?,
            (Some(f), HandKind::Allegro) => allegro = f.apply_to_allegro(allegro).map_err(named)?,
            (None, _) => {}
        }
        leap.baud = options.baud.unwrap_or(leap.baud);
        leap.cap_ma = options.cap.or(leap.cap_ma);
        let cap_nm = options.cap.or(file.as_ref().and_then(HandFile::cap_nm));
        let mut most_nm = allegro.torque_caps_nm();
        if hand == HandKind::Allegro {
            allegro = with_cap(allegro, cap_nm)?;
            if cap_nm.is_some() {
                most_nm = allegro.torque_caps_nm();
            }
        }
        Ok(Self { hand, robot, leap, allegro, most_nm, file })
    }

    /// The motors of a LEAP hand that nobody has connected: those that the file names, or else those of the full hand.
    pub fn expected_motors(&self) -> MotorModel {
        self.file.as_ref().and_then(HandFile::motor_model).unwrap_or(MotorModel::Xc330M288)
    }
}

/// Options with the cap that somebody gave, N m, or a gentle one.
fn with_cap(options: AllegroOptions, cap_nm: Option<f64>) -> Result<AllegroOptions> {
    let Some(cap) = cap_nm else { return Ok(options.with_gentle_caps()) };
    let most = options.torque_caps_nm().into_iter().fold(0.0, f64::max);
    if cap > most {
        let gentle = options.clone().with_gentle_caps().torque_caps_nm().into_iter().fold(f64::INFINITY, f64::min);
        return Err(Error::NotAllowed(format!(
            "a cap of {cap} N m, above the {most:.3} N m at which the vendor's driver clips the strongest joint; start with {gentle:.2} N m"
        )));
    }
    Ok(options.with_cap_nm(cap))
}
