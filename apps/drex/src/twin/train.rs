//! Grasps to a network.

use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use drex_core::fsutil;
use drex_grasp::{HandSurface, static_check_with};
use drex_mesh::{farthest_points, sample_surface};
use drex_policy::{Dataset, GraspPolicy, GraspSample, TrainOptions};
use nalgebra::Point3;
use rayon::prelude::*;

use super::files::{FITS, MASS, POLICY, TRAINING, read_json, write_json};
use super::{FitFile, MassFile, Scene, Training, Twin};
use crate::ui::Ui;

/// Surface points that the network sees.
const POINTS: usize = 512;
/// The network learns the force at these multiples of the object's mass.
const MASS_FACTORS: [f64; 5] = [0.25, 0.5, 1.0, 2.0, 4.0];

pub fn make(twin: &Twin, ui: &Ui) -> Result<Vec<PathBuf>> {
    let scene = Scene::of(twin)?;
    let fits: FitFile = read_json(&twin.path(FITS))?;
    let mass: MassFile = read_json(&twin.path(MASS))?;
    let data = dataset(twin, &scene, &fits, &mass)?;
    let options = options(twin);
    let bar = ui.bar("train", options.epochs as u64);
    let (policy, mut report) = GraspPolicy::train(&data, &options, &mut |epoch| {
        bar.set_position(epoch.epoch as u64);
        bar.set_message(format!("loss {:.4}", epoch.total));
        ControlFlow::Continue(())
    })?;
    bar.finish_and_clear();
    // Wall times are in twin.lock; what a stage makes depends on its inputs only.
    report.seconds = 0.0;
    let folder = twin.path(POLICY);
    policy.save(&folder)?;
    let training =
        Training { grasps: report.train_grasps + report.held_out_grasps, samples: data.samples.len(), report };
    write_json(&twin.path(TRAINING), &training)?;
    fsutil::write_atomic(&twin.path("policy/curve.csv"), curve_csv(&training.report).as_bytes())?;
    Ok(vec![folder, twin.path(TRAINING), twin.path("policy/curve.csv")])
}

/// The object's points as the network sees them.
pub fn cloud(scene: &Scene, seed: u64) -> Vec<Point3<f64>> {
    let dense: Vec<Point3<f64>> =
        sample_surface(&scene.asset.visual, 8 * POINTS, seed).into_iter().map(|s| s.point).collect();
    farthest_points(&dense, POINTS).into_iter().map(|i| dense[i]).collect()
}

/// Each accepted grasp at several masses, with the smallest squeeze that carries that mass.
fn dataset(twin: &Twin, scene: &Scene, fits: &FitFile, mass: &MassFile) -> Result<Dataset> {
    let mut check = scene.check_options();
    // The force of a heavy object may be beyond this hand's motors; the law that the network learns is not.
    check.motors = false;
    let surface = HandSurface::new(&scene.robot, check.contact.spacing_m)?;
    let accepted: Vec<_> = fits.grasps.iter().filter(|g| g.accepted).collect();
    let per_grasp: Vec<Vec<GraspSample>> = accepted
        .par_iter()
        .map(|fit| {
            let object_from_base = fit.object_from_base.to_pose()?;
            let mut samples = Vec::new();
            for factor in MASS_FACTORS {
                let mass_kg = factor * mass.mass_kg;
                let body = scene.asset.properties.with_mass(mass_kg);
                let judged =
                    static_check_with(&surface, &scene.grasp(&fit.joints_rad, object_from_base, &body), &check)?;
                if let Some(squeeze_n) = judged.squeeze_n {
                    samples.push(GraspSample {
                        joints: fit.joints_rad.clone(),
                        object_from_palm: object_from_base,
                        squeeze_n,
                        mass_kg,
                    });
                }
            }
            Ok(samples)
        })
        .collect::<Result<_>>()?;
    let samples: Vec<GraspSample> = per_grasp.into_iter().flatten().collect();
    if samples.is_empty() {
        bail!(
            "none of the {} fitted grasps can carry the object at friction {}: see the reasons in {}",
            accepted.len(),
            twin.friction(),
            twin.path(FITS).display()
        );
    }
    let joint_limits = scene
        .robot
        .joints
        .iter()
        .map(|j| {
            j.limits.with_context(|| {
                format!("joint {} of {} has no limits; the network needs them", j.name, scene.robot.name)
            })
        })
        .collect::<Result<_>>()?;
    Ok(Dataset {
        joint_names: fits.joint_names.clone(),
        joint_limits,
        hand: fits.hand.clone(),
        points: cloud(scene, twin.seed),
        samples,
    })
}

fn options(twin: &Twin) -> TrainOptions {
    let mut options = TrainOptions::default().with_seed(twin.seed).with_points(POINTS);
    if let Some(train) = &twin.manifest.train {
        options.epochs = train.epochs.unwrap_or(options.epochs);
        options.learning_rate = train.learning_rate.unwrap_or(options.learning_rate);
        options.modes = train.modes.unwrap_or(options.modes);
        options.hidden = train.hidden.unwrap_or(options.hidden);
    }
    options
}

fn curve_csv(report: &drex_policy::TrainReport) -> String {
    let mut csv = String::from("epoch,joint_loss,wrist_loss,force_loss,mode_loss,total\n");
    for e in &report.curve {
        csv += &format!("{},{},{},{},{},{}\n", e.epoch, e.joint_loss, e.wrist_loss, e.force_loss, e.mode_loss, e.total);
    }
    csv
}
