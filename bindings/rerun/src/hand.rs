//! The robot hand: its links where the joints put them, where they touch the object, how hard the fingers press.

use anyhow::{Context, Result};
use drex_core::{Pose, TriMesh};
use drex_grasp::{Contact, ContactOptions, HandSurface};
use drex_robot::Robot;
use nalgebra::{Point3, Vector3};
use re_sdk_types::archetypes::{Arrows3D, Points3D};

use crate::recorder::{Recorder, Times, mesh, point, vector};
use crate::twin::{ARROW_M_PER_N, Twin};

/// Corners around a circle.
const SEGMENTS: usize = 20;
const LINK_RGBA: [u8; 4] = [92, 107, 133, 255];
const TIP_RGBA: [u8; 4] = [51, 153, 158, 255];
const CONTACT_RGB: [u8; 3] = [235, 200, 40];
const CONTACT_M: f32 = 0.0015;
const FORCE_RGB: [u8; 3] = [204, 51, 46];

/// The hand of the manifest.
pub struct Hand {
    robot: Robot,
    surface: HandSurface,
    /// Collision shapes of a link in its frame: index, mesh, colour.
    links: Vec<(usize, TriMesh, [u8; 4])>,
}

/// A hand about the object at one time.
pub struct Held {
    /// rad, in the order of the names given to [`Hand::record`].
    pub joints_rad: Vec<f64>,
    /// The hand's base in the world.
    pub world_from_base: Pose,
    /// The object's mesh frame in the world.
    pub world_from_object: Pose,
    /// Normal force of each finger, N, in the order of [`Hand::fingers`]; empty where it is not known.
    pub finger_n: Vec<f64>,
}

impl Hand {
    /// Of the manifest; none without `[grasps]`.
    pub fn of(twin: &mut Twin) -> Result<Option<Self>> {
        let Some(config) = &twin.folder.manifest.grasps else { return Ok(None) };
        let robot = Robot::resolve(&config.hand, &twin.folder.root)
            .with_context(|| format!("[grasps] hand of {}", twin.folder.file.display()))?;
        let surface = HandSurface::new(&robot, ContactOptions::default().spacing_m)?;
        let tips: Vec<usize> = surface.fingers.iter().map(|f| f.tip_link).collect();
        let mut links: Vec<(usize, TriMesh, [u8; 4])> = Vec::new();
        for (link, geom) in robot.collision_geoms() {
            let Some(shape) = geom.shape.to_mesh(SEGMENTS) else { continue };
            let shape = shape.transformed(&geom.link_from_geom);
            match links.iter_mut().find(|l| l.0 == link) {
                Some((_, all, _)) => {
                    let first = all.vertices.len() as u32;
                    all.vertices.extend(shape.vertices);
                    all.faces.extend(shape.faces.iter().map(|f| f.map(|v| v + first)));
                }
                None => links.push((link, shape, if tips.contains(&link) { TIP_RGBA } else { LINK_RGBA })),
            }
        }
        Ok(Some(Self { robot, surface, links }))
    }

    /// Names of the fingers.
    pub fn fingers(&self) -> Vec<&str> {
        self.surface.fingers.iter().map(|f| f.name.as_str()).collect()
    }

    /// Records links, contacts and forces under `world/STAGE`, numbers under `STAGE`. `joints` names the columns of
    /// [`Held::joints_rad`].
    pub fn record(
        &self,
        recorder: &Recorder,
        twin: &Twin,
        stage: &str,
        joints: &[String],
        times: Times<'_>,
        held: &[Held],
    ) -> Result<()> {
        let q: Vec<Vec<f64>> =
            held.iter().map(|h| self.robot.joint_vector_full(joints, &h.joints_rad)).collect::<Result<_, _>>()?;
        let links: Vec<Vec<Pose>> =
            q.iter().zip(held).map(|(q, h)| self.robot.forward_kinematics(q, &h.world_from_base)).collect();
        for (link, shape, rgba) in &self.links {
            let entity = ["world", stage, "hand", self.robot.links[*link].name.as_str()];
            let poses: Vec<Pose> = links.iter().map(|all| all[*link]).collect();
            recorder.poses(&entity, times, &poses)?;
            recorder.starting(&entity, times, &mesh(shape, false, *rgba))?;
        }
        for (j, joint) in self.robot.joint_names().into_iter().enumerate() {
            let angle: Vec<f64> = q.iter().map(|q| q[j]).collect();
            recorder.series(&[stage, "joint_rad", joint], times, &angle)?;
        }
        if held.iter().all(|h| h.finger_n.len() == self.surface.fingers.len()) {
            for (f, finger) in self.fingers().into_iter().enumerate() {
                let newtons: Vec<f64> = held.iter().map(|h| h.finger_n[f]).collect();
                recorder.series(&[stage, "finger_force_n", finger], times, &newtons)?;
            }
        }
        self.contacts(recorder, twin, stage, times, held, &q)
    }

    /// Where the links touch the mesh, and an arrow for each finger whose force is known.
    fn contacts(
        &self,
        recorder: &Recorder,
        twin: &Twin,
        stage: &str,
        times: Times<'_>,
        held: &[Held],
        q: &[Vec<f64>],
    ) -> Result<()> {
        let Some(object) = &twin.surface else { return Ok(()) };
        let options = ContactOptions::with_friction(twin.folder.friction());
        let (mut points, mut arrows) = (Vec::new(), Vec::new());
        for (h, q) in held.iter().zip(q) {
            let object_from_base = h.world_from_object.inverse() * h.world_from_base;
            let found = self.surface.contacts(&self.robot, q, &object_from_base, object, &options)?;
            points.push(found.iter().map(|c| point(&(h.world_from_object * c.point))).collect::<Vec<_>>());
            arrows.push(forces(&found, &h.finger_n, &h.world_from_object));
        }
        let entity = ["world", stage, "contacts"];
        let all = Points3D::new(points.iter().flatten().copied());
        recorder.columns(&entity, times, points.len(), all.columns(points.iter().map(Vec::len))?)?;
        let look = Points3D::update_fields().with_radii([CONTACT_M]).with_colors([CONTACT_RGB]);
        recorder.starting(&entity, times, &look)?;
        if held.iter().all(|h| h.finger_n.is_empty()) {
            return Ok(());
        }
        let entity = ["world", stage, "forces"];
        let all = Arrows3D::from_vectors(arrows.iter().flatten().map(|(_, v)| *v))
            .with_origins(arrows.iter().flatten().map(|(tail, _)| *tail));
        recorder.columns(&entity, times, arrows.len(), all.columns(arrows.iter().map(Vec::len))?)?;
        recorder.starting(&entity, times, &Arrows3D::update_fields().with_colors([FORCE_RGB]))
    }
}

/// Tail and vector of an arrow for each finger that presses: along the mean normal of its contacts, with the tip in their middle.
fn forces(contacts: &[Contact], finger_n: &[f64], world_from_object: &Pose) -> Vec<([f32; 3], [f32; 3])> {
    let arrow = |(finger, newtons): (usize, &f64)| {
        let own: Vec<&Contact> = contacts.iter().filter(|c| c.finger == Some(finger)).collect();
        let normal = own.iter().map(|c| c.normal).sum::<Vector3<f64>>().try_normalize(1e-9)?;
        let middle = own.iter().map(|c| c.point.coords).sum::<Vector3<f64>>() / own.len() as f64;
        let force = world_from_object * normal * (ARROW_M_PER_N * newtons);
        (*newtons > 0.0).then(|| (point(&(world_from_object * Point3::from(middle) - force)), vector(&force)))
    };
    finger_n.iter().enumerate().filter_map(arrow).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arrow_of_a_finger_ends_between_its_contacts() {
        let at = |x: f64| Contact::new(Point3::new(x, 0.0, 0.0), Vector3::new(0.0, 2.0, 0.0), 0.5).by_finger(1);
        let moved = Pose::translation(0.0, 0.0, 1.0);
        let seen = forces(&[at(0.1), at(0.3)], &[5.0, 10.0, 5.0], &moved);
        assert_eq!(seen, [([0.2, -0.2, 1.0], [0.0, 0.2, 0.0])]);
        assert!(forces(&[at(0.1)], &[5.0, 0.0], &moved).is_empty());
    }
}
