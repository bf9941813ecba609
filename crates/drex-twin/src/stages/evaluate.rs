//! The network's grasps evaluated at rest, beside the demonstrations it learned from.

use std::path::PathBuf;

use crate::Result;
use drex_core::{Object, PoseRecord};
use drex_grasp::{EvaluationOptions, Grasp, HandSurface, evaluate_with};
use drex_policy::{GraspPolicy, PredictedGrasp, Query};
use rayon::prelude::*;

use crate::Progress;
use crate::Twin;
use crate::learn::{POINTS, grasp_of};
use crate::records::{EVALUATION, FITS, POLICY, read_json, write_json};
use crate::records::{EvaluatedGrasp, Evaluation, FitFile};
use crate::scene::Scene;

pub(crate) fn make(twin: &Twin, progress: &dyn Progress) -> Result<Vec<PathBuf>> {
    let scene = Scene::of(twin)?;
    let fits: FitFile = read_json(&twin.path(FITS))?;
    let mass = twin.mass()?;
    let policy = GraspPolicy::load(&twin.path(POLICY))?;
    let cloud = scene.object.point_cloud(POINTS, twin.seed);
    let query = Query::new(&cloud, mass.grip_kg, twin.friction()).with_up(scene.object.table().up.into_inner());
    let predictions = policy.predict(&query)?;
    progress.begin("evaluate", None);

    let evaluator = Evaluator::new(&scene, mass.grip_kg)?;
    let own = |p: &PredictedGrasp| grasp_of(policy.hand(), policy.joint_names(), p);
    let predicted = predictions.par_iter().map(|p| evaluator.predicted(&own(p), p)).collect::<Result<_>>()?;
    let refined = predictions.par_iter().map(|p| evaluator.refined(p)).collect::<Result<_>>()?;
    let demonstrations = fits
        .grasps
        .par_iter()
        .filter(|g| g.accepted)
        .map(|g| evaluator.evaluate(&g.grasp(&scene.robot)?))
        .collect::<Result<_>>()?;
    let evaluation =
        Evaluation { mass_kg: mass.grip_kg, friction: twin.friction(), predicted, refined, demonstrations };
    write_json(&twin.output(EVALUATION)?, &evaluation)?;
    progress.end();
    Ok(vec![twin.path(EVALUATION)])
}

/// The evaluation at one mass.
struct Evaluator<'a> {
    scene: &'a Scene,
    object: Object,
    surface: HandSurface,
    options: EvaluationOptions,
}

impl<'a> Evaluator<'a> {
    fn new(scene: &'a Scene, mass_kg: f64) -> Result<Self> {
        let object = scene.object.clone().with_mass(mass_kg);
        let options = EvaluationOptions::default();
        let surface = HandSurface::new(&scene.robot, options.contact.spacing_m)?;
        Ok(Self { scene, object, surface, options })
    }

    fn evaluate(&self, grasp: &Grasp) -> Result<EvaluatedGrasp> {
        let check = evaluate_with(&self.surface, grasp, &self.object, &self.scene.robot, &self.options)?;
        Ok(EvaluatedGrasp {
            joints_rad: grasp.joints_rad.clone(),
            object_from_base: PoseRecord::from(&grasp.object_from_base),
            predicted_grip_force_n: None,
            weight: None,
            check,
        })
    }

    fn predicted(&self, grasp: &Grasp, from: &PredictedGrasp) -> Result<EvaluatedGrasp> {
        let evaluated = self.evaluate(grasp)?;
        Ok(EvaluatedGrasp { predicted_grip_force_n: Some(from.grip_force_n), weight: Some(from.weight), ..evaluated })
    }

    /// The predicted joint angles put onto the surface: wrist solved for them, fingers corrected within the fit's bound.
    fn refined(&self, p: &PredictedGrasp) -> Result<EvaluatedGrasp> {
        let fit = self.scene.fit(&p.joints)?;
        self.predicted(&fit.grasp, p)
    }
}
