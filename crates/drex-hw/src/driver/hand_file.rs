//! `hand.toml`: what one hand has that another of its kind has not.

use std::collections::BTreeMap;
use std::path::Path;

use drex_core::fsutil;
use serde::{Deserialize, Serialize};

use super::kind::{HandKind, Side};
use crate::allegro::{AllegroOptions, AllegroVersion};
use crate::leap::LeapOptions;
use crate::leap::table::MotorModel;
use crate::{Error, Result};

/// Layout of the file.
const SCHEMA: u32 = 1;
/// Unit comments at the head of a file that drex writes.
const HEAD: &str = "\
# One hand: docs/hardware.md says more. LEAP: zero and homing_offset in ticks (4096 per turn), cap_ma in mA.
# Allegro: zero in encoder counts, cap_nm in N m, gear_ratio over the plain gear, temperature_period_ms in ms.
";

/// A `hand.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandFile {
    schema: u32,
    /// Which hand it is.
    pub hand: HandKind,
    /// Left or right.
    #[serde(default)]
    pub side: Side,
    /// LEAP: motors that it has; others are refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    motors: Option<Motors>,
    /// LEAP: speed of the bus, bits per second.
    #[serde(skip_serializing_if = "Option::is_none")]
    baud: Option<u32>,
    /// LEAP: largest current of every motor, mA.
    #[serde(skip_serializing_if = "Option::is_none")]
    cap_ma: Option<f64>,
    /// Allegro: generation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub version: Option<AllegroVersion>,
    /// Allegro: serial number; another hand is refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// Allegro: largest torque of every joint, N m.
    #[serde(skip_serializing_if = "Option::is_none")]
    cap_nm: Option<f64>,
    /// Allegro: wire units per N m.
    #[serde(skip_serializing_if = "Option::is_none")]
    wire_per_nm: Option<f64>,
    /// Allegro: time between temperatures, ms; 0 is never.
    #[serde(skip_serializing_if = "Option::is_none")]
    temperature_period_ms: Option<u16>,
    /// Joints by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub joints: BTreeMap<String, JointEntry>,
}

/// One joint.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointEntry {
    /// Reading at the model's zero: ticks of the motor (LEAP), encoder counts (Allegro).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zero: Option<i32>,
    /// 1 or -1: whether the reading grows or falls as the model's angle grows.
    #[serde(skip_serializing_if = "Option::is_none")]
    sign: Option<Sign>,
    /// LEAP: homing offset (register 20) with which the zero was read, ticks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub homing_offset: Option<i32>,
    /// Allegro: 1 or -1: whether a positive number on the wire pushes to larger angles.
    #[serde(skip_serializing_if = "Option::is_none")]
    torque_sign: Option<Sign>,
    /// Allegro: reduction over the plain gear.
    #[serde(skip_serializing_if = "Option::is_none")]
    gear_ratio: Option<f64>,
}

/// Motors of a LEAP hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Motors {
    Xc330,
    Xl330,
}

/// 1 or -1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "i64", into = "i64")]
struct Sign {
    reversed: bool,
}

impl TryFrom<i64> for Sign {
    type Error = String;

    fn try_from(value: i64) -> Result<Self, String> {
        match value {
            1 => Ok(Self { reversed: false }),
            -1 => Ok(Self { reversed: true }),
            other => Err(format!("a sign is 1 or -1, not {other}")),
        }
    }
}

impl From<Sign> for i64 {
    fn from(sign: Sign) -> Self {
        if sign.reversed { -1 } else { 1 }
    }
}

impl HandFile {
    /// A file with nothing but the kind of the hand.
    pub fn new(hand: HandKind) -> Self {
        Self {
            schema: SCHEMA,
            hand,
            side: Side::Right,
            motors: None,
            baud: None,
            cap_ma: None,
            version: None,
            serial: None,
            cap_nm: None,
            wire_per_nm: None,
            temperature_period_ms: None,
            joints: BTreeMap::new(),
        }
    }

    /// Reads the file at `path`.
    ///
    /// # Errors
    /// If it cannot be read or is of another shape, with key and line; or has a key that hands of its kind have not.
    pub fn read(path: &Path) -> Result<Self> {
        let text = fsutil::read_text(path)?;
        let file: Self = fsutil::from_toml(path, &text)?;
        file.check().map_err(|(key, what)| {
            let line = line_of(&text, &key).map_or_else(String::new, |n| format!(" line {n}"));
            Error::NotAllowed(format!("{}{line}: {key} {what}", path.display()))
        })?;
        Ok(file)
    }

    /// The text of the file.
    ///
    /// # Errors
    /// If it cannot be written as TOML.
    pub fn text(&self) -> Result<String> {
        let text =
            toml::to_string(self).map_err(|e| Error::NotAllowed(format!("the hand file cannot be written: {e}")))?;
        Ok(format!("{HEAD}{text}"))
    }

    /// The motors that a LEAP hand is said to have.
    pub fn motor_model(&self) -> Option<MotorModel> {
        self.motors.map(|m| match m {
            Motors::Xc330 => MotorModel::Xc330M288,
            Motors::Xl330 => MotorModel::Xl330M288,
        })
    }

    /// The first key that makes no sense, and why.
    fn check(&self) -> Result<(), (String, String)> {
        let bad = |key: &str, what: String| Err((key.to_owned(), what));
        if self.schema != SCHEMA {
            return bad("schema", format!("is {}: this program reads {SCHEMA}", self.schema));
        }
        let (leap, allegro) = (self.hand == HandKind::Leap, self.hand == HandKind::Allegro);
        let foreign = [
            ("motors", self.motors.is_some(), leap),
            ("baud", self.baud.is_some(), leap),
            ("cap_ma", self.cap_ma.is_some(), leap),
            ("version", self.version.is_some(), allegro),
            ("serial", self.serial.is_some(), allegro),
            ("cap_nm", self.cap_nm.is_some(), allegro),
            ("wire_per_nm", self.wire_per_nm.is_some(), allegro),
            ("temperature_period_ms", self.temperature_period_ms.is_some(), allegro),
        ];
        if let Some((key, ..)) = foreign.into_iter().find(|(_, given, its)| *given && !its) {
            return bad(key, format!("is no key of a hand {:?}: remove it", self.hand));
        }
        let positive = [("cap_ma", self.cap_ma), ("cap_nm", self.cap_nm), ("wire_per_nm", self.wire_per_nm)];
        if let Some((key, Some(value))) = positive.into_iter().find(|(_, v)| v.is_some_and(|v| v <= 0.0)) {
            return bad(key, format!("is {value}: give a number above zero"));
        }
        if let Some(baud) = self.baud.filter(|b| !(9_600..=10_500_000).contains(b)) {
            return bad("baud", format!("is {baud}: give 9600 to 10500000"));
        }
        for (name, joint) in &self.joints {
            let key = |field: &str| format!("joints.{name}.{field}");
            let foreign = [
                ("homing_offset", joint.homing_offset.is_some(), leap),
                ("torque_sign", joint.torque_sign.is_some(), allegro),
                ("gear_ratio", joint.gear_ratio.is_some(), allegro),
            ];
            if let Some((field, ..)) = foreign.into_iter().find(|(_, given, its)| *given && !its) {
                return bad(&key(field), format!("is no key of a hand {:?}: remove it", self.hand));
            }
            if let Some(ratio) = joint.gear_ratio.filter(|g| !(0.1..=10.0).contains(g)) {
                return bad(&key("gear_ratio"), format!("is {ratio}: give 0.1 to 10"));
            }
            let most = if leap { 4096 } else { 1 << 20 };
            if let Some(zero) = joint.zero.filter(|z| !(-most..=most).contains(z)) {
                return bad(&key("zero"), format!("is {zero}: give {} to {most}", -most));
            }
        }
        Ok(())
    }

    /// Puts what it says into the options of a LEAP hand.
    ///
    /// # Errors
    /// If there is no joint of a name.
    pub fn apply_to_leap(&self, mut options: LeapOptions) -> Result<LeapOptions> {
        options.baud = self.baud.unwrap_or(options.baud);
        options.cap_ma = self.cap_ma.or(options.cap_ma);
        for (name, entry) in &self.joints {
            let names: Vec<String> = options.joints.iter().map(|j| j.name.clone()).collect();
            let joint = options.joints.iter_mut().find(|j| j.name == *name).ok_or_else(|| no_joint(name, &names))?;
            joint.zero_ticks = entry.zero.unwrap_or(joint.zero_ticks);
            joint.reversed = entry.sign.map_or(joint.reversed, |s| s.reversed);
            joint.homing_offset_ticks = entry.homing_offset.unwrap_or(joint.homing_offset_ticks);
        }
        Ok(options)
    }

    /// Puts what it says into the options of an Allegro hand, all but the cap.
    ///
    /// # Errors
    /// If there is no joint of a name.
    pub fn apply_to_allegro(&self, mut options: AllegroOptions) -> Result<AllegroOptions> {
        options.wire_per_nm = self.wire_per_nm.unwrap_or(options.wire_per_nm);
        options.temperature_period_ms = self.temperature_period_ms.unwrap_or(options.temperature_period_ms);
        for (name, entry) in &self.joints {
            let Some(j) = options.names.iter().position(|n| n == name) else {
                return Err(no_joint(name, &options.names));
            };
            let calibration = &mut options.calibration[j];
            calibration.offset_counts = entry.zero.unwrap_or(calibration.offset_counts);
            calibration.encoder_reversed = entry.sign.map_or(calibration.encoder_reversed, |s| s.reversed);
            calibration.motor_reversed = entry.torque_sign.map_or(calibration.motor_reversed, |s| s.reversed);
            options.gear_ratios[j] = entry.gear_ratio.unwrap_or(options.gear_ratios[j]);
        }
        Ok(options)
    }

    /// The cap of an Allegro hand, N m.
    pub fn cap_nm(&self) -> Option<f64> {
        self.cap_nm
    }
}

fn no_joint(name: &str, names: &[String]) -> Error {
    Error::NotAllowed(format!("joints.{name}: there is no such joint; there are {}", names.join(", ")))
}

/// Line of a dotted key, as far as it can be seen: that of its last part, behind that of its joint.
fn line_of(text: &str, key: &str) -> Option<usize> {
    let mut parts = key.trim_start_matches("joints.").split('.').peekable();
    let mut wanted = parts.next()?;
    for (number, line) in text.lines().enumerate() {
        while line.split(['[', ']', '.', '=', ' ', '{', ',', '"']).any(|word| word == wanted) {
            match parts.next() {
                Some(next) => wanted = next,
                None => return Some(number + 1),
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn read(text: &str) -> Result<HandFile> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("hand.toml");
        std::fs::write(&path, text).unwrap();
        HandFile::read(&path)
    }

    fn refused(text: &str, words: &[&str]) {
        let error = read(text).unwrap_err().to_string();
        assert!(words.iter().all(|w| error.contains(w)), "{error}");
    }

    #[test]
    fn what_is_written_is_read_again() {
        let text = "schema = 1\nhand = \"allegro\"\nside = \"left\"\nversion = \"v5\"\nserial = \"SAHB0123\"\ncap_nm = 0.1\n\
                    wire_per_nm = 1900.0\ntemperature_period_ms = 100\n\n[joints.ffj1]\nzero = -120\nsign = -1\n\
                    torque_sign = -1\ngear_ratio = 2.0\n";
        let file = read(text).unwrap();
        assert_eq!(read(&file.text().unwrap()).unwrap(), file);
        let options = file.apply_to_allegro(AllegroOptions::new(AllegroVersion::V5)).unwrap();
        assert_eq!((options.wire_per_nm, options.temperature_period_ms), (1900.0, 100));
        assert_eq!((options.gear_ratios[1], options.gear_ratios[0]), (2.0, 1.0));
        let c = options.calibration[1];
        assert_eq!((c.offset_counts, c.encoder_reversed, c.motor_reversed), (-120, true, true));
    }

    #[test]
    fn a_key_that_makes_no_sense_is_named_with_its_line() {
        let head = "schema = 1\nhand = \"leap\"\n";
        refused(&format!("{head}colour = 1\n"), &["line 3", "colour"]);
        refused(&format!("{head}[joints.if_mcp]\nzer = 1\n"), &["line 4", "zer"]);
        refused(&format!("{head}[joints.if_mcp]\nsign = 2\n"), &["line 4", "a sign is 1 or -1, not 2"]);
        refused(&format!("{head}cap_nm = 0.1\n"), &["line 3", "cap_nm", "no key of a hand Leap"]);
        refused(
            &format!("{head}[joints.if_mcp]\nzero = 9\n[joints.if_pip]\ngear_ratio = 2.0\n"),
            &["line 6", "joints.if_pip.gear_ratio"],
        );
        refused(&format!("{head}cap_ma = -3.0\n"), &["line 3", "cap_ma is -3"]);
        refused(&format!("{head}cap_ma = nan\n"), &["cap_ma is not finite"]);
        refused(&format!("{head}joints.if_mcp = {{ zero = 5000 }}\n"), &["line 3", "joints.if_mcp.zero is 5000"]);
        refused("schema = 7\nhand = \"leap\"\n", &["line 1", "schema is 7"]);
        let unknown = read(&format!("{head}[joints.knee]\nzero = 9\n")).unwrap();
        let error = unknown.apply_to_leap(LeapOptions::right()).unwrap_err().to_string();
        assert!(error.contains("joints.knee") && error.contains("if_mcp"), "{error}");
    }
}
