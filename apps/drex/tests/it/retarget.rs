//! `drex retarget` and `drex hands` from the command line, on a hand that is made up.

use crate::common;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::common::{drex, shared_data};
use drex_core::Pose;
use drex_demo::{Demonstration, FingerAngles, HandFrame, HandSkeleton, Side};
use drex_retarget::{Objective, RetargetOptions, Scale, TargetHand, retarget};
use serde_json::Value;

fn made_up(folder: &Path, side: Side, frames: usize) -> (PathBuf, Demonstration) {
    let demo = HandSkeleton::new(side).moving(frames);
    let path = folder.join("demo.json");
    demo.save_json(&path).unwrap();
    (path, demo)
}

fn read(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

#[test]
fn a_clip_is_what_the_library_makes_of_it() {
    let dir = tempfile::tempdir().unwrap();
    let (demo, person) = made_up(dir.path(), Side::Right, 24);
    let (out, sheet) = (dir.path().join("out.json"), dir.path().join("sheet.png"));
    let run = drex([
        "retarget".as_ref(),
        demo.as_os_str(),
        "--hand".as_ref(),
        "allegro".as_ref(),
        "--objective".as_ref(),
        "dexpilot".as_ref(),
        "--scale".as_ref(),
        "1.3".as_ref(),
        "--json".as_ref(),
        "--out".as_ref(),
        out.as_os_str(),
        "--picture".as_ref(),
        sheet.as_os_str(),
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let mut options = RetargetOptions::new(Objective::DexPilot);
    options.scale = Scale::Fixed(1.3);
    let expected = retarget(&person, &TargetHand::resolve("allegro").unwrap(), &options).unwrap();
    let file = read(&out);
    let frames = file["frames"].as_array().unwrap();
    assert_eq!((frames.len(), file["joint_names"].as_array().unwrap().len()), (24, 16));
    for (frame, ours) in frames.iter().zip(&expected.frames) {
        let q: Vec<f64> = serde_json::from_value(frame["q"].clone()).unwrap();
        // The file of key points carries them with fewer digits.
        assert!(q.iter().zip(&ours.q).all(|(a, b)| (a - b).abs() < 1e-6), "{q:?} {:?}", ours.q);
    }
    let mean = expected.frames.iter().map(|f| f.objective).sum::<f64>() / 24.0;
    let answer = run.json();
    assert!((answer["mean_objective"].as_f64().unwrap() - mean).abs() < 1e-6 && answer["ms_per_frame"].is_f64());
    // Frames 0, 10 and 20 side by side.
    let picture = image::open(&sheet).unwrap().to_rgb8();
    assert_eq!(picture.width() % 3, 0);
    let corner = *picture.get_pixel(picture.width() - 1, 0);
    assert!(picture.pixels().filter(|p| **p != corner).count() > 3000);
}

#[test]
fn a_left_hand_goes_to_the_mirror_image() {
    let dir = tempfile::tempdir().unwrap();
    let (demo, _) = made_up(dir.path(), Side::Left, 5);
    let out = dir.path().join("out.json");
    let arguments = ["--hand", "leap", "--out", out.to_str().unwrap()];
    let run = drex(["retarget", demo.to_str().unwrap()].into_iter().chain(arguments));
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(run.stderr.contains("mirror image"), "{}", run.stderr);
    let file = read(&out);
    assert_eq!((file["hand"].as_str(), file["side"].as_str()), (Some("leap_left"), Some("left")));
}

#[test]
fn a_stream_answers_every_line_and_outlives_bad_ones() {
    let dir = tempfile::tempdir().unwrap();
    let (_, person) = made_up(dir.path(), Side::Right, 3);
    let mut child = Command::new(env!("CARGO_BIN_EXE_drex"))
        .args(["retarget", "-", "--hand", "leap", "--objective", "vector"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    for frame in &person.frames {
        let points: Vec<[f64; 3]> = frame.points.iter().map(|p| p.unwrap().coords.into()).collect();
        writeln!(stdin, "{}", serde_json::json!({ "t": frame.t_s, "keypoints": points })).unwrap();
        stdin.write_all(b"no frame \xff\n").unwrap();
    }
    drop(stdin);
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines: Vec<Value> =
        String::from_utf8(output.stdout).unwrap().lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(lines[0]["joint_names"].as_array().unwrap().len(), 16);
    assert_eq!(lines.len(), 7);
    for (k, line) in lines[1..].iter().enumerate() {
        assert_eq!(line["frame"].as_u64(), Some(k as u64));
        assert_eq!((line["q"].is_array(), line["error"].is_string()), (k % 2 == 0, k % 2 == 1), "{line}");
    }
}

/// A box whose faces are split in two.
fn write_box(path: &Path, half: [f64; 3]) {
    let mut text = String::new();
    for i in 0..8 {
        let sign = |bit: usize, h: f64| if i >> bit & 1 == 1 { h } else { -h };
        text += &format!("v {} {} {}\n", sign(0, half[0]), sign(1, half[1]), sign(2, half[2]));
    }
    for [a, b, c, d] in [[1, 3, 4, 2], [5, 6, 8, 7], [1, 2, 6, 5], [3, 7, 8, 4], [1, 5, 7, 3], [2, 4, 8, 6]] {
        text += &format!("f {a} {b} {c}\nf {a} {c} {d}\n");
    }
    fs::write(path, text).unwrap();
}

#[test]
fn what_is_missing_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let (demo, _) = made_up(dir.path(), Side::Right, 3);
    let (demo, out) = (demo.to_str().unwrap(), dir.path().join("out.json"));
    let run = |rest: &[&str]| drex(["retarget", demo].iter().chain(rest));
    run(&["--hand", "leap"]).fails_with(&["--out", "--picture"]);
    let out_text = out.to_str().unwrap();
    run(&["--hand", "no_hand", "--out", out_text]).fails_with(&["no_hand", "leap_right"]);
    assert_eq!(run(&["--hand", "leap", "--objective", "grasp", "--out", out_text]).code, 2);
    let mesh = dir.path().join("box.obj");
    write_box(&mesh, [0.03, 0.04, 0.1]);
    let grasp = ["--hand", "leap", "--objective", "grasp", "--object", mesh.to_str().unwrap(), "--out", out_text];
    run(&grasp).fails_with(&["pose of the object"]);
    assert!(!out.exists());
    drex(["retarget", "-", "--hand", "leap", "--objective", "grasp", "--object", "x.obj"]).fails_with(&["whole clips"]);
    assert_eq!(run(&["--hand", "leap", "--frames", "7-3", "--out", out_text]).code, 2);
    run(&["--hand", "leap", "--augment", "9", "--out", out_text]).fails_with(&["--augment", "--objective grasp"]);
    run(&["--hand", "leap", "--picture", out_text]).fails_with(&["out.json", ".png"]);
    run(&["--hand", "leap_right", "--mapping", "no.toml", "--out", out_text]).fails_with(&["no.toml"]);
    drex(["retarget", "-", "--hand", "leap", "--frames", "1-2"]).fails_with(&["--frames", "stream"]);
    assert!(!out.exists());
}

/// A hand that comes down to a box between thumb and middle finger and lifts it, and half the width of that box.
fn holds_a_box() -> (Demonstration, f64) {
    let skeleton = HandSkeleton::new(Side::Right);
    let angles = std::array::from_fn(|i| match i {
        0 => FingerAngles { spread: 1.0, flexion: [0.3, 0.3, 0.2] },
        _ => FingerAngles { spread: 0.0, flexion: [0.9, 0.5, 0.3] },
    });
    let at_rest = skeleton.points(&angles, &Pose::identity());
    let (thumb, finger) = (at_rest[4].unwrap(), at_rest[12].unwrap());
    let across = nalgebra::UnitQuaternion::rotation_between(&nalgebra::Vector3::x(), &(finger - thumb)).unwrap();
    let middle = nalgebra::center(&thumb, &finger);
    let frames = (0..30).map(|k| {
        // Away from the box along the palm's normal, then up with it.
        let (away, up) = (0.012 * (10.0 - k as f64).max(0.0), 0.006 * (k as f64 - 14.0).max(0.0));
        let lift = Pose::translation(0.0, 0.0, up);
        let mut frame =
            HandFrame::new(k as f64 / 30.0, skeleton.points(&angles, &(lift * Pose::translation(-away, 0.0, 0.0))));
        frame.source_from_object = Some(lift * Pose::from_parts(middle.coords.into(), across));
        frame
    });
    let mut person = Demonstration::new("a made-up lift", Side::Right, frames.collect());
    person.up = Some(nalgebra::Vector3::z_axis());
    (person, 0.5 * (finger - thumb).norm() - 0.002)
}

#[test]
fn a_person_who_holds_a_box_becomes_a_robot_that_does() {
    let dir = tempfile::tempdir().unwrap();
    let (person, half_m) = holds_a_box();
    let (demo, mesh, out) = (dir.path().join("d.json"), dir.path().join("box.obj"), dir.path().join("out.json"));
    person.save_json(&demo).unwrap();
    write_box(&mesh, [half_m, 0.03, 0.06]);
    let paths = [&demo, &mesh, &out].map(|p| p.to_str().unwrap());
    let arguments = [
        "retarget",
        paths[0],
        "--hand",
        "leap",
        "--objective",
        "grasp",
        "--object",
        paths[1],
        "--out",
        paths[2],
        "--json",
    ];
    let run = drex(arguments);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let file = read(&out);
    assert_eq!(file["object"]["sha256"].as_str().unwrap().len(), 64);
    let frames = file["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 30);
    for frame in frames {
        let penetration = frame["penetration_mm"].as_f64().unwrap();
        assert!(
            frame["reasons"].is_array() && (penetration <= 2.0 || !frame["accepted"].as_bool().unwrap()),
            "{frame}"
        );
    }
    let answer = run.json();
    assert!(
        answer["held_frames"].as_u64().unwrap() > 15 && answer["accepted_frames"].as_u64().unwrap() > 15,
        "{answer}"
    );
    assert_eq!(answer["contact_share"].as_f64(), Some(1.0), "{answer}");
    assert!(answer["force_closure_share"].as_f64().unwrap() >= 0.9, "{answer}");
    let again = dir.path().join("again.json");
    let one = ["--threads", "1", "--out", again.to_str().unwrap()];
    assert_eq!(drex(arguments[..8].iter().chain(&one)).code, 0);
    assert_eq!(fs::read(&out).unwrap(), fs::read(&again).unwrap());
}

/// A twin folder of the box and the lift, in a folder of demonstrations.
fn box_twin(root: &Path) {
    let (person, half_m) = holds_a_box();
    fs::create_dir_all(root.join("demos")).unwrap();
    person.save_json(&root.join("demos/lift.json")).unwrap();
    fs::write(root.join("demos/notes.txt"), "not a demonstration").unwrap();
    write_box(&root.join("box.obj"), [half_m, 0.03, 0.06]);
    // Up is where the palm is: the hand comes from above.
    let manifest = "schema = 1\nname = \"box\"\n[object]\nmesh = \"box.obj\"\nup_in_mesh = [0.0, -1.0, 0.0]\n[mass]\nweighed_kg = 0.2\n\
                    [grasps]\nfile = \"demos\"\nrecorded = \"human\"\nhand = \"leap_right\"\naugment = 6\n[train]\nepochs = 3\n";
    fs::write(root.join("twin.toml"), manifest).unwrap();
}

#[test]
fn a_twin_learns_from_a_person() {
    let dir = tempfile::tempdir().unwrap();
    let (root, twin) = (dir.path(), dir.path().to_str().unwrap());
    box_twin(root);
    let run = drex(["run", twin, "--json"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let fits = read(&root.join("grasps/wrist_fits.json"));
    let (clip, grasps) = (&fits["clips"][0], fits["grasps"].as_array().unwrap());
    assert_eq!((clip["file"].as_str(), clip["frames"].as_u64()), (Some("demos/lift.json"), Some(30)));
    let (held, made) = (clip["held"].as_u64().unwrap() as usize, clip["augmented"].as_u64().unwrap() as usize);
    assert!(held > 15 && made > 0 && grasps.len() == held + made, "{clip}");
    assert!(clip["accepted"].as_u64().unwrap() > 15, "{clip}");
    for (i, grasp) in grasps.iter().enumerate() {
        assert_eq!(grasp["demonstration"].as_u64(), Some(i as u64));
        assert_eq!(grasp["accepted"].as_bool().unwrap(), grasp["reasons"].as_array().unwrap().is_empty());
        assert_eq!((grasp["source"]["symmetry"].is_u64(), grasp.get("pushed_out")), (i >= held, None), "{grasp}");
    }
    assert!(image::open(root.join("grasps/contact_sheet.png")).unwrap().width() >= 900);
    let page = fs::read_to_string(root.join("report.html")).unwrap();
    assert!(page.contains("every 10th frame") && page.contains("demos/lift.json"));
    let again = drex(["run", twin, "--json"]);
    assert_eq!(again.json()["stages_run"], serde_json::json!([]), "{}", again.stderr);
    fs::remove_file(root.join("grasps/contact_sheet.png")).unwrap();
    let again = drex(["run", twin, "--json"]);
    assert_eq!(again.json()["stages_run"], serde_json::json!(["report"]), "{}", again.stderr);
}

#[test]
fn what_a_twin_cannot_do_with_a_person_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let (root, twin) = (dir.path(), dir.path().to_str().unwrap());
    box_twin(root);
    common::edit(&root.join("twin.toml"), "leap_right", "leap_left");
    drex(["train", twin]).fails_with(&["lift.json is of a right hand", "leap_right"]);
    common::edit(&root.join("twin.toml"), "recorded = \"human\"\n", "");
    drex(["train", twin]).fails_with(&["twin.toml", "[grasps] augment = 6", "recorded"]);
    common::edit(&root.join("twin.toml"), "hand = \"leap_left\"", "recorded = \"human\"\nhand = \"leap_right\"");
    fs::rename(root.join("demos/lift.json"), root.join("demos/lift.txt")).unwrap();
    drex(["train", twin]).fails_with(&["no demonstration", ".json"]);
}

#[test]
fn a_detector_is_any_command() {
    if !cfg!(unix) {
        eprintln!("skipped: the detector of this test is a shell script");
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let (demo, _) = made_up(dir.path(), Side::Right, 4);
    let (video, out) = (dir.path().join("v.mp4"), dir.path().join("hands.json"));
    fs::write(&video, "not looked at").unwrap();
    let [demo, video, out_text] = [&demo, &video, &out].map(|p| p.to_str().unwrap());
    let common = ["hands", video, "--detector", "command", "--out", out_text, "--json", "--"];
    let copy = format!("cp {demo} \"$1\"");
    let run = drex(common.iter().chain(&["sh", "-c", &copy, "sh", "{out}"]));
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert_eq!(run.json()["frames"], 4);
    assert_eq!(read(&out)["format"], "drex-hand-demo/1");
    fs::remove_file(&out).unwrap();
    drex(common.iter().chain(&["sh", "-c", "echo lost the lens >&2; exit 3"])).fails_with(&["lost the lens"]);
    drex(common.iter().chain(&["no-such-program"])).fails_with(&["no-such-program"]);
    drex(&common[..6]).fails_with(&["after --"]);
    assert!(!out.exists());
}

#[test]
fn recorded_clips_of_two_objects_keep_the_rules() {
    let Some(shared) = shared_data("recorded_clips_of_two_objects_keep_the_rules") else { return };
    let clips = [
        ("demos/dexmv_relocate_mustard/hand.json", "demos/dexmv_relocate_mustard/object_collision.obj"),
        ("grasps/dexycb_cracker_box/demo.json", "grasps/dexycb_cracker_box/object.obj"),
    ];
    let dir = tempfile::tempdir().unwrap();
    for (demo, mesh) in clips {
        let [demo, mesh, out] = [shared.join(demo), shared.join(mesh), dir.path().join("out.json")];
        let [demo, mesh, out] = [&demo, &mesh, &out].map(|p| p.to_str().unwrap());
        let run = drex([
            "retarget",
            demo,
            "--hand",
            "allegro",
            "--objective",
            "grasp",
            "--object",
            mesh,
            "--object-hull",
            "--out",
            out,
            "--json",
        ]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        let answer = run.json();
        let number = |key: &str| answer[key].as_f64().unwrap();
        assert!(number("contact_share") >= 0.8 && number("force_closure_share") >= 0.6, "{answer}");
        assert!(number("fastest_joint_rad_s") <= 8.5, "{answer}");
    }
}
