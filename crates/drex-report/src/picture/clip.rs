//! The contact sheet of a clip.

use std::path::Path;

use crate::Result;
use drex_core::{Pose, TriMesh, fsutil};
use drex_robot::Robot;

use super::hand::HandShapes;
use super::raster::Part;
use super::sheet::contact_sheet;

const OBJECT_COLOR: [f64; 3] = [0.86, 0.55, 0.30];

/// Hand and object in one frame.
pub struct Posed<'a> {
    /// Number that is printed on the picture.
    pub frame: usize,
    /// Joint angles in the model's order, rad.
    pub q: &'a [f64],
    /// Pose of the hand's base.
    pub world_from_base: Pose,
    /// Pose of the object, if it is drawn.
    pub world_from_object: Option<Pose>,
}

/// Draws every `every`-th frame.
pub fn write(path: &Path, robot: &Robot, object: Option<&TriMesh>, poses: &[Posed<'_>], every: usize) -> Result<()> {
    let shapes = HandShapes::new(robot);
    let links: Vec<_> =
        poses.iter().step_by(every).map(|p| (p, robot.forward_kinematics(p.q, &p.world_from_base))).collect();
    let mut subject = None;
    let scenes: Vec<_> = links
        .iter()
        .map(|(p, links)| {
            let mut parts = shapes.parts(links);
            if let Some((mesh, pose)) = object.zip(p.world_from_object) {
                subject = Some(parts.len());
                parts.push(Part { mesh, world_from_mesh: pose, color: OBJECT_COLOR, texture: None });
            }
            (p.frame, parts)
        })
        .collect();
    Ok(fsutil::write_atomic(path, &contact_sheet(&scenes, subject)?)?)
}
