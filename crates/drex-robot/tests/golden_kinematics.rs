//! Poses, Jacobians, mass matrix and bias force against MuJoCo.
#![allow(clippy::unwrap_used, missing_docs, reason = "a test that fails by panic is what tests are")]

use std::path::{Path, PathBuf};

use drex_robot::Robot;
use nalgebra::{DMatrix, Point3, Quaternion, UnitQuaternion, Vector3};
use serde_json::Value;

fn shared() -> Option<PathBuf> {
    let folder = std::env::var_os("DREX_SHARED").map(PathBuf::from);
    if folder.is_none() {
        eprintln!("skipped: DREX_SHARED is not set");
    }
    folder
}

fn numbers(v: &Value) -> Vec<f64> {
    v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn matrix(v: &Value) -> DMatrix<f64> {
    let rows: Vec<Vec<f64>> = v.as_array().unwrap().iter().map(numbers).collect();
    DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
}

/// Joint vector from an object of numbers by joint name.
fn by_name(robot: &Robot, v: &Value) -> Vec<f64> {
    let named = v.as_object().unwrap();
    assert_eq!(named.len(), robot.dof());
    robot.joint_vector(named.iter().map(|(name, x)| (name.as_str(), x.as_f64().unwrap()))).unwrap()
}

/// Compares with the golden file `name`; the model's path in it is relative to `folder`.
fn check(folder: &Path, file: &str, name: &str) {
    let text = std::fs::read_to_string(folder.join(file)).unwrap();
    let golden: Value = serde_json::from_str(&text).unwrap();
    let robot = Robot::load(&folder.join(golden["model"].as_str().unwrap())).unwrap();
    let gravity = Vector3::from_column_slice(&numbers(&golden["gravity"]));
    let mut worst = [0.0f64; 4];
    for case in golden["cases"].as_array().unwrap() {
        let q = by_name(&robot, &case["q_rad"]);
        let qd = by_name(&robot, &case["qvel"]);
        let base = robot.file_world_from_base;
        let poses = robot.forward_kinematics(&q, &base);

        for (body, pose) in case["bodies"].as_object().unwrap() {
            let ours = &poses[robot.link_index(body).unwrap()];
            let w = numbers(&pose["quat_wxyz"]);
            let theirs = UnitQuaternion::from_quaternion(Quaternion::new(w[0], w[1], w[2], w[3]));
            let shift = (ours.translation.vector - Vector3::from_column_slice(&numbers(&pose["pos_m"]))).abs().max();
            let turn = (ours.rotation.to_rotation_matrix().matrix() - theirs.to_rotation_matrix().matrix()).abs().max();
            worst[0] = worst[0].max(shift).max(turn);
        }

        // Columns of the golden in our order.
        let dofs: Vec<usize> = case["dof_joint"]
            .as_array()
            .unwrap()
            .iter()
            .map(|n| robot.joint_index(n.as_str().unwrap()).unwrap())
            .collect();
        let link = robot.link_index(case["jacobian_body"].as_str().unwrap()).unwrap();
        let origin = Point3::from(poses[link].translation.vector);
        let (linear, angular) = robot.jacobian(&poses, link, &origin);
        for (ours, theirs) in [(linear, &case["jac_pos_rows"]), (angular, &case["jac_rot_rows"])] {
            let theirs = matrix(theirs);
            for (column, &j) in dofs.iter().enumerate() {
                worst[1] = worst[1].max((ours.column(j) - theirs.column(column)).abs().max());
            }
        }

        let m = robot.mass_matrix(&q);
        let theirs = matrix(&case["mass_matrix"]);
        let bias = robot.bias_force(&q, &qd, &base.inverse_transform_vector(&gravity));
        let their_bias = numbers(&case["bias_force"]);
        for (a, &i) in dofs.iter().enumerate() {
            worst[3] = worst[3].max((bias[i] - their_bias[a]).abs());
            for (b, &j) in dofs.iter().enumerate() {
                worst[2] = worst[2].max((m[(i, j)] - theirs[(a, b)]).abs());
            }
        }
    }
    eprintln!(
        "{name}: largest difference: pose {:.1e}, jacobian {:.1e}, mass matrix {:.1e}, bias {:.1e}",
        worst[0], worst[1], worst[2], worst[3]
    );
    assert!(worst[0] < 1e-9 && worst[1] < 1e-9, "{name}: {worst:?}");
    assert!(worst[2] < 1e-7 && worst[3] < 1e-7, "{name}: {worst:?}");
}

#[test]
fn leap_right() {
    if let Some(shared) = shared() {
        check(&shared.join("data"), "golden/kinematics/leap_right.json", "leap_right");
    }
}

#[test]
fn allegro_right() {
    if let Some(shared) = shared() {
        check(&shared.join("data"), "golden/kinematics/allegro_right.json", "allegro_right");
    }
}

#[test]
fn panda_with_independent_fingers() {
    if let Some(shared) = shared() {
        check(&shared.join("data"), "golden/kinematics/panda.json", "panda");
    }
}

/// Several joints on one body, anchors, references, frames, all orientations, inertia from shapes, balanced and scaled.
#[test]
fn odd_model() {
    check(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden"), "odd.json", "odd");
}

/// A body without an inertial: the exact volume of its mesh, which MuJoCo's legacy rule triples.
#[test]
fn inertia_from_meshes_is_exact() {
    let Some(shared) = shared() else { return };
    let robot = Robot::load(&shared.join("data/robots/allegro_hand/mjcf/right_hand.xml")).unwrap();
    let mass = |n: &str| robot.links[robot.require_link(n).unwrap()].inertial.unwrap().mass_kg;
    assert!((mass("ff_base") - 2.74e-3).abs() < 5e-6, "{}", mass("ff_base"));
    // A simple convex part, where both rules must agree.
    assert!((mass("ff_tip") - 0.006844521380847799).abs() < 1e-8, "{}", mass("ff_tip"));
    assert!(robot.unsupported.iter().all(|r| !r.contains("not closed")), "{:?}", robot.unsupported);
}
