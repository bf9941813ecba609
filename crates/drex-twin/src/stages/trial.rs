//! The grasp that `drex grasp` gives, lifted, held and shaken in simulation.

use std::path::PathBuf;

use drex_core::PoseRecord;
use drex_grasp::GripForcePolicy;
use drex_policy::{GraspPolicy, Query};
use drex_trial::{Command, Condition, ConditionSpread, Evaluator, Frame, GraspPath, Uncertainty, Verdict, wilson};
use rayon::prelude::*;

use super::simulated::Simulated;
use crate::Progress;
use crate::learn::{POINTS, propose};
use crate::records::{POLICY, RecordedFrame, RolloutRecord, TRIAL, TrialFile, write_json};
use crate::{Error, Result, Twin};

/// Rollouts.
const ROLLOUTS: usize = 24;
/// Time between two frames of the recording, s.
const FRAME_S: f64 = 0.08;
/// Set apart from the seeds of the practice.
const TRIAL_SEED: u64 = 0x74_72_69_61;
/// Set apart from the seed of the conditions.
const MASS_SEED: u64 = 0x6d_61_73_73;

pub(crate) fn make(twin: &Twin, progress: &dyn Progress) -> Result<Vec<PathBuf>> {
    let mass = twin.mass()?;
    let robot = twin.hand()?;
    let policy = GraspPolicy::load(&twin.path(POLICY))?;
    // As `drex grasp` plans it: with exact distances.
    let simulated = Simulated::new(twin.object()?, &robot, mass.grip_kg)?;
    let spread = ConditionSpread::around(twin.manifest.object.friction);
    let unknown = match twin.manifest.object.friction {
        Some(_) => None,
        None => {
            let uncertainty = Uncertainty::new(mass.likely_kg(), Uncertainty::ANY_FRICTION)?;
            Some(uncertainty.spoken_for_by(mass.grip_kg)?.in_turn(&GripForcePolicy::default()))
        }
    };
    let conditions = spread.conditions(ROLLOUTS, twin.seed ^ TRIAL_SEED);
    let true_masses_kg = mass.posterior.sample_kg(ROLLOUTS, twin.seed ^ TRIAL_SEED ^ MASS_SEED);
    let cloud = simulated.object.point_cloud(POINTS, twin.seed);
    let up = simulated.object.table().up.into_inner();

    progress.begin("trial", Some(conditions.len() as u64));
    let run = |(condition, true_kg): (&Condition, &f64)| -> Result<(RolloutRecord, Option<Command>)> {
        if progress.is_stopped() {
            return Err(Error::Stopped);
        }
        let assumed = match &unknown {
            Some(in_turn) => in_turn.map(|(_, assumed)| assumed).to_vec(),
            None => vec![condition.assumed(mass.grip_kg)],
        };
        let query = Query::new(&cloud, mass.grip_kg, assumed[0].friction).with_up(up);
        let planned = GraspPath::default().plan_in_turn(&simulated.evaluator, propose(&policy, &query)?, &assumed)?;
        let mut record = RolloutRecord {
            verdict: Verdict::NoContact,
            mass_kg: *true_kg,
            friction: condition.friction,
            proposal: 0,
            grip_force_n: 0.0,
            held_n: None,
            friction_used: None,
        };
        let command = match planned.command {
            Ok(command) => {
                let outcome = simulated.evaluator.evaluate(&command, &condition.truth(*true_kg))?;
                record.verdict = outcome.verdict;
                (record.proposal, record.grip_force_n) = (planned.place, outcome.grip_force_n);
                (record.held_n, record.friction_used) = (outcome.held_n, outcome.friction_used);
                Some(command)
            }
            Err(reason) => {
                record.verdict = reason.verdict();
                None
            }
        };
        progress.step();
        Ok((record, command))
    };
    let done: Vec<(RolloutRecord, Option<Command>)> =
        conditions.par_iter().zip(&true_masses_kg).map(run).collect::<Result<_>>()?;
    progress.end();

    let succeeded = |(r, _): &(RolloutRecord, _)| r.verdict == Verdict::Success;
    let held = done.iter().filter(|d| succeeded(d)).count();
    let filmed = done.iter().position(succeeded).or_else(|| done.iter().position(|d| d.1.is_some()));
    let recording = match filmed.map(|i| (&conditions[i], &done[i])) {
        Some((condition, (record, Some(command)))) => {
            simulated.evaluator.record(command, &condition.truth(record.mass_kg), FRAME_S)?
        }
        _ => Vec::new(),
    };
    let interval = wilson(held, done.len());
    let file = TrialFile {
        schema: 1,
        hand: robot.name.clone(),
        joint_names: robot.joint_names().into_iter().map(str::to_owned).collect(),
        mass_kg: mass.grip_kg,
        mass_median_kg: mass.mass_kg,
        mass_ci95_kg: mass.ci95_kg,
        mass_sd_kg: mass.sd_kg,
        friction: [spread.friction.0, spread.friction.1],
        held,
        n: done.len(),
        interval: [interval.low, interval.high],
        rollouts: done.into_iter().map(|d| d.0).collect(),
        recording: recording.into_iter().map(frame).collect(),
        filmed,
    };
    write_json(&twin.output(TRIAL)?, &file)?;
    Ok(vec![twin.path(TRIAL)])
}

fn frame(f: Frame) -> RecordedFrame {
    RecordedFrame {
        time_s: f.time_s,
        world_from_base: PoseRecord::from(&f.world_from_base),
        joints_rad: f.joints,
        world_from_object: PoseRecord::from(&f.world_from_object),
        finger_n: f.finger_n,
    }
}
