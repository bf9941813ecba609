//! Demonstrated joint angles to grasps on the object.

use std::path::PathBuf;

use crate::Result;
use crate::error::Context;
use crate::manifest::{GraspsConfig, RecordedAs};
use drex_recording::JointPoses;
use drex_recording::readers::read_grasps;
use drex_retarget::WristFit;
use drex_robot::{Robot, joint_order};
use rayon::prelude::*;

use super::human;
use crate::Progress;
use crate::Twin;
use crate::records::{FITS, write_json};
use crate::records::{FitFile, FitRecord};
use crate::scene::Scene;

pub(crate) fn make(twin: &Twin, progress: &dyn Progress) -> Result<Vec<PathBuf>> {
    let scene = Scene::of(twin)?;
    let config = twin.manifest.grasps.as_ref().context("the manifest has no [grasps]")?;
    let (grasps, clips) = match config.recorded {
        RecordedAs::Robot => (of_robot(twin, config, &scene, progress)?, Vec::new()),
        RecordedAs::Human => human::make(twin, config, &scene, progress)?,
    };
    let file = FitFile {
        schema: 1,
        hand: scene.robot.name.clone(),
        joint_names: scene.robot.joint_names().into_iter().map(str::to_owned).collect(),
        demonstrations: grasps.len(),
        accepted: grasps.iter().filter(|g| g.accepted).count(),
        clips,
        grasps,
    };
    let what = if file.clips.is_empty() { "demonstrations" } else { "grasps of people" };
    progress.note(&format!("{:>10}  {} of {} {what} fit the object", "grasps", file.accepted, file.demonstrations));
    write_json(&twin.output(FITS)?, &file)?;
    Ok(vec![twin.path(FITS)])
}

/// Recorded joint angles, each put onto the object.
fn of_robot(twin: &Twin, config: &GraspsConfig, scene: &Scene, progress: &dyn Progress) -> Result<Vec<FitRecord>> {
    let demonstrations = read(twin, config, &scene.robot)?;
    progress.begin("grasps", Some(demonstrations.len() as u64));
    let fits: Vec<WristFit> = demonstrations
        .par_iter()
        .map(|joints| scene.fit(joints).inspect(|_| progress.step()))
        .collect::<Result<_>>()?;
    progress.end();
    Ok(fits.iter().enumerate().map(|(i, fit)| record(i, fit, scene.object.weight_n())).collect())
}

/// The demonstrations as joint vectors in the model's order.
fn read(twin: &Twin, config: &GraspsConfig, robot: &Robot) -> Result<Vec<Vec<f64>>> {
    let path = twin.path(&config.file);
    let names: Option<Vec<String>> = match &config.joint_order {
        Some(order) => Some(joint_order::require(order)?.iter().map(|&n| n.to_owned()).collect()),
        None => None,
    };
    let poses: JointPoses = read_grasps(&path, names.as_deref())?;
    poses
        .rows
        .iter()
        .enumerate()
        .map(|(i, row)| {
            robot
                .joint_vector_full(&poses.names, row)
                .with_context(|| format!("grasp {i} of {} for hand {}", path.display(), robot.name))
        })
        .collect()
}

fn record(demonstration: usize, fit: &WristFit, weight_n: f64) -> FitRecord {
    FitRecord {
        largest_clipping_rad: fit.clipped_rad.iter().fold(0.0, |m, c| c.abs().max(m)),
        pushed_out: Some(fit.pushed_out),
        ..FitRecord::of(demonstration, &fit.grasp, &fit.evaluation, fit.correction_rad.clone(), weight_n)
    }
}
