//! Recordings of hands in every layout that is read.
#![cfg(feature = "files")]
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)] // a test: a panic is the report, a line that it was skipped

mod numpy;

use std::path::{Path, PathBuf};

use drex_core::Pose;
use drex_demo::{
    DemoUnit, Demonstration, HandFrame, KEYPOINTS, KeyPointOrder, KeyPoints, LoadOptions, Side, hand_length_m,
    operator_frame,
};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use numpy::{npy, npz, raw_npy};
use proptest::prelude::*;

fn shared() -> Option<PathBuf> {
    let folder = std::env::var_os("DREX_SHARED").map(PathBuf::from);
    if folder.is_none() {
        println!("skipped: DREX_SHARED is not set");
    }
    folder
}

/// A right hand that closes: frame `i` of `n`.
fn hand(i: usize) -> KeyPoints {
    let bend = 0.1 * i as f64;
    let mut points: KeyPoints = [None; KEYPOINTS];
    points[0] = Some(Point3::origin());
    for f in 0..5 {
        let (mut at, mut along) = if f == 0 {
            (Point3::new(0.03, 0.02, 0.005), Vector3::new(0.6, 0.8, 0.1))
        } else {
            (Point3::new(0.045 - 0.02 * f as f64, 0.09, 0.0), Vector3::y())
        };
        for j in 0..4 {
            points[4 * f + 1 + j] = Some(at);
            // The palm faces +z.
            along = UnitQuaternion::from_scaled_axis(Vector3::x() * bend) * along;
            at += along * (0.032 - 0.004 * j as f64);
        }
    }
    points
}

fn numbers(frames: &[KeyPoints]) -> Vec<f64> {
    let nan = Point3::new(f64::NAN, 0.0, 0.0);
    frames.iter().flatten().flat_map(|p| p.unwrap_or(nan).coords.iter().copied().collect::<Vec<_>>()).collect()
}

fn parse(name: &str, bytes: &[u8], options: &LoadOptions) -> drex_core::Result<Demonstration> {
    Demonstration::parse(Path::new(name), bytes, options)
}

fn read(name: &str, bytes: &[u8]) -> Demonstration {
    parse(name, bytes, &LoadOptions::default()).unwrap()
}

fn refused(name: &str, bytes: &[u8]) -> String {
    parse(name, bytes, &LoadOptions::default()).unwrap_err().to_string()
}

fn options(change: impl FnOnce(&mut LoadOptions)) -> LoadOptions {
    let mut options = LoadOptions::default();
    change(&mut options);
    options
}

fn same(a: &KeyPoints, b: &KeyPoints) {
    for (p, q) in a.iter().zip(b) {
        match (p, q) {
            (Some(p), Some(q)) => assert!((p - q).norm() < 1e-12, "{p} {q}"),
            _ => assert_eq!(p, q),
        }
    }
}

#[test]
fn an_array_is_read_with_what_is_assumed_said() {
    let frames: Vec<KeyPoints> = (0..4).map(hand).collect();
    let demo = read("a.npy", &npy(&[4, 21, 3], &numbers(&frames)));
    assert_eq!(demo.side, Side::Right);
    for (f, p) in demo.frames.iter().zip(&frames) {
        same(&f.points, p);
    }
    assert_eq!(demo.frames[3].t_s, 0.1);
    assert!(demo.notes.iter().any(|n| n.contains("right hand is assumed")));
    assert!(demo.notes.iter().any(|n| n.contains("30 frames per second")));
    same(&read("a.npy", &npy(&[4, 63], &numbers(&frames))).frames[2].points, &frames[2]);
    same(&read("a.npy", &npy(&[21, 3], &numbers(&frames[1..2]))).frames[0].points, &frames[1]);
    assert!(refused("a.npy", &npy(&[2, 2, 21, 3], &numbers(&frames))).contains("2 x 2 x 21 x 3"));
    assert!(refused("a.npy", &npy(&[0, 21, 3], &[])).contains("no frames"));
}

#[test]
fn a_glove_s_25_nodes_lose_the_four_metacarpals() {
    let points = hand(2);
    let mut nodes = Vec::new();
    for (i, p) in points.iter().enumerate() {
        if i >= 5 && i % 4 == 1 {
            nodes.extend([9.0, 9.0, 9.0, 1.0, 0.0, 0.0, 0.0]);
        }
        nodes.extend(p.unwrap().coords.iter().chain(&[1.0, 0.0, 0.0, 0.0]).copied());
    }
    let demo = read("g.npz", &npz(&[("run", npy(&[1, 25, 7], &nodes))], true));
    same(&demo.frames[0].points, &points);
    assert!(demo.notes.iter().any(|n| n.contains("\"run\"")));
}

#[test]
fn an_archive_brings_times_object_side_and_unit_along() {
    let frames: Vec<KeyPoints> = (0..3).map(hand).collect();
    let millimetres: Vec<f64> = numbers(&frames).iter().map(|v| v * 1e3).collect();
    let objects: Vec<f64> = (0..3).flat_map(|i| [f64::from(i) * 10.0, 20.0, 30.0, 1.0, 0.0, 0.0, 0.0]).collect();
    let text: Vec<u8> = "left".chars().flat_map(|c| (c as u32).to_le_bytes()).collect();
    let unit: Vec<u8> = "mm".chars().flat_map(|c| (c as u32).to_le_bytes()).collect();
    let arrays = [
        ("keypoints", npy(&[3, 21, 3], &millimetres)),
        ("t", npy(&[3], &[0.0, 0.5, 1.0])),
        ("object_pose", npy(&[3, 7], &objects)),
        ("side", raw_npy("<U4", "()", &text)),
        ("units", raw_npy("<U2", "()", &unit)),
        ("object_dtype_extra", raw_npy("|O", "(1,)", &[0; 8])),
    ];
    for deflated in [false, true] {
        let demo = read("a.npz", &npz(&arrays, deflated));
        assert_eq!(demo.side, Side::Left);
        assert_eq!(demo.frames[2].t_s, 1.0);
        same(&demo.frames[1].points, &frames[1]);
        let t = demo.frames[2].source_from_object.unwrap().translation.vector;
        assert!((t - Vector3::new(0.02, 0.02, 0.03)).norm() < 1e-12);
    }
    let short = [("keypoints", npy(&[3, 21, 3], &millimetres)), ("t", npy(&[2], &[0.0, 0.5]))];
    assert!(refused("a.npz", &npz(&short, true)).contains("2 rows of t for 3 frames"));
}

#[test]
fn pickles_are_refused_with_the_way_out() {
    for (name, bytes) in [("a.pkl", &b"x"[..]), ("a.npy", b"\x80\x04\x95"), ("a.npz", b"\x80\x04K\x01.")] {
        let said = refused(name, bytes);
        assert!(said.contains("numpy.savez") && said.contains("never opened"), "{said}");
    }
    let said = refused("a.npy", &raw_npy("|O", "(1,)", &[0; 8]));
    assert!(said.contains("pickled") && said.contains("dtype=float"), "{said}");
    let said = refused("a.npz", &npz(&[("keypoints", raw_npy("|O", "(1,)", &[0; 8]))], true));
    assert!(said.contains("pickled"), "{said}");
}

#[test]
fn hamer_s_left_hands_are_turned_around_and_put_into_the_picture() {
    // What HaMeR gives for a left hand: a right one, seen in a mirror.
    let points = hand(1);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2, 0.3));
    let matrix: Vec<f64> = turn.to_rotation_matrix().matrix().transpose().iter().copied().collect();
    let arrays = |right: f64| {
        vec![
            ("pred_keypoints_3d", npy(&[1, 21, 3], &numbers(&[points]))),
            ("global_orient", npy(&[1, 1, 3, 3], &matrix)),
            ("hand_pose", npy(&[1, 15, 3, 3], &[1.0; 135])),
            ("pred_cam", npy(&[1, 3], &[0.9, 0.05, 0.02])),
            ("box_center", npy(&[1, 2], &[700.0, 300.0])),
            ("box_size", npy(&[1], &[250.0])),
            ("img_size", npy(&[1, 2], &[1280.0, 720.0])),
            ("right", npy(&[1], &[right])),
        ]
    };
    let focal = options(|o| o.focal_px = Some(1000.0));
    let right = parse("h.npz", &npz(&arrays(1.0), true), &focal).unwrap();
    let left = parse("h.npz", &npz(&arrays(0.0), true), &focal).unwrap();
    assert_eq!((right.side, left.side), (Side::Right, Side::Left));
    let bs = 250.0 * 0.9;
    let t = |tx: f64| Vector3::new(tx + 2.0 * 60.0 / bs, 0.02 - 2.0 * 60.0 / bs, 2000.0 / bs);
    let tip = points[8].unwrap();
    assert!((right.frames[0].points[8].unwrap() - (tip + t(0.05))).norm() < 1e-12);
    let expected = Point3::new(-tip.x, tip.y, tip.z) + t(-0.05);
    assert!((left.frames[0].points[8].unwrap() - expected).norm() < 1e-12);
    let axis = left.frames[0].source_from_mano_wrist.unwrap().scaled_axis();
    assert!((axis - Vector3::new(0.1, -0.2, -0.3)).norm() < 1e-9);
    // The operator frame of the left hand is the mirror image of the right one's.
    let frame = |d: &Demonstration| operator_frame(&d.frames[0].points, d.side).unwrap();
    let (l, r) = (frame(&left) * Vector3::x(), frame(&right) * Vector3::x());
    assert!((l - Vector3::new(-r.x, r.y, r.z)).norm() < 1e-9);
}

#[test]
fn detections_are_put_at_their_frames_and_the_other_hand_left_out() {
    let points: Vec<KeyPoints> = (0..4).map(hand).collect();
    let arrays = [
        ("pred_keypoints_3d", npy(&[4, 21, 3], &numbers(&points))),
        ("pred_cam_t_full", npy(&[4, 3], &[0.0; 12])),
        ("right", npy(&[4], &[1.0, 0.0, 1.0, 1.0])),
        ("frame", npy(&[4], &[0.0, 2.0, 2.0, 5.0])),
    ];
    let demo = read("h.npz", &npz(&arrays, true));
    assert_eq!(demo.frames.len(), 6);
    same(&demo.frames[2].points, &points[2]);
    same(&demo.frames[5].points, &points[3]);
    assert!(demo.frames[1].points.iter().all(Option::is_none));
    let huge = [("keypoints", npy(&[1, 21, 3], &numbers(&points[..1]))), ("frame", npy(&[1], &[1e15]))];
    assert!(refused("h.npz", &npz(&huge, true)).contains("frame numbers"));
}

#[test]
fn mano_s_order_is_never_guessed() {
    const FROM_MANO: [usize; 21] = [0, 13, 14, 15, 16, 1, 2, 3, 17, 4, 5, 6, 18, 10, 11, 12, 19, 7, 8, 9, 20];
    let points = hand(3);
    let mut mano = [None; 21];
    for (i, &m) in FROM_MANO.iter().enumerate() {
        mano[m] = points[i];
    }
    let bytes = npy(&[1, 21, 3], &numbers(&[mano]));
    assert!(refused("m.npy", &bytes).contains("\"mano\""));
    let stated = parse("m.npy", &bytes, &options(|o| o.order = KeyPointOrder::Mano)).unwrap();
    same(&stated.frames[0].points, &points);
}

#[test]
fn json_knows_names_units_gaps_and_nan() {
    let points = hand(2);
    let row = |p: &Point3<f64>| format!("[{}, {}, {}]", p.x * 100.0, p.y * 100.0, p.z * 100.0);
    let mut rows: Vec<String> = points.iter().map(|p| row(&p.unwrap())).collect();
    rows[4] = "null".into();
    rows[8] = "[NaN, 1.0, 2.0]".into();
    rows[12] = "[null, 1.0, -Infinity]".into();
    let text = format!(
        r#"{{"format": "drex-hand-demo/1", "source": "said \"NaN\"", "units": "cm", "fps": 20, "extra": {{"a": 1}},
            "frames": [{{"mp_label": "Left", "score": 0.5, "keypoints": [{}], "object_pose_3x4": [[1,0,0,5],[0,1,0,0],[0,0,1,NaN]]}},
                       {{"keypoints": []}}]}}"#,
        rows.join(", ")
    );
    let demo = read("d.json", text.as_bytes());
    assert_eq!((demo.side, demo.source.as_str()), (Side::Right, "said \"NaN\""));
    let f = &demo.frames[0];
    assert_eq!((f.points[4], f.points[8], f.points[12], f.score), (None, None, None, Some(0.5)));
    assert!((f.points[3].unwrap() - points[3].unwrap()).norm() < 1e-12);
    assert!(f.source_from_object.is_none());
    assert_eq!(demo.frames[1].t_s, 0.05);
    // Named points in another order are put right.
    let mut names: Vec<&str> = vec!["wrist"];
    for finger in ["index", "middle", "ring", "pinky"] {
        for joint in ["mcp", "pip", "dip", "tip"] {
            names.push(Box::leak(format!("{finger}_{joint}").into_boxed_str()));
        }
    }
    names.extend(["thumb_cmc", "thumb_mcp", "thumb_ip", "thumb_tip"]);
    let reordered: Vec<String> = (0..1).chain(5..21).chain(1..5).map(|i| row(&points[i].unwrap())).collect();
    let text = format!(
        r#"{{"units": "cm", "hand": "right", "joint_names": {names:?}, "frames": [{{"keypoints": [{}]}}]}}"#,
        reordered.join(", ")
    );
    same(&read("d.json", text.as_bytes()).frames[0].points, &points);
}

#[test]
fn messages_say_where() {
    let point = "[0, 0, 0],".repeat(20);
    let said = refused("d.json", format!("{{\"frames\": [{{\"keypoints\": [{point} [1, 2]]}}]}}").as_bytes());
    assert!(said.contains("frame 0") && said.contains("key point 20 has 2 coordinates"), "{said}");
    let said = refused("d.json", b"{\"frames\": [\n{\"keypoints\": [[0, 0, 0]]}]}");
    assert!(said.contains("1 key points"), "{said}");
    let said = refused("d.json", b"{\"frames\": [\n{\"keypoints\": [[0, \"a\", 0]]}]}");
    assert!(said.contains("line 2"), "{said}");
    assert!(refused("d.json", b"{\"format\": \"drex-hand-demo/9\", \"frames\": []}").contains("drex-hand-demo/9"));
    assert!(refused("d.json", b"{}").contains("hand_joints"));
    assert!(refused("d.jsonl", b"{\"keypoints\": []}\n{\"keypoints\": [1]}\n").contains("line 2"));
    assert!(refused("d.txt", b"").contains(".txt"));
    let said = HandFrame::from_json_line("{\"t\": 0}", 7).unwrap_err().to_string();
    assert!(said.contains("line 7") && said.contains("keypoints"), "{said}");
}

#[test]
fn lines_are_frames() {
    let points = hand(1);
    let coords: Vec<[f64; 3]> = points.iter().map(|p| p.unwrap().coords.into()).collect();
    let line = format!(
        "{{\"t\": 1.5, \"keypoints\": {coords:?}, \"object_pose\": [0.1, 0.2, 0.3, 1, 0, 0, 0], \"mp_label\": \"Right\"}}"
    );
    let frame = HandFrame::from_json_line(&line, 1).unwrap();
    assert_eq!((frame.t_s, frame.points), (1.5, points));
    assert_eq!(frame.source_from_object, Some(Pose::translation(0.1, 0.2, 0.3)));
    let demo = read("d.jsonl", format!("{line}\n\n{line}\n").as_bytes());
    assert_eq!((demo.frames.len(), demo.side), (2, Side::Left));
    let frame = HandFrame::from_json_line("{\"keypoints\": [], \"more\": {}}", 4).unwrap();
    assert_eq!((frame.index, frame.t_s), (3, 0.1));
}

#[test]
fn tables_are_read_by_their_header() {
    let points = hand(2);
    let names = ["wrist", "thumb_cmc", "thumb_mcp", "thumb_ip", "thumb_tip"].map(str::to_owned).into_iter().chain(
        ["index", "middle", "ring", "pinky"]
            .iter()
            .flat_map(|f| ["mcp", "pip", "dip", "tip"].map(|j| format!("{f}_{j}"))),
    );
    let header: Vec<String> = names.flat_map(|n| ["x", "y", "z"].map(|a| format!("{n}_{a}"))).collect();
    let cells: Vec<String> = numbers(&[points]).iter().map(f64::to_string).collect();
    let text = format!(
        "t,{},object_x,object_y,object_z,object_qw,object_qx,object_qy,object_qz\n0.5,{},0.1,0,0,1,0,0,0\n",
        header.join(","),
        cells.join(",")
    );
    let demo = read("d.csv", text.as_bytes());
    same(&demo.frames[0].points, &points);
    assert_eq!((demo.frames[0].t_s, demo.frames[0].source_from_object), (0.5, Some(Pose::translation(0.1, 0.0, 0.0))));
    let numbered: Vec<String> = (0..21).flat_map(|i| ["x", "y", "z"].map(|a| format!("kp{i}_{a}"))).collect();
    let mut gaps = cells.clone();
    gaps[12] = String::new();
    gaps[24] = "nan".into();
    let text = format!("{}\n{}\n", numbered.join(","), gaps.join(","));
    let demo = read("d.csv", text.as_bytes());
    assert!(demo.frames[0].points[4].is_none() && demo.frames[0].points[8].is_none());
    assert_eq!(demo.frames[0].points[5], points[5]);
    gaps[0] = "far".into();
    let said = refused("d.csv", format!("{}\n{}\n", numbered.join(","), gaps.join(",")).as_bytes());
    assert!(said.contains("line 2") && said.contains("kp0_x"), "{said}");
    assert!(refused("d.csv", b"a,b\n1,2\n").contains("wrist_x"));
}

#[test]
fn object_poses_come_from_a_file_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let frames: Vec<KeyPoints> = (0..3).map(hand).collect();
    let demo = npy(&[3, 21, 3], &numbers(&frames));
    let mut matrices = vec![0.0; 48];
    for i in 0..3 {
        for d in 0..4 {
            matrices[16 * i + 5 * d] = 1.0;
        }
        matrices[16 * i + 3] = 0.1 * i as f64;
    }
    let path = folder.path().join("object.npy");
    std::fs::write(&path, npy(&[3, 4, 4], &matrices)).unwrap();
    let chosen = options(|o| {
        o.object_poses = Some(path.clone());
        o.first_frame = Some(1);
    });
    let read = parse("d.npy", &demo, &chosen).unwrap();
    assert!((read.frames[1].source_from_object.unwrap().translation.x - 0.2).abs() < 1e-12);
    let csv = folder.path().join("object.csv");
    std::fs::write(&csv, "t,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n0.1,0.3,0,0,1,0,0,0\n").unwrap();
    let read = parse("d.npy", &demo, &options(|o| o.object_poses = Some(csv.clone()))).unwrap();
    assert!((read.frames[1].source_from_object.unwrap().translation.x - 0.1).abs() < 1e-9);
    let poses = folder.path().join("ob_in_cam");
    std::fs::create_dir(&poses).unwrap();
    for i in 0..3 {
        let text = format!("1 0 0 {}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", 0.05 * f64::from(i));
        std::fs::write(poses.join(format!("{i:04}.txt")), text).unwrap();
    }
    let read = parse("d.npy", &demo, &options(|o| o.object_poses = Some(poses.clone()))).unwrap();
    assert!((read.frames[2].source_from_object.unwrap().translation.x - 0.1).abs() < 1e-9);
    std::fs::write(&path, npy(&[2, 4, 4], &matrices[..32])).unwrap();
    let said = parse("d.npy", &demo, &options(|o| o.object_poses = Some(path))).unwrap_err().to_string();
    assert!(said.contains("2 object poses for 3 frames"), "{said}");
}

#[test]
fn what_is_saved_is_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("demo.json");
    let mut frame = HandFrame::new(0.25, hand(1));
    frame.points[9] = None;
    frame.source_from_mano_wrist = Some(UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2, 0.3)));
    frame.source_from_object = Some(Pose::translation(0.1, 0.2, 0.3));
    let mut demo = Demonstration::new("a test", Side::Left, vec![frame.clone()]);
    demo.up = Some(Vector3::z_axis());
    demo.save_json(&path).unwrap();
    let read = Demonstration::load(&path, &LoadOptions::default()).unwrap();
    assert_eq!((read.side, read.source.as_str(), read.up), (demo.side, "a test", demo.up));
    assert_eq!((read.frames[0].points, read.frames[0].t_s), (frame.points, 0.25));
    let turn = read.frames[0].source_from_mano_wrist.unwrap().angle_to(&frame.source_from_mano_wrist.unwrap());
    assert!(turn < 1e-9);
    assert!(Demonstration::load(folder.path(), &LoadOptions::default()).unwrap_err().to_string().contains("folder"));
}

#[test]
fn units_can_be_stated() {
    let bytes = npy(&[1, 21, 3], &numbers(&[hand(0).map(|p| p.map(|p| p * 100.0))]));
    assert!(refused("a.npy", &bytes).contains("unit"));
    let demo = parse("a.npy", &bytes, &options(|o| o.unit = Some(DemoUnit::Cm))).unwrap();
    assert!((hand_length_m(&demo.frames[0].points).unwrap() - hand_length_m(&hand(0)).unwrap()).abs() < 1e-12);
}

#[test]
fn the_recordings_are_read_whole_and_found_good() {
    let Some(shared) = shared() else { return };
    // Frames, frames with an object, rough length of the hand.
    for (file, frames, objects, length) in [
        ("demos/dexret_human_video/hand.json", 621, 0, 0.189),
        ("demos/mimic_index_mcp_video/hand.json", 139, 0, 0.196),
        ("demos/manus_subject000/hand.json", 700, 0, 0.1945),
        ("demos/dexmv_relocate_mustard/hand.json", 122, 122, 0.1715),
        ("grasps/dexycb_cracker_box/demo.json", 74, 74, 0.188),
    ] {
        let demo = Demonstration::load(&shared.join("data").join(file), &LoadOptions::default()).unwrap();
        assert_eq!((demo.frames.len(), demo.side), (frames, Side::Right), "{file}");
        assert_eq!(demo.frames.iter().filter(|f| f.source_from_object.is_some()).count(), objects);
        let report = demo.check();
        assert!((report.hand_length_m.unwrap() - length).abs() < 2e-3, "{file}: {:?}", report.hand_length_m);
        assert_eq!(report.missing_share, 0.0);
        println!(
            "{file}: spread {:?}, {} flagged, notes {:?} {:?}",
            report.bone_spread, report.flagged, report.notes, demo.notes
        );
        assert!(10 * report.flagged < frames, "{file}: {} frames flagged", report.flagged);
        // MANO's wrist frame differs from the operator frame by a constant turn (9.7 and 8.3 degrees, measured).
        for frame in demo.frames.iter().filter(|f| objects > 0 && f.source_from_mano_wrist.is_some()) {
            let operator = operator_frame(&frame.points, demo.side).unwrap();
            let mano = frame.source_from_mano_wrist.unwrap();
            let tips = operator.rotation.inverse() * (mano * -Vector3::x());
            assert!(tips.z > 0.95, "{file}: MANO's -x is along the fingers: {tips}");
        }
    }
}

#[test]
fn distances_to_the_object_tell_good_tracking_from_bad() {
    let Some(shared) = shared() else { return };
    let report = |demo: &str, mesh: &str| {
        let demo = Demonstration::load(&shared.join("data").join(demo), &LoadOptions::default()).unwrap();
        let mesh = drex_mesh::read_mesh(&shared.join("data").join(mesh)).unwrap();
        let mesh = drex_mesh::repair(&mesh, &drex_mesh::RepairOptions::default()).unwrap().0;
        demo.check_with_object(&drex_mesh::MeshSdf::new(&mesh).unwrap())
    };
    let share_near = |r: &drex_demo::InputReport, from: usize, to: usize| {
        let near = r.frames[from..=to].iter().filter(|f| f.object_distance_mm.is_some_and(|d| d < 15.0)).count();
        near as f64 / (to + 1 - from) as f64
    };
    let cracker = report("grasps/dexycb_cracker_box/demo.json", "grasps/dexycb_cracker_box/object.obj");
    assert!(share_near(&cracker, 36, 73) > 0.99, "held");
    // Occluded from frame 53 on: hand and object come from separate estimators.
    let folder = "demos/dexmv_relocate_mustard";
    let mustard = report(&format!("{folder}/hand.json"), &format!("{folder}/object_collision.obj"));
    assert!(share_near(&mustard, 42, 52) > share_near(&mustard, 56, 70) + 0.3, "{mustard:?}");
}

#[test]
fn a_hand_that_is_the_other_one_is_noticed() {
    let mut demo = Demonstration::new("test", Side::Left, (0..8).map(|i| HandFrame::new(i as f64, hand(i))).collect());
    assert!(demo.check().notes.iter().any(|n| n.contains("right hand")), "{:?}", demo.check().notes);
    demo.side = Side::Right;
    assert!(demo.check().notes.is_empty(), "{:?}", demo.check().notes);
}

#[test]
fn bad_frames_are_flagged_one_by_one() {
    let frame = |i: usize| {
        let shift = Vector3::new(0.01 * i as f64, 0.0, 0.0);
        HandFrame::new(i as f64 / 30.0, hand(3).map(|p| p.map(|p| p + shift)))
    };
    let mut demo = Demonstration::new("test", Side::Right, (0..40).map(frame).collect());
    assert_eq!(demo.check().flagged, 0, "{:?}", demo.check());
    demo.frames[10].points[8].as_mut().unwrap().z += 0.12;
    demo.frames[15].points = demo.frames[15].points.map(|p| p.map(|p| p + Vector3::new(0.0, 0.3, 0.0)));
    demo.frames[20].points[12] = None;
    demo.frames[25].points = [Some(Point3::origin()); KEYPOINTS];
    demo.frames[30].t_s = demo.frames[29].t_s;
    let wrist = demo.frames[35].points[0].unwrap();
    demo.frames[35].points = demo.frames[35].points.map(|p| p.map(|p| wrist + (p - wrist) * 1.6));
    let report = demo.check();
    let flagged: Vec<usize> = report.frames.iter().filter(|f| !f.flags.is_empty()).map(|f| f.index).collect();
    let numbers: Vec<usize> =
        report.frames.iter().enumerate().filter(|(_, f)| !f.flags.is_empty()).map(|(i, _)| i).collect();
    assert_eq!(flagged.len(), numbers.len());
    for i in [10, 15, 20, 25, 30, 35] {
        assert!(numbers.contains(&i), "frame {i}: {numbers:?}");
    }
    // The neighbours of a jump may be flagged with it, no others.
    assert!(numbers.iter().all(|i| [10, 15, 20, 25, 30, 35].iter().any(|b| i.abs_diff(*b) <= 1)), "{numbers:?}");
    assert!(Demonstration::new("none", Side::Right, vec![]).check().frames.is_empty());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Whatever the bytes: a demonstration or an error.
    #[test]
    fn no_bytes_make_a_reader_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400), format in 0..4usize) {
        let name = ["a.json", "a.npy", "a.npz", "a.csv"][format];
        let _ = parse(name, &bytes, &LoadOptions::default());
        let _ = HandFrame::from_json_line(&String::from_utf8_lossy(&bytes), 1);
    }

    /// A good file with some bytes changed or cut off.
    #[test]
    fn no_damage_makes_a_reader_panic(
        at in 0.0..1.0f64, value in any::<u8>(), cut in 0.0..1.0f64, format in 0..4usize, deflated in any::<bool>()
    ) {
        let points = numbers(&[hand(0), hand(1)]);
        let header: Vec<String> = (0..21).flat_map(|i| ["x", "y", "z"].map(|a| format!("p{i}_{a}"))).collect();
        let row = |v: &[f64]| v.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
        let arrays = [("keypoints", npy(&[2, 21, 3], &points)), ("object_pose", npy(&[2, 7], &[0.5; 14])), ("t", npy(&[2], &[0.0, 1.0]))];
        let (name, mut bytes) = match format {
            0 => {
                let folder = tempfile::tempdir().unwrap();
                let path = folder.path().join("a.json");
                Demonstration::new("t", Side::Right, vec![HandFrame::new(0.0, hand(0))]).save_json(&path).unwrap();
                ("a.json", std::fs::read(path).unwrap())
            }
            1 => ("a.npy", npy(&[2, 21, 3], &points)),
            2 => ("a.npz", npz(&arrays, deflated)),
            _ => ("a.csv", format!("{}\n{}\n{}\n", header.join(","), row(&points[..63]), row(&points[63..])).into_bytes()),
        };
        let i = (at * (bytes.len() - 1) as f64) as usize;
        bytes[i] = value;
        let whole = parse(name, &bytes, &LoadOptions::default());
        if let Ok(demo) = whole {
            let _ = demo.check();
        }
        bytes.truncate((cut * bytes.len() as f64) as usize);
        let _ = parse(name, &bytes, &LoadOptions::default());
    }
}

#[test]
fn json_that_is_no_recording_is_told_what_one_is() {
    for (text, what) in
        [("", "empty"), ("\n \n", "empty"), ("[]", "no JSON object"), ("7", "no JSON object"), ("{}", "neither")]
    {
        let path = Path::new("x.json");
        let error = Demonstration::parse(path, text.as_bytes(), &LoadOptions::default()).unwrap_err().to_string();
        assert!(error.contains(what) && error.contains("drex-hand-demo/1"), "{text}: {error}");
    }
}
