//! Recorded pushes: simulated by MuJoCo with known masses. The truth is read by the tests alone.

use std::path::Path;

use crate::common::{object_at, object_of, shared};
use drex_core::TriMesh;
use drex_recording::convert::mujoco_push::{self, ForceQuality, Inputs, PoseQuality};
use drex_recording::{Drive, PushRecording, StatedParameter};
use drex_sysid::{Identification, IdentifyOptions, Parameter, Verdict, identify};

fn weigh(folder: &Path, inputs: Inputs) -> Identification {
    let recording = mujoco_push::load(folder, inputs).unwrap();
    let object = object_at(&recording.mesh);
    identify(&[recording], &object, &IdentifyOptions::default()).unwrap()
}

fn truth(folder: &Path) -> f64 {
    let text = std::fs::read_to_string(folder.join("truth.json")).unwrap();
    serde_json::from_str::<serde_json::Value>(&text).unwrap()["mass"].as_f64().unwrap()
}

/// One scenario of each kind, different objects; the whole set takes minutes.
const KNOWN_FORCE: [(&str, &str); 3] =
    [("letter_l", "lift_force"), ("letter_t", "slide_force"), ("letter_l_rho1", "overhang_press")];

#[test]
fn known_forces_weigh_within_three_percent() {
    let Some(shared) = shared() else { return };
    let exact = Inputs { poses: PoseQuality::Clean, force: ForceQuality::Exact };
    for (object, scenario) in KNOWN_FORCE {
        let folder = shared.join("data/push_mujoco").join(object).join(scenario);
        let a = weigh(&folder, exact);
        let error = a.mass_kg.unwrap_or(f64::NAN) / truth(&folder) - 1.0;
        assert!(error.abs() < 0.03, "{object}/{scenario}: {error:+.4}, {}", a.reason);
    }
}

/// Pushes of random objects, each kind of push twice, with the start withheld (`tests/data/pushes/README.md`). In 95 of 100 draws the
/// interval holds the truth: of 14 pushes two may miss (more do in 1 of 30 sets), none may brag or hide (the press on 20 g, whose force is
/// a sixth noise in each direction, is known to a sixth: 13 to 17 % by the seed of the draws), and the cylinder that was pushed a hair
/// beside its middle, which goes elsewhere whatever the mass if it starts where it is expected, is found all the same.
#[test]
fn random_objects_are_weighed_without_their_start() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/pushes");
    let folders = |of: &Path| {
        let mut found: Vec<_> =
            std::fs::read_dir(of).unwrap().map(|e| e.unwrap().path()).filter(|p| p.is_dir()).collect();
        found.sort();
        found
    };
    let (mut held, mut all) = (0, 0);
    for folder in folders(&root).iter().flat_map(|object| folders(object)) {
        let mut recording = mujoco_push::load(&folder, Inputs::default()).unwrap();
        recording.initial_pose = None;
        let object = object_at(&recording.mesh);
        let a = identify(&[recording], &object, &IdentifyOptions::default()).unwrap();
        let (name, m) = (folder.display(), truth(&folder));
        assert_eq!(a.verdict, Verdict::Identified, "{name}: {}", a.reason);
        let ([low, high], error) = (a.ci95_kg.unwrap(), a.mass_kg.unwrap() / m - 1.0);
        let widest = match (folder.ends_with("overhang_press"), folder.ends_with("T000/overhang_press")) {
            (_, true) => 1.4,
            (true, false) => 1.25,
            _ => 1.1,
        };
        assert!((1.01..widest).contains(&(high / low)), "{name}: {low} to {high} kg");
        assert!(error.abs() < (high / low).ln(), "{name}: {error:+.4} with {low} to {high} kg for {m}");
        held += usize::from(low < m && m < high);
        all += 1;
    }
    eprintln!("{held} of {all} intervals hold the truth");
    assert!(all == 14 && held + 2 >= all, "{held} of {all}");
}

#[test]
fn tosses_weigh_nothing() {
    let Some(shared) = shared() else { return };
    for object in ["brick", "can"] {
        let a = weigh(&shared.join("data/push_mujoco").join(object).join("toss"), Inputs::default());
        assert_eq!(a.verdict, Verdict::NotIdentifiable);
        assert!(a.mass_kg.is_none() && a.prior_kg.is_some());
        let first = a.profile[0].1;
        assert!(
            a.profile.len() == 7 && a.profile.iter().all(|p| (p.1 - first).abs() < 1e-6 * first),
            "{:?}",
            a.profile
        );
    }
}

#[test]
fn compliant_fingers_weigh_and_a_rigid_one_does_not() {
    let Some(shared) = shared() else { return };
    let brick = shared.join("data/push_mujoco/brick");
    for scenario in ["finger_slow", "finger_fast", "finger_tilt"] {
        let a = weigh(&brick.join(scenario), Inputs::default());
        let (ci, m) = (a.ci95_kg.unwrap(), truth(&brick.join(scenario)));
        assert!(ci[0] < m && m < ci[1], "{scenario}: {ci:?} and {m}");
        assert!((a.mass_kg.unwrap() / m - 1.0).abs() < 0.05, "{scenario}: {:?} and {m}", a.mass_kg);
    }
    assert_eq!(weigh(&brick.join("finger_rigid"), Inputs::default()).verdict, Verdict::NotIdentifiable);
}

/// The same letter of three densities.
#[test]
fn three_densities_of_one_shape_are_told_apart() {
    let Some(shared) = shared() else { return };
    let root = shared.join("data/push_mujoco");
    for scenario in ["lift_force", "tilt_force", "overhang_press", "finger_tilt"] {
        let intervals = ["letter_l_rho1", "letter_l", "letter_l_rho3"].map(|object| {
            let folder = root.join(object).join(scenario);
            let a = weigh(&folder, Inputs::default());
            assert_eq!(a.verdict, Verdict::Identified, "{object}/{scenario}: {}", a.reason);
            let (ci, m) = (a.ci95_kg.unwrap(), truth(&folder));
            assert!(ci[0] < m && m < ci[1], "{object}/{scenario}: {ci:?} without {m}");
            ci
        });
        assert!(intervals[0][1] < intervals[1][0] && intervals[1][1] < intervals[2][0], "{scenario}: {intervals:?}");
    }
}

/// What the answer says about errors of what it took for granted is what they do.
#[test]
fn sensitivities_predict_what_a_wrong_finger_or_a_wrong_friction_does() {
    let Some(shared) = shared() else { return };
    let root = shared.join("data/push_mujoco");
    for name in ["brick/finger_tilt", "letter_t/finger_slow", "letter_l/finger_fast"] {
        let push = mujoco_push::load(&root.join(name), Inputs::default()).unwrap();
        let object = object_at(&push.mesh);
        let right = identify(std::slice::from_ref(&push), &object, &IdentifyOptions::default()).unwrap();
        let changes = |p: Parameter| right.sensitivities.iter().find(|s| s.parameter == p).map_or(0.0, |s| s.log_mass);
        let (mut stiff, mut rough) = (push.clone(), push.clone());
        if let Drive::Finger(finger) = &mut stiff.drive {
            finger.impedance.kp_n_m *= 1.1;
        }
        rough.support.friction = push.support.friction.map(|mu| mu * 1.3);
        for (wrong, parameter, factor) in
            [(stiff, Parameter::ActuatorStiffness, 1.1_f64), (rough, Parameter::Friction, 1.3)]
        {
            let a = identify(&[wrong], &object, &IdentifyOptions::default()).unwrap();
            let change = (a.mass_kg.unwrap() / right.mass_kg.unwrap()).ln();
            let predicted = changes(parameter) * factor.ln();
            eprintln!(
                "{name}: {} times {factor} moves log mass by {change:+.4}, predicted {predicted:+.4}",
                parameter.as_str()
            );
            assert!((change - predicted).abs() < 0.01 + 0.25 * predicted.abs());
        }
    }
}

/// A tin that is rocked almost until it falls, its shape known to 1.5 mm: one fit that ends beside the motion excludes no mass amid others
/// that are as good.
#[test]
fn the_likelihood_of_a_rocked_tin_has_no_gap() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../apps/drex/data/tin");
    let mut push = PushRecording::load(&data.join("push/tilt")).unwrap();
    for p in ["center_x", "center_y", "center_z", "start_x", "start_y", "start_z", "contact_height"] {
        push.parameters.insert(p.to_owned(), StatedParameter::Expected { mean: 0.0, sd: 1.5e-3 });
    }
    let tin = TriMesh::read(&push.mesh).unwrap();
    let truth = 0.236; // kg, as in truth.json beside it
    for wider in [1.01, 1.015] {
        let vertices = tin.vertices.iter().map(|v| [wider * v.x, wider * v.y, v.z].into()).collect();
        let object = object_of(&TriMesh::new(vertices, tin.faces.clone()).unwrap());
        let a = identify(std::slice::from_ref(&push), &object, &IdentifyOptions::default()).unwrap();
        let ci = a.ci95_kg.unwrap();
        assert!(ci[0] < truth && truth < ci[1], "{wider}: {ci:?}");
        let inside: Vec<(f64, f64)> = a.profile.into_iter().filter(|p| ci[0] < p.0 && p.0 < ci[1]).collect();
        assert!(inside.len() > 4, "{wider}: {inside:?}");
        for three in inside.windows(3) {
            assert!(three[1].1 < three[0].1.max(three[2].1) + 1.92, "{wider}: {three:?}");
        }
    }
}
