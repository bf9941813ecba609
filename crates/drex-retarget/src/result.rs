//! What retargeting gives back.

use drex_core::Pose;
use drex_demo::{FrameFlag, HumanFinger};
use serde::{Deserialize, Serialize};

/// The quantity that is minimised; the names are those of dex-retargeting.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Objective {
    /// Vectors from the wrist to the fingertips.
    Vector,
    /// Vectors from the wrist to the fingertips and between fingertips, drawn together for a pinch.
    DexPilot,
    /// Positions of fingertips and middle joints; the robot's base floats.
    Position,
    /// Contacts with the object, over a whole sequence.
    Grasp,
}

/// A sequence, retargeted.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Retargeting {
    /// Joint names in the order of every `q`.
    pub joint_names: Vec<String>,
    /// The quantity that was minimised.
    pub objective: Objective,
    /// The scale of the human hand.
    pub scale: ScaleReport,
    /// One per frame of the demonstration.
    pub frames: Vec<RetargetedFrame>,
}

/// Scale between the human hand and the robot's.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ScaleReport {
    /// Factor on the human vectors.
    pub scale: f64,
    /// Whether it was found automatically.
    pub automatic: bool,
    /// Length of the human hand along the bones from the wrist to the tip of the middle finger (index or ring finger where it
    /// was never seen), medians over the frames, m; 0 where no finger was ever seen whole.
    #[serde(rename = "person_reach_m")]
    pub human_reach_m: f64,
    /// Largest distance of the robot's middle fingertip (or the longest finger's) from its wrist, m.
    pub hand_reach_m: f64,
}

impl ScaleReport {
    /// A remark where an automatic scale is unusual for key points in metres.
    pub fn note(&self) -> Option<String> {
        (self.automatic && !(0.8..=1.6).contains(&self.scale)).then(|| {
            format!(
                "the automatic scale is {:.3} (robot hand {:.0} mm, human hand {:.0} mm): key points in metres have 0.8 to 1.6; \
                 check their unit",
                self.scale,
                self.hand_reach_m * 1e3,
                self.human_reach_m * 1e3
            )
        })
    }
}

/// One frame, retargeted.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct RetargetedFrame {
    /// Seconds.
    pub t_s: f64,
    /// Joint vector in the model's order, rad, within the limits.
    pub q: Vec<f64>,
    /// Joint vector after the low-pass filter, in the model's order, rad, within the limits.
    pub q_filtered: Vec<f64>,
    /// Pose of the robot's base in the source frame: solved for by `position`, else so that the wrists and palms coincide. A frame
    /// that is no hand repeats the pose before, if there was one.
    pub source_from_base: Option<Pose>,
    /// Value of the objective at `q`, without regularisation; NaN in a frame that is no hand.
    pub objective: f64,
    /// Residual of each finger.
    pub fingers: Vec<FingerResidual>,
    /// Reasons not to trust the frame.
    pub flags: Vec<FrameFlag>,
}

/// Residual of one fingertip.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FingerResidual {
    /// The finger.
    pub finger: HumanFinger,
    /// Distance of the robot's fingertip from the scaled human one, mm; `None` where the human fingertip was not seen.
    pub residual_mm: Option<f64>,
}
