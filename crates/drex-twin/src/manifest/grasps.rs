//! `[grasps]`: what was recorded of hands.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use drex_core::{Error, Result};

/// Recorded grasps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraspsConfig {
    /// Of a robot: JSON or npy, as `drex_recording::readers::read_grasps` takes them. Of a person: a demonstration (key points of the hand
    /// and poses of the object), or a folder of them.
    pub file: PathBuf,
    /// Who was recorded.
    #[serde(default, skip_serializing_if = "RecordedAs::is_robot")]
    pub recorded: RecordedAs,
    /// A bundled hand (`leap_right`) or the path of a URDF or MJCF file.
    pub hand: String,
    /// Order of the joints, such as `leap_sdk`, for files that name no joints.
    pub joint_order: Option<String>,
    /// Grasps to make of each demonstration of a person beside its own frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub augment: Option<usize>,
    /// Most that any joint of the hand gives, N m: needed where its model names no torque, a limit where it does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub torque_cap_nm: Option<f64>,
}

impl GraspsConfig {
    pub(super) fn check(&self) -> Result<()> {
        let refuse = |what: String, remedy: &str| Err(Error::value(what, remedy));
        if self.hand.trim().is_empty() {
            return refuse(
                "[grasps] hand is empty".into(),
                "name a bundled hand such as leap_right, or a URDF or MJCF file",
            );
        }
        if let Some(cap) = self.torque_cap_nm
            && !(cap > 0.0 && cap.is_finite())
        {
            return refuse(
                format!("[grasps] torque_cap_nm = {cap}"),
                "give what the motor of a joint gives, N m, or leave it out for what the hand's model says",
            );
        }
        if let Some(count) = self.augment {
            if self.recorded.is_robot() {
                return refuse(
                    format!("[grasps] augment = {count} is for demonstrations of a person"),
                    "add recorded = \"human\" if the file holds key points, or leave augment out",
                );
            }
            if count == 0 {
                return refuse("[grasps] augment = 0".into(), "give how many grasps to make, or leave it out");
            }
        }
        if let (RecordedAs::Human, Some(order)) = (self.recorded, &self.joint_order) {
            return refuse(
                format!("[grasps] joint_order = \"{order}\" is for a robot's joint angles"),
                "leave it out: a person's key points have no joints",
            );
        }
        Ok(())
    }
}

/// Whose hand a file of grasps recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RecordedAs {
    /// A robot's: joint angles.
    #[default]
    Robot,
    /// A person's: key points, retargeted with contacts on the object.
    Human,
}

impl RecordedAs {
    fn is_robot(&self) -> bool {
        *self == Self::Robot
    }
}
