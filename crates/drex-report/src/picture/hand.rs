//! A robot's shapes as parts of a picture.

use drex_core::{Pose, TriMesh};
use drex_robot::Robot;

use super::raster::Part;

const HAND_COLOR: [f64; 3] = [0.36, 0.42, 0.52];
const TIP_COLOR: [f64; 3] = [0.20, 0.60, 0.62];

/// The collision shapes of a robot as meshes, made once for many pictures.
pub struct HandShapes {
    shapes: Vec<Shape>,
}

struct Shape {
    link: usize,
    link_from_mesh: Pose,
    mesh: TriMesh,
    color: [f64; 3],
}

impl HandShapes {
    /// The shapes of a robot.
    pub fn new(robot: &Robot) -> Self {
        let tips: Vec<usize> = robot.fingers().iter().map(|f| f.tip_link).collect();
        let shapes = robot
            .collision_geoms()
            .filter_map(|(link, geom)| {
                let color = if tips.contains(&link) { TIP_COLOR } else { HAND_COLOR };
                Some(Shape { link, link_from_mesh: geom.link_from_geom, mesh: geom.shape.to_mesh(20)?, color })
            })
            .collect();
        Self { shapes }
    }

    /// The shapes of each link and colour as one mesh in the link's frame: number of the link, mesh, colour.
    pub fn by_link(&self) -> Vec<(usize, TriMesh, [f64; 3])> {
        let mut merged: Vec<(usize, TriMesh, [f64; 3])> = Vec::new();
        for s in &self.shapes {
            let mesh = s.mesh.transformed(&s.link_from_mesh);
            match merged.iter_mut().find(|(link, _, color)| *link == s.link && *color == s.color) {
                Some((_, all, _)) => all.append(&mesh),
                None => merged.push((s.link, mesh, s.color)),
            }
        }
        merged
    }

    /// The shapes where the links are.
    pub fn parts(&self, world_from_link: &[Pose]) -> Vec<Part<'_>> {
        self.shapes
            .iter()
            .map(|s| Part {
                mesh: &s.mesh,
                world_from_mesh: world_from_link[s.link] * s.link_from_mesh,
                color: s.color,
                texture: None,
            })
            .collect()
    }
}
