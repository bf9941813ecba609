//! What speaks against a hand, or for mending it first.

use crate::{Error, Result};

/// Kind of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum FindingKind {
    /// The USB adapter holds answers back.
    UsbLatency,
    /// Motors wait before they answer.
    ReturnDelay,
    /// Firmware that does not know common answers.
    OldFirmware,
    /// Motors of different or unknown models.
    MixedModels,
    /// A motor that does not answer, or refuses.
    Silent,
    /// A drive mode other than 0.
    DriveMode,
    /// A motor that does things by itself when power comes.
    Startup,
    /// A second id to which a motor listens.
    SecondId,
    /// A homing offset other than the one that the hand was calibrated with: the joint is not where it says.
    HomingOffset,
    /// A hardware error.
    HardwareError,
    /// Too little supply voltage.
    LowVoltage,
    /// Too much supply voltage.
    HighVoltage,
    /// A hot motor.
    Hot,
}

impl FindingKind {
    /// All kinds.
    pub const ALL: [Self; 13] = [
        Self::UsbLatency,
        Self::ReturnDelay,
        Self::OldFirmware,
        Self::MixedModels,
        Self::Silent,
        Self::DriveMode,
        Self::Startup,
        Self::SecondId,
        Self::HomingOffset,
        Self::HardwareError,
        Self::LowVoltage,
        Self::HighVoltage,
        Self::Hot,
    ];

    /// Name by which it is allowed, such as `homing-offset`.
    pub fn name(self) -> &'static str {
        match self {
            Self::UsbLatency => "usb-latency",
            Self::ReturnDelay => "return-delay",
            Self::OldFirmware => "old-firmware",
            Self::MixedModels => "mixed-models",
            Self::Silent => "silent",
            Self::DriveMode => "drive-mode",
            Self::Startup => "startup",
            Self::SecondId => "second-id",
            Self::HomingOffset => "homing-offset",
            Self::HardwareError => "hardware-error",
            Self::LowVoltage => "low-voltage",
            Self::HighVoltage => "high-voltage",
            Self::Hot => "hot",
        }
    }

    /// Whether a hand with this finding should not move before somebody has looked. The others make it slow, or are mended or
    /// refused by [`LeapHand::connect`](super::LeapHand::connect).
    pub fn stops_motion(self) -> bool {
        use FindingKind::{HardwareError, HighVoltage, HomingOffset, Hot, LowVoltage, SecondId};
        matches!(self, SecondId | HomingOffset | HardwareError | LowVoltage | HighVoltage | Hot)
    }
}

/// Something that is not as it should be.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Finding {
    /// Kind, by which it can be allowed.
    pub kind: FindingKind,
    /// The motor; `None` concerns all.
    pub motor: Option<u8>,
    /// What was found.
    pub what: String,
    /// How to mend it.
    pub fix: String,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.motor {
            Some(id) => write!(f, "motor {id}: {}; {}", self.what, self.fix),
            None => write!(f, "{}; {}", self.what, self.fix),
        }
    }
}

/// Refuses motion with findings that stop it, unless their kind is among `allowed`.
///
/// # Errors
/// [`Error::Value`] with every finding that stops the motion, how to mend it, and the name by which it is allowed.
pub fn refuse_motion(findings: &[Finding], allowed: &[FindingKind]) -> Result<()> {
    let against: Vec<&Finding> =
        findings.iter().filter(|f| f.kind.stops_motion() && !allowed.contains(&f.kind)).collect();
    if against.is_empty() {
        return Ok(());
    }
    let mut names: Vec<&str> = against.iter().map(|f| f.kind.name()).collect();
    names.dedup();
    let what: Vec<String> = against.iter().map(ToString::to_string).collect();
    Err(Error::value(
        format!("not as it should be, so it does not move: {}", what.join(". ")),
        format!("mend that, or allow it by name: {}", names.join(",")),
    ))
}
