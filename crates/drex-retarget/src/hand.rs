//! A robot hand to retarget to: where on the model the person's wrist and fingertips are.

use std::path::Path;

use drex_core::{Pose, fsutil};
use drex_robot::Robot;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use crate::{HumanFinger, Result, RetargetError, Side};

/// A robot with a person's hand mapped onto it.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct TargetHand {
    /// The model.
    pub robot: Robot,
    /// Which hand the model is.
    pub side: Side,
    /// Operator frame of the hand (see [`crate::operator_frame`]) in the frame of the robot's base, m.
    pub base_from_operator: Pose,
    /// The fingers that have a human counterpart, thumb first.
    pub fingers: Vec<TargetFinger>,
}

/// One finger.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct TargetFinger {
    /// The person's finger that it follows.
    pub human: HumanFinger,
    /// The fingertip.
    pub tip: LinkPoint,
    /// The point that follows the person's [`HumanFinger::middle`], for the `position` objective.
    pub middle: LinkPoint,
}

/// A point fixed to a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkPoint {
    /// Index of the link.
    pub link: usize,
    /// The point in the link's frame, m.
    pub point: Point3<f64>,
}

/// The mapping file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Mapping {
    side: Side,
    wrist: WristMapping,
    fingers: std::collections::BTreeMap<HumanFinger, FingerMapping>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct WristMapping {
    link: String,
    #[serde(default)]
    point_m: [f64; 3],
    palm: [f64; 3],
    tips: [f64; 3],
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct FingerMapping {
    tip: PointMapping,
    middle: PointMapping,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct PointMapping {
    link: String,
    #[serde(default)]
    point_m: [f64; 3],
}

/// Mappings of the bundled hands.
const BUNDLED: [(&str, &str); 2] = [
    ("leap_right", include_str!("../mappings/leap_right.toml")),
    ("allegro_right", include_str!("../mappings/allegro_right.toml")),
];

impl TargetHand {
    /// A bundled hand: `leap_right` or `allegro_right`.
    ///
    /// # Errors
    /// If there is no bundled hand of that name.
    pub fn bundled(name: &str) -> Result<Self> {
        let robot = Robot::bundled(name)?;
        let Some((_, text)) = BUNDLED.iter().find(|(n, _)| *n == name) else {
            return Err(RetargetError::value(
                format!("the bundled robot \"{name}\" has no mapping"),
                "use leap_right or allegro_right",
            ));
        };
        Self::with_mapping(robot, Path::new(name), text)
    }

    /// `robot` with the text of a mapping file; `path` is for messages only.
    ///
    /// # Errors
    /// If the text is no mapping or does not fit the robot.
    pub fn with_mapping(robot: Robot, path: &Path, text: &str) -> Result<Self> {
        let mapping: Mapping = fsutil::from_toml(path, text)?;
        let poses = robot.forward_kinematics(&robot.reference_position(), &Pose::identity());
        let wrist = robot.require_link(&mapping.wrist.link)?;
        let (palm, tips) = (Vector3::from(mapping.wrist.palm), Vector3::from(mapping.wrist.tips));
        let (Some(tips), Some(y)) = (tips.try_normalize(1e-9), tips.cross(&palm).try_normalize(1e-9)) else {
            return Err(RetargetError::value(
                format!("{}: [wrist] palm and tips are parallel or zero", path.display()),
                "give two directions at right angles",
            ));
        };
        let axes = Matrix3::from_columns(&[y.cross(&tips), y, tips]);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let link_from_operator = Isometry3::from_parts(Translation3::from(mapping.wrist.point_m), rotation);
        let fingers = mapping
            .fingers
            .iter()
            .map(|(&human, f)| {
                let point = |p: &PointMapping| -> Result<LinkPoint> {
                    Ok(LinkPoint { link: robot.require_link(&p.link)?, point: Point3::from(p.point_m) })
                };
                Ok(TargetFinger { human, tip: point(&f.tip)?, middle: point(&f.middle)? })
            })
            .collect::<Result<Vec<_>>>()?;
        let base_from_operator = poses[wrist] * link_from_operator;
        Ok(Self { robot, side: mapping.side, base_from_operator, fingers })
    }
}
