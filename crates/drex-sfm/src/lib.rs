//! Cameras and sparse points from photos of an object, or a verdict that says why not.
//!
//! ```text
//! photos ─► keypoints ─► matches ─► still background out ─► focal vote ─► verified pairs ─► triplet check
//!                                                                                              │
//!            models, report ◄─ poses with sigma ◄─ last adjustment ◄─ sub-pixels ◄─ mapping ◄──┘
//! ```
//! Keypoints, matching, two-view geometry and mapping are openmvg's; what captures of objects need on top is here.

mod adjust;
mod cameras;
mod features;
mod mapping;
pub mod marker;
pub mod masks;
mod matching;
mod model;
mod photos;
pub mod programs;
mod register;
mod relocate;
mod report;
mod still;
mod subpixel;
mod triplets;
mod verdict;
mod verify;

pub use cameras::FocalSource;
pub use register::{InputPhoto, RegisterOptions, Registration, Step, register};
pub use report::{LensReport, ModelReport, PhotoReport, Report};
pub use verdict::{Cause, Verdict};

/// Runs the examples of the README as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
