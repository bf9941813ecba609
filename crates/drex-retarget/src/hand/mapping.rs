//! The mapping file.

use std::collections::BTreeMap;
use std::path::Path;

use drex_core::fsutil;
use drex_demo::{HumanFinger, Side};
use drex_robot::Robot;
use nalgebra::Point3;
use serde::Deserialize;

use super::{LinkPoint, names};
use crate::{Error, Result};

/// What a mapping file may say; what it leaves out is derived from the model.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Mapping {
    model: Option<String>,
    pub(super) side: Option<Side>,
    #[serde(default)]
    pub(super) wrist: WristMapping,
    #[serde(default)]
    pub(super) fingers: BTreeMap<HumanFinger, FingerMapping>,
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WristMapping {
    pub(super) link: Option<String>,
    pub(super) point_m: Option<[f64; 3]>,
    pub(super) palm: Option<[f64; 3]>,
    pub(super) tips: Option<[f64; 3]>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FingerMapping {
    pub(super) tip: PointMapping,
    pub(super) middle: Option<PointMapping>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PointMapping {
    pub(super) link: String,
    #[serde(default)]
    pub(super) point_m: [f64; 3],
}

impl Mapping {
    pub(super) fn read(path: &Path) -> Result<Self> {
        Self::parse(path, &fsutil::read_text(path)?)
    }

    pub(super) fn parse(path: &Path, text: &str) -> Result<Self> {
        let mapping: Self = fsutil::from_toml(path, text)?;
        let wrist = &mapping.wrist;
        if wrist.link.is_none() && (wrist.point_m.is_some() || wrist.palm.is_some() || wrist.tips.is_some()) {
            return Err(Error::mapping(
                path,
                "wrist",
                "point_m, palm and tips are in the frame of no link",
                "add link",
            ));
        }
        if wrist.palm.is_some() != wrist.tips.is_some() {
            return Err(Error::mapping(path, "wrist", "one of palm and tips is missing", "give both or neither"));
        }
        Ok(mapping)
    }

    /// The robot model that the file names.
    pub(super) fn require_model(&self, path: &Path) -> Result<&str> {
        let remedy = "add model = \"hand.urdf\" or give the model beside the mapping";
        self.model.as_deref().ok_or_else(|| Error::mapping(path, "model", "no model is named", remedy))
    }
}

impl PointMapping {
    /// The point on `robot`; `key` is where it stands in the file.
    pub(super) fn find(&self, robot: &Robot, path: &Path, key: &str) -> Result<LinkPoint> {
        Ok(LinkPoint { link: find_link(robot, path, key, &self.link)?, point: Point3::from(self.point_m) })
    }
}

/// Index of the link called `name`, or an error that names the most similar one.
pub(super) fn find_link(robot: &Robot, path: &Path, key: &str, name: &str) -> Result<usize> {
    robot.link_index(name).ok_or_else(|| {
        let known: Vec<&str> = robot.links.iter().map(|l| l.name.as_str()).collect();
        let remedy = match names::most_similar(name, &known) {
            Some(similar) => format!("did you mean \"{similar}\"? The links are {}", known.join(", ")),
            None => format!("use one of {}", known.join(", ")),
        };
        Error::mapping(path, key, format!("robot \"{}\" has no link \"{name}\"", robot.name), remedy)
    })
}
