//! A robot hand to retarget to: where on the model the human wrist and fingertips are.

mod check;
mod derive;
mod frame;
mod mapping;
mod names;

use std::path::Path;

use drex_core::Pose;
use drex_demo::{HumanFinger, Side};
use drex_robot::{MirrorPlane, Robot};
use nalgebra::Point3;

use crate::Result;
use mapping::Mapping;

/// A robot with a human hand mapped onto it.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct TargetHand {
    /// The model. Joints that move the palm (an arm, a wrist) are held where the model's zero has them: their limits are closed.
    pub robot: Robot,
    /// Which hand the model is.
    pub side: Side,
    /// Operator frame of the hand (see [`drex_demo::operator_frame`]) in the frame of the robot's base, m.
    pub base_from_operator: Pose,
    /// The fingers that have a human counterpart, thumb first.
    pub fingers: Vec<TargetFinger>,
    /// What was derived from the model, what is held or coupled, and what looks odd; one sentence each.
    pub notes: Vec<String>,
}

/// One finger.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct TargetFinger {
    /// The human finger that it follows.
    pub human: HumanFinger,
    /// The fingertip.
    pub tip: LinkPoint,
    /// The point that follows the human [`HumanFinger::middle`], for the `position` objective.
    pub middle: LinkPoint,
    /// Joints between palm and tip, from the palm on.
    pub joints: Vec<usize>,
}

/// A point fixed to a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkPoint {
    /// Index of the link.
    pub link: usize,
    /// The point in the link's frame, m.
    pub point: Point3<f64>,
}

/// Names, robots and mappings of the bundled hands.
const BUNDLED: [(&str, &str, &str); 2] = [
    ("leap", "leap_right", include_str!("../mappings/leap_right.toml")),
    ("allegro", "allegro_right", include_str!("../mappings/allegro_right.toml")),
];

impl TargetHand {
    /// A bundled hand: `leap_right`, `allegro_right` (also `leap`, `allegro`), or `leap_left`, `allegro_left`, which are their
    /// mirror images.
    ///
    /// # Errors
    /// If there is no bundled hand of that name.
    pub fn bundled(name: &str) -> Result<Self> {
        for (short, right, text) in BUNDLED {
            if name == short || name == right {
                return Self::with_mapping(Robot::bundled(right)?, Path::new(right), text);
            }
            if right.strip_suffix("right").zip(name.strip_suffix("left")).is_some_and(|(a, b)| a == b) {
                return Ok(Self::bundled(right)?.mirrored());
            }
        }
        Self::derive(Robot::bundled(name)?)
    }

    /// A bundled hand by name, or what [`TargetHand::load`] makes of a file.
    ///
    /// # Errors
    /// As [`TargetHand::load`], and if there is neither a bundled hand nor a file of that name.
    pub fn resolve(name_or_path: &str) -> Result<Self> {
        let path = Path::new(name_or_path);
        if path.extension().is_some() || path.is_file() { Self::load(path, None) } else { Self::bundled(name_or_path) }
    }

    /// A hand from files. `model` is a URDF or MJCF file; `mapping` says what the model does not (see the crate's
    /// documentation), what it leaves out is derived; a model that the mapping names gives way to `model`. `model` may also be a mapping file that names its model
    /// (`model = "hand.urdf"`, relative to the mapping file, or the name of a bundled robot).
    ///
    /// # Errors
    /// If a file cannot be read, names what the model does not have, or contradicts the model: the message says what, where,
    /// and what to write instead.
    pub fn load(model: &Path, mapping: Option<&Path>) -> Result<Self> {
        if model.extension().is_some_and(|e| e == "toml") {
            let parsed = Mapping::read(model)?;
            let robot = Robot::resolve(parsed.require_model(model)?, model.parent().unwrap_or(Path::new("")))?;
            return Self::build(robot, model, parsed);
        }
        let robot = Robot::load(model)?;
        match mapping {
            Some(path) => Self::build(robot, path, Mapping::read(path)?),
            None => Self::build(robot, model, Mapping::default()),
        }
    }

    /// A hand of which everything is derived from the model: fingers by name, else by their order along the palm; palm and
    /// direction of the fingers from how they bend; side from where the thumb is; wrist from a link of that name, else from the
    /// end of the palm. [`TargetHand::notes`] says how each was found.
    ///
    /// # Errors
    /// If the model is no hand: no thumb, no other finger, or nothing that tells left from right.
    pub fn derive(robot: Robot) -> Result<Self> {
        let name = robot.name.clone();
        Self::build(robot, Path::new(&name), Mapping::default())
    }

    /// `robot` with the text of a mapping file; `path` is for messages only.
    ///
    /// # Errors
    /// As [`TargetHand::load`].
    pub fn with_mapping(robot: Robot, path: &Path, text: &str) -> Result<Self> {
        Self::build(robot, path, Mapping::parse(path, text)?)
    }

    /// The mirror image: the other hand. Mirrored key points of the other side give the same joint values on it.
    pub fn mirrored(&self) -> Self {
        let plane = MirrorPlane::Y;
        let mirror = |p: &LinkPoint| LinkPoint { link: p.link, point: plane.point(&p.point) };
        let fingers = self.fingers.iter();
        Self {
            robot: self.robot.mirrored_through(plane),
            side: self.side.other(),
            // The operator's y axis, too, turns around.
            base_from_operator: plane.pose(&self.base_from_operator),
            fingers: fingers
                .map(|f| TargetFinger { tip: mirror(&f.tip), middle: mirror(&f.middle), ..f.clone() })
                .collect(),
            notes: self.notes.iter().cloned().chain([format!("mirror image of \"{}\"", self.robot.name)]).collect(),
        }
    }

    /// This hand if it is a `side` hand, else its mirror image.
    pub fn for_side(self, side: Side) -> Self {
        if self.side == side { self } else { self.mirrored() }
    }

    /// The finger that follows the human `human`.
    pub fn finger(&self, human: HumanFinger) -> Option<&TargetFinger> {
        self.fingers.iter().find(|f| f.human == human)
    }

    fn build(mut robot: Robot, path: &Path, mapping: Mapping) -> Result<Self> {
        let mut notes = Vec::new();
        check::couplings(&robot, path, &mut notes)?;
        let mut fingers = derive::fingers(&robot, path, &mapping, &mut notes)?;
        let palm_joints = derive::hold_palm(&mut robot, &mut fingers, &mut notes);
        let rest = frame::Rest::new(&robot, path, &mapping, palm_joints);
        check::tips(&rest, &fingers)?;
        let bends = frame::Bends::new(&rest, &fingers)?;
        let fingers = derive::label(&rest, &bends, fingers, &mut notes)?;
        let base_from_operator = derive::operator(&rest, &bends, &fingers, &mut notes)?;
        check::frame(&rest, &bends, &base_from_operator, &fingers, &mut notes)?;
        let side = check::side(&rest, &base_from_operator, &fingers, &mut notes)?;
        Ok(Self { robot, side, base_from_operator, fingers, notes })
    }
}
