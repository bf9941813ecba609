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
    /// Too few pairs to fit a law.
    #[error(
        "torque law: {have} usable pairs at {distinct} different currents; measure at least {need} at {need} currents"
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
    #[error("torque law: {what} is not monotone; {remedy}")]
    NotMonotone {
        /// What is not.
        what: String,
        /// What to do about it.
        remedy: String,
    },
    /// A torque or current outside of what was calibrated.
    #[error("torque law: {value} {unit} is outside of the calibrated 0 to {most} {unit}; {remedy}")]
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
}

impl Error {
    pub(crate) fn value(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Value { what: what.into(), remedy: remedy.into() }
    }
}
