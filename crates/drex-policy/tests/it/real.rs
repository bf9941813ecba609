//! Real sets of grasps: how near the modes come to grasps that were held out.
#![cfg(feature = "flex")]

use std::ops::ControlFlow;
use std::path::Path;

use crate::common::{leap_grasps, tin};
use drex_core::Pose;
use drex_policy::{Dataset, GRAVITY_M_S2, GraspPolicy, GraspSample, ObjectCloud, Query, TrainOptions, TrainReport};
use nalgebra::{Matrix4, Point3, Vector3};

fn fingers() -> Vec<String> {
    ["thumb", "index", "middle", "ring"].map(String::from).to_vec()
}

/// The number that an environment variable gives, to lengthen a run from the outside.
fn setting(name: &str, otherwise: usize) -> usize {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(otherwise)
}

fn report(data: &Dataset) -> TrainReport {
    let epochs = setting("DREX_POLICY_EPOCHS", 25);
    let options = TrainOptions::default().with_epochs(epochs).with_modes(setting("DREX_POLICY_MODES", 16));
    let (policy, report) = GraspPolicy::train(data, &options, &mut |_| ControlFlow::Continue(())).unwrap();
    let started = std::time::Instant::now();
    policy.predict(&Query::new(&data.objects[0].points, 0.2, 0.5)).unwrap();
    eprintln!("predicted in {:.1} ms", 1e3 * started.elapsed().as_secs_f64());
    eprintln!("{epochs} epochs in {:.1} s, {} parameters", report.seconds, report.parameters);
    eprintln!(
        "log-likelihood held out {:?}, joints alone {:?}; {:?}",
        report.held_out_log_likelihood, report.held_out_joint_log_likelihood, report.spread
    );
    eprintln!("held out {:?}\n{:#?}\n{:#?}", report.held_out, report.baselines, report.modes);
    report
}

/// The wrists of these grasps are not recorded, so this looks at joints only.
#[test]
fn modes_are_nearer_to_real_grasps_than_their_mean_is() {
    let Some(rows) = leap_grasps() else { return };
    let limits = (0..16).map(|j| {
        let column = rows.iter().map(|r| r[j]);
        (column.clone().fold(f64::INFINITY, f64::min), column.fold(f64::NEG_INFINITY, f64::max))
    });
    let sample = |joints: &Vec<f64>, mass_kg: f64| GraspSample {
        joints: joints.clone(),
        object_from_base: Pose::translation(0.0, 0.0, 0.1),
        grip_force_n: 3.0 * mass_kg * GRAVITY_M_S2,
        mass_kg,
        object: 0,
        contacts: vec![true; 4],
        friction: 0.5,
    };
    let data = Dataset {
        joint_names: (0..16).map(|j| format!("joint{j}")).collect(),
        joint_limits: limits.collect(),
        hand: "leap_right".into(),
        fingers: fingers(),
        objects: vec![ObjectCloud::upright("tin", tin())],
        samples: rows.iter().flat_map(|r| [0.1, 0.2, 0.4].map(|m| sample(r, m))).collect(),
    };
    let report = report(&data);
    let (found, rules) = (report.held_out.unwrap(), report.baselines.unwrap());
    assert!(found.joint_rms_rad < 0.9 * rules.mean_demonstration.joint_rms_rad);
    assert!(found.joint_rms_rad < rules.random_demonstrations.joint_rms_rad);
}

/// A hundred grasps of a cracker box by an Allegro hand on an arm: joints and wrists, made by an optimiser.
#[test]
fn wrists_are_learned_with_the_joints() {
    let Some(shared) = std::env::var_os("DREX_SHARED") else {
        eprintln!("skipped: DREX_SHARED is not set");
        return;
    };
    let folder = Path::new(&shared).join("data/grasps/frogger_fr3_allegro");
    let json = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(folder.join(name)).unwrap()).unwrap()
    };
    let (kinematics, grasps) = (json("kinematics.json"), json("003_cracker_box__fccorr16.json"));
    let matrix = |v: &serde_json::Value| {
        let rows: Vec<f64> =
            v.as_array().unwrap().iter().flat_map(|r| r.as_array().unwrap()).map(|x| x.as_f64().unwrap()).collect();
        let mut m = Matrix4::identity();
        rows.iter().enumerate().for_each(|(i, v)| m[(i / 4, i % 4)] = *v);
        drex_core::pose::pose_from_matrix(&m).unwrap()
    };
    let joints = kinematics["joints"].as_array().unwrap();
    let world_from_object = matrix(&grasps["X_WO"]);
    // The arm is a chain of revolute joints about z, its hand is welded on.
    let world_from_base = |q: &[f64]| {
        let arm = joints.iter().take(7).zip(q).fold(Pose::identity(), |pose, (joint, q)| {
            pose * matrix(&joint["T_parent_joint"])
                * Pose::rotation(Vector3::z() * *q)
                * matrix(&joint["T_joint_child"])
        });
        arm * matrix(&kinematics["fixed"][0]["T_parent_child"])
    };
    let limit = |j: &serde_json::Value, name: &str| j[name].as_f64().unwrap();
    let hand = &joints[7..23];
    let mut samples = Vec::new();
    for q in grasps["q"].as_array().unwrap() {
        let q: Vec<f64> = q.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        let clamped = q[7..].iter().zip(hand).map(|(q, j)| q.clamp(limit(j, "lower"), limit(j, "upper")));
        let sample = GraspSample {
            joints: clamped.collect(),
            object_from_base: world_from_object.inverse() * world_from_base(&q),
            grip_force_n: 0.0,
            mass_kg: 0.0,
            object: 0,
            contacts: vec![true; 4],
            friction: 0.5,
        };
        for mass_kg in [0.1, 0.2, 0.4] {
            samples.push(GraspSample { grip_force_n: 4.0 * mass_kg * GRAVITY_M_S2, mass_kg, ..sample.clone() });
        }
    }
    assert_eq!(samples.len(), 300);
    let mesh = std::fs::read_to_string(folder.join("meshes/003_cracker_box.obj")).unwrap();
    let vertex = |line: &str| {
        let v: Vec<f64> = line.strip_prefix("v ")?.split_whitespace().map(|n| n.parse().unwrap()).collect();
        Some(Point3::new(v[0], v[1], v[2]))
    };
    let data = Dataset {
        joint_names: hand.iter().map(|j| j["joint"].as_str().unwrap().to_owned()).collect(),
        joint_limits: hand.iter().map(|j| (limit(j, "lower"), limit(j, "upper"))).collect(),
        hand: "allegro_right".into(),
        fingers: fingers(),
        objects: vec![ObjectCloud::upright("cracker box", mesh.lines().filter_map(vertex).collect())],
        samples,
    };
    let reach = data.samples.iter().map(|s| s.object_from_base.translation.vector.norm());
    assert!(reach.fold(0.0, f64::max) < 0.35, "hands are within reach of the box");
    let report = report(&data);
    let (found, rules) = (report.held_out.unwrap(), report.baselines.unwrap());
    assert!(found.distance_m < 0.5 * rules.mean_demonstration.distance_m);
    assert!(found.distance_m < rules.random_demonstrations.distance_m);
    assert!(found.wrist_m < rules.mean_demonstration.wrist_m);
    assert!(found.wrist_rad < rules.mean_demonstration.wrist_rad);
}
