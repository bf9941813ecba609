//! What a lab records of an object and a robot: pose tracks, joint logs, forces, clocks, grasps, and the push that they make.
//!
//! A recorded push is one value on one clock, whatever files it came in:
//!
//! ```no_run
//! use drex_recording::{Drive, PushRecording};
//!
//! let push = PushRecording::load("twin/push/push1".as_ref())?;
//! println!("{}: {}", push.name, push.notes.join("; "));
//! if let Drive::Hand(hand) = &push.drive {
//!     println!("{} moved it; joints {}", hand.robot, hand.joints.names.join(", "));
//! }
//! # Ok::<(), drex_core::Error>(())
//! ```
//!
//! The conventions of frames, units and quaternions are those of [`drex_core`]; errors are [`drex_core::Error`]: what was wrong,
//! in which file and line, and what to do. No input makes the crate panic.

pub mod clock;
pub mod convert;
mod push;
pub mod readers;
mod series;

pub use push::{
    ClockConfig, ClockKind, Drive, FingerConfig, FingerImpedance, FingerPush, ForceConfig, FrameKind, Free, HandConfig,
    HandPush, PoseConfig, PushConfig, PushRecording, StartConfig, StatedParameter, Support, SupportBox, TrackConfig,
    TrackFormat, TrackFrame, mesh_sd_m,
};
pub use series::{EncoderTrack, ForceProfile, JointLog, JointPoses, PointSeries};

/// Runs the examples of the README as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
