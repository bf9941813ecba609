//! Recordings in which the mass cannot be seen, shown by simulation where there is something to simulate.
//!
//! Gravity, Coulomb friction and contact scale with the mass, and so does the force a prescribed pusher needs: the
//! motion is the same for every mass. Simulating it with masses a hundredfold apart gives the same cost.

use std::sync::Arc;

use drex_core::pose::pose_difference;
use drex_core::{Object, Pose};
use drex_diffsim::Collider;
use drex_recording::{Drive, PushRecording, TrackFrame};
use nalgebra::{SMatrix, SVector, Vector3};

use crate::parameters::Parameter;
use crate::problem::Problem;
use crate::{IdentifyOptions, Result, noise};

/// Masses at which the cost of a motion without known force is compared.
const MASSES_KG: [f64; 7] = [0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0];

/// What a recording without a known force tells.
pub(crate) struct Finding {
    pub reason: String,
    pub notes: Vec<String>,
    pub profile: Vec<(f64, f64)>,
    pub simulated: Vec<Pose>,
}

pub(crate) fn explain(
    recording: &PushRecording,
    object: &Object,
    collider: &Arc<Collider>,
    options: &IdentifyOptions,
) -> Result<Finding> {
    let mut finding = Finding { reason: String::new(), notes: Vec::new(), profile: Vec::new(), simulated: Vec::new() };
    let mut flat = false;
    if recording.track_frame == TrackFrame::World {
        let noise = recording.noise.unwrap_or_else(|| noise::of_track(&recording.track));
        let mut problem = Problem::new(recording, object, collider, options, noise)?;
        if !recording.starts_at_rest {
            start_from_track(&mut problem, recording);
        }
        let friction = recording.support.friction.unwrap_or(Parameter::Friction.nominal());
        for mass in MASSES_KG {
            let Ok(motion) = problem.simulate(&problem.stated(mass, friction), options.dt_s) else { continue };
            let fit = problem.fit(&motion, None);
            if finding.simulated.is_empty() {
                finding.simulated = problem.times_s.iter().map(|t| motion.at(t - fit.nuisance[0])).collect();
            }
            finding.profile.push((mass, fit.cost));
        }
        let costs = || finding.profile.iter().map(|p| p.1);
        let spread = costs().fold(f64::NEG_INFINITY, f64::max) - costs().fold(f64::INFINITY, f64::min);
        flat = finding.profile.len() == MASSES_KG.len() && spread < 1e-3;
        if !finding.profile.is_empty() {
            finding.notes.push(format!(
                "simulated with {} masses from 20 g to 2 kg: the cost differs by {spread:.1e} (it would have to differ by 1.92)",
                finding.profile.len()
            ));
        }
    }
    let shown = if flat { " (simulated with masses from 20 g to 2 kg, the cost is the same)" } else { "" };
    finding.reason = match &recording.drive {
        Drive::Nothing => format!(
            "no known force acted on the object: gravity, friction and impact scale with its mass, so every mass moves \
                           the same way{shown}; push it with a known force, tip it, or lift it"
        ),
        _ => "the poses are given in a camera of unknown pose, where neither gravity nor the force has a direction; state the \
              camera's pose in the world (world_from_camera in push.toml)"
            .into(),
    };
    Ok(finding)
}

/// Start pose and velocity of a motion that does not start at rest, from the first frames: straight line in free fall,
/// constant rotation about a fixed axis.
fn start_from_track(problem: &mut Problem, recording: &PushRecording) {
    let n = problem.times_s.len().min(6);
    let mut normal = SMatrix::<f64, 2, 2>::zeros();
    let mut right = SMatrix::<f64, 2, 6>::zeros();
    let first = problem.observed[0];
    for k in 0..n {
        let t = problem.times_s[k];
        let mut d = pose_difference(&first, &problem.observed[k]);
        // Rotation in the world, translation without the fall.
        let turn = first.rotation * Vector3::new(d[3], d[4], d[5]);
        let fall = recording.gravity * (0.5 * t * t);
        for i in 0..3 {
            d[i] -= fall[i];
            d[i + 3] = turn[i];
        }
        let a = SVector::<f64, 2>::new(1.0, t);
        normal += a * a.transpose();
        right += a * d.transpose();
    }
    if let Some(solution) = normal.try_inverse().map(|i| i * right) {
        let spin = Vector3::new(solution[(1, 3)], solution[(1, 4)], solution[(1, 5)]);
        let origin = Vector3::new(solution[(1, 0)], solution[(1, 1)], solution[(1, 2)]);
        problem.start = recording.initial_pose.unwrap_or(first);
        problem.start_spin = spin;
        // The track follows the mesh frame; the simulator wants the centre of mass.
        problem.start_velocity = origin + spin.cross(&(problem.start.rotation * problem.center_of_mass().coords));
    }
}
