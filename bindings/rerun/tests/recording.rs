//! A twin folder in, a recording out that Rerun's own decoder reads back.
#![allow(clippy::unwrap_used, clippy::expect_used)] // a test: a panic is the report

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use drex_splat::io::write_gaussians;
use drex_splat::{Gaussians, Kind, Label};
use re_log_encoding::DecoderApp;
use re_sdk::log::{Chunk, LogMsg};
use re_sdk_types::archetypes::{Arrows3D, EncodedImage, Mesh3D, Points3D, Scalars, Transform3D};
use serde_json::{Value, json};
use tempfile::TempDir;

/// Bundled with the project.
fn data(relative: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data").join(relative)
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

fn write(root: &Path, relative: &str, text: impl AsRef<[u8]>) {
    let file = root.join(relative);
    fs::create_dir_all(file.parent().unwrap()).unwrap();
    fs::write(file, text).unwrap();
}

fn write_json(root: &Path, relative: &str, value: &Value) {
    write(root, relative, value.to_string());
}

/// A copy of the tin as a person gives it: no stage has run.
fn tin() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    copy(&data("tin"), dir.path());
    dir
}

/// How high the asset's file says that the mesh stands.
const LIFTED_M: f64 = 0.25;
const JOINTS: [&str; 16] = [
    "if_mcp", "if_rot", "if_pip", "if_dip", "mf_mcp", "mf_rot", "mf_pip", "mf_dip", "rf_mcp", "rf_rot", "rf_pip",
    "rf_dip", "th_cmc", "th_axl", "th_mcp", "th_ipl",
];

fn pose(x: f64, z: f64) -> Value {
    json!({"translation_m": [x, 0.0, z], "quat_wxyz": [1.0, 0.0, 0.0, 0.0]})
}

/// The tin with what the stages would write, in their layout: the numbers are made up for the test.
fn finished_tin() -> TempDir {
    let dir = tin();
    let root = dir.path();
    let mesh = fs::read(root.join("scan/tin.obj")).unwrap();
    write(root, "mesh/visual.obj", &mesh);
    write(root, "mesh/collision_00.obj", &mesh);
    write(root, "mesh/collision_01.obj", &mesh);
    let model = format!(
        "<mujoco model=\"object\"><asset><mesh name=\"visual\" file=\"../mesh/visual.obj\"/></asset><worldbody>\
         <body name=\"object\" pos=\"0 0 {LIFTED_M}\"><freejoint/><geom type=\"mesh\" mesh=\"visual\"/></body></worldbody></mujoco>"
    );
    write(root, "asset/object.xml", model);
    let at = |x: f64| json!([x, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0]);
    write_json(
        root,
        "mass.json",
        &json!({"mass_kg": 0.24, "source": "identified", "ci95_kg": [0.2, 0.3], "sd_kg": 0.02, "grip_kg": 0.28,
            "posterior": {"mass_kg": [0.1, 0.24, 0.4], "cost": [12.0, 0.0, 20.0]}, "identification": {
            "verdict": "identified", "reason": "", "simulations": 9, "sensitivities": [], "assumptions": [],
            "profile": [[0.1, 12.0], [0.24, 2.0], [0.4, null]],
            "pushes": [{"name": "tilt", "position_sd_m": 0.001, "rotation_sd_rad": 0.01, "outliers": 0, "notes": [],
                        "times_s": [0.0, 0.5, 1.0], "observed": [at(0.0), at(0.01), at(0.02)],
                        "simulated": [at(0.0), at(0.012), at(0.02)]}],
        }}),
    );
    let q = vec![0.1; JOINTS.len()];
    let fit = |accepted: bool, x: f64| {
        json!({"demonstration": 3, "accepted": accepted, "reasons": [], "joints_rad": q, "largest_clipping_rad": 0.0,
               "correction_rad": q, "largest_correction_rad": 0.1, "object_from_base": pose(x, 0.1),
               "penetration_mm": 0.5, "table_clearance_mm": 7.0, "touching": ["thumb"], "squeeze_per_weight": null})
    };
    write_json(
        root,
        "grasps/wrist_fits.json",
        &json!({"schema": 1, "hand": "leap_right", "joint_names": JOINTS, "demonstrations": 3, "accepted": 2,
            "grasps": [fit(true, 0.1), fit(false, 0.2), fit(true, 0.3)]}),
    );
    write_json(
        root,
        "policy/evaluation.json",
        &json!({"mass_kg": 0.28, "friction": 0.5, "refined": [], "demonstrations": [],
            "predicted": [{"joints_rad": q, "object_from_base": pose(0.1, 0.1), "predicted_squeeze_n": 5.0, "weight": 1.0,
            "check": {"passed": false, "failures": ["too deep"], "penetration_mm": 1.0, "table_penetration_mm": 0.0,
                      "force_closure": true, "squeeze_n": 5.0, "mass_kg": 0.28, "friction": 0.5, "gamma": 1.0,
                      "contacts": [{"finger": "thumb", "contacts": 2, "normal_n": 2.5},
                                   {"finger": "palm", "contacts": 0, "normal_n": 0.0}]}}]}),
    );
    let frame = |t: f64, z: f64| {
        json!({"time_s": t, "world_from_base": pose(0.1, 0.1 + z), "joints_rad": q, "world_from_object": pose(0.0, z),
               "finger_n": [0.0, 0.5, 1.0, 1.5 * t]})
    };
    write_json(
        root,
        "policy/trial.json",
        &json!({"schema": 1, "hand": "leap_right", "joint_names": JOINTS, "mass_kg": 0.28, "mass_median_kg": 0.24,
            "mass_ci95_kg": [0.2, 0.3], "mass_sd_kg": 0.02, "friction": [0.4, 0.6], "held": 1, "n": 2, "interval": [0.1, 0.9],
            "rollouts": [{"verdict": "success", "mass_kg": 0.23, "friction": 0.5, "proposal": 1, "squeeze_n": 5.0, "held_n": 4.5},
                         {"verdict": "cannot_carry", "mass_kg": 0.25, "friction": 0.5, "proposal": 0, "squeeze_n": 0.0, "held_n": null}],
            "filmed": 0, "film": [frame(0.0, 0.0), frame(0.08, 0.05), frame(0.16, 0.1)]}),
    );
    write_json(
        root,
        "policy/execution.json",
        &json!({"schema": 1, "hand": "leap_right", "emulated": true, "unit": "mA", "joint_names": JOINTS, "open_rad": q,
            "closed_rad": q, "closing_limits": q, "force_limits": q, "held": true, "contacts": []}),
    );
    write(
        root,
        "policy/execution.csv",
        "timestamp,position_if_mcp,current_ma_if_mcp,goal_if_mcp,limit_if_mcp,late_s,phase\n\
         5.00,0.1,10,0.2,60,0,open\n5.01,0.15,55,0.2,60,0,close\n5.02,0.16,95,0.2,95,0,force\n",
    );
    dir
}

fn record(root: &Path, arguments: &[&str]) -> Output {
    // What the environment says to Rerun changes nothing.
    let mut command = Command::new(env!("CARGO_BIN_EXE_drex-rerun"));
    command.arg(root).args(arguments).env("RERUN", "off").env("RERUN_LOG_TICK", "1");
    command.output().unwrap()
}

/// Records the twin, which must work, and gives what was said on the error stream with the chunks.
fn recorded(root: &Path) -> (String, Recording) {
    let out = root.join("made/here.rrd");
    let output = record(root, &["--out", out.to_str().unwrap()]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{said}");
    (said, Recording::read(&out))
}

/// The chunks of a recording by the path of their entity.
struct Recording(BTreeMap<String, Vec<Chunk>>);

impl Recording {
    fn read(file: &Path) -> Self {
        let bytes = fs::read(file).unwrap();
        assert_eq!(&bytes[..4], b"RRF2");
        let mut chunks: BTreeMap<String, Vec<Chunk>> = BTreeMap::new();
        for message in DecoderApp::decode_eager(&bytes[..]).unwrap() {
            if let LogMsg::ArrowMsg(_, message) = message.unwrap() {
                let chunk = Chunk::from_arrow_msg(&message).unwrap();
                chunks.entry(chunk.entity_path().to_string()).or_default().push(chunk);
            }
        }
        Self(chunks)
    }

    fn has(&self, entity: &str) -> bool {
        self.0.contains_key(entity)
    }

    /// Chunks of an entity that have this component.
    fn of(&self, entity: &str, component: re_sdk::ComponentIdentifier) -> Vec<&Chunk> {
        let all = self.0.get(entity).unwrap_or_else(|| panic!("{entity} is none of {:#?}", self.0.keys()));
        all.iter().filter(|c| c.components_identifiers().any(|id| id == component)).collect()
    }

    fn numbers(&self, entity: &str) -> Vec<f64> {
        let component = Scalars::descriptor_scalars().component;
        self.of(entity, component).iter().flat_map(|c| c.iter_slices::<f64>(component)).flatten().copied().collect()
    }

    /// The rows of a component of three numbers, each row a list.
    fn vectors(&self, entity: &str, component: re_sdk::ComponentIdentifier) -> Vec<Vec<[f32; 3]>> {
        self.of(entity, component)
            .iter()
            .flat_map(|c| c.iter_slices::<[f32; 3]>(component))
            .map(<[_]>::to_vec)
            .collect()
    }

    fn places(&self, entity: &str) -> Vec<[f32; 3]> {
        self.vectors(entity, Transform3D::descriptor_translation().component).concat()
    }

    fn timelines(&self) -> BTreeSet<String> {
        self.0.values().flatten().flat_map(|c| c.timelines().keys().map(ToString::to_string)).collect()
    }
}

fn close(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9 || a.is_nan() && b.is_nan())
}

#[test]
fn every_stage_of_a_finished_twin_is_there() {
    let twin = finished_tin();
    let (said, seen) = recorded(twin.path());
    assert_eq!(said.lines().count(), 1, "{said}");
    assert!(said.contains("the manifest has no [scan]"), "{said}");
    let timelines = ["execution", "grasp", "mass_mg", "predicted", "push_tilt", "rollout", "trial"];
    assert_eq!(seen.timelines(), timelines.map(str::to_owned).into());
    let mixed: Vec<_> = seen.0.values().flatten().filter(|c| c.timelines().len() > 1).map(Chunk::entity_path).collect();
    assert!(mixed.is_empty(), "on several timelines: {mixed:?}");

    // The object stands where the asset's file puts it.
    assert_eq!(seen.places("/world/object"), [[0.0, 0.0, LIFTED_M as f32]]);
    for entity in ["/world/object/mesh", "/world/object/pieces/00", "/world/object/pieces/01"] {
        assert_eq!(seen.of(entity, Mesh3D::descriptor_vertex_positions().component).len(), 1, "{entity}");
    }

    // The mass and the push.
    assert!(close(&seen.numbers("/mass/mass_kg"), &[0.24]));
    assert!(close(&seen.numbers("/mass/cost_above_best"), &[10.0, 0.0]));
    assert!(close(&seen.numbers("/mass/likelihood_to_best"), &[(-10.0_f64).exp(), 1.0]));
    assert_eq!(seen.places("/world/push/tilt/simulated").len(), 3);
    assert_eq!(seen.places("/world/push/tilt/tracked")[1], [0.01, 0.0, 0.1]);
    assert!(close(&seen.numbers("/push/tilt/tracked_from_simulated_mm"), &[0.0, 2.0, 0.0]));
    let forces = fs::read_to_string(twin.path().join("push/tilt/force.csv")).unwrap();
    let sent: Vec<f64> = forces.lines().skip(1).map(|l| l.split(',').nth(3).unwrap().parse().unwrap()).collect();
    assert!(close(&seen.numbers("/push/tilt/force_n/z"), &sent));
    let arrows = seen.vectors("/world/push/tilt/force", Arrows3D::descriptor_vectors().component);
    assert_eq!(arrows.iter().map(Vec::len).collect::<Vec<_>>(), [1, 1, 1]);

    // Grasps: those that were accepted, about the object where it rests.
    assert!(close(&seen.numbers("/grasps/demonstration"), &[3.0, 3.0]));
    assert!(close(&seen.numbers("/grasps/squeeze_per_weight"), &[f64::NAN, f64::NAN]));
    let palm: Vec<_> = seen.0.keys().filter(|k| k.starts_with("/world/grasps/hand/")).collect();
    assert!(palm.len() > 10, "{palm:?}");
    assert!(seen.has("/world/grasps/contacts"));
    let (grasped, lifted) = (seen.places("/world/grasps/hand/palm"), seen.places("/world/trial/hand/palm"));
    for (a, expected) in [(grasped[0], [0.0, 0.0, LIFTED_M]), (grasped[1], [0.2, 0.0, LIFTED_M])] {
        // The first frame of the trial has the same base, about an object at the origin.
        let apart: Vec<f64> = a.iter().zip(lifted[0]).map(|(a, b)| f64::from(a - b)).collect();
        assert!(apart.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{apart:?}");
    }
    assert!(close(&seen.numbers("/predicted/finger_force_n/thumb"), &[2.5]));
    assert!(close(&seen.numbers("/predicted/squeeze_n"), &[5.0]));

    // The trial: the base of the hand and the object rise together.
    assert_eq!(seen.places("/world/trial/object").iter().map(|p| p[2]).collect::<Vec<_>>(), [0.0, 0.05, 0.1]);
    let links: Vec<_> = seen.0.keys().filter(|k| k.starts_with("/world/trial/hand/")).cloned().collect();
    assert_eq!(links.len(), palm.len());
    for link in links {
        let at = seen.places(&link);
        assert!((at[2][2] - at[0][2] - 0.1).abs() < 1e-6, "{link}: {at:?}");
    }
    assert!(close(&seen.numbers("/trial/joint_rad/th_ipl"), &[0.1; 3]));
    assert!(close(&seen.numbers("/trial/held"), &[1.0]));
    assert!(close(&seen.numbers("/rollouts/squeeze_held_n"), &[4.5, f64::NAN]));
    let by_finger: Vec<_> = seen.0.keys().filter(|k| k.starts_with("/trial/finger_force_n/")).cloned().collect();
    let last: f64 = by_finger.iter().map(|finger| seen.numbers(finger)[2]).sum();
    assert!(by_finger.len() == 4 && (last - (0.5 + 1.0 + 1.5 * 0.16)).abs() < 1e-9, "{by_finger:?}: {last}");

    // The joints, from the first row on.
    assert!(close(&seen.numbers("/hand/joints/if_mcp/position_rad"), &[0.1, 0.15, 0.16]));
    assert!(close(&seen.numbers("/hand/joints/if_mcp/current_ma"), &[10.0, 55.0, 95.0]));
    assert!(close(&seen.numbers("/hand/joints/if_mcp/limit_ma"), &[60.0, 60.0, 95.0]));
    let chunk = seen.of("/hand/joints/if_mcp/goal_rad", Scalars::descriptor_scalars().component)[0];
    let times: Vec<i64> = chunk.timelines()[&"execution".into()].times_raw().to_vec();
    assert_eq!(times, [0, 10_000_000, 20_000_000]);
}

#[test]
fn what_no_stage_has_made_is_remarked_and_the_rest_recorded() {
    let twin = tin();
    let (said, seen) = recorded(twin.path());
    for file in ["asset/object.xml", "mesh/visual.obj", "mass.json", "wrist_fits.json", "trial.json", "execution.json"]
    {
        assert!(said.lines().any(|l| l.starts_with("not recorded: ") && l.contains(file)), "{file}: {said}");
    }
    assert!(seen.timelines().is_empty());

    let twin = finished_tin();
    fs::remove_file(twin.path().join("mesh/visual.obj")).unwrap();
    fs::remove_file(twin.path().join("asset/object.xml")).unwrap();
    fs::remove_file(twin.path().join("policy/execution.csv")).unwrap();
    let (said, seen) = recorded(twin.path());
    assert!(said.contains("execution.csv is not there"), "{said}");
    assert!(seen.has("/world/trial/object") && !seen.has("/world/trial/object/mesh") && !seen.has("/world/object"));
    assert!(!seen.0.keys().any(|k| k.contains("contacts")));
}

#[test]
fn a_push_that_a_camera_of_unknown_place_tracked_is_not_put_into_the_world() {
    let twin = finished_tin();
    let hand = json!({"up_in_tracked": [0, 0, 1], "runner_up_odds": 0.1, "motion_start_s": [0.2, 0.1], "trusted_until_s": 1.0,
        "fingers": [], "budget": []});
    edit(&twin.path().join("mass.json"), "\"name\":\"tilt\"", &format!("\"hand\":{hand},\"name\":\"tilt\""));
    let (_, seen) = recorded(twin.path());
    assert_eq!(seen.places("/tracker/push/tilt/tracked").len(), 3);
    assert!(!seen.0.keys().any(|k| k.starts_with("/world/push")));
}

/// Cameras for the demo's 40 photos, whose own are found when it runs: all where the first one is, and a point.
fn write_cameras(scan: &Path) {
    let frame = |i: usize| {
        let matrix = [[0.0, -0.4, 0.9165, 0.8], [1.0, 0.0, 0.0, 0.0], [0.0, 0.9165, 0.4, 0.45], [0.0, 0.0, 0.0, 1.0]];
        json!({"file_path": format!("images/{i:02}.jpg"), "transform_matrix": matrix})
    };
    let frames: Vec<Value> = (0..40).map(frame).collect();
    let lens = json!({"camera_model": "OPENCV", "w": 640, "h": 480, "fl_x": 600.0, "fl_y": 600.0, "cx": 320.0, "cy": 240.0,
        "ply_file_path": "points.ply", "frames": frames});
    write_json(scan, "transforms.json", &lens);
    let properties = "property float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n";
    write(
        scan,
        "points.ply",
        format!("ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n0 0 0.1 90 90 90\n"),
    );
}

#[test]
fn a_scan_and_the_clips_of_a_person_have_their_place_in_the_world() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    copy(&data("demo"), root);
    write_cameras(&root.join("scan"));
    // The mesh's frame is half the scan's, moved by 0.1 m; it rests 0.25 m up.
    let mesh = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
    write(root, "mesh/visual.obj", mesh);
    let model = format!(
        "<mujoco><asset><mesh name=\"m\" file=\"../mesh/visual.obj\"/></asset><worldbody>\
         <body name=\"object\" pos=\"0 0 {LIFTED_M}\"><freejoint/><geom type=\"mesh\" mesh=\"m\"/></body></worldbody></mujoco>"
    );
    write(root, "asset/object.xml", model);
    let similarity = [[0.5, 0.0, 0.0, 0.1], [0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 0.5, 0.0], [0.0, 0.0, 0.0, 1.0]];
    let frame = json!({"scan": "scan", "metres_per_unit": 0.5, "scale_from": "marker", "up_from": "marker", "up_in_mesh": [0, 0, 1],
        "mesh_from_scan": similarity, "others_on_table": 0});
    let fusion = json!({"views": 40, "used_views": 40, "voxel_m": 0.001, "truncation_m": 0.004, "wall_below_resolution": false,
        "footprint_m": 0.001, "noise_m": 0.001, "spread_m": 0.001, "blocks": 1, "volume_bytes": 1, "volume_m3": 0.001,
        "seen_share": 1.0, "unseen_share": 0.0, "support_share": 0.0, "parts": 1, "dropped_parts": 0, "dropped": [],
        "filled_hollows": 0});
    write_json(root, "splat/scan.json", &json!({"scan": frame, "fusion": fusion}));
    let mut gaussians = Gaussians::new(Kind::Ellipsoid, 0);
    for opacity in [3.0, -6.0] {
        gaussians.means.push([0.2, 0.4, 0.0]);
        gaussians.rotations.push([1.0, 0.0, 0.0, 0.0]);
        gaussians.log_scales.push([0.02_f32.ln(); 3]);
        gaussians.logit_opacities.push(opacity);
        gaussians.sh.extend([0.0, 0.0, 0.0]);
        gaussians.labels.push(Label::default());
    }
    write_gaussians(&root.join("splat/appearance.ply"), &gaussians).unwrap();
    let (said, seen) = recorded(root);
    assert!(said.contains("mass.json is not there"), "{said}");

    // One Gaussian can be seen through; the other is in metres, in the world.
    let centres = seen.vectors("/world/splat", Points3D::descriptor_positions().component);
    assert_eq!(centres.len(), 1);
    assert_eq!(centres[0].len(), 1);
    let expected = [0.2, 0.2, LIFTED_M as f32];
    assert!(centres[0][0].iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{centres:?}");
    let radius = Points3D::descriptor_radii().component;
    let radii: Vec<f32> =
        seen.of("/world/splat", radius).iter().flat_map(|c| c.iter_slices::<f32>(radius)).flatten().copied().collect();
    assert!(radii.len() == 1 && (radii[0] - 0.01).abs() < 1e-6, "{radii:?}");

    // The first photo of transforms.json.
    let stands = seen.places("/world/scan/cameras/00")[0];
    let expected = [0.5 * 0.8 + 0.1, 0.0, 0.5 * 0.45 + LIFTED_M as f32];
    assert!(stands.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{stands:?}");
    let blob = EncodedImage::descriptor_blob().component;
    let photos = seen.0.keys().filter(|k| k.starts_with("/world/scan/cameras/") && k.ends_with("/photo"));
    assert_eq!(photos.filter(|k| seen.of(k, blob).len() == 1).count(), 40);
    assert!(seen.has("/world/scan/points"));

    // Clips: a point per key point and frame; the wrist comes first.
    let text = fs::read_to_string(root.join("demos/clip_0.json")).unwrap();
    let frames = serde_json::from_str::<Value>(&text).unwrap()["frames"].as_array().unwrap().len();
    let hand = seen.vectors("/world/demonstrations/clip_0/key_points", Points3D::descriptor_positions().component);
    assert_eq!(hand.len(), frames);
    assert!(hand.iter().all(|points| points.len() <= 21) && hand.iter().any(|points| points.len() == 21));
    assert!(seen.timelines().contains("demonstration_clip_3"));
}

#[test]
fn a_damaged_file_is_named_and_nothing_is_written() {
    for (file, from, to, says) in [
        ("mass.json", "\"mass_kg\":0.24", "\"mass_kg\":\"much\"", "delete it and run again"),
        ("mass.json", "\"times_s\":[0.0,0.5,1.0]", "\"times_s\":[0.0,0.5]", "3 rows for 2 times"),
        ("policy/trial.json", "\"th_ipl\"", "\"th_ipx\"", "th_ipx"),
        ("policy/trial.json", "\"quat_wxyz\":[1.0,", "\"quat_wxyz\":[2.0,", "norm 2"),
        ("policy/execution.csv", "0.15", "often", "line 3"),
    ] {
        let twin = finished_tin();
        edit(&twin.path().join(file), from, to);
        let output = record(twin.path(), &[]);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{file}: {said}");
        assert!(said.starts_with("error: ") && said.contains(file) && said.contains(says), "{file}: {said}");
        assert!(!twin.path().join("twin.rrd").exists(), "{file}");
    }
    let output = record(Path::new("there/is/no/twin"), &[]);
    assert!(!output.status.success() && String::from_utf8_lossy(&output.stderr).contains("there/is/no/twin"));
}

fn edit(file: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(file).unwrap();
    assert!(text.contains(from), "{from} is not in {text}");
    fs::write(file, text.replacen(from, to, 1)).unwrap();
}

#[test]
fn the_recording_goes_into_the_twin_folder() {
    let twin = finished_tin();
    let output = record(twin.path(), &[]);
    assert!(output.status.success());
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.contains("twin.rrd") && said.contains("MB"), "{said}");
    assert!(Recording::read(&twin.path().join("twin.rrd")).has("/world/object/mesh"));
}
