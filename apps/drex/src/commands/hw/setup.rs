//! What a hand is driven with: the command line before the hand file before the defaults.

use anyhow::{Context, Result, bail};
use drex_hw::allegro::{AllegroOptions, AllegroVersion};
use drex_hw::leap::LeapOptions;
use drex_hw::leap::table::MotorModel;
use drex_robot::Robot;

use super::hand_file::{HandFile, Side};
use crate::cli::{AllegroArg, HandArg, LinkArgs};

/// A hand and how it is driven.
pub struct Setup {
    /// Which hand.
    pub hand: HandArg,
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
    /// That of a hand on the command line; a right one unless the hand file says otherwise.
    ///
    /// # Errors
    /// If the hand file cannot be read or is of another hand, or a cap is above what the hand can take.
    pub fn of(hand: HandArg, link: &LinkArgs) -> Result<Self> {
        let file = link.hand_file.as_deref().map(HandFile::read).transpose()?;
        let side = file.as_ref().map_or(Side::Right, |f| f.side);
        Self::with(hand, side, file, link)
    }

    /// That of the hand that a grasp was made for, by the name of its model.
    ///
    /// # Errors
    /// As [`Setup::of`], and if the hand file is of the other side or there is no driver.
    pub fn for_model(robot: &str, link: &LinkArgs) -> Result<Self> {
        let (hand, side) = kind(robot)?;
        let file = link.hand_file.as_deref().map(HandFile::read).transpose()?;
        if let Some(other) = file.as_ref().map(|f| f.side).filter(|s| *s != side) {
            bail!("the grasp is for {robot}, the hand file for a {} hand", format!("{other:?}").to_lowercase());
        }
        Self::with(hand, side, file, link)
    }

    fn with(hand: HandArg, side: Side, file: Option<HandFile>, link: &LinkArgs) -> Result<Self> {
        if let (Some(f), Some(path)) = (&file, &link.hand_file)
            && HandArg::from(f.hand) != hand
        {
            bail!("{} is of a hand {:?}, not {hand:?}", path.display(), HandArg::from(f.hand));
        }
        let named = || link.hand_file.as_ref().map_or_else(String::new, |p| format!("cannot use {}", p.display()));
        let robot = Robot::bundled(match side {
            Side::Right => hand.robot(),
            Side::Left => hand.left_robot(),
        })?;
        let mut leap = if side == Side::Left { LeapOptions::left() } else { LeapOptions::right() };
        let generation = link.allegro.or(file.as_ref().and_then(|f| f.version).map(Into::into));
        let mut allegro = AllegroOptions::new(version(generation.unwrap_or(AllegroArg::V4)));
        match (&file, hand) {
            (Some(f), HandArg::Leap) => leap = f.apply_to_leap(leap).with_context(named)?,
            (Some(f), HandArg::Allegro) => allegro = f.apply_to_allegro(allegro).with_context(named)?,
            (None, _) => {}
        }
        leap.baud = link.baud.unwrap_or(leap.baud);
        leap.cap_ma = link.cap.or(leap.cap_ma);
        let cap_nm = link.cap.or(file.as_ref().and_then(HandFile::cap_nm));
        let mut most_nm = allegro.torque_caps_nm();
        if hand == HandArg::Allegro {
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
        bail!(
            "a cap of {cap} N m, above the {most:.3} N m at which the vendor's driver clips the strongest joint; start with {gentle:.2} N m"
        );
    }
    Ok(options.with_cap_nm(cap))
}

/// Which driver a model takes, and of which side it is.
///
/// # Errors
/// If there is none.
pub fn kind(robot: &str) -> Result<(HandArg, Side)> {
    let hands = [HandArg::Leap, HandArg::Allegro];
    let right = hands.into_iter().find(|k| k.robot() == robot).map(|k| (k, Side::Right));
    let left = || hands.into_iter().find(|k| k.left_robot() == robot).map(|k| (k, Side::Left));
    right.or_else(left).with_context(|| {
        format!("no driver for the hand \"{robot}\": there are leap_right, leap_left, allegro_right and allegro_left")
    })
}

fn version(allegro: AllegroArg) -> AllegroVersion {
    match allegro {
        AllegroArg::V3 => AllegroVersion::V3,
        AllegroArg::V4 => AllegroVersion::V4,
        AllegroArg::V5 => AllegroVersion::V5,
    }
}
