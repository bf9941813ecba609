//! The object of a twin in its simulator, and the grasps that are worth simulating.

use std::sync::Arc;

use drex_core::Object;
use drex_grasp::{EvaluationOptions, Grasp, HandSurface, synthesize_grasps};
use drex_robot::Robot;
use drex_trial::{Engine, TrialEvaluator, TrialOptions};

use crate::records::FitFile;
use crate::{Result, Twin};

/// Hand and object, ready to be simulated.
pub(crate) struct Simulated {
    pub robot: Arc<Robot>,
    pub object: Object,
    pub evaluator: TrialEvaluator,
}

impl Simulated {
    /// The twin's object at this mass, with fast distances for a search.
    pub fn of(twin: &Twin, robot: &Robot, mass_kg: f64) -> Result<Self> {
        Self::new(twin.asset()?.to_object(&twin.manifest.name)?, robot, mass_kg)
    }

    /// This object at this mass.
    pub fn new(object: Object, robot: &Robot, mass_kg: f64) -> Result<Self> {
        let object = object.with_mass(mass_kg).at_world_origin();
        let robot = Arc::new(robot.clone());
        let evaluator = TrialEvaluator::new(&object, &robot, &TrialOptions::default(), Engine::Diffsim)?;
        Ok(Self { robot, object, evaluator })
    }

    /// The demonstrated grasps, and those made of them, that are worth simulating; behind them what a synthesis from `search`
    /// candidates finds.
    pub fn grasps(&self, fits: &FitFile, search: usize, seed: u64) -> Result<Vec<Grasp>> {
        let options = EvaluationOptions::candidate();
        let surface = HandSurface::new(&self.robot, options.contact.spacing_m)?;
        let mut grasps = Vec::new();
        for fit in fits.grasps.iter().filter(|g| g.accepted) {
            grasps.extend(fit.grasp(&self.robot)?.screened(&surface, &self.object, &self.robot, &options)?);
        }
        if search > 0 {
            grasps.extend(synthesize_grasps(&self.object, &self.robot, search, seed)?);
        }
        Ok(grasps)
    }
}
