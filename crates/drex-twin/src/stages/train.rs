//! Grasps to a network.

use std::ops::ControlFlow;
use std::path::PathBuf;

use crate::Result;
use crate::error::{Context, refuse};
use drex_core::fsutil;
use drex_grasp::{
    ContactOptions, GraspError, GripForceError, GripForcePolicy, GripForceProblem, HandSurface, OriginCounts,
};
use drex_policy::{Dataset, GraspPolicy, GraspSample, ObjectCloud, TrainOptions};
use drex_trial::{ConditionSpread, TrialOptions};
use rayon::prelude::*;

use super::practice::Simulated;
use crate::Progress;
use crate::Twin;
use crate::learn::{LearnOptions, Learned, POINTS};
use crate::records::{CURVE, FITS, MASS, POLICY, PracticeRecord, TRAINING, read_json, write_json};
use crate::records::{FitFile, FitRecord, MassFile, Training};
use crate::scene::Scene;

/// The network learns the force at these multiples of the mass that grasps are made for.
const MASS_FACTORS: [f64; 4] = [0.25, 0.5, 1.0, 2.0];
/// And at these multiples of its friction.
const FRICTION_FACTORS: [f64; 3] = [0.7, 1.0, 1.4];

pub(crate) fn make(twin: &Twin, progress: &dyn Progress) -> Result<Vec<PathBuf>> {
    let scene = Scene::of(twin)?;
    let fits: FitFile = read_json(&twin.path(FITS))?;
    let mass: MassFile = read_json(&twin.path(MASS))?;
    let options = options(twin);
    if let Some(practised) = twin.manifest.train.as_ref().and_then(|t| t.practice).filter(|p| *p > 0) {
        return practise(twin, &scene, &fits, &mass, options, practised as usize, progress);
    }
    let (data, learned) = dataset(twin, &scene, &fits, &mass)?;
    progress.begin("train", Some(options.epochs as u64));
    let (policy, report) = GraspPolicy::train(&data, &options, &mut |epoch| {
        progress.at(epoch.epoch as u64, &format!("loss {:.4}", epoch.total));
        ControlFlow::Continue(())
    })?;
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
fn practise(
    twin: &Twin,
    scene: &Scene,
    fits: &FitFile,
    mass: &MassFile,
    train: TrainOptions,
    practised: usize,
    progress: &dyn Progress,
) -> Result<Vec<PathBuf>> {
    progress.begin("search", None);
    let simulated = Simulated::of(twin, &scene.robot, mass.grip_kg)?;
    let search = twin.manifest.train.as_ref().and_then(|t| t.search).unwrap_or(0);
    let grasps = simulated.grasps(fits, search, twin.seed)?;
    progress.begin("practice", None);
    let mut options = LearnOptions {
        train,
        spread: ConditionSpread::around(Some(twin.friction())),
        simulated: practised,
        shake_m_s2: TrialOptions::default().shake_m_s2,
        masses_kg: Vec::new(),
        mass_hidden: false,
    };
    options.train.rollouts.wanted_friction_share = GripForcePolicy::default().friction_share();
    let learned = Learned::train(&simulated.object, &simulated.robot, &grasps, &simulated.evaluator, &options)?;
    progress.end();
    progress.note(&format!(
        "{:>10}  {} of {} grasps hold in practice, {} learned",
        "practice",
        learned.robust,
        learned.commanded,
        learned.learned.total()
    ));
    for (part, seconds) in ["practice", "demonstrations", "rollouts"].into_iter().zip(learned.seconds) {
        twin.took(part, seconds);
    }
    let training = Training {
        learned: learned.learned,
        tried: OriginCounts::of(grasps.iter().map(|g| g.origin)),
        samples: learned.samples,
        report: learned.report.clone(),
        practice: Some(PracticeRecord { commanded: learned.commanded, robust: learned.robust }),
    };
    write(twin, learned.policy(), &training)
}

/// Each accepted grasp at several masses and frictions, with the grip force that the grip-force policy asks for there, and where the grasps come
/// from for which it has one.
fn dataset(twin: &Twin, scene: &Scene, fits: &FitFile, mass: &MassFile) -> Result<(Dataset, OriginCounts)> {
    let contact = ContactOptions::with_friction(scene.object.friction);
    let surface = HandSurface::new(&scene.robot, contact.spacing_m)?;
    let law = GripForcePolicy::default();
    let object_friction = twin.friction();
    let accepted: Vec<_> = fits.grasps.iter().filter(|g| g.accepted).collect();
    let per_grasp: Vec<Vec<GraspSample>> = accepted
        .par_iter()
        .map(|fit| {
            let object_from_base = fit.object_from_base.to_pose()?;
            let touching = surface.contacts(
                &scene.robot,
                &fit.joints_rad,
                &object_from_base,
                scene.object.geometry.exact(),
                &contact,
            )?;
            let contacts: Vec<bool> =
                (0..surface.fingers.len()).map(|f| touching.iter().any(|c| c.finger == Some(f))).collect();
            let mut samples = Vec::new();
            for (factor, part) in MASS_FACTORS.iter().flat_map(|m| FRICTION_FACTORS.map(|f| (*m, f))) {
                let (mass_kg, friction) = (factor * mass.grip_kg, part * object_friction);
                let mut problem = GripForceProblem::new(
                    touching.clone(),
                    mass_kg,
                    scene.object.center_of_mass(),
                    scene.object.table().gravity(),
                );
                problem.contacts.iter_mut().for_each(|c| c.friction = friction);
                // The force of a heavy object may be beyond this hand's motors; the law that the network learns is not.
                let grip_force_n = match law.command(&problem) {
                    Ok(force) => force.total_n,
                    Err(GripForceError::Input(GraspError::Solver { .. })) => continue,
                    Err(GripForceError::Input(error)) => return Err(error.into()),
                    Err(_) => continue,
                };
                samples.push(GraspSample {
                    object: 0,
                    joints: fit.joints_rad.clone(),
                    object_from_base,
                    contacts: contacts.clone(),
                    grip_force_n,
                    mass_kg,
                    friction,
                });
            }
            Ok(samples)
        })
        .collect::<Result<_>>()?;
    let learned =
        OriginCounts::of(accepted.iter().zip(&per_grasp).filter(|(_, s)| !s.is_empty()).map(|(fit, _)| fit.origin()));
    let samples: Vec<GraspSample> = per_grasp.into_iter().flatten().collect();
    if samples.is_empty() {
        refuse!(
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
    let data = Dataset {
        joint_names: fits.joint_names.clone(),
        joint_limits,
        hand: fits.hand.clone(),
        fingers: surface.fingers.iter().map(|f| f.name.clone()).collect(),
        objects: vec![ObjectCloud {
            name: twin.manifest.name.clone(),
            points: scene.object.point_cloud(POINTS, twin.seed),
            up: scene.object.table().up.into_inner(),
        }],
        samples,
    };
    Ok((data, learned))
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
