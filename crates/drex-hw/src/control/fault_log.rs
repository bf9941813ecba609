//! What went wrong with joints while the loop ran.

use std::fmt;

use crate::{HandState, JointStatus};

/// What went wrong with a joint. A joint can have more than one of these.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum JointFault {
    /// It was not well at the end: silent, faulted or being started again.
    Lasting(JointStatus),
    /// It was not well for a while, and is again.
    Recovered {
        /// The last that was wrong.
        from: JointStatus,
        /// Cycles in all; a single one is a lost packet.
        cycles: u64,
    },
    /// It had a hardware error; the number is the device's own, several are or-ed. It may be well again.
    HardwareError(u8),
    /// Heat took something from its limit.
    Derated {
        /// Hottest that it was, °C.
        celsius: f64,
        /// Smallest share of its cap that was left.
        share: f64,
    },
    /// Too little supply voltage took something from its limit.
    LowVoltage {
        /// Least supply that it had, V.
        volts: f64,
        /// Smallest share of its cap that was left.
        share: f64,
    },
}

impl fmt::Display for JointFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lasting(status) => write!(f, "{} at the end", name(*status)),
            Self::Recovered { from, cycles } => write!(f, "{} for {cycles} cycles, well again", name(*from)),
            Self::HardwareError(code) => write!(f, "had a hardware error ({code:#04x})"),
            Self::LowVoltage { volts, share } => {
                write!(f, "down to {volts:.1} V of supply, its limit down to {:.0} % of the cap", share * 100.0)
            }
            Self::Derated { celsius, share } => {
                write!(f, "up to {celsius:.0} °C, its limit down to {:.0} % of the cap", share * 100.0)
            }
        }
    }
}

fn name(status: JointStatus) -> String {
    match status {
        JointStatus::TorqueOff => "without torque".into(),
        JointStatus::Driven => "well".into(),
        JointStatus::Silent => "silent".into(),
        JointStatus::Faulted(code) => format!("faulted (error {code:#04x})"),
        JointStatus::Recovering => "started again after a fault".into(),
    }
}

#[derive(Debug, Clone, Copy)]
struct Seen {
    now: JointStatus,
    /// The last that was wrong.
    wrong: JointStatus,
    cycles: u64,
    errors: u8,
    celsius: f64,
    share: f64,
    volts: f64,
    volt_share: f64,
}

/// Collects them, without allocating after it was made.
#[derive(Debug)]
pub(super) struct FaultLog(Vec<Seen>);

impl FaultLog {
    pub fn new(joints: usize) -> Self {
        let well = Seen {
            now: JointStatus::TorqueOff,
            wrong: JointStatus::TorqueOff,
            cycles: 0,
            errors: 0,
            celsius: f64::NEG_INFINITY,
            share: 1.0,
            volts: f64::INFINITY,
            volt_share: 1.0,
        };
        Self(vec![well; joints])
    }

    /// Takes a state that was read.
    pub fn see(&mut self, state: &HandState) {
        for ((seen, status), errors) in self.0.iter_mut().zip(&state.status).zip(&state.hardware_error) {
            seen.now = *status;
            seen.errors |= errors;
            if is_wrong(*status) {
                seen.wrong = *status;
                seen.cycles += 1;
            }
        }
    }

    /// Takes a limit that heat lowered to a share of the cap.
    pub fn derate(&mut self, joint: usize, celsius: f64, share: f64) {
        if let Some(seen) = self.0.get_mut(joint) {
            seen.celsius = seen.celsius.max(celsius);
            seen.share = seen.share.min(share);
        }
    }

    /// Takes a limit that a low supply lowered to a share of the cap.
    pub fn sag(&mut self, joint: usize, volts: f64, share: f64) {
        if let Some(seen) = self.0.get_mut(joint) {
            seen.volts = seen.volts.min(volts);
            seen.volt_share = seen.volt_share.min(share);
        }
    }

    /// What there was, with the index of the joint, in the order of the joints.
    pub fn list(&self) -> Vec<(usize, JointFault)> {
        let mut list = Vec::new();
        for (joint, seen) in self.0.iter().enumerate() {
            if is_wrong(seen.now) {
                list.push((joint, JointFault::Lasting(seen.now)));
            } else if seen.cycles > 0 {
                list.push((joint, JointFault::Recovered { from: seen.wrong, cycles: seen.cycles }));
            }
            if seen.errors != 0 {
                list.push((joint, JointFault::HardwareError(seen.errors)));
            }
            if seen.volt_share < 1.0 {
                list.push((joint, JointFault::LowVoltage { volts: seen.volts, share: seen.volt_share }));
            }
            if seen.share < 1.0 {
                list.push((joint, JointFault::Derated { celsius: seen.celsius, share: seen.share }));
            }
        }
        list
    }
}

fn is_wrong(status: JointStatus) -> bool {
    matches!(status, JointStatus::Silent | JointStatus::Faulted(_) | JointStatus::Recovering)
}
