//! The MANO forward model on a small model made by hand, whose answers are known; the real model belongs to its owners.
#![cfg(feature = "files")]
#![allow(clippy::unwrap_used, missing_docs)] // a test: a panic is the report

mod numpy;

use std::f64::consts::FRAC_PI_2;
use std::path::Path;

use drex_demo::{Demonstration, KeyPoints, LoadOptions, ManoModel, ManoPose, Side, mirrored};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use numpy::{npy, npz};

const VERTICES: usize = 778;
const TIPS: [usize; 5] = [744, 320, 443, 554, 671];
/// Finger (thumb 0 to little 4) of each group of three joints after the wrist.
const GROUPS: [usize; 5] = [1, 2, 4, 3, 0];

/// Rest position of joint `j` of the made-up model: five straight fingers along +x, 10 mm apart along y, joints at 80, 110, 130 mm.
fn joint(j: usize) -> Vector3<f64> {
    if j == 0 {
        return Vector3::new(0.005, 0.0, 0.001);
    }
    let (group, k) = ((j - 1) / 3, (j - 1) % 3);
    Vector3::new([0.08, 0.11, 0.13][k], 0.01 * GROUPS[group] as f64, 0.0)
}

fn tip(finger: usize) -> Vector3<f64> {
    Vector3::new(0.15, 0.01 * finger as f64, 0.0)
}

/// Vertex 0..16 are the joints; shape parameter 0 grows everything by itself, 1 moves the index tip by 1 m along z; the entry (0, 0) of
/// the first index joint's R - I moves the thumb's tip along y; the mean pose bends the second index joint by 0.3 about z.
fn model_bytes(drop: Option<&str>) -> Vec<u8> {
    let mut template = vec![0.0; VERTICES * 3];
    let mut shapes = vec![0.0; VERTICES * 3 * 10];
    let mut regressor = vec![0.0; 16 * VERTICES];
    let mut weights = vec![0.0; VERTICES * 16];
    let mut put = |v: usize, p: Vector3<f64>| {
        for c in 0..3 {
            template[3 * v + c] = p[c];
            shapes[30 * v + 10 * c] = p[c];
        }
    };
    for j in 0..16 {
        put(j, joint(j));
        regressor[j * VERTICES + j] = 1.0;
    }
    for (finger, &v) in TIPS.iter().enumerate() {
        put(v, tip(finger));
        let group = GROUPS.iter().position(|g| *g == finger).unwrap();
        weights[16 * v + 3 * group + 3] = 1.0;
    }
    // The middle fingertip is held half by its last joint and half by the one before.
    weights[16 * TIPS[2] + 6] = 0.5;
    weights[16 * TIPS[2] + 5] = 0.5;
    shapes[30 * TIPS[1] + 10 * 2 + 1] = 1.0;
    let mut poses = vec![0.0; VERTICES * 3 * 135];
    poses[135 * (3 * TIPS[0] + 1)] = 0.02;
    let mut mean = vec![0.0; 45];
    mean[5] = 0.3;
    let mut tree = vec![4_294_967_295.0];
    tree.extend((1..16).map(|j| if (j - 1) % 3 == 0 { 0.0 } else { f64::from(j - 1) }));
    tree.extend((0..16).map(f64::from));
    let arrays = [
        ("v_template", npy(&[VERTICES, 3], &template)),
        ("shapedirs", npy(&[VERTICES, 3, 10], &shapes)),
        ("posedirs", npy(&[VERTICES, 3, 135], &poses)),
        ("J_regressor", npy(&[16, VERTICES], &regressor)),
        ("weights", npy(&[VERTICES, 16], &weights)),
        ("kintree_table", npy(&[2, 16], &tree)),
        ("hands_mean", npy(&[45], &mean)),
    ];
    npz(&arrays.into_iter().filter(|(n, _)| Some(*n) != drop).collect::<Vec<_>>(), false)
}

fn model() -> ManoModel {
    ManoModel::parse_npz(Path::new("MANO_RIGHT.npz"), &model_bytes(None)).unwrap()
}

fn at(points: &KeyPoints, i: usize) -> Vector3<f64> {
    points[i].unwrap().coords
}

fn pose(angles: &[(usize, f64)], betas: &[f64], translation: Vector3<f64>) -> ManoPose {
    let mut all = [0.0; 48];
    angles.iter().for_each(|(i, a)| all[*i] = *a);
    ManoPose::from_axis_angles(&all, betas, translation).unwrap()
}

#[test]
fn the_flat_hand_is_the_template_in_openpose_s_order() {
    let points = model().key_points(&pose(&[], &[], Vector3::zeros()), true);
    assert!((at(&points, 0) - joint(0)).norm() < 1e-12);
    // Index: joints 1 to 3 of MANO are key points 5 to 7; little: 7 to 9 are 17 to 19; thumb: 13 to 15 are 1 to 3.
    for (key, mano) in [(5, 1), (7, 3), (9, 4), (13, 10), (17, 7), (19, 9), (1, 13), (3, 15)] {
        assert!((at(&points, key) - joint(mano)).norm() < 1e-12, "{key}");
    }
    for (finger, key) in [4, 8, 12, 16, 20].into_iter().enumerate() {
        assert!((at(&points, key) - tip(finger)).norm() < 1e-12, "{key}");
    }
}

#[test]
fn wrist_and_shape_and_translation_are_those_of_a_rigid_body() {
    let turn = Vector3::new(0.4, -0.7, 0.2);
    let shift = Vector3::new(0.1, 0.2, 0.7);
    let pose = pose(&[(0, turn.x), (1, turn.y), (2, turn.z)], &[0.25], shift);
    let points = model().key_points(&pose, true);
    let rotation = UnitQuaternion::from_scaled_axis(turn);
    // The wrist turns about itself and is not at the origin.
    let expected = |rest: Vector3<f64>| rotation * ((rest - joint(0)) * 1.25) + joint(0) * 1.25 + shift;
    for (key, rest) in [(0, joint(0)), (6, joint(2)), (8, tip(1)), (20, tip(4))] {
        assert!((at(&points, key) - expected(rest)).norm() < 1e-12, "{key}");
    }
    let points = model().key_points(&self::pose(&[], &[0.0, 0.03], Vector3::zeros()), true);
    assert!((at(&points, 8) - tip(1) - Vector3::z() * 0.03).norm() < 1e-12, "the second shape moves the index tip");
}

#[test]
fn joints_bend_what_hangs_on_them() {
    // First index joint (parameters 3 to 5) by a quarter about z.
    let points = model().key_points(&pose(&[(5, FRAC_PI_2)], &[], Vector3::zeros()), true);
    let base = joint(1);
    let turned = |rest: Vector3<f64>| base + Vector3::new(0.0, rest.x - base.x, 0.0);
    assert!((at(&points, 6) - turned(joint(2))).norm() < 1e-12);
    assert!((at(&points, 8) - turned(tip(1))).norm() < 1e-12);
    assert!((at(&points, 12) - tip(2)).norm() < 1e-12, "the others stay");
    // R - I has -1 at (0, 0): the thumb's tip moves by -0.02 along y.
    assert!((at(&points, 4) - (tip(0) - Vector3::y() * 0.02)).norm() < 1e-12);
    // The last joint of the middle finger moves its tip half.
    let points = model().key_points(&pose(&[(3 * 6 + 2, FRAC_PI_2)], &[], Vector3::zeros()), true);
    let whole = joint(6) + Vector3::new(0.0, tip(2).x - joint(6).x, 0.0);
    assert!((at(&points, 12) - (whole + tip(2)) / 2.0).norm() < 1e-12);
    // Offsets from the mean pose bend the index finger's second joint; rotations never do.
    let mean = model().key_points(&pose(&[], &[], Vector3::zeros()), false);
    let bent = model().key_points(&pose(&[(8, 0.3)], &[], Vector3::zeros()), true);
    assert!((at(&mean, 8) - at(&bent, 8)).norm() < 1e-12 && (at(&mean, 8) - tip(1)).norm() > 5e-3);
    let identity =
        ManoPose::from_rotations(UnitQuaternion::identity(), [UnitQuaternion::identity(); 15], &[], Vector3::zeros());
    assert!((at(&model().key_points(&identity, false), 8) - tip(1)).norm() < 1e-12);
}

fn with_model() -> (tempfile::TempDir, LoadOptions) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("MANO_RIGHT.npz");
    std::fs::write(&path, model_bytes(None)).unwrap();
    let mut options = LoadOptions::default();
    options.mano_model = Some(path);
    options.mano_flat_hand = true;
    (folder, options)
}

#[test]
fn recordings_of_parameters_become_key_points() {
    let (_folder, options) = with_model();
    let mut poses = vec![0.0; 96];
    poses[48 + 5] = FRAC_PI_2;
    let trans = [0.0, 0.0, 0.5, 0.0, 0.0, 0.6];
    let bytes = npz(
        &[("poses", npy(&[2, 48], &poses)), ("betas", npy(&[10], &[0.0; 10])), ("trans", npy(&[2, 3], &trans))],
        false,
    );
    let demo = Demonstration::parse(Path::new("m.npz"), &bytes, &options).unwrap();
    assert!((at(&demo.frames[0].points, 8) - (tip(1) + Vector3::z() * 0.5)).norm() < 1e-12);
    let expected = model().key_points(&pose(&[(5, FRAC_PI_2)], &[], Vector3::z() * 0.6), true);
    assert_eq!(demo.frames[1].points, expected);
    // Without the model: what to get.
    let said = Demonstration::parse(Path::new("m.npz"), &bytes, &LoadOptions::default()).unwrap_err().to_string();
    assert!(said.contains("MANO_RIGHT") && said.contains("mano.is.tue.mpg.de"), "{said}");
    // The same in JSON.
    let row = |i: usize| format!("{:?}", &poses[48 * i..48 * (i + 1)]);
    let json = format!(
        r#"{{"hand": "right", "fps": 30, "frames": [{{"mano_pose_axis_angle_48": {}, "mano_trans_3": [0, 0, 0.6]}}]}}"#,
        row(1)
    );
    let from_json = Demonstration::parse(Path::new("m.json"), json.as_bytes(), &options).unwrap();
    assert_eq!(from_json.frames[0].points, expected);
}

#[test]
fn hamer_s_left_parameters_are_those_of_the_mirrored_right_hand() {
    let (_folder, options) = with_model();
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, 0.2, -0.1));
    let rows =
        |q: &UnitQuaternion<f64>| q.to_rotation_matrix().matrix().transpose().iter().copied().collect::<Vec<_>>();
    let mut fingers: Vec<f64> = (0..15).flat_map(|_| rows(&UnitQuaternion::identity())).collect();
    fingers[..9].copy_from_slice(&rows(&UnitQuaternion::from_scaled_axis(Vector3::z())));
    let bytes = |right: f64| {
        npz(
            &[
                ("global_orient", npy(&[1, 1, 3, 3], &rows(&turn))),
                ("hand_pose", npy(&[1, 15, 3, 3], &fingers)),
                ("betas", npy(&[1, 10], &[0.1; 10])),
                ("pred_cam_t_full", npy(&[1, 3], &[0.0; 3])),
                ("right", npy(&[1], &[right])),
            ],
            false,
        )
    };
    let read = |right| Demonstration::parse(Path::new("h.npz"), &bytes(right), &options).unwrap();
    let (right, left) = (read(1.0), read(0.0));
    assert_eq!(left.side, Side::Left);
    assert_eq!(left.frames[0].points, mirrored(&right.frames[0].points));
    let bent: Point3<f64> = right.frames[0].points[8].unwrap();
    assert!((bent.coords - tip(1)).norm() > 0.01);
}

#[test]
fn a_model_that_is_none_is_refused() {
    let parse = |bytes: &[u8]| ManoModel::parse_npz(Path::new("m.npz"), bytes).unwrap_err().to_string();
    assert!(parse(&model_bytes(Some("weights"))).contains("weights"));
    assert!(parse(b"no zip").contains("zip"));
    assert!(parse(&npz(&[("v_template", npy(&[3, 3], &[0.0; 9]))], false)).contains("3 vertices"));
    let said = ManoPose::from_axis_angles(&[0.0; 33], &[], Vector3::zeros()).unwrap_err().to_string();
    assert!(said.contains("33") && said.contains("principal components"), "{said}");
    assert!(ManoPose::from_axis_angles(&[f64::NAN; 48], &[], Vector3::zeros()).is_err());
}
