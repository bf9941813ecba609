//! The error type of the crate: what was wrong, where, and what to do.

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong between a program and a hand.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A number means nothing or is not allowed.
    #[error("hand: {what}; {remedy}")]
    Value {
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// A hand, its file or its settings are not as they have to be; the message says what to do.
    #[error("{0}")]
    NotAllowed(String),
    /// A run ended because of a failure; the message says what became of the torque.
    #[error("{off}")]
    RunEnded {
        /// What became of the torque.
        off: String,
        /// Why the run ended.
        #[source]
        source: Box<Error>,
    },
    /// A file could not be read or written.
    #[error(transparent)]
    File(#[from] drex_core::Error),
    /// Too few pairs to fit a model.
    #[error(
        "torque-current model: {have} usable pairs at {distinct} different currents; measure at least {need} at {need} currents"
    )]
    TooFewPairs {
        /// Pairs with a current above zero.
        have: usize,
        /// Different currents among them.
        distinct: usize,
        /// How many are needed.
        need: usize,
    },
    /// More current does not mean more torque.
    #[error("torque-current model: {what} is not monotone; {remedy}")]
    NotMonotone {
        /// What is not.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// A torque or current outside of what was calibrated.
    #[error("torque-current model: {value} {unit} is outside of the calibrated 0 to {most} {unit}; {remedy}")]
    OutOfRange {
        /// What was asked for.
        value: f64,
        /// Its unit.
        unit: &'static str,
        /// The largest there is.
        most: f64,
        /// What to do about it.
        remedy: &'static str,
    },
    /// The robot model refused.
    #[error("hand model: {0}")]
    Model(#[from] drex_robot::Error),
    /// The port failed.
    #[error("port {port}: {source}; {remedy}")]
    Port {
        /// Name of the port.
        port: String,
        /// What the system said.
        source: std::io::Error,
        /// What to do about it.
        remedy: String,
    },
    /// A joint is not as it has to be.
    #[error("joint {joint} (motor {id}): {what}; {remedy}")]
    Joint {
        /// Name of the joint.
        joint: String,
        /// Its motor.
        id: u8,
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// No motor of a hand answers.
    #[error("no motor of the hand answers in time on {port}; {remedy}")]
    NoMotors {
        /// Name of the port.
        port: String,
        /// What to do about it.
        remedy: String,
    },
    /// Joints that never told where they are.
    #[error("hand: nothing was ever read of {joints}; check power and cables, and scan for the motors")]
    NeverRead {
        /// Their names.
        joints: String,
    },
    /// The loop cannot have a thread.
    #[error("no thread for the control loop: {0}; end other programs, or raise the limit on threads")]
    Thread(std::io::Error),
    /// Signals cannot be caught.
    #[error("signals cannot stop the hand: {0}; stop it otherwise")]
    Signals(std::io::Error),
    /// The guard of a port cannot be started.
    #[error("no guard for the port: {what}; {remedy}")]
    Guard {
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// Nobody confirmed that the torque of these joints is off.
    #[error(
        "torque unknown: {joints} did not answer; a motor without power has no torque, otherwise switch its power off"
    )]
    TorqueUnknown {
        /// Joints and motors.
        joints: String,
    },
    /// A motor does not answer.
    #[error("motor {id} does not answer; check its power, cable, id and speed (baud)")]
    Silent {
        /// Who.
        id: u8,
    },
    /// A motor answers that it does not do what it was asked.
    #[error("motor {id} refuses: {}", status_meaning(*.number))]
    Refused {
        /// Who.
        id: u8,
        /// Number in the status packet.
        number: u8,
    },
}

/// What the error number of a status packet means, and what to do.
fn status_meaning(number: u8) -> &'static str {
    match number {
        1 => "it failed to do it (1); reboot it",
        2 => "it does not know the instruction (2); update its firmware",
        3 => "it got a damaged packet (3); check the cable",
        4 => "the value is out of range (4), or its bus watchdog has run out; clear the watchdog first",
        5 => "the value has the wrong length (5); check the control table of its model",
        6 => "the value is beyond a limit set in the motor (6); stay within the current limit in register 38",
        7 => {
            "the register is locked or read-only, or there is none at this address to read (7); take its torque off before a write, and read only addresses that its control table has"
        }
        _ => "an error number that the protocol does not have; check its firmware",
    }
}

impl Error {
    pub(crate) fn value(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Value { what: what.into(), remedy: remedy.into() }
    }

    /// By whom and why the torque was taken off, if the guard of the port has done that, or its end: there is no way back for this
    /// connection.
    #[cfg(unix)]
    pub fn taken_over(&self) -> Option<&crate::TakenOver> {
        let Self::Port { source, .. } = self else { return None };
        source.get_ref()?.downcast_ref()
    }

    pub(crate) fn is_taken_over(&self) -> bool {
        #[cfg(unix)]
        return self.taken_over().is_some();
        #[cfg(not(unix))]
        false
    }

    /// Whether the same would come of another try.
    pub(crate) fn is_final(&self) -> bool {
        // A command or state that means nothing does not become better by waiting.
        matches!(self, Self::Value { .. }) || self.is_taken_over()
    }
}
