//! Hand poses of people and other hands for a robot hand, aware of the object.
//!
//! # Conventions
//! Poses are `a_from_b`: of b in a, metres. Joint vectors are in the model's order, rad. Key points are in the order of
//! MediaPipe. The table is a plane in the object's frame that also says which way is up.

// Tests within the crate share code with those outside.
#[cfg(test)]
extern crate self as drex_retarget;

mod demo;
mod detect;
mod error;
mod flags;
mod hand;
mod keypoints;
mod kinematics;
mod objective;
mod person;
mod register;
mod result;
mod retarget;
mod scale;
mod skeleton;
mod solve;
mod wrist_fit;

pub use demo::{
    CropCamera, DemoUnit, Demonstration, FrameCheck, HandFrame, HandPose, InputReport, KeyPointOrder, LoadOptions,
    ManoModel, ManoPose, crop_to_full,
};
pub use detect::{ExternalDetector, HAMER_SCRIPT, HandDetector, MEDIAPIPE_SCRIPT, MediaPipe};
pub use drex_grasp::TablePlane;
pub use error::{Result, RetargetError};
pub use hand::{LinkPoint, TargetFinger, TargetHand};
pub use keypoints::{
    FrameError, HumanFinger, KEYPOINTS, KeyPoints, Side, canonical, hand_length_m, mirrored, operator_frame,
    transformed,
};
pub use register::{
    Placement, RegisterOptions, Registration, RegistrationSummary, parse_points, read_points, register, register_clip,
};
pub use result::{FingerResidual, Flag, Objective, RetargetedFrame, Retargeting, ScaleReport};
pub use retarget::{RetargetOptions, Retargeter, Scale, retarget};
pub use skeleton::{FingerAngles, HandSkeleton};
pub use wrist_fit::{FingerGap, ObjectSurface, Rejection, Verdict, WristFit, WristFitOptions, fit_wrist, fit_wrists};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
