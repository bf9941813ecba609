//! The trial: the film of one rollout that lifts, holds and shakes, and what became of all.

use anyhow::{Context, Result};
use drex_core::Pose;
use drex_twin::records::{RecordedFrame, RolloutRecord, TRIAL, TrialFile};

use crate::hand::{Hand, Held};
use crate::recorder::{Recorder, Times, mesh};
use crate::twin::{OBJECT_RGBA, Twin};

/// Records the film on the timeline `trial`, the rollouts on `rollout`, numbered from 0.
pub fn record(recorder: &Recorder, twin: &mut Twin, hand: &Hand) -> Result<()> {
    let Some(trial) = twin.record::<TrialFile>(TRIAL, "there is no trial")? else { return Ok(()) };
    recorder.number(&["trial", "held"], trial.held as f64)?;
    recorder.number(&["trial", "rollouts"], trial.n as f64)?;
    recorder.number(&["trial", "interval95_low"], trial.interval[0])?;
    recorder.number(&["trial", "interval95_high"], trial.interval[1])?;
    rollouts(recorder, &trial.rollouts)?;
    if trial.recording.is_empty() {
        twin.missing.push("film of the trial: no rollout could be carried out".into());
        return Ok(());
    }
    let context = || twin.folder.path(TRIAL).display().to_string();
    let times_s: Vec<f64> = trial.recording.iter().map(|f| f.time_s).collect();
    let times = Times::Seconds("trial", &times_s);
    let held: Vec<Held> = trial.recording.into_iter().map(held).collect::<Result<_>>().with_context(context)?;
    let object: Vec<Pose> = held.iter().map(|h| h.world_from_object).collect();
    recorder.poses(&["world", "trial", "object"], times, &object).with_context(context)?;
    if let Some(shape) = &twin.mesh {
        recorder.starting(&["world", "trial", "object", "mesh"], times, &mesh(shape, true, OBJECT_RGBA))?;
    }
    hand.record(recorder, twin, "trial", &trial.joint_names, times, &held).with_context(context)
}

fn held(frame: RecordedFrame) -> Result<Held> {
    Ok(Held {
        joints_rad: frame.joints_rad,
        world_from_base: frame.world_from_base.to_pose()?,
        world_from_object: frame.world_from_object.to_pose()?,
        finger_n: frame.finger_n,
    })
}

fn rollouts(recorder: &Recorder, all: &[RolloutRecord]) -> Result<()> {
    let numbers: Vec<i64> = (0..all.len() as i64).collect();
    let times = Times::Numbers("rollout", &numbers);
    let series = |name: &str, value: &dyn Fn(&RolloutRecord) -> f64| {
        let values: Vec<f64> = all.iter().map(value).collect();
        recorder.series(&["rollouts", name], times, &values)
    };
    series("true_mass_kg", &|r| r.mass_kg)?;
    series("true_friction", &|r| r.friction)?;
    series("squeeze_told_n", &|r| r.grip_force_n)?;
    series("squeeze_held_n", &|r| r.held_n.unwrap_or(f64::NAN))
}
