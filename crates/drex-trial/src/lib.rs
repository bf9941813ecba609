//! Lift, hold, shake: the protocol by which a grasp is evaluated in a simulator.
//!
//! The object rests on the table. The open hand comes near, closes until the fingers touch, grips as commanded, lifts by
//! 20 cm in 2 s, holds for 3 s and is shaken six times. [`Trial::run`] says whether the object stayed in the hand and, if not,
//! what went wrong first.
//!
//! What the hand assumes ([`Assumed`]) and what is true ([`Truth`]) are kept apart: a command is made from the former
//! alone.

mod assumed;
mod closing;
mod command;
mod control;
mod engine;
mod error;
mod evaluator;
mod find;
mod hand_and_object;
mod mismatch;
mod options;
mod outcome;
mod path;
mod reach;
mod selection;
mod stats;
mod stoppable;
mod timeline;
mod trial;
mod uncertainty;
mod watch;

pub use assumed::{Assumed, Truth};
pub use closing::ClosingPlan;
pub use command::{Command, GripForce, NoCommand};
pub use control::ContactForce;
pub use engine::Engine;
pub use error::{Error, Result};
pub use evaluator::{Condition, ConditionSpread, Evaluation, Evaluator, TrialEvaluator, rollouts};
pub use find::{FindOptions, TriedGrasp, find_grasp, find_grasp_among, find_grasp_watched};
pub use mismatch::Mismatch;
pub use options::TrialOptions;
pub use outcome::{Outcome, Verdict};
pub use path::{GraspPath, PathForce, PlannedGrasp, Proposal, sort_proposals};
pub use reach::Reach;
pub use selection::{DemonstrationCounts, Selection, SelectionOptions, ValidatedGrasp, select_grasps};
pub use stats::{Interval, clustered, clustered_difference, paired_difference, wilson};
pub use stoppable::Stoppable;
pub use timeline::phases;
pub use trial::{Frame, Trial};
pub use uncertainty::Uncertainty;

// The test double in tests/doubles is a file of several crates.
#[cfg(test)]
extern crate self as drex_trial;
#[cfg(test)]
#[path = "../tests/doubles/formula.rs"]
mod formula;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
