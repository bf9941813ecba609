//! Recordings that were tampered with: what must not weigh the object does not, and a force that belongs to another mass gives
//! that other mass.
//!
//! The forces of one run with the poses of the same object at 0.6 and 1.6 times its mass are made here for a block. Where
//! `DREX_PLACEBO` names a folder, sets of simulated pushes in it are used as well: `x1.0`, `x0.6` and `x1.6`, each written by the
//! generator of the shared data set `push_mujoco` with one and the same seed, in a copy of the script whose list `PUBLIC` holds the
//! true masses times that factor.

use std::path::{Path, PathBuf};

use crate::common::{block, object_at, shared, simulated};
use drex_core::trajectory::PoseNoise;
use drex_core::{Object, Trajectory};
use drex_recording::convert::mujoco_push::{self, ForceQuality, Inputs, PoseQuality};
use drex_recording::{Drive, ForceProfile, PushRecording};
use drex_sysid::{Identification, IdentifyOptions, Verdict, identify};
use nalgebra::{Point3, Vector3};

const G: f64 = 9.81;
/// One of each kind of push.
const RECORDINGS: [&str; 6] = [
    "letter_t/lift_force",
    "letter_l/slide_force",
    "brick/tilt_force",
    "letter_l_rho1/overhang_press",
    "brick/finger_fast",
    "letter_t/finger_tilt",
];

fn weigh(push: PushRecording, object: &Object) -> Identification {
    identify(&[push], object, &IdentifyOptions::default()).unwrap()
}

fn load(folder: &Path, inputs: Inputs) -> (PushRecording, Object) {
    let recording = mujoco_push::load(folder, inputs).unwrap();
    let object = object_at(&recording.mesh);
    (recording, object)
}

/// A lift, a slide and a tilt of the block.
fn blocks(m: f64) -> [PushRecording; 3] {
    [
        simulated(m, 0.4, Vector3::z() * m * G * 1.6, Point3::origin()),
        simulated(m, 0.4, Vector3::x() * m * G * 0.4 * 1.8, Point3::new(-0.025, 0.0, -0.03)),
        simulated(m, 0.9, Vector3::x() * m * G * (0.025 / 0.075) * 1.25, Point3::new(-0.025, 0.0, 0.035)),
    ]
}

/// The same poses in another order.
fn shuffled(track: &Trajectory, seed: u64) -> Trajectory {
    let mut poses = track.poses().to_vec();
    let mut state = seed;
    for k in (1..poses.len()).rev() {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        poses.swap(k, (state >> 33) as usize % (k + 1));
    }
    Trajectory::from_samples(track.times_s(), &poses).unwrap()
}

/// The first pose over and over.
fn held(track: &Trajectory) -> Trajectory {
    Trajectory::from_samples(track.times_s(), &vec![track.poses()[0]; track.len()]).unwrap()
}

fn with_track(push: &PushRecording, track: Trajectory, noise: Option<PoseNoise>) -> PushRecording {
    let mut out = push.clone();
    (out.track, out.noise) = (track, noise);
    out
}

fn with_drive(mut push: PushRecording, drive: Drive) -> PushRecording {
    push.drive = drive;
    push
}

fn weighs_nothing(push: PushRecording, object: &Object, what: &str) {
    let a = weigh(push, object);
    assert_eq!(a.verdict, Verdict::NotIdentifiable, "{what}: {:?} {:?} {}", a.mass_kg, a.ci95_kg, a.reason);
    assert!(a.mass_kg.is_none() && a.ci95_kg.is_none());
}

#[test]
fn shuffled_and_constant_poses_of_a_block_weigh_nothing() {
    for push in blocks(0.137) {
        for stated in [push.noise, None] {
            for seed in [1, 2] {
                weighs_nothing(with_track(&push, shuffled(&push.track, seed), stated), &block(), "shuffled");
            }
            weighs_nothing(with_track(&push, held(&push.track), stated), &block(), "constant");
        }
    }
}

#[test]
fn shuffled_and_constant_poses_of_recordings_weigh_nothing() {
    let Some(shared) = shared() else { return };
    for name in RECORDINGS {
        let (push, object) = load(&shared.join("data/push_mujoco").join(name), Inputs::default());
        let track = shuffled(&push.track, 1);
        weighs_nothing(with_track(&push, track, push.noise), &object, &format!("{name} shuffled"));
        weighs_nothing(with_track(&push, held(&push.track), push.noise), &object, &format!("{name} held"));
    }
}

/// The encoder's readings 0.15 s late: no mass makes the fingertip do what they say.
#[test]
fn an_encoder_that_is_late_weighs_nothing() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/pushes/L001/finger_fast");
    let (mut push, object) = load(&folder, Inputs::default());
    if let Drive::Finger(finger) = &mut push.drive {
        finger.encoder.as_mut().unwrap().times_s.iter_mut().for_each(|t| *t += 0.15);
    }
    let a = weigh(push, &object);
    assert_eq!(a.verdict, Verdict::NotIdentifiable, "{:?} {:?} {}", a.mass_kg, a.ci95_kg, a.reason);
    assert!(a.reason.contains("the encoder of"), "{}", a.reason);
    // Nothing of the estimate is left that could be taken for one.
    assert!(a.mass_kg.is_none() && a.ci95_kg.is_none() && a.sd_log_mass.is_none() && a.sensitivities.is_empty());
}

#[test]
fn a_first_guess_moves_nothing() {
    let push = blocks(0.137)[1].clone();
    let answers = [0.1, 1.0, 10.0].map(|factor| {
        let mut push = push.clone();
        push.mass_prior_kg = Some(0.137 * factor);
        let mut a = weigh(push, &block());
        assert_eq!(a.prior_kg.take(), Some(0.137 * factor));
        a.seconds = 0.0;
        a
    });
    assert!(answers[0].ci95_kg.is_some());
    assert_eq!(answers[0], answers[1]);
    assert_eq!(answers[1], answers[2]);
}

#[test]
fn forces_of_another_mass_give_that_mass() {
    let m = 0.137;
    for factor in [0.6, 1.6] {
        for (own, other) in blocks(m).into_iter().zip(blocks(factor * m)) {
            // The lighter object moves under 0.6 of the force as the heavier one does under all of it.
            let a = weigh(with_drive(other, own.drive), &block());
            assert_eq!(a.verdict, Verdict::Identified, "{}", a.reason);
            assert!((a.mass_kg.unwrap() / m - 1.0).abs() < 2e-3, "{factor}: {:?}", a.mass_kg);
        }
    }
}

#[test]
fn forces_of_another_mass_give_that_mass_in_other_simulations() {
    let Some(root) = std::env::var_os("DREX_PLACEBO").map(PathBuf::from) else {
        eprintln!("skipped: DREX_PLACEBO is not set");
        return;
    };
    let exact = Inputs { poses: PoseQuality::Noisy, force: ForceQuality::Exact };
    let mut compared = 0;
    for set in ["x0.6", "x1.6"] {
        for name in ["letter_l", "brick"]
            .iter()
            .flat_map(|o| ["lift_force", "slide_force", "tilt_force", "overhang_press"].map(|s| format!("{o}/{s}")))
        {
            let (own, _) = load(&root.join("x1.0").join(&name), exact);
            let (other, object) = load(&root.join(set).join(&name), exact);
            let truth = std::fs::read_to_string(root.join(set).join(&name).join("truth.json")).unwrap();
            let truth = serde_json::from_str::<serde_json::Value>(&truth).unwrap()["mass"].as_f64().unwrap();
            let (Drive::Force(f), Drive::Force(g)) = (&own.drive, &other.drive) else { panic!("{name} has no force") };
            // Draws that were rejected for one mass and not for the other leave other pulses.
            let Some(gain) = ratio(f, g) else {
                eprintln!("skipped {set}/{name}: its force is no multiple of the other's");
                continue;
            };
            let a = weigh(with_drive(other, own.drive.clone()), &object);
            let (ci, expected) = (a.ci95_kg.unwrap(), truth * gain);
            eprintln!(
                "{set}/{name}: {:.4} kg with its force times {gain:.4}: {:.4} ({ci:.4?}), expected {expected:.4}",
                truth,
                a.mass_kg.unwrap()
            );
            assert!(ci[0] < expected && expected < ci[1] && (a.mass_kg.unwrap() / expected - 1.0).abs() < 0.02);
            assert!(!(ci[0]..ci[1]).contains(&truth));
            compared += 1;
        }
    }
    assert!(compared >= 4, "{compared}");
}

/// The factor that makes `g` to `f`, if there is one to a percent.
fn ratio(f: &ForceProfile, g: &ForceProfile) -> Option<f64> {
    let sum =
        |a: &ForceProfile, b: &ForceProfile| a.forces_n.iter().zip(&b.forces_n).map(|(a, b)| a.dot(b)).sum::<f64>();
    let gain = sum(f, g) / sum(g, g);
    let cosine = sum(f, g) / (sum(f, f) * sum(g, g)).sqrt();
    (f.forces_n.len() == g.forces_n.len() && cosine > 0.9999).then_some(gain)
}
