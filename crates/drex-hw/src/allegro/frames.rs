//! What is said on the bus: commands to the hand, reports from it, for the three wire formats.
//!
//! Version 3 has identifiers `command << 6 | destination << 3 | source` and big-endian torques that begin with the joint at the tip.
//! Versions 4 and 5 have identifiers `message << 2 | device` and little-endian numbers.

use serde::{Deserialize, Serialize};

use crate::can::CanFrame;

/// Generation of the hand, which decides how its frames look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AllegroVersion {
    /// Firmware 2 and 3.
    V3,
    /// Firmware 4.
    V4,
    /// Hardware 5, also as "Plus".
    V5,
}

/// From the computer to the hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum AllegroCommand {
    /// Motors on, and with them the stream of poses.
    On,
    /// Motors off.
    Off,
    /// Torques of a finger, 0 to 3, in the units of the wire, joint at the palm first.
    Torque {
        /// Index, middle, ring, thumb.
        finger: u8,
        /// Wire units.
        wire: [i16; 4],
    },
    /// How often the hand reports on its own, ms; 0 is never. Version 3 knows only poses.
    Period {
        /// Of poses.
        pose_ms: u16,
        /// Of the inertial sensor.
        imu_ms: u16,
        /// Of temperatures.
        temperature_ms: u16,
    },
    /// Asks for [`AllegroReport::Info`].
    AskInfo,
    /// Asks for [`AllegroReport::Serial`]; not in version 3.
    AskSerial,
    /// Asks version 3 to begin to report.
    AskState,
}

/// From the hand to the computer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum AllegroReport {
    /// Encoders of a finger, joint at the palm first.
    Pose {
        /// Index, middle, ring, thumb.
        finger: u8,
        /// Encoder units, zero at the middle of their range.
        counts: [i16; 4],
    },
    /// Temperatures of a finger's motors, °C.
    Temperature {
        /// Index, middle, ring, thumb.
        finger: u8,
        /// °C.
        celsius: [u8; 4],
    },
    /// Which hand it is.
    Info(AllegroInfo),
    /// Serial number, ASCII.
    Serial([u8; 8]),
    /// A motor of version 5 reports an error: bits of [`AllegroReport::MOTOR_ERRORS`].
    MotorError {
        /// Joint in the order of the wire.
        motor: u8,
        /// Error bits, 0 for none.
        code: u8,
    },
    /// Pressure at two finger tips of version 5, Pa.
    Fingertips {
        /// First of the two fingers.
        finger: u8,
        /// Of it and of the next.
        pascal: [i32; 2],
    },
    /// Inertial sensor: seen, not read.
    Imu,
}

/// What a hand says about itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct AllegroInfo {
    /// Hardware version, main version in the upper byte.
    pub hardware: u16,
    /// Firmware version, main version in the upper byte.
    pub firmware: u16,
    /// Whether it is a left hand.
    pub left: bool,
    /// Status bits of version 4; see [`AllegroInfo::status_names`].
    pub status: u8,
}

impl AllegroInfo {
    /// Status bit: the motors are on.
    pub const MOTORS_ON: u8 = 1;
    /// Status bit: too hot.
    pub const TOO_HOT: u8 = 2;
    /// Status bit: a motor does not answer.
    pub const MOTOR_SILENT: u8 = 4;

    /// What the status bits that are set mean.
    pub fn status_names(&self) -> Vec<&'static str> {
        let names = [
            (Self::MOTORS_ON, "motors on"),
            (Self::TOO_HOT, "too hot"),
            (Self::MOTOR_SILENT, "a motor does not answer"),
        ];
        names.into_iter().filter_map(|(bit, name)| (self.status & bit != 0).then_some(name)).collect()
    }
}

const V3_HAND: u16 = 1;
const V3_COMPUTER: u16 = 2;
const V3_FINGER: u16 = 3;

impl AllegroReport {
    /// Names of the error bits of version 5's motors.
    pub const MOTOR_ERRORS: [(u8, &'static str); 4] =
        [(1, "input voltage"), (4, "too hot"), (16, "electrical shock or too little power"), (32, "overload")];
}

fn id_v3(command: u16, to: u16, from: u16) -> u16 {
    command << 6 | to << 3 | from
}

fn to_v3(command: u16, data: &[u8]) -> CanFrame {
    CanFrame::masked(id_v3(command, V3_HAND, V3_COMPUTER), data)
}

fn words(values: &[u16], big: bool) -> [u8; 8] {
    let mut bytes = [0; 8];
    for (to, v) in bytes.chunks_exact_mut(2).zip(values) {
        to.copy_from_slice(&if big { v.to_be_bytes() } else { v.to_le_bytes() });
    }
    bytes
}

/// Four numbers of a full frame.
fn read_words(data: &[u8], big: bool) -> Option<[u16; 4]> {
    let data: &[u8; 8] = data.try_into().ok()?;
    let word = |k: usize| {
        let pair = [data[2 * k], data[2 * k + 1]];
        if big { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) }
    };
    Some([word(0), word(1), word(2), word(3)])
}

impl AllegroCommand {
    /// The frame, or `None` if this version has no such command.
    pub fn encode(&self, version: AllegroVersion) -> Option<CanFrame> {
        match version {
            AllegroVersion::V3 => self.encode_v3(),
            AllegroVersion::V4 | AllegroVersion::V5 => self.encode_v4(),
        }
    }

    fn encode_v3(&self) -> Option<CanFrame> {
        Some(match self {
            Self::On => to_v3(0x01, &[]),
            Self::Off => to_v3(0x02, &[]),
            Self::Period { pose_ms, .. } => to_v3(0x03, &[u8::try_from(*pose_ms).unwrap_or(u8::MAX)]),
            Self::Torque { finger, wire } if *finger < 4 => {
                let [a, b, c, d] = wire.map(|w| w as u16);
                to_v3(0x06 + u16::from(*finger), &words(&[d, c, b, a], true))
            }
            Self::AskState => to_v3(0x0e, &[]),
            Self::AskInfo => to_v3(0x10, &[]),
            Self::Torque { .. } | Self::AskSerial => return None,
        })
    }

    fn encode_v4(&self) -> Option<CanFrame> {
        let message = |m: u16, data: &[u8]| CanFrame::masked(m << 2, data);
        Some(match self {
            Self::On => message(0x40, &[]),
            Self::Off => message(0x41, &[]),
            Self::Torque { finger, wire } if *finger < 4 => {
                message(0x60 + u16::from(*finger), &words(&wire.map(|w| w as u16), false))
            }
            Self::Period { pose_ms, imu_ms, temperature_ms } => {
                message(0x81, &words(&[*pose_ms, *imu_ms, *temperature_ms], false)[..6])
            }
            Self::AskInfo => CanFrame::masked_remote(0x80 << 2),
            Self::AskSerial => CanFrame::masked_remote(0x88 << 2),
            Self::Torque { .. } | Self::AskState => return None,
        })
    }

    /// Reads a command, as the hand does; `None` for what is none.
    pub fn decode(version: AllegroVersion, frame: &CanFrame) -> Option<Self> {
        let data = frame.data();
        if version == AllegroVersion::V3 {
            if frame.is_remote() || frame.id() & 0x3f != id_v3(0, V3_HAND, V3_COMPUTER) {
                return None;
            }
            return Some(match frame.id() >> 6 {
                0x01 => Self::On,
                0x02 => Self::Off,
                0x03 => Self::Period { pose_ms: (*data.first()?).into(), imu_ms: 0, temperature_ms: 0 },
                c @ 0x06..=0x09 => {
                    let [d, c3, b, a] = read_words(data, true)?.map(|w| w as i16);
                    Self::Torque { finger: (c - 0x06) as u8, wire: [a, b, c3, d] }
                }
                0x0e => Self::AskState,
                0x10 => Self::AskInfo,
                _ => return None,
            });
        }
        Some(match (frame.id() >> 2, frame.is_remote()) {
            (0x40, false) => Self::On,
            (0x41, false) => Self::Off,
            (m @ 0x60..=0x63, false) => {
                Self::Torque { finger: (m - 0x60) as u8, wire: read_words(data, false)?.map(|w| w as i16) }
            }
            (0x81, false) => {
                let word = |k: usize| Some(u16::from_le_bytes([*data.get(k)?, *data.get(k + 1)?]));
                Self::Period { pose_ms: word(0)?, imu_ms: word(2)?, temperature_ms: word(4)? }
            }
            (0x80, true) => Self::AskInfo,
            (0x88, true) => Self::AskSerial,
            _ => return None,
        })
    }
}

impl AllegroReport {
    /// The frame, as the hand sends it, or `None` if this version has no such report.
    pub fn encode(&self, version: AllegroVersion) -> Option<CanFrame> {
        if version == AllegroVersion::V3 {
            let from = |command, source, data: &[u8]| CanFrame::masked(id_v3(command, V3_COMPUTER, source), data);
            return match self {
                Self::Pose { finger, counts } if *finger < 4 => {
                    let shifted = counts.map(|c| (c as u16) ^ 0x8000);
                    Some(from(0x0f, V3_FINGER + u16::from(*finger), &words(&shifted, false)))
                }
                Self::Info(i) => {
                    let ([h1, h0], [f1, f0]) = (i.hardware.to_be_bytes(), i.firmware.to_be_bytes());
                    Some(from(0x10, V3_HAND, &[0, 0, h0, h1, f0, f1, 0, u8::from(i.left)]))
                }
                _ => None,
            };
        }
        let message = |m: u16, data: &[u8]| Some(CanFrame::masked(m << 2, data));
        match self {
            Self::Pose { finger, counts } if *finger < 4 => {
                message(0x20 + u16::from(*finger), &words(&counts.map(|c| c as u16), false))
            }
            Self::Temperature { finger, celsius } if *finger < 4 => message(0x38 + u16::from(*finger), celsius),
            Self::Info(i) => {
                let ([h1, h0], [f1, f0]) = (i.hardware.to_be_bytes(), i.firmware.to_be_bytes());
                message(0x80, &[h0, h1, f0, f1, u8::from(i.left), 0, i.status])
            }
            Self::Serial(text) => message(0x88, text),
            Self::MotorError { motor, code } if version == AllegroVersion::V5 => message(0xee, &[*motor, *code]),
            Self::Fingertips { finger, pascal } if version == AllegroVersion::V5 => {
                let ([a, b, c, d], [e, f, g, h]) = (pascal[0].to_le_bytes(), pascal[1].to_le_bytes());
                message(0xf0 + u16::from(*finger & 2), &[a, b, c, d, e, f, g, h])
            }
            _ => None,
        }
    }

    /// Reads a report; `None` for what is none, or is too short.
    pub fn decode(version: AllegroVersion, frame: &CanFrame) -> Option<Self> {
        if frame.is_remote() {
            return None;
        }
        let data = frame.data();
        let v5 = version == AllegroVersion::V5;
        if version == AllegroVersion::V3 {
            let source = frame.id() & 7;
            return match frame.id() >> 6 {
                0x0f if (V3_FINGER..V3_FINGER + 4).contains(&source) => {
                    let counts = read_words(data, false)?.map(|w| (w ^ 0x8000) as i16);
                    Some(Self::Pose { finger: (source - V3_FINGER) as u8, counts })
                }
                0x10 => Some(Self::Info(AllegroInfo {
                    hardware: u16::from_le_bytes([*data.get(2)?, *data.get(3)?]),
                    firmware: u16::from_le_bytes([*data.get(4)?, *data.get(5)?]),
                    left: *data.get(7)? != 0,
                    status: 0,
                })),
                0x11..=0x15 => Some(Self::Imu),
                _ => None,
            };
        }
        match frame.id() >> 2 {
            m @ 0x20..=0x23 => {
                Some(Self::Pose { finger: (m - 0x20) as u8, counts: read_words(data, false)?.map(|w| w as i16) })
            }
            0x30 => Some(Self::Imu),
            m @ 0x38..=0x3b => {
                let celsius = match <[u8; 4]>::try_from(data.get(..4)?).ok()? {
                    // Older firmware sends one number of four bytes for the finger.
                    [t, 0, 0, 0] => [t; 4],
                    each => each,
                };
                Some(Self::Temperature { finger: (m - 0x38) as u8, celsius })
            }
            0x80 => Some(Self::Info(AllegroInfo {
                hardware: u16::from_le_bytes([*data.first()?, *data.get(1)?]),
                firmware: u16::from_le_bytes([*data.get(2)?, *data.get(3)?]),
                left: data.get(4).is_some_and(|b| *b != 0),
                status: data.get(6).copied().unwrap_or(0),
            })),
            0x88 => Some(Self::Serial(data.try_into().ok()?)),
            0xee if v5 => Some(Self::MotorError { motor: *data.first()?, code: *data.get(1)? }),
            // The manual says 0x50 and 0x52, firmware says 0xf0 and 0xf2.
            m @ (0x50 | 0x52 | 0xf0 | 0xf2) if v5 => {
                let (a, b) = data.split_at_checked(4)?;
                let pascal = [i32::from_le_bytes(a.try_into().ok()?), i32::from_le_bytes(b.try_into().ok()?)];
                Some(Self::Fingertips { finger: (m & 2) as u8, pascal })
            }
            _ => None,
        }
    }
}
