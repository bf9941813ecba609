//! `drex asset` from scans: a made RGB-D recording with known truth.

use std::f64::consts::TAU;
use std::path::Path;

use crate::common::drex;
use drex_core::{Pose, TriMesh};
use drex_mesh::{DepthCamera, cast_depth, read_mesh};
use image::{ImageBuffer, Luma, RgbImage};
use nalgebra::{Point3, Vector3};

/// A cup: the profile (radius, height) turned about z. 80 mm tall, wall and floor 5 mm.
const PROFILE: [[f64; 2]; 6] = [[0.0, 0.0], [0.03, 0.0], [0.04, 0.08], [0.035, 0.08], [0.0255, 0.005], [0.0, 0.005]];

fn turned(profile: &[[f64; 2]], steps: usize) -> TriMesh {
    let mut mesh = TriMesh::default();
    for [r, z] in profile {
        for k in 0..steps {
            let (sin, cos) = (TAU * k as f64 / steps as f64).sin_cos();
            mesh.vertices.push(Point3::new(r * cos, r * sin, *z));
        }
    }
    let at = |ring: usize, k: usize| (ring * steps + k % steps) as u32;
    for ring in 0..profile.len() - 1 {
        for k in 0..steps {
            let [a, b, c, d] = [at(ring, k), at(ring, k + 1), at(ring + 1, k + 1), at(ring + 1, k)];
            mesh.faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

/// The cup on a table with a box beside it.
fn scene() -> TriMesh {
    let mut scene = turned(&PROFILE, 64);
    let mut add = |corners: [[f64; 3]; 4]| {
        let n = scene.vertices.len() as u32;
        scene.vertices.extend(corners.map(Point3::from));
        scene.faces.extend([[n, n + 1, n + 2], [n, n + 2, n + 3]]);
    };
    add([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]]);
    add([[0.12, -0.03, 0.0], [0.12, 0.03, 0.0], [0.12, 0.03, 0.06], [0.12, -0.03, 0.06]]);
    add([[0.12, -0.03, 0.06], [0.12, 0.03, 0.06], [0.18, 0.03, 0.06], [0.18, -0.03, 0.06]]);
    scene
}

/// 40 views from 25 to 80 degrees above the table, depth in whole millimetres.
fn record(folder: &Path) {
    for dir in ["rgb", "depth", "ob_in_cam"] {
        std::fs::create_dir_all(folder.join(dir)).unwrap();
    }
    std::fs::write(folder.join("cam_K.txt"), "300 0 159.5\n0 300 119.5\n0 0 1\n").unwrap();
    let camera = DepthCamera { width_px: 320, height_px: 240, fx_px: 300.0, fy_px: 300.0, cx_px: 160.0, cy_px: 120.0 };
    let scene = scene();
    for i in 0..40 {
        let azimuth = 2.4 * f64::from(i);
        let elevation = (25.0 + 55.0 * f64::from(i) / 39.0).to_radians();
        let eye = Point3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()) * 0.3;
        let down = -Vector3::z();
        let world_from_camera = Pose::face_towards(&eye, &Point3::new(0.0, 0.0, 0.035), &down);
        let map = cast_depth(&scene, &camera, &world_from_camera);
        let at = |dir: &str, ending: &str| folder.join(format!("{dir}/{i:06}.{ending}"));
        let millimetres = map.depth_m.iter().map(|z| (z * 1000.0).round() as u16).collect();
        ImageBuffer::<Luma<u16>, Vec<u16>>::from_raw(320, 240, millimetres).unwrap().save(at("depth", "png")).unwrap();
        RgbImage::from_pixel(320, 240, image::Rgb([128; 3])).save(at("rgb", "png")).unwrap();
        let m = world_from_camera.inverse().to_homogeneous();
        let rows: Vec<String> =
            (0..4).map(|r| (0..4).map(|c| m[(r, c)].to_string()).collect::<Vec<_>>().join(" ")).collect();
        std::fs::write(at("ob_in_cam", "txt"), rows.join("\n")).unwrap();
    }
}

#[test]
fn a_recording_becomes_a_hollow_cup_that_stands() {
    let guard = tempfile::tempdir().unwrap();
    let (recording, out) = (guard.path().join("cup"), guard.path().join("out"));
    record(&recording);
    let run = drex([
        "asset",
        recording.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
        "--voxel",
        "0.002",
        "--mass",
        "0.2",
        "--json",
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let answer = run.json();
    let truth = turned(&PROFILE, 64).mass_properties(1.0).unwrap().mass_kg;
    let volume = answer["asset"]["volume_m3"].as_f64().unwrap();
    eprintln!("volume {:+.2} %", 100.0 * (volume / truth - 1.0));
    assert!((volume / truth - 1.0).abs() < 0.08, "{volume} is not {truth}");
    assert_eq!(answer["asset"]["open_edges"], 0);
    assert_eq!(answer["scan"]["scale_from"], "depth camera");
    assert_eq!(answer["scan"]["others_on_table"], 1);
    // Up is found, the cup stands on z = 0 and is not filled: its hulls are not much larger than it.
    let size: Vec<f64> = answer["asset"]["size_m"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    assert!((size[2] - 0.08).abs() < 2e-3 && (size[0] - 0.08).abs() < 2e-3, "{size:?}");
    let hull = std::f64::consts::PI * 0.08 * (0.03f64.powi(2) + 0.03 * 0.04 + 0.04f64.powi(2)) / 3.0;
    let pieces = answer["asset"]["pieces_to_solid_volume"].as_f64().unwrap();
    assert!(pieces * volume < 0.6 * hull, "the cup was filled: {pieces}");
    assert!(out.join("asset/object.xml").is_file() && out.join("mesh/scan.json").is_file());
}

#[test]
fn a_region_that_cuts_the_object_is_doubted_and_clicks_are_checked() {
    let guard = tempfile::tempdir().unwrap();
    let (recording, out) = (guard.path().join("cup"), guard.path().join("out"));
    record(&recording);
    let asset = |more: &[&str]| {
        let fixed =
            ["asset", recording.to_str().unwrap(), "--out", out.to_str().unwrap(), "--voxel", "0.003", "--json"];
        drex(fixed.iter().chain(more))
    };
    let run = asset(&["--region", "-0.06,-0.06,-0.01,0.06,0.06,0.06"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let warnings = run.json()["asset"]["warnings"].to_string();
    assert!(warnings.contains("rule 20 (inside its region)") && warnings.contains("--region"), "{warnings}");
    let report = std::fs::read_to_string(out.join("mesh/report.json")).unwrap();
    assert!(report.contains("rule 20") && run.stderr.contains("doubt"), "{}", run.stderr);
    // `drex mesh check` reads the same from the files.
    let check = drex(["mesh", "check", out.to_str().unwrap()]);
    assert!(check.stdout.contains("DOUBT") && check.stdout.contains("border of the region"), "{}", check.stdout);
    asset(&["--object", "5,5@nowhere.png"]).fails_with(&["nowhere.png", "no camera"]);
    let wrong = asset(&["--object", "5;5@a.png"]);
    assert!(wrong.code == 2 && wrong.stderr.contains("512,300@"), "{}", wrong.stderr);
}

#[test]
fn a_recording_is_the_scan_of_a_twin() {
    let guard = tempfile::tempdir().unwrap();
    let twin = guard.path().join("cup");
    record(&twin.join("recording"));
    let manifest = |up: &str| {
        let text = format!(
            "schema = 1\nname = \"cup\"\n[scan]\nphotos = \"recording\"\n[object]\nmesh = \"splat/cup.obj\"\n\
             up_in_mesh = {up}\n[mass]\nweighed_kg = 0.2\n"
        );
        std::fs::write(twin.join("twin.toml"), text).unwrap();
    };
    let folder = twin.to_str().unwrap();
    manifest("[0, 0, 1]");
    drex(["asset", &format!("{folder}/twin.toml"), "--out", folder]).fails_with(&["cup.obj", "[scan]", "drex run"]);
    let run = drex(["run", folder, "--json"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    // No Gaussians were made, and the report does not need them.
    assert!(twin.join("report.html").is_file() && !twin.join("splat/report.json").exists());
    let mesh = read_mesh(&twin.join("splat/cup.obj")).unwrap();
    let truth = turned(&PROFILE, 64).mass_properties(1.0).unwrap().mass_kg;
    let volume = mesh.mass_properties(1.0).unwrap().mass_kg;
    assert!((volume / truth - 1.0).abs() < 0.1, "{volume} is not {truth}");
    manifest("[1, 0, 0]");
    drex(["run", folder]).fails_with(&["up is [", "90 degrees", "up_in_mesh under [object]"]);
}

#[test]
fn a_recording_without_poses_is_refused() {
    let guard = tempfile::tempdir().unwrap();
    record(guard.path());
    std::fs::rename(guard.path().join("ob_in_cam"), guard.path().join("elsewhere")).unwrap();
    let out = guard.path().join("out");
    let arguments = ["asset", guard.path().to_str().unwrap(), "--out", out.to_str().unwrap()];
    drex(arguments).fails_with(&["no poses of the object", "ob_in_cam"]);
    assert!(!out.exists());
}

#[test]
fn photos_without_a_scale_are_refused_before_anything_is_trained() {
    let guard = tempfile::tempdir().unwrap();
    record(guard.path());
    let frame = |i: usize| {
        let file = format!("rgb/{i:06}.png");
        let pose = [[1.0, 0.0, 0.0, i as f64], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
        serde_json::json!({ "file_path": file, "transform_matrix": pose, "fl_x": 300.0 })
    };
    let text = serde_json::json!({ "frames": (0..4).map(frame).collect::<Vec<_>>() }).to_string();
    std::fs::write(guard.path().join("transforms.json"), text).unwrap();
    let out = guard.path().join("out");
    let (scan, written) = (guard.path().to_str().unwrap(), out.to_str().unwrap());
    drex(["asset", scan, "--out", written]).fails_with(&["has no scale", "--distance", "--scale"]);
    drex(["asset", scan, "--out", written, "--distance", "A-C=0.12"]).fails_with(&["marks.json"]);
    assert!(!out.exists());
}
