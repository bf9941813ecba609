//! The network's grasps judged by the static check, beside the demonstrations it learned from.

use std::path::PathBuf;

use anyhow::Result;
use drex_core::Pose;
use drex_grasp::{HandSurface, StaticCheck, static_check_with};
use drex_policy::{GraspPolicy, PredictedGrasp, Query};
use rayon::prelude::*;

use super::files::{EVALUATION, FITS, MASS, POLICY, read_json, write_json};
use super::{Evaluation, FitFile, JudgedGrasp, MassFile, PoseRecord, Scene, Twin, train};
use crate::ui::Ui;

pub fn make(twin: &Twin, ui: &Ui) -> Result<Vec<PathBuf>> {
    let scene = Scene::of(twin)?;
    let fits: FitFile = read_json(&twin.path(FITS))?;
    let mass: MassFile = read_json(&twin.path(MASS))?;
    let policy = GraspPolicy::load(&twin.path(POLICY))?;
    let cloud = train::cloud(&scene, twin.seed);
    let query = Query::new(&cloud, mass.grip_kg, twin.friction()).with_up(scene.table.up.into_inner());
    let predictions = policy.predict(&query)?;
    let spinner = ui.spinner("evaluate");

    let judge = Judge::new(&scene, mass.grip_kg)?;
    let predicted =
        predictions.par_iter().map(|p| judge.predicted(&p.joints, p.object_from_palm, p)).collect::<Result<_>>()?;
    let refined = predictions.par_iter().map(|p| judge.refined(p)).collect::<Result<_>>()?;
    let demonstrations = fits
        .grasps
        .par_iter()
        .filter(|g| g.accepted)
        .map(|g| judge.judge(&g.joints_rad, g.object_from_base.to_pose()?))
        .collect::<Result<_>>()?;
    let evaluation =
        Evaluation { mass_kg: mass.grip_kg, friction: twin.friction(), predicted, refined, demonstrations };
    write_json(&twin.output(EVALUATION)?, &evaluation)?;
    spinner.finish_and_clear();
    Ok(vec![twin.path(EVALUATION)])
}

/// The static check at one mass.
struct Judge<'a> {
    scene: &'a Scene,
    surface: HandSurface,
    body: drex_core::MassProperties,
}

impl<'a> Judge<'a> {
    fn new(scene: &'a Scene, mass_kg: f64) -> Result<Self> {
        let surface = HandSurface::new(&scene.robot, scene.check_options().contact.spacing_m)?;
        Ok(Self { scene, surface, body: scene.asset.properties.with_mass(mass_kg) })
    }

    fn judge(&self, joints: &[f64], object_from_base: Pose) -> Result<JudgedGrasp> {
        let grasp = self.scene.grasp(joints, object_from_base, &self.body);
        let check: StaticCheck = static_check_with(&self.surface, &grasp, &self.scene.check_options())?;
        Ok(JudgedGrasp {
            joints_rad: joints.to_vec(),
            object_from_base: PoseRecord::from(&object_from_base),
            predicted_squeeze_n: None,
            weight: None,
            check,
        })
    }

    fn predicted(&self, joints: &[f64], object_from_base: Pose, from: &PredictedGrasp) -> Result<JudgedGrasp> {
        let judged = self.judge(joints, object_from_base)?;
        Ok(JudgedGrasp { predicted_squeeze_n: Some(from.squeeze_n), weight: Some(from.weight), ..judged })
    }

    /// The predicted joint angles put onto the surface: wrist solved for them, fingers corrected within the fit's bound.
    fn refined(&self, p: &PredictedGrasp) -> Result<JudgedGrasp> {
        let fit = self.scene.fit(&p.joints)?;
        self.predicted(&fit.joints, fit.object_from_base, p)
    }
}
