//! Hand poses of humans for a robot hand, aware of the object.
//!
//! ```
//! use drex_demo::{HandSkeleton, Side};
//! use drex_retarget::{RetargetOptions, TargetHand, retarget};
//!
//! # fn main() -> drex_retarget::Result<()> {
//! let demonstration = HandSkeleton::new(Side::Left).moving(30);
//! let hand = TargetHand::resolve("allegro")?.for_side(demonstration.side);
//! let sequence = retarget(&demonstration, &hand, &RetargetOptions::default())?;
//! assert_eq!(sequence.frames.len(), 30);
//! # Ok(()) }
//! ```
//!
//! # Conventions
//! Poses are `a_from_b`: of b in a, metres. Joint vectors are in the model's order, rad. Key points are in the order of
//! MediaPipe. The operator frame of a hand ([`drex_demo::operator_frame`]) has its origin at the wrist, x out of the palm and z to the
//! fingertips. The table is a plane in the object's frame that also says which way is up.
//!
//! # Mapping files
//! What [`TargetHand::load`] cannot derive from a model, or should not, a TOML file says. Every key may be left out.
//!
//! | key | what |
//! |---|---|
//! | `model` | URDF or MJCF file, relative to the mapping file, or the name of a bundled robot |
//! | `side` | `"right"` or `"left"`; derived from where the thumb is |
//! | `wrist.link`, `wrist.point_m` | the wrist: a link that moves with the palm, and a point in its frame (its origin) |
//! | `wrist.palm`, `wrist.tips` | directions in the frame of `wrist.link`: out of the palm, to the tips of the open hand; derived from how the fingers bend |
//! | `fingers.NAME.tip` | `{ link = "…", point_m = [x, y, z] }` of `thumb`, `index`, `middle`, `ring` or `little`; with any of them, only these fingers are used |
//! | `fingers.NAME.middle` | the same, what follows the human middle joint in the `position` objective; the last joint but one (of two the last) |

// Tests within the crate share code with those outside.
#[cfg(test)]
extern crate self as drex_retarget;

mod augment;
mod error;
mod frame_checks;
mod grasp;
mod hand;
mod kinematics;
mod levenberg_marquardt;
mod measurements;
mod objective;
mod pad;
mod result;
mod retarget;
mod scale;
mod self_collision;
mod solve;
mod wrist_fit;

pub use augment::{AugmentOptions, Augmentation, AugmentedGrasp, augment, symmetries};
pub use error::{Error, Result};
pub use grasp::{FingerContact, GraspFrame, GraspOptions, GraspRetargeting, retarget_grasp};
pub use hand::{LinkPoint, TargetFinger, TargetHand};
pub use result::{FingerResidual, Objective, RetargetedFrame, Retargeting, ScaleReport};
pub use retarget::{RetargetOptions, Retargeter, Scale, retarget};
pub use wrist_fit::{WristFit, WristFitOptions, fit_wrist, fit_wrists};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
