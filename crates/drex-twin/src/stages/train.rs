//! Grasps to a network.

use std::path::PathBuf;

use crate::error::refuse;
use drex_core::fsutil;
use drex_grasp::{
    ContactOptions, GraspError, GripForceError, GripForcePolicy, GripForceProblem, HandSurface, OriginCounts,
};
use drex_policy::{Dataset, GraspPolicy, GraspSample, TrainOptions};
use drex_trial::{ConditionSpread, Stoppable, TrialOptions};
use rayon::prelude::*;

use super::simulated::Simulated;
use crate::learn::{self, LearnOptions, Learned, MASS_FACTORS, POINTS, labels};
use crate::progress::flow;
use crate::records::{CURVE, FITS, LearnedGrasp, POLICY, PracticeRecord, TRAINING, read_json, write_json};
use crate::records::{FitFile, FitRecord, MassFile, Training};
use crate::scene::Scene;
use crate::{Error, Progress, Result, Twin};

pub(crate) fn make(twin: &Twin, progress: &dyn Progress) -> Result<Vec<PathBuf>> {
    let scene = Scene::of(twin)?;
    let fits: FitFile = read_json(&twin.path(FITS))?;
    let mass = twin.mass()?;
    let options = options(twin);
    if let Some(simulated) = twin.manifest.train.as_ref().and_then(|t| t.practice).filter(|p| *p > 0) {
        return validated(twin, &scene, &fits, &mass, options, simulated as usize, progress);
    }
    let (data, learned) = dataset(&scene, &fits, &mass, twin.seed)?;
    progress.begin("train", Some(options.epochs as u64));
    let (policy, report) = GraspPolicy::train(&data, &options, &mut |epoch| {
        progress.at(epoch.epoch as u64, &format!("loss {:.4}", epoch.total));
        flow(progress)
    })?;
    if progress.is_stopped() {
        return Err(Error::Stopped);
    }
    progress.end();
    twin.took("training", report.seconds);
    let tried = OriginCounts::of(fits.grasps.iter().filter(|g| g.accepted).map(FitRecord::origin));
    write(twin, &policy, &Training { learned, tried, samples: data.samples.len(), report, practice: None })
}

fn write(twin: &Twin, policy: &GraspPolicy, training: &Training) -> Result<Vec<PathBuf>> {
    let (folder, curve) = (twin.output(POLICY)?, twin.output(CURVE)?);
    policy.save(&folder)?;
    write_json(&twin.output(TRAINING)?, training)?;
    fsutil::write_atomic(&curve, training.report.curve_csv().as_bytes())?;
    Ok(vec![folder, twin.path(TRAINING), curve])
}

/// Learns the grasps that hold when they are tried, of the demonstrations and of a search, then from rollouts of its own.
fn validated(
    twin: &Twin,
    scene: &Scene,
    fits: &FitFile,
    mass: &MassFile,
    train: TrainOptions,
    simulated: usize,
    progress: &dyn Progress,
) -> Result<Vec<PathBuf>> {
    progress.begin("search", None);
    let tried = Simulated::of(twin, &scene.robot, mass.grip_kg)?;
    let search = twin.manifest.train.as_ref().and_then(|t| t.search).unwrap_or(0);
    let grasps = tried.grasps(fits, search, twin.seed)?;
    progress.begin("practice", None);
    let options = LearnOptions {
        train,
        // Where nobody states the friction they have to hold at all that the hand reckons with.
        spread: ConditionSpread::around(twin.manifest.object.friction),
        simulated,
        shake_m_s2: TrialOptions::default().shake_m_s2,
        masses_kg: Vec::new(),
        mass_hidden: false,
    };
    let go_on = || flow(progress);
    let evaluator = Stoppable::new(&tried.evaluator, &go_on);
    let learned = Learned::train(&tried.object, &tried.robot, &grasps, &evaluator, &options)?;
    progress.end();
    progress.note(&format!(
        "{:>10}  {} of {} grasps hold in practice, {} learned",
        "practice",
        learned.robust,
        learned.commanded,
        learned.learned.total()
    ));
    for (part, seconds) in ["practice", "learning"].into_iter().zip(learned.seconds) {
        twin.took(part, seconds);
    }
    let training = Training {
        learned: learned.learned,
        tried: OriginCounts::of(grasps.iter().map(|g| g.origin)),
        samples: learned.samples,
        report: learned.report.clone(),
        practice: Some(PracticeRecord {
            commanded: learned.commanded,
            robust: learned.robust,
            demonstrations: learned.demonstrations,
            learned: learned.validated.iter().map(LearnedGrasp::from).collect(),
        }),
    };
    write(twin, learned.policy(), &training)
}

/// Each accepted grasp at several masses and frictions, with the grip force that the grip-force policy asks for there, and where the grasps come
/// from for which it has one.
fn dataset(scene: &Scene, fits: &FitFile, mass: &MassFile, seed: u64) -> Result<(Dataset, OriginCounts)> {
    let Scene { robot, object, .. } = scene;
    let contact = ContactOptions::with_friction(object.friction);
    let surface = HandSurface::new(robot, contact.spacing_m)?;
    let law = GripForcePolicy::default();
    let masses = MASS_FACTORS.map(|factor| factor * mass.grip_kg);
    let accepted: Vec<_> = fits.grasps.iter().filter(|g| g.accepted).collect();
    let per_grasp: Vec<Vec<GraspSample>> = accepted
        .par_iter()
        .map(|fit| {
            let grasp = fit.grasp(robot)?;
            let (pose, exact) = (&grasp.object_from_base, object.geometry.exact());
            let touching = surface.contacts(robot, &grasp.joints_rad, pose, exact, &contact)?;
            let fingers: Vec<bool> =
                (0..surface.fingers.len()).map(|f| touching.iter().any(|c| c.finger == Some(f))).collect();
            labels(&grasp, &fingers, &masses, object.friction, |assumed| {
                let (com, gravity) = (object.center_of_mass(), object.table().gravity());
                let mut problem = GripForceProblem::new(touching.clone(), assumed.mass_kg, com, gravity);
                problem.contacts.iter_mut().for_each(|c| c.friction = assumed.friction);
                // The force of a heavy object may be beyond this hand's motors; the law that the network learns is not.
                match law.command(&problem) {
                    Ok(force) => Ok(Some(force.total_n)),
                    Err(GripForceError::Input(error)) if !matches!(error, GraspError::Solver { .. }) => {
                        Err(error.into())
                    }
                    Err(_) => Ok(None),
                }
            })
        })
        .collect::<Result<_>>()?;
    let learned =
        OriginCounts::of(accepted.iter().zip(&per_grasp).filter(|(_, s)| !s.is_empty()).map(|(fit, _)| fit.origin()));
    let samples: Vec<GraspSample> = per_grasp.into_iter().flatten().collect();
    if samples.is_empty() {
        refuse!(
            "none of the {} fitted grasps can carry the object at friction {}: see the reasons in {FITS}",
            accepted.len(),
            object.friction
        );
    }
    Ok((learn::dataset(object, robot, samples, seed)?, learned))
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
