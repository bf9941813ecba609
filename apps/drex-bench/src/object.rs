//! An object of the bench with everything that grasping it takes.

use anyhow::{Context, Result};
use drex_core::Object;
use drex_mesh::asset_from_mesh;

use crate::objects::ObjectSpec;

/// An object at rest on its table.
pub struct BenchObject {
    pub spec: ObjectSpec,
    /// Sides of the bounding box, metres.
    pub size_m: [f64; 3],
    pub object: Object,
}

impl BenchObject {
    /// Convex parts, mass properties, distances, rest pose.
    pub fn new(spec: &ObjectSpec) -> Result<Self> {
        let at = || format!("object \"{}\"", spec.name);
        let asset = asset_from_mesh(&spec.mesh, &spec.asset_options()).with_context(at)?;
        let mut object = asset.to_object(&spec.name).with_context(at)?;
        object.friction = spec.friction.unwrap_or(object.friction);
        object.max_finger_n = spec.max_force_n;
        // Without a direction that is up it stands in its most probable rest pose.
        if let Some(rest) = asset.stable_poses.first().filter(|_| spec.up.is_none()) {
            object = object.with_rest_pose(rest.world_from_mesh);
        }
        Ok(Self { spec: spec.clone(), size_m: asset.report.size_m, object: object.at_world_origin() })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use drex_grasp::{ContactOptions, EvaluationOptions, Grasp, HandSurface, evaluate_with, power_grasps};
    use drex_robot::Robot;

    use super::*;
    use crate::objects;

    /// What so many hands make of the ketchup bottle, the heaviest of the objects.
    fn bottle(tries: usize, seed: u64) -> (Object, Robot, Vec<Grasp>) {
        let object = BenchObject::new(&objects::named("ketchup_bottle").unwrap()).unwrap().object;
        let robot = Robot::bundled("leap_right").unwrap();
        let grasps = power_grasps(&object, &robot, tries, seed).unwrap();
        (object, robot, grasps)
    }

    #[test]
    fn power_grasps_hold_with_the_palm_and_near_the_knuckles() {
        let (object, robot, grasps) = bottle(60, 0);
        assert!(grasps.len() >= 5, "{} of 60", grasps.len());
        let surface = HandSurface::new(&robot, ContactOptions::default().spacing_m).unwrap();
        let mut beside_the_tip = 0;
        for g in &grasps {
            let found = evaluate_with(&surface, g, &object, &robot, &EvaluationOptions::synthesised()).unwrap();
            assert!(found.passed, "{found:?}");
            assert!(found.fingers.last().unwrap().contacts > 0, "no palm: {found:?}");
            let contacts = found.contacts;
            let tips: Vec<usize> = surface.fingers.iter().map(|f| f.tip_link).collect();
            beside_the_tip += usize::from(contacts.iter().any(|c| c.finger.is_some() && !tips.contains(&c.link)));
        }
        assert!(2 * beside_the_tip >= grasps.len(), "{beside_the_tip} of {} touch with more than tips", grasps.len());
    }

    #[test]
    fn power_grasps_depend_on_the_seed_alone() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let (_, _, many) = bottle(20, 0);
        let (_, _, one) = pool.install(|| bottle(20, 0));
        assert!(!many.is_empty() && many == one);
        assert_ne!(many, bottle(20, 1).2);
    }
}
