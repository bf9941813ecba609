//! Wrong input is refused with the file, the place and a remedy.
#![allow(clippy::unwrap_used, missing_docs)] // a test may stop at the first surprise

use std::path::{Path, PathBuf};

use drex_recording::convert::mujoco_push::{ForceQuality, PoseQuality};
use drex_recording::{Drive, Free, PushConfig, PushRecording, StatedParameter, TrackFrame};
use tempfile::TempDir;

/// A small push of each kind on disk, sound until a test spoils it.
struct Push(TempDir);

const TRACK: &str = "t,x,y,z,qw,qx,qy,qz\n10,0,0,0.05,1,0,0,0\n10.1,0,0,0.05,1,0,0,0\n10.2,0.01,0,0.05,1,0,0,0\n";
const CAMERA_TRACK: &str = "2025-04-17T18:59:37.5 - Pose:\ntensor([[[1, 0, 0, 0.1],\n[0, 1, 0, 0],\n[0, 0, 1, 0.8],\n[0, 0, 0, 1]]])\n\
    2025-04-17T18:59:38.5 - Pose:\ntensor([[[1, 0, 0, 0.1],\n[0, 1, 0, 0],\n[0, 0, 1, 0.8],\n[0, 0, 0, 1]]])\n";

const FORCE: &str = r#"schema = 1
mesh = "box.obj"
mass_prior_kg = 0.3
[track]
file = "pose.csv"
format = "pose_csv"
frame = "world"
noise = { position_m = 0.002, rotation_rad = 0.017 }
[support]
friction = 0.4
boxes = [{ center_m = [0.1, 0, 0.02], half_m = [0.05, 0.1, 0.02] }]
[start]
at_rest = true
time_s = 10
[force]
file = "force.csv"
point_in_object_m = [0, 0, 0.02]
"#;

const FINGER: &str = r#"schema = 1
mesh = "box.obj"
[track]
file = "pose.csv"
format = "pose_csv"
frame = "world"
[start]
at_rest = true
pose = { position_m = [0, 0, 0.05], quat_wxyz = [1, 0, 0, 0] }
[finger]
commands = "action.csv"
encoder = "proprio.csv"
clock = { offset_s = 10.0 }
impedance = { radius_m = 0.01, mass_kg = 0.04, armature_kg = 0.02, damping_ns_m = 0.5, kp_n_m = 135, kv_ns_m = 2.9, friction = 0.6, home_m = [0, 0, 0.1] }
"#;

const HAND: &str = r#"schema = 1
name = "hand"
mesh = "box.obj"
[track]
file = "poses.txt"
format = "foundation_pose_log"
clock = { kind = "local_iso", utc_offset = "-07:00" }
frame = "camera"
up_in_mesh = [0, 0, 2]
push_in_mesh = [1, 0, 0]
[hand]
robot = "allegro_right"
world_from_base = { position_m = [0, 0, 0.3], quat_wxyz = [1, 0, 0, 0] }
joints = "joints.csv"
joint_names = ["ffj0", "ffj1"]
clock = { kind = "unix" }
"#;

const CAMERA_POSE: &str = "world_from_camera = { position_m = [0, 0, 1], quat_wxyz = [1, 0, 0, 0] }";

const TOSS: &str =
    "schema = 1\nmesh = \"box.obj\"\n[track]\nfile = \"pose.csv\"\nformat = \"pose_csv\"\nframe = \"world\"\n";

impl Push {
    fn new(toml: &str) -> Self {
        let push = Self(tempfile::tempdir().unwrap());
        push.write("push.toml", toml);
        push.write("box.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
        push.write("pose.csv", TRACK);
        push.write("poses.txt", CAMERA_TRACK);
        push.write("force.csv", "t,fx,fy,fz\n10,0,0,0\n10.05,1,0,0\n10.1,0,0,0\n");
        push.write("action.csv", "t,x_cmd,y_cmd,z_cmd\n0,0,0,0.1\n0.1,0.01,0,0.1\n");
        push.write("proprio.csv", "t,x,y,z,vx,vy,vz\n0,0,0,0.1,0,0,0\n0.1,0.01,0,0.1,0.1,0,0\n");
        // 1744941577.5 is 2025-04-17T18:59:37.5-07:00.
        push.write(
            "joints.csv",
            "timestamp,position_0,position_1,effort_0,effort_1\n1744941577.9,0,0.1,0,0\n1744941578.0,0,0.2,0,0\n",
        );
        push
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.0.path().join(name), text).unwrap();
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn load(&self) -> PushRecording {
        PushRecording::load(self.0.path()).unwrap()
    }

    fn message(&self) -> String {
        PushRecording::load(self.0.path()).unwrap_err().to_string()
    }
}

#[test]
fn a_mesh_of_photos_is_known_to_its_voxel() {
    let push = Push::new(FORCE);
    assert_eq!(push.load().mesh_sd_m, None);
    push.write("scan.json", r#"{"fusion": {"voxel_m": 0.00088}}"#);
    let found = push.load();
    assert_eq!(found.mesh_sd_m, Some(0.0009));
    assert!(found.notes.contains(&"the mesh is known to 0.9 mm".to_owned()), "{:?}", found.notes);
    // What the push says counts more.
    for stated in [0.0, 0.002] {
        push.write("push.toml", &format!("mesh_sd_m = {stated}\n{FORCE}"));
        assert_eq!(push.load().mesh_sd_m, Some(stated));
    }
    push.write("push.toml", &format!("mesh_sd_m = -0.001\n{FORCE}"));
    assert!(push.message().contains("mesh_sd_m"), "{}", push.message());
    push.write("push.toml", FORCE);
    push.write("scan.json", r#"{"fusion": "#);
    assert!(push.message().contains("scan.json"), "{}", push.message());
    push.write("scan.json", r#"{"of": "something else"}"#);
    assert_eq!(push.load().mesh_sd_m, None);
}

#[test]
fn all_four_kinds_of_push_can_be_said() {
    let force = Push::new(FORCE).load();
    let Drive::Force(profile) = &force.drive else { panic!() };
    assert!((profile.times_s[1] - 0.05).abs() < 1e-12 && force.track.times_s()[0] == 0.0);
    assert_eq!(force.support.boxes.len(), 1);
    assert!(profile.torques_nm.is_empty() && force.parameters.is_empty());
    assert!(force.noise.is_some() && force.starts_at_rest);

    // The start has a pose, so zero stays zero; the finger's own clock starts at 10 s of the track's.
    let finger = Push::new(FINGER).load();
    let Drive::Finger(push) = &finger.drive else { panic!() };
    assert_eq!((push.command_times_s[0], finger.track.times_s()[0]), (10.0, 10.0));
    assert!(push.encoder.is_some());

    let hand = Push::new(HAND).load();
    let Drive::Hand(push) = &hand.drive else { panic!() };
    assert!((push.joints.times_s[0] - 0.4).abs() < 1e-6 && hand.track.times_s()[0] == 0.0);
    let TrackFrame::Camera { of_mesh, up, .. } = hand.track_frame else { panic!() };
    assert!(!of_mesh && up.unwrap().z == 1.0);
    let bare = Push::new(&HAND.replace("up_in_mesh = [0, 0, 2]\npush_in_mesh = [1, 0, 0]\n", "")).load();
    assert_eq!(bare.track_frame, TrackFrame::Camera { of_mesh: false, up: None, push: None });

    // A quarter turn about z, then a metre down: the tracked (0.1, 0, 0.8) is (0, 0.1, -0.2) in the world.
    let pose = "world_from_camera = { position_m = [0, 0, -1], quat_wxyz = [0.5, 0, 0, 0.5] }\n";
    let pose = pose.replace("0.5", &std::f64::consts::FRAC_1_SQRT_2.to_string());
    let calibrated = HAND.replace("up_in_mesh = [0, 0, 2]\npush_in_mesh = [1, 0, 0]\n", &pose);
    let known = Push::new(&calibrated).load();
    let at = known.track.poses()[0].translation.vector;
    assert_eq!(known.track_frame, TrackFrame::World);
    assert!((at - nalgebra::Vector3::new(0.0, 0.1, -0.2)).norm() < 1e-12, "{at}");

    let toss = Push::new(TOSS).load();
    assert!(matches!(toss.drive, Drive::Nothing) && toss.track.times_s()[0] == 0.0);
    for text in [FORCE, FINGER, HAND, TOSS, &calibrated] {
        let file = Push::new(text);
        let config = PushConfig::read(&file.path("push.toml")).unwrap();
        file.write("push.toml", &config.to_toml_string().unwrap());
        assert_eq!(PushConfig::read(&file.path("push.toml")).unwrap(), config);
    }
}

#[test]
fn torques_and_stated_parameters_are_read() {
    let stated =
        "[parameters]\nfriction = \"free\"\nforce_gain = 1.02\ncontact_height = { mean = 0.0, sd = 0.005 }\n[force]";
    let push = Push::new(&FORCE.replace("[force]", stated));
    push.write("force.csv", "t,fx,fy,fz,tx,ty,tz\n10,0,0,0,0,0,0\n10.05,1,0,0,0,0.2,0\n10.1,0,0,0,0,0,0\n");
    let loaded = push.load();
    let Drive::Force(profile) = &loaded.drive else { panic!() };
    assert_eq!(profile.torques_nm[1].y, 0.2);
    let of = |name: &str| loaded.parameters[name];
    assert_eq!(of("friction"), StatedParameter::Free(Free::Free));
    assert_eq!(of("force_gain"), StatedParameter::Value(1.02));
    assert_eq!(of("contact_height"), StatedParameter::Expected { mean: 0.0, sd: 0.005 });
}

#[test]
fn spoiled_push_files_are_named_with_the_place() {
    for (toml, from, to, expected) in [
        (FORCE, "friction = 0.4", "frction = 0.4", "line 10: column 1: unknown field `frction`"),
        (FORCE, "format = \"pose_csv\"", "format = \"csv\"", "line 6: column 10: unknown variant `csv`"),
        (FORCE, "mesh = \"box.obj\"", "", "missing field `mesh`"),
        (FORCE, "schema = 1", "schema = 9", "schema 9"),
        (FORCE, "schema = 1", "schema = ", "line 1"),
        (FORCE, "box.obj", "gone.obj", "gone.obj"),
        (FORCE, "pose.csv", "gone.csv", "gone.csv"),
        (FORCE, "[force]", "[hand]", "unknown field `file`"),
        (FORCE, "friction = 0.4", "friction = nan", "support.friction is not finite"),
        (FORCE, "friction = 0.4", "friction = -0.4", "the friction of object and support is given as -0.4"),
        (FORCE, "position_m = 0.002", "position_m = 2", "the noise of positions (m)"),
        (FINGER, "kp_n_m = 135", "kp_n_m = 0", "the stiffness of the finger"),
        (FINGER, "[finger]", "[force]\nfile = \"force.csv\"\npoint_in_object_m = [0,0,0]\n[finger]", "more than one"),
        (
            FINGER,
            "quat_wxyz = [1, 0, 0, 0]",
            "quat_wxyz = [0, 0, 0, 0]",
            "push.toml: [start] pose: the quaternion (0, 0, 0, 0) has norm 0.0000",
        ),
        (FINGER, "offset_s = 10.0", "offset_s = 0.0", "do not overlap"),
        (HAND, "up_in_mesh = [0, 0, 2]", "up_in_mesh = [0, 0, 0]", "no direction"),
        (HAND, "up_in_mesh = [0, 0, 2]", CAMERA_POSE, "already says what up_in_mesh and push_in_mesh would"),
        (
            TOSS,
            "frame = \"world\"",
            format!("frame = \"world\"\n{CAMERA_POSE}").as_str(),
            "world_from_camera has no meaning",
        ),
        (TOSS, "frame = \"world\"", "frame = \"world\"\npush_in_mesh = [1, 0, 0]", "push_in_mesh has no meaning"),
        (
            HAND,
            "up_in_mesh = [0, 0, 2]\npush_in_mesh = [1, 0, 0]",
            "world_from_camera = { position_m = [0, 0, 1], quat_wxyz = [2, 0, 0, 0] }",
            "push.toml: [track] world_from_camera: the quaternion",
        ),
        (HAND, "-07:00", "soon", "names no UTC offset"),
        (HAND, "-07:00", "-06:00", "time zone"),
        (HAND, ", utc_offset = \"-07:00\"", "", "utc_offset"),
        (HAND, "clock = { kind = \"unix\" }", "", "state clock.offset_s"),
        (HAND, "[\"ffj0\", \"ffj1\"]", "[\"ffj0\"]", "2 joint columns but 1 joint names"),
        (HAND, "joint_names = [\"ffj0\", \"ffj1\"]", "", "joints are unknown"),
        (TOSS, "pose_csv", "bop_csv", "needs fps"),
    ] {
        assert!(toml.contains(from));
        let push = Push::new(&toml.replace(from, to));
        let message = push.message();
        assert!(message.contains(expected), "expected `{expected}` in: {message}");
    }
}

#[test]
fn spoiled_tables_are_named_with_the_line() {
    for (toml, file, text, expected) in [
        (TOSS, "pose.csv", TRACK.replace("10.1,0,0,", "10.1,0,NaN,"), "line 3: column y: `NaN` is not finite"),
        (TOSS, "pose.csv", TRACK.replace("10.1,0,0,", "10.1,0,zero,"), "line 3: column y: `zero` is not a number"),
        (TOSS, "pose.csv", TRACK.replace("0.05,1,0,0,0\n10.2", "0.05,0.5,0,0,0\n10.2"), "line 3: the quaternion"),
        (TOSS, "pose.csv", TRACK.replace("qw,", "w,"), "no column qw; the columns are t, x, y, z, w, qx"),
        (TOSS, "pose.csv", TRACK.replace("0.05", "50"), "millimetres"),
        (TOSS, "pose.csv", TRACK.replace("10.1,0,0,0.05,1,0,0,0", "10.1,0,0"), "line 3: 3 fields"),
        (TOSS, "pose.csv", "t,x,y,z,qw,qx,qy,qz\n".into(), "no rows"),
        (TOSS, "pose.csv", String::new(), "empty"),
        (FORCE, "force.csv", "t,fx,fy\n10,0,0\n".into(), "no column fz"),
        (FORCE, "force.csv", "t,fx,fy,fz\n10,0,0,inf\n".into(), "line 2: column fz"),
        (FORCE, "force.csv", "t,fx,fy,fz,tx,tz\n10,0,0,0,0,0\n".into(), "no column ty"),
        (FORCE, "force.csv", "t,fx,fy,fz\n99,0,0,0\n".into(), "do not overlap"),
        (HAND, "joints.csv", "timestamp,position_0,position_1\n1744941577.9,0,90\n".into(), "joint ffj1 at 90.000 rad"),
        (HAND, "joints.csv", "timestamp,angle_0\n1744941577.9,0\n".into(), "no column position_0"),
        (HAND, "joints.csv", "timestamp,position_0,position_1\n1744966777.9,0,0\n".into(), "25199.400 s lie between"),
        (HAND, "poses.txt", "nothing here".into(), "no complete"),
        (HAND, "poses.txt", CAMERA_TRACK.replacen("[0, 1, 0, 0]", "[0, 2, 0, 0]", 1), "no rotation"),
    ] {
        let push = Push::new(toml);
        push.write(file, &text);
        let message = push.message();
        assert!(message.contains(expected) && message.contains(file), "expected `{expected}` in: {message}");
        assert!(message.contains("; "), "no remedy in: {message}");
    }
}

#[test]
fn a_row_that_was_cut_off_while_written_is_dropped() {
    let push = Push::new(TOSS);
    push.write("pose.csv", TRACK.strip_suffix(",0.05,1,0,0,0\n").unwrap());
    assert_eq!(push.load().track.len(), 2);
}

#[test]
fn folders_without_a_push_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let message = |p: &Path| PushRecording::load(p).unwrap_err().to_string();
    assert!(message(folder.path()).contains("the folder holds no push.toml"));
    let other = folder.path().join("meta.json");
    assert!(message(&other).contains("cannot read"));
    std::fs::write(&other, "{}").unwrap();
    assert!(message(&other).contains("the file is no push.toml") && message(&other).contains("`drex import`"));
    assert!(message(&folder.path().join("push.toml")).contains("cannot read"));
    assert!("loud".parse::<PoseQuality>().unwrap_err().to_string().contains("noisy, hard or clean"));
    assert_eq!("exact".parse::<ForceQuality>().unwrap(), ForceQuality::Exact);
}

/// The examples in the documentation of the format are of the format.
#[test]
fn documented_examples_are_read() {
    let source = include_str!("../src/push/toml.rs");
    let mut examples = 0;
    for block in source.split("/// ```toml\n").skip(1) {
        let text = block.split("/// ```").next().unwrap().replace("/// ", "").replace("///", "");
        let config: PushConfig = drex_core::fsutil::from_toml(Path::new("example"), &text).unwrap();
        assert!(config.force.is_some() != config.hand.is_some());
        examples += 1;
    }
    assert_eq!(examples, 2);
}
