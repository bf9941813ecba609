//! The axes of a push. What is decided axis by axis (medians of frames, which samples of a force are noise, draws of a place) must not
//! depend on how the world is turned: a push by a known force on a plane is estimated in axes whose x is where it heads.

use drex_core::{Pose, Trajectory};
use drex_recording::{Drive, PushRecording};
use nalgebra::{UnitQuaternion, Vector3};

use crate::Result;
use crate::parameters::{Knowledge, Parameter, ParameterSet};

/// The world's axes from those of a push; the world's own where more is stated along one of them than along the other.
pub(crate) fn world_from_push(recording: &PushRecording, parameters: &ParameterSet) -> UnitQuaternion<f64> {
    use Parameter::{BiasX, BiasY, StartX, StartY};
    let alike = |x, y| match parameters.get(x) {
        Some(Knowledge::Prior { mean, .. } | Knowledge::Fixed(mean)) if mean != 0.0 => false,
        of_x => of_x == parameters.get(y),
    };
    let is_alike = alike(StartX, StartY) && alike(BiasX, BiasY);
    match &recording.drive {
        Drive::Force(force) if recording.support.boxes.is_empty() && is_alike => {
            let heads: Vector3<f64> = force.forces_n.iter().sum();
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heads.y.atan2(heads.x))
        }
        _ => UnitQuaternion::identity(),
    }
}

/// A push by a known force, its world turned about the vertical.
pub(crate) fn turned(recording: &PushRecording, by: &UnitQuaternion<f64>) -> Result<PushRecording> {
    let mut out = recording.clone();
    let pose = |p: &Pose| *by * p;
    let poses: Vec<Pose> = recording.track.poses().iter().map(pose).collect();
    out.track = Trajectory::from_samples(recording.track.times_s(), &poses)?;
    out.initial_pose = recording.initial_pose.as_ref().map(pose);
    out.gravity = by * recording.gravity;
    if let Drive::Force(force) = &mut out.drive {
        force.forces_n.iter_mut().chain(&mut force.torques_nm).for_each(|v| *v = by * *v);
    }
    Ok(out)
}
