//! The mass: how likely each one is, and the pushes that say so.

use anyhow::{Context, Result};
use drex_core::{Pose, pose};
use drex_recording::{Drive, ForceProfile, PushRecording};
use drex_sysid::PushReport;
use drex_twin::records::{MASS, MassFile};
use nalgebra::Vector3;
use re_sdk_types::archetypes::Arrows3D;

use crate::recorder::{Recorder, Times, mesh, point, vector};
use crate::twin::{ARROW_M_PER_N, OBJECT_RGBA, Twin};

const TRACKED_RGBA: [u8; 4] = [0, 115, 178, 110];
const FORCE_RGB: [u8; 3] = [204, 51, 46];
const AXES: [&str; 3] = ["x", "y", "z"];

/// Records the mass, its likelihood and every push.
pub fn record(recorder: &Recorder, twin: &mut Twin) -> Result<()> {
    let Some(mass) = twin.record::<MassFile>(MASS, "there is neither mass nor push")? else { return Ok(()) };
    recorder.number(&["mass", "mass_kg"], mass.mass_kg)?;
    recorder.number(&["mass", "ci95_low_kg"], mass.ci95_kg[0])?;
    recorder.number(&["mass", "ci95_high_kg"], mass.ci95_kg[1])?;
    let Some(result) = mass.identification else {
        twin.missing.push("pushes: mass.json tells of none, the mass was weighed or guessed".into());
        return Ok(());
    };
    likelihood(recorder, &result.profile)?;
    for (i, push) in result.pushes.iter().enumerate() {
        let given = twin.folder.manifest.mass.identify.get(i).map(|p| twin.folder.path(p));
        let recording = match given.map(|p| PushRecording::load(&p)) {
            Some(Ok(recording)) if recording.name == push.name => Some(recording),
            Some(Err(e)) => {
                twin.missing.push(format!("force of push {}: {e}", push.name));
                None
            }
            _ => None,
        };
        let context = || format!("push {} of {}", push.name, twin.folder.path(MASS).display());
        record_push(recorder, twin, push, recording.as_ref()).with_context(context)?;
    }
    Ok(())
}

/// The profile over masses in whole milligrams.
fn likelihood(recorder: &Recorder, profile: &[(f64, f64)]) -> Result<()> {
    let known: Vec<(f64, f64)> = profile.iter().copied().filter(|p| p.1.is_finite()).collect();
    let least = known.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
    // A cast of a float saturates; masses are below a ton.
    let mg: Vec<i64> = known.iter().map(|p| (1e6 * p.0).round() as i64).collect();
    let above: Vec<f64> = known.iter().map(|p| p.1 - least).collect();
    let likelihood: Vec<f64> = above.iter().map(|c| (-c).exp()).collect();
    let times = Times::Numbers("mass_mg", &mg);
    recorder.series(&["mass", "cost_above_best"], times, &above)?;
    recorder.series(&["mass", "likelihood_to_best"], times, &likelihood)
}

fn record_push(recorder: &Recorder, twin: &Twin, push: &PushReport, recording: Option<&PushRecording>) -> Result<()> {
    let name = push.name.as_str();
    let timeline = format!("push_{name}");
    let times = Times::Seconds(&timeline, &push.times_s);
    let observed = poses(&push.observed)?;
    let simulated = poses(&push.simulated)?;
    // A hand's push is tracked by a camera whose place nobody knows: those poses are none of the world.
    let space = if push.hand.is_some() || simulated.is_empty() { "tracker" } else { "world" };
    for (what, poses, rgba) in [("tracked", &observed, TRACKED_RGBA), ("simulated", &simulated, OBJECT_RGBA)] {
        if poses.is_empty() {
            continue;
        }
        recorder.poses(&[space, "push", name, what], times, poses)?;
        if let Some(shape) = &twin.mesh {
            recorder.starting(&[space, "push", name, what, "mesh"], times, &mesh(shape, true, rgba))?;
        }
    }
    if simulated.len() == observed.len() {
        let apart = |(o, s): (&Pose, &Pose)| 1e3 * (o.translation.vector - s.translation.vector).norm();
        let off_mm: Vec<f64> = observed.iter().zip(&simulated).map(apart).collect();
        recorder.series(&["push", name, "tracked_from_simulated_mm"], times, &off_mm)?;
    }
    let Some(Drive::Force(force)) = recording.map(|r| &r.drive) else { return Ok(()) };
    let sampled = Times::Seconds(&timeline, &force.times_s);
    for (axis, label) in AXES.iter().enumerate() {
        let newtons: Vec<f64> = force.forces_n.iter().map(|f| f[axis]).collect();
        recorder.series(&["push", name, "force_n", label], sampled, &newtons)?;
    }
    if space != "world" {
        return Ok(());
    }
    arrows(recorder, &["world", "push", name, "force"], times, force, &push.times_s, &simulated)
}

fn poses(rows: &[[f64; 7]]) -> Result<Vec<Pose>> {
    rows.iter().map(|p| Ok(pose::pose_from_wxyz([p[0], p[1], p[2]], [p[3], p[4], p[5], p[6]])?)).collect()
}

/// The force as an arrow whose tip is where it acts on the simulated object.
fn arrows(
    recorder: &Recorder,
    parts: &[&str],
    times: Times<'_>,
    force: &ForceProfile,
    times_s: &[f64],
    object: &[Pose],
) -> Result<()> {
    let vectors: Vec<Vector3<f64>> = times_s.iter().map(|t| ARROW_M_PER_N * force_at(force, *t)).collect();
    let tails = vectors.iter().zip(object).map(|(v, pose)| point(&(pose * force.point_in_object - v)));
    let arrows = Arrows3D::from_vectors(vectors.iter().map(vector)).with_origins(tails);
    recorder.columns(parts, times, object.len(), arrows.columns_of_unit_batches()?)?;
    recorder.starting(parts, times, &Arrows3D::update_fields().with_colors([FORCE_RGB]))
}

/// Held from each sample to the next, nil before the first and after the last; newtons, world frame.
fn force_at(force: &ForceProfile, t: f64) -> Vector3<f64> {
    let next = force.times_s.partition_point(|s| *s <= t);
    let beyond = next == 0 || force.times_s.last().is_none_or(|end| t > *end);
    if beyond { Vector3::zeros() } else { force.forces_n.get(next - 1).copied().unwrap_or_else(Vector3::zeros) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn a_force_is_held_and_ends() {
        let force = ForceProfile {
            times_s: vec![0.0, 1.0, 2.0],
            forces_n: vec![Vector3::x(), 2.0 * Vector3::x(), 3.0 * Vector3::x()],
            torques_nm: vec![],
            point_in_object: Point3::origin(),
        };
        let seen = [-0.1, 0.0, 0.9, 1.0, 2.0, 2.1].map(|t| force_at(&force, t).x);
        assert_eq!(seen, [0.0, 1.0, 1.0, 2.0, 3.0, 0.0]);
    }
}
