//! Recorded and simulated pushes, read from their own layouts.
#![allow(clippy::unwrap_used, missing_docs)] // a test may stop at the first surprise

use std::path::{Path, PathBuf};

use drex_core::push::{
    Drive, InputChoice, PoseChoice, PushConfig, PushRecording, TrackFrame, drex_run,
};

fn shared(part: &str) -> Option<PathBuf> {
    let Some(root) = std::env::var_os("DREX_SHARED") else {
        eprintln!("skipped: DREX_SHARED is not set");
        return None;
    };
    Some(Path::new(&root).join("data").join(part))
}

fn folders(root: &Path) -> Vec<PathBuf> {
    let mut out: Vec<PathBuf> = std::fs::read_dir(root)
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| p.is_dir())
        .collect();
    out.sort();
    out
}

#[test]
fn every_simulated_push_is_read_in_every_quality() {
    let Some(root) = shared("push_mujoco") else {
        return;
    };
    let mut seen = [0; 3];
    for scenario in folders(&root).iter().flat_map(|object| folders(object)) {
        for poses in [PoseChoice::Noisy, PoseChoice::Hard, PoseChoice::Clean] {
            let choice = InputChoice {
                poses,
                ..InputChoice::default()
            };
            let push = PushRecording::load(&scenario, &choice).unwrap();
            assert_eq!(push.noise.is_some(), poses == PoseChoice::Noisy);
            assert_eq!(push.track_frame, TrackFrame::World);
            assert!(push.initial_pose.is_some() && push.mass_prior_kg.is_some());
            assert_eq!(
                push.support.boxes.len(),
                usize::from(scenario.ends_with("overhang_press"))
            );
            match &push.drive {
                Drive::Force(f) => {
                    assert!(f.times_s.len() > 50);
                    seen[0] += 1;
                }
                Drive::Finger(f) => {
                    assert!(f.encoder.is_some() && f.commands.len() == f.command_times_s.len());
                    seen[1] += 1;
                }
                Drive::Nothing => {
                    assert!(scenario.ends_with("toss") && !push.starts_at_rest);
                    seen[2] += 1;
                }
                other => panic!("{other:?}"),
            }
        }
    }
    assert!(seen.iter().all(|&n| n >= 3), "{seen:?}");
    let fast = root.join("brick/finger_fast");
    let push = PushRecording::load(
        &fast,
        &InputChoice {
            encoder: false,
            ..InputChoice::default()
        },
    )
    .unwrap();
    assert!(matches!(push.drive, Drive::Finger(f) if f.encoder.is_none()));
}

#[test]
fn every_real_run_is_read_on_one_clock_in_the_mesh_frame() {
    let Some(root) = shared("drex_real/runs") else {
        return;
    };
    for run in folders(&root) {
        let push = PushRecording::load(&run, &InputChoice::default()).unwrap();
        for note in &push.notes {
            eprintln!("{}: {note}", push.name);
        }
        assert_eq!(push.track.times_s()[0], 0.0);
        let Drive::Hand(hand) = &push.drive else {
            panic!("{:?}", push.drive)
        };
        assert_eq!(hand.joints.names.len(), 16);
        assert_eq!(hand.joints.names[12], "thj0");
        assert_eq!(hand.joints.efforts.len(), hand.joints.times_s.len());
        // The joint log lies inside the track in all of these runs.
        assert!(
            hand.joints.times_s[0] > 0.0
                && *hand.joints.times_s.last().unwrap() < push.track.span_s().unwrap().1
        );
        // Gravity points the same way in the camera before every push of a day; up must agree with the picture: the
        // camera looks down on the table, so up has a component against the image's y axis.
        let TrackFrame::Camera {
            up_in_mesh,
            push_in_mesh,
        } = &push.track_frame
        else {
            panic!()
        };
        let up_in_camera = push.track.poses()[0] * up_in_mesh;
        assert!(
            (up_in_mesh.norm() - 1.0).abs() < 1e-12 && up_in_camera.y < -0.5,
            "{}: {up_in_camera}",
            push.name
        );
        assert!(push_in_mesh.unwrap().dot(up_in_mesh).abs() < 1e-9);
    }
}

#[test]
fn a_real_run_written_as_push_toml_reads_the_same() {
    let Some(root) = shared("drex_real/runs") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    for run in folders(&root) {
        let config = drex_run::to_push_config(&run.join("run.json"), folder.path()).unwrap();
        let file = folder.path().join("push.toml");
        std::fs::write(&file, config.to_toml_string().unwrap()).unwrap();
        assert_eq!(PushConfig::read(&file).unwrap(), config);
        let a = PushRecording::load(&run, &InputChoice::default()).unwrap();
        let b = PushRecording::load(&file, &InputChoice::default()).unwrap();
        assert_eq!(a.name, b.name);
        assert_eq!(a.track, b.track);
        assert_eq!(a.track_frame, b.track_frame);
        let (Drive::Hand(a), Drive::Hand(b)) = (a.drive, b.drive) else {
            panic!()
        };
        assert_eq!(a, b);
        assert_eq!(b.joints.names[0], "ffj0");
    }
}
