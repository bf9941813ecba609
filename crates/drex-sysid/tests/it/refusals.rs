//! Recordings that cannot be what they say they are.

use crate::common::{block, box_mesh, normals, object_of, simulated};
use drex_core::{Pose, Trajectory};
use drex_recording::{Drive, PushRecording};
use drex_sysid::{IdentifyOptions, identify};
use nalgebra::{Point3, Vector3};

fn lifted() -> PushRecording {
    simulated(0.2, 0.4, Vector3::z() * 3.0, Point3::origin())
}

/// The error message for a recording, or the verdict's reason.
fn refusal(push: &PushRecording) -> Result<String, String> {
    match identify(std::slice::from_ref(push), &block(), &IdentifyOptions::default()) {
        Err(e) => Ok(e.to_string()),
        Ok(a) => Err(a.reason),
    }
}

fn retracked(mut push: PushRecording, change: impl Fn(usize, f64, &Pose) -> Option<(f64, Pose)>) -> PushRecording {
    let rows = push.track.times_s().iter().zip(push.track.poses()).enumerate();
    let (times, poses): (Vec<f64>, Vec<Pose>) = rows.filter_map(|(k, (t, p))| change(k, *t, p)).unzip();
    push.track = Trajectory::from_samples(&times, &poses).unwrap();
    push
}

#[test]
fn nine_poses_are_too_few() {
    let short = retracked(lifted(), |k, t, p| (k < 9).then_some((t, *p)));
    let message = refusal(&short).unwrap();
    assert!(message.contains("9 poses") && message.contains("10"), "{message}");
}

#[test]
fn nothing_that_acts_and_nothing_that_moves_is_no_push() {
    let mut noise = normals(3);
    let rest = Pose::translation(0.0, 0.0, 0.04);
    let shaken: Vec<Pose> = (0..36).map(|_| Pose::translation(1e-3 * noise(), 1e-3 * noise(), 0.0) * rest).collect();
    let mut push = retracked(lifted(), |k, t, _| Some((t, shaken[k])));
    // With a force that should have lifted it, this is a verdict.
    assert!(refusal(&push).is_err());
    if let Drive::Force(f) = &mut push.drive {
        f.forces_n.fill(Vector3::zeros());
    }
    assert!(refusal(&push).unwrap().contains("nothing moves"));
    push.drive = Drive::Nothing;
    assert!(refusal(&push).unwrap().contains("nothing moves"));
}

#[test]
fn a_start_at_rest_must_be_one() {
    let mut push = retracked(lifted(), |_, t, p| Some((t, Pose::translation(0.1 * t, 0.0, 0.0) * p)));
    push.initial_pose = None;
    assert!(refusal(&push).unwrap().contains("no rest segment"));
    // Noise is no motion.
    let mut noise = normals(9);
    for _ in 0..6 {
        let shift: Vec<f64> = (0..36).map(|_| 1e-3 * noise()).collect();
        let mut push = retracked(lifted(), |k, t, p| Some((t, Pose::translation(shift[k], 0.0, 0.0) * p)));
        push.initial_pose = None;
        assert!(refusal(&push).is_err());
    }
    // Nor is one frame that is wild.
    for wild in 0..5 {
        let far = Pose::translation(0.03, 0.03, 0.06);
        let mut push = retracked(lifted(), |k, t, p| Some((t, if k == wild { far * p } else { *p })));
        push.initial_pose = None;
        assert_eq!(refusal(&push).ok(), None, "{wild}");
    }
}

#[test]
fn an_object_at_rest_stands_on_something() {
    for (height, what) in [(-0.1, "above what it should stand on"), (0.1, "deep in the table")] {
        let mut push = lifted();
        push.support.table_height_m = height;
        let message = refusal(&push).unwrap();
        assert!(message.contains(what) && message.contains("100 mm"), "{message}");
    }
}

#[test]
fn a_mesh_in_millimetres_is_named() {
    let huge = object_of(&box_mesh(Vector3::new(25.0, 30.0, 40.0), Vector3::zeros()));
    let message = identify(&[lifted()], &huge, &IdentifyOptions::default()).unwrap_err().to_string();
    assert!(message.contains("m across") && message.contains("millimetres"), "{message}");
}
