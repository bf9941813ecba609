//! Lift, hold, shake: the protocol by which a grasp is judged in a simulator.
//!
//! The object rests on the table. The open hand comes near, closes until the fingers touch, squeezes as commanded, lifts by
//! 20 cm in 2 s, holds for 3 s and is shaken six times. [`Trial::run`] says whether the object stayed in the hand and, if not,
//! what went wrong first.
//!
//! What the hand is told ([`Belief`]) and what is true ([`Truth`]) are kept apart: a command is made from the belief
//! alone.

mod command;
mod control;
mod engine;
mod error;
mod reach;
mod stats;
mod timeline;
mod trial;
mod types;
mod watch;

pub use command::{Rehearsal, needed_force};
pub use control::Push;
pub use error::{Error, Result};
pub use reach::{Reach, plan as plan_reach};
pub use stats::{Interval, paired_difference, wilson};
pub use timeline::phases;
pub use trial::Trial;
pub use types::{
    Belief, Command, Frame, Judge, NoCommand, Outcome, Squeeze, TrialObject, TrialOptions, Truth, Verdict,
};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
