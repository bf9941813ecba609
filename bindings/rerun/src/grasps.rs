//! Grasps: the demonstrated ones that fit the object, and those that the network gives for it.

use anyhow::{Context, Result};
use drex_core::PoseRecord;
use drex_twin::records::{EVALUATION, EvaluatedGrasp, Evaluation, FITS, FitFile, FitRecord};

use crate::hand::{Hand, Held};
use crate::recorder::{Recorder, Times};
use crate::twin::Twin;

/// Records accepted grasps on the timeline `grasp` and predicted ones on `predicted`, both numbered from 0.
pub fn record(recorder: &Recorder, twin: &mut Twin, hand: &Hand) -> Result<()> {
    let Some(file) = twin.record::<FitFile>(FITS, "there are no grasps")? else { return Ok(()) };
    demonstrated(recorder, twin, hand, &file).with_context(|| twin.folder.path(FITS).display().to_string())?;
    let Some(evaluation) = twin.record::<Evaluation>(EVALUATION, "there are no predicted grasps")? else {
        return Ok(());
    };
    predicted(recorder, twin, hand, &file.joint_names, &evaluation.predicted)
        .with_context(|| twin.folder.path(EVALUATION).display().to_string())
}

fn demonstrated(recorder: &Recorder, twin: &mut Twin, hand: &Hand, file: &FitFile) -> Result<()> {
    let accepted: Vec<&FitRecord> = file.grasps.iter().filter(|g| g.accepted).collect();
    if accepted.is_empty() {
        twin.missing.push("grasps: no demonstration fits the object".into());
        return Ok(());
    }
    let numbers: Vec<i64> = (0..accepted.len() as i64).collect();
    let times = Times::Numbers("grasp", &numbers);
    let held: Vec<Held> =
        accepted.iter().map(|g| at_rest(twin, &g.joints_rad, g.object_from_base, Vec::new())).collect::<Result<_>>()?;
    hand.record(recorder, twin, "grasps", &file.joint_names, times, &held)?;
    let series = |name: &str, value: &dyn Fn(&FitRecord) -> f64| {
        let values: Vec<f64> = accepted.iter().map(|g| value(g)).collect();
        recorder.series(&["grasps", name], times, &values)
    };
    series("demonstration", &|g| g.demonstration as f64)?;
    series("penetration_mm", &|g| g.penetration_mm)?;
    series("table_clearance_mm", &|g| g.table_clearance_mm)?;
    series("squeeze_per_weight", &|g| g.grip_force_per_weight.unwrap_or(f64::NAN))
}

fn predicted(recorder: &Recorder, twin: &Twin, hand: &Hand, joints: &[String], all: &[EvaluatedGrasp]) -> Result<()> {
    let numbers: Vec<i64> = (0..all.len() as i64).collect();
    let times = Times::Numbers("predicted", &numbers);
    let of_finger = |g: &EvaluatedGrasp, finger: &str| -> f64 {
        g.check.fingers.iter().filter(|c| c.finger == finger).map(|c| c.normal_n).sum()
    };
    let held: Vec<Held> = all
        .iter()
        .map(|g| {
            let finger_n = hand.fingers().into_iter().map(|f| of_finger(g, f)).collect();
            at_rest(twin, &g.joints_rad, g.object_from_base, finger_n)
        })
        .collect::<Result<_>>()?;
    hand.record(recorder, twin, "predicted", joints, times, &held)?;
    let series = |name: &str, value: &dyn Fn(&EvaluatedGrasp) -> f64| {
        let values: Vec<f64> = all.iter().map(value).collect();
        recorder.series(&["predicted", name], times, &values)
    };
    series("squeeze_n", &|g| g.predicted_grip_force_n.unwrap_or(f64::NAN))?;
    series("weight", &|g| g.weight.unwrap_or(f64::NAN))?;
    series("penetration_mm", &|g| g.check.penetration_mm)
}

/// A grasp of the object as it rests on the table.
fn at_rest(twin: &Twin, joints_rad: &[f64], object_from_base: PoseRecord, finger_n: Vec<f64>) -> Result<Held> {
    Ok(Held {
        joints_rad: joints_rad.to_vec(),
        world_from_base: twin.world_from_mesh * object_from_base.to_pose()?,
        world_from_object: twin.world_from_mesh,
        finger_n,
    })
}
