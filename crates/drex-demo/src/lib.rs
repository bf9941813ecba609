#![doc = include_str!("../README.md")]

mod demonstration;
#[cfg(feature = "files")]
mod detect;
#[cfg(feature = "files")]
mod files;
mod keypoints;
mod quality;
mod register;
mod skeleton;

pub use demonstration::{Demonstration, HandFrame};
#[cfg(feature = "files")]
pub use detect::{ExternalDetector, HAMER_SCRIPT, HandDetector, MEDIAPIPE_SCRIPT, MediaPipe};
#[cfg(feature = "files")]
pub use files::{CropCamera, DemoUnit, HandPose, KeyPointOrder, LoadOptions, ManoModel, ManoPose, crop_to_full};
pub use keypoints::{
    HumanFinger, KEYPOINTS, KeyPoints, OperatorFrameError, Side, canonical, hand_length_m, mirrored, operator_frame,
    transformed,
};
pub use quality::{FrameCheck, FrameFlag, InputReport};
pub use register::{
    Placement, RegisterOptions, Registration, RegistrationSummary, parse_points, read_point_frames, read_points,
    register, register_sequence,
};
pub use skeleton::{FingerAngles, HandSkeleton};

/// The upper median; sorts the values.
pub(crate) fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
