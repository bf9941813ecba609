//! What practice and trials take of a twin: the object in its simulator, and the grasps that are worth trying.

use std::sync::Arc;

use anyhow::Result;
use drex_grasp::{ContactOptions, HandSurface};
use drex_robot::Robot;
use drex_trial::{Judge as Engine, TrialOptions};
use nalgebra::Vector3;

use super::{FitFile, Twin};
use crate::bench::judge::Rollouts;
use crate::bench::library::{Grasp, found};
use crate::bench::objects::ObjectSpec;
use crate::bench::thing::Thing;

/// Hand and object, ready to be simulated.
pub struct Ground {
    pub robot: Arc<Robot>,
    pub thing: Thing,
    pub judge: Rollouts,
}

impl Ground {
    /// The twin's object at this mass.
    pub fn of(twin: &Twin, robot: &Robot, mass_kg: f64) -> Result<Self> {
        let asset = twin.asset()?.clone().with_mass(mass_kg);
        let spec = ObjectSpec {
            name: twin.manifest.name.clone(),
            mesh: asset.visual.clone(),
            mass_kg,
            friction: Some(twin.friction()),
            max_force_n: None,
            up: Some(Vector3::from(twin.manifest.object.up_in_mesh)),
        };
        let thing = Thing::of_asset(&spec, asset)?;
        let robot = Arc::new(robot.clone());
        let judge = Rollouts::new(&thing, &robot, &TrialOptions::default(), Engine::Diffsim)?;
        Ok(Self { robot, thing, judge })
    }

    /// The demonstrated grasps and those made of them that hold on paper, and behind them those that hands laid on the object and a search among so many
    /// pinches find.
    pub fn grasps(&self, fits: &FitFile, search: usize, seed: u64) -> Result<Vec<Grasp>> {
        let friction = self.thing.spec.friction.unwrap_or(drex_core::twin::ASSUMED_FRICTION);
        let surface = HandSurface::new(&self.robot, ContactOptions::default().spacing_m)?;
        let mut grasps = Vec::new();
        for fit in fits.grasps.iter().filter(|g| g.accepted) {
            let pose = fit.object_from_base.to_pose()?;
            let measured = Grasp::measured(&self.thing, &self.robot, &surface, &fit.joints_rad, &pose, friction)?;
            grasps.extend(measured.map(|g| Grasp { clip: fit.demonstration, kind: fit.kind(), ..g }));
        }
        if search > 0 {
            grasps.extend(found(&self.thing, &self.robot, search, friction, seed)?);
        }
        Ok(grasps)
    }
}
