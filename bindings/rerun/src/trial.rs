//! The trial: the film of one rollout that lifts, holds and shakes, and what became of all.

use anyhow::{Context, Result};
use drex_core::Pose;
use serde::Deserialize;

use crate::hand::{Hand, Held};
use crate::recorder::{Recorder, Times, mesh};
use crate::twin::{OBJECT_RGBA, PoseRecord, Twin};

/// What of `policy/trial.json` is recorded.
#[derive(Deserialize)]
struct TrialFile {
    joint_names: Vec<String>,
    held: usize,
    n: usize,
    interval: [f64; 2],
    rollouts: Vec<Rollout>,
    film: Vec<Frame>,
}

#[derive(Deserialize)]
struct Rollout {
    mass_kg: f64,
    friction: f64,
    #[serde(rename = "squeeze_n")]
    grip_force_n: f64,
    held_n: Option<f64>,
}

#[derive(Deserialize)]
struct Frame {
    time_s: f64,
    world_from_base: PoseRecord,
    joints_rad: Vec<f64>,
    world_from_object: PoseRecord,
    finger_n: Vec<f64>,
}

/// Records the film on the timeline `trial`, the rollouts on `rollout`, numbered from 0.
pub fn record(recorder: &Recorder, twin: &mut Twin, hand: &Hand) -> Result<()> {
    const FILE: &str = "policy/trial.json";
    let Some(trial) = twin.json::<TrialFile>(FILE, "there is no trial")? else { return Ok(()) };
    recorder.number(&["trial", "held"], trial.held as f64)?;
    recorder.number(&["trial", "rollouts"], trial.n as f64)?;
    recorder.number(&["trial", "interval95_low"], trial.interval[0])?;
    recorder.number(&["trial", "interval95_high"], trial.interval[1])?;
    rollouts(recorder, &trial.rollouts)?;
    if trial.film.is_empty() {
        twin.missing.push("film of the trial: no rollout could be carried out".into());
        return Ok(());
    }
    let context = || twin.path(FILE).display().to_string();
    let times_s: Vec<f64> = trial.film.iter().map(|f| f.time_s).collect();
    let times = Times::Seconds("trial", &times_s);
    let object: Vec<Pose> = trial.film.iter().map(|f| f.world_from_object.0).collect();
    recorder.poses(&["world", "trial", "object"], times, &object).with_context(context)?;
    if let Some(shape) = &twin.mesh {
        recorder.starting(&["world", "trial", "object", "mesh"], times, &mesh(shape, true, OBJECT_RGBA))?;
    }
    let held: Vec<Held> = trial
        .film
        .into_iter()
        .map(|f| Held {
            joints_rad: f.joints_rad,
            world_from_base: f.world_from_base.0,
            world_from_object: f.world_from_object.0,
            finger_n: f.finger_n,
        })
        .collect();
    hand.record(recorder, twin, "trial", &trial.joint_names, times, &held).with_context(context)
}

fn rollouts(recorder: &Recorder, all: &[Rollout]) -> Result<()> {
    let numbers: Vec<i64> = (0..all.len() as i64).collect();
    let times = Times::Numbers("rollout", &numbers);
    let series = |name: &str, value: &dyn Fn(&Rollout) -> f64| {
        let values: Vec<f64> = all.iter().map(value).collect();
        recorder.series(&["rollouts", name], times, &values)
    };
    series("true_mass_kg", &|r| r.mass_kg)?;
    series("true_friction", &|r| r.friction)?;
    series("squeeze_told_n", &|r| r.grip_force_n)?;
    series("squeeze_held_n", &|r| r.held_n.unwrap_or(f64::NAN))
}
