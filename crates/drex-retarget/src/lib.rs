//! Hand poses of people and other hands for a robot hand, aware of the object.
//!
//! Here so far: the wrist pose of grasps that were recorded as joint angles only ([`fit_wrist`], [`fit_wrists`]).
//!
//! # Conventions
//! Poses are `object_from_base`: of the robot's base in the object's mesh frame, metres. Joint vectors are in the model's order,
//! rad. The table is a plane in the object's frame that also says which way is up.

mod error;
mod wrist_fit;

pub use drex_grasp::TablePlane;
pub use error::{Result, RetargetError};
pub use wrist_fit::{FingerGap, ObjectSurface, Rejection, Verdict, WristFit, WristFitOptions, fit_wrist, fit_wrists};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
