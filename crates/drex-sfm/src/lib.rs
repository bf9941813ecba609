//! Cameras and sparse points from photos of an object, or a verdict that says why not.
//!
//! ```text
//! photos ─► keypoints ─► matches ─► still background out ─► focal vote ─► verified pairs ─► triplet check
//!                                                                                              │
//!            models, report ◄─ poses with sigma ◄─ last adjustment ◄─ sub-pixels ◄─ mapping ◄──┘
//! ```
//! Keypoints, matching, two-view geometry and mapping are openmvg's; what captures of objects need on top is here.

mod adjust;
mod calibration;
mod cameras;
mod distance;
mod features;
mod folder;
mod front_end;
mod mapping;
pub mod marker;
pub mod masks;
mod matching;
mod model;
mod photos;
pub mod picture;
pub mod programs;
mod refine;
mod register;
mod relocate;
mod report;
mod result;
mod scale;
mod still;
mod subpixel;
mod triplets;
mod verdict;
mod verify;
pub mod video;

pub use calibration::read_calibration;
pub use cameras::FocalSource;
pub use folder::PhotoFolder;
pub use front_end::{InputPhoto, RegisterOptions, Step};
pub use register::{Registration, register};
pub use report::{LensReport, ModelReport, PhotoReport, Report};
pub use result::{
    FolderOptions, FolderRegistration, FolderReport, StoredReport, check_output, register_folder, remove,
};
pub use scale::{MarkerReport, measure_marker, scale_by_marker};
pub use verdict::{Cause, Verdict};

/// Runs the examples of the README as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
