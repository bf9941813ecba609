//! `drex reconstruct`: a scan of a coloured ball, drawn by this test, from photos to Gaussians.

use crate::common;

use std::fs;
use std::path::Path;

use drex_core::capture::{Capture, CaptureOptions};
use drex_core::npy::write_npy;
use drex_splat::io::{picture, read_gaussians};
use drex_splat::train::from_points;
use drex_splat::{Cpu, Kind, Label, Orbit, Rasterizer, RenderOptions};
use nalgebra::Vector3;

use crate::common::drex;

const RADIUS: f64 = 0.5;
/// Of what the photos show: the Gaussians on it reach beyond it.
const SHOWN_RADIUS: f64 = 0.57;

/// Writes 16 photos of a ball round the origin with their opacity, cameras and sparse points.
fn write_scan(folder: &Path) {
    let points: Vec<[f64; 3]> = (0..3000)
        .map(|i| {
            let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / 3000.0;
            let (sin, cos) = (2.4 * f64::from(i)).sin_cos();
            let r = (1.0 - z * z).sqrt();
            [r * cos, r * sin, z].map(|v| RADIUS * v)
        })
        .collect();
    let colours: Vec<[u8; 3]> = points.iter().map(|p| p.map(|v| (128.0 + 240.0 * v) as u8)).collect();
    let ball = from_points(&points, &colours, Kind::Ellipsoid, 0, 0.95);
    let mut orbit = Orbit::round(&ball, Vector3::z(), 0.3, 0.7, 80, 60).unwrap();
    let mut frames = Vec::new();
    for (ring, elevation) in [-0.5, 0.5].into_iter().enumerate() {
        orbit.elevation = elevation;
        for (i, camera) in orbit.cameras(8).unwrap().iter().enumerate() {
            let (render, _) = Cpu.forward(&ball, camera, &RenderOptions::default()).unwrap();
            let name = format!("images/{ring}{i}.png");
            picture::write_rgba(&folder.join(&name), 80, 60, &render.rgb, &render.alpha).unwrap();
            let m = camera.camera_from_world.inverse().to_homogeneous();
            let row = |r: usize| [m[(r, 0)], -m[(r, 1)], -m[(r, 2)], m[(r, 3)]];
            frames.push(serde_json::json!({
                "file_path": name, "transform_matrix": [row(0), row(1), row(2), row(3)],
                "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy, "w": 80, "h": 60,
            }));
        }
    }
    let transforms = serde_json::json!({ "ply_file_path": "points.ply", "frames": frames });
    fs::write(folder.join("transforms.json"), transforms.to_string()).unwrap();
    let mut ply = "ply\nformat ascii 1.0\nelement vertex 300\nproperty float x\nproperty float y\nproperty float z\n\
                   property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
        .to_owned();
    for p in points.iter().step_by(10) {
        ply += &format!("{} {} {} 128 128 128\n", p[0], p[1], p[2]);
    }
    fs::write(folder.join("points.ply"), ply).unwrap();
}

/// Writes the ball's depth and masks beside the photos of [`write_scan`].
fn write_depth(folder: &Path) {
    let capture = Capture::load(folder, &CaptureOptions::default()).unwrap();
    for (i, view) in capture.views.iter().enumerate() {
        let camera = capture.pinhole(i, None).unwrap();
        let eye = camera.centre().coords;
        let depth = |at: usize| {
            let ray = camera.camera_from_world.inverse().rotation
                * camera.ray([(at % 80) as f64 + 0.5, (at / 80) as f64 + 0.5]);
            let (a, b) = (ray.norm_squared(), ray.dot(&eye));
            let root = b * b - a * (eye.norm_squared() - SHOWN_RADIUS * SHOWN_RADIUS);
            if root > 0.0 { ((-b - root.sqrt()) / a) as f32 } else { 0.0 }
        };
        let depth: Vec<f32> = (0..60 * 80).map(depth).collect();
        let file = folder.join("depths").join(&view.name).with_extension("npy");
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        write_npy(&file, &[60, 80], &depth).unwrap();
        let mask: Vec<f32> = depth.iter().map(|z| f32::from(u8::from(*z > 0.0))).collect();
        picture::write_alpha(&folder.join("masks").join(Path::new(&view.name).file_name().unwrap()), 80, 60, &mask)
            .unwrap();
    }
}

fn reconstruct(scan: &Path, out: &Path, options: &[&str]) -> common::Run {
    let mut arguments =
        vec!["reconstruct".to_owned(), scan.display().to_string(), "--out".into(), out.display().to_string()];
    arguments.extend(["--json", "--preset", "fast", "--hold-out", "4"].map(str::to_owned));
    arguments.extend(options.iter().map(|&o| o.to_owned()));
    drex(arguments)
}

#[test]
fn photos_become_gaussians() {
    let dir = tempfile::tempdir().unwrap();
    let (scan, out) = (dir.path().join("scan"), dir.path().join("twin"));
    write_scan(&scan);
    let run = reconstruct(&scan, &out, &["--iterations", "1000", "--checkpoint-every", "300", "--also", "spz"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let json = run.json();
    assert_eq!((json["photos_trained"].as_u64(), json["photos_held_out"].as_u64()), (Some(12), Some(4)));
    assert_eq!(json["object_only"].as_bool(), Some(true));
    let set = &json["appearance"];
    let rows = set["held_out"]["rows"].as_array().unwrap();
    let psnr = rows.iter().map(|r| r["psnr"].as_f64().unwrap()).sum::<f64>() / 4.0;
    assert!(psnr > 23.0, "{psnr:.1} dB");
    let gaussians = read_gaussians(&out.join("splat/appearance.ply"), Kind::Ellipsoid).unwrap();
    assert_eq!(set["gaussians"].as_u64(), Some(gaussians.len() as u64));
    assert!(gaussians.labels.iter().all(|l| *l == Label::OBJECT));
    let small = read_gaussians(&out.join("splat/appearance.spz"), Kind::Ellipsoid).unwrap();
    assert_eq!(small.len(), gaussians.len());
    assert!(!out.join("splat/appearance.checkpoint").exists());
    assert!(out.join("splat/report.json").exists());
}

#[test]
fn after_an_asset_gaussians_are_born_on_its_mesh() {
    let dir = tempfile::tempdir().unwrap();
    let (scan, out, alone) = (dir.path().join("scan"), dir.path().join("twin"), dir.path().join("alone"));
    write_scan(&scan);
    // The ball is too smooth for stereo: its mesh is made of its depth.
    let measured = dir.path().join("measured");
    write_scan(&measured);
    write_depth(&measured);
    let [input, folder] = [&measured, &out].map(|p| p.display().to_string());
    let asset = drex(["asset", &input, "--out", &folder, "--scale", "0.1", "--up", "0,0,1"]);
    assert_eq!(asset.code, 0, "{}", asset.stderr);
    let trained = |out: &Path| {
        let run = reconstruct(&scan, out, &["--iterations", "60"]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        let json = run.json();
        let rows = json["appearance"]["held_out"]["rows"].as_array().unwrap().clone();
        let psnr = rows.iter().map(|r| r["psnr"].as_f64().unwrap()).sum::<f64>() / rows.len() as f64;
        (json["appearance"]["gaussians"].as_u64().unwrap(), psnr)
    };
    let (gaussians, born) = trained(&out);
    assert!(gaussians.abs_diff(30_000) < 10, "{gaussians}");
    let (others, sought) = trained(&alone);
    assert!(others < 10_000 && born > sought + 3.0, "{born:.1} dB on the mesh, {sought:.1} dB of {others} without");
    // With other cameras it is the mesh of something else.
    let transforms = fs::read_to_string(scan.join("transforms.json")).unwrap();
    let mut moved: serde_json::Value = serde_json::from_str(&transforms).unwrap();
    for frame in moved["frames"].as_array_mut().unwrap() {
        let x = &mut frame["transform_matrix"][0][3];
        *x = (x.as_f64().unwrap() + 0.05).into();
    }
    fs::write(scan.join("transforms.json"), moved.to_string()).unwrap();
    let other = reconstruct(&scan, &out, &["--iterations", "10"]);
    let gaussians = other.json()["appearance"]["gaussians"].as_u64().unwrap();
    assert!(other.stderr.contains("other cameras") && gaussians < 10_000, "{gaussians}: {}", other.stderr);
}

#[test]
fn a_stopped_run_goes_on_to_the_same_files() {
    let dir = tempfile::tempdir().unwrap();
    let scan = dir.path().join("scan");
    write_scan(&scan);
    let (whole, stopped) = (dir.path().join("whole"), dir.path().join("stopped"));
    let options = ["--iterations", "60", "--checkpoint-every", "25"];
    assert_eq!(reconstruct(&scan, &whole, &options).code, 0);
    // Stopped by the system: what is left is a checkpoint (or, on a fast machine, nothing or all of it).
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_drex"))
        .args([
            "reconstruct",
            scan.to_str().unwrap(),
            "--out",
            stopped.to_str().unwrap(),
            "--preset",
            "fast",
            "--hold-out",
            "4",
        ])
        .args(options)
        .stderr(std::process::Stdio::null())
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    for _ in 0..2000 {
        if stopped.join("splat/appearance.checkpoint").exists() || stopped.join("splat/appearance.ply").exists() {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    if stopped.join("splat/appearance.checkpoint").exists() {
        let other = reconstruct(&scan, &stopped, &["--iterations", "61", "--resume"]);
        other.fails_with(&["appearance.checkpoint", "other settings"]);
    }
    assert_eq!(reconstruct(&scan, &stopped, &[&options[..], &["--resume", "--threads", "1"]].concat()).code, 0);
    let file = "splat/appearance.ply";
    assert_eq!(fs::read(whole.join(file)).unwrap(), fs::read(stopped.join(file)).unwrap());
}

#[test]
fn a_whole_scene_is_labelled_by_its_masks() {
    let dir = tempfile::tempdir().unwrap();
    let (scan, out) = (dir.path().join("scan"), dir.path().join("twin"));
    write_scan(&scan);
    let run = reconstruct(&scan, &out, &["--iterations", "30", "--whole-scene"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert_eq!(run.json()["object_only"].as_bool(), Some(false));
    let set = read_gaussians(&out.join("splat/appearance.ply"), Kind::Ellipsoid).unwrap();
    // Everything there is lies on the ball, in sight of all cameras.
    let object = set.labels.iter().filter(|l| **l == Label::OBJECT).count();
    assert!(object * 10 > set.len() * 9, "{object} of {}", set.len());
}

#[test]
fn what_is_missing_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("twin");
    let run = reconstruct(&dir.path().join("nowhere"), &out, &[]);
    assert_eq!(run.code, 1);
    assert!(run.stderr.contains("nowhere"), "{}", run.stderr);

    let scan = dir.path().join("scan");
    write_scan(&scan);
    let run = reconstruct(&scan, &out, &["--hold-out", "1"]);
    assert!(run.stderr.contains("held out") || run.stderr.contains("hold-out"), "{}", run.stderr);
    reconstruct(&scan, &out, &["--max-gaussians", "0"]).fails_with(&["max_gaussians is 0"]);
    reconstruct(&scan, &out, &["--max-side", "0"]).fails_with(&["0 pixels"]);
    let file = fs::read_to_string(scan.join("transforms.json")).unwrap();
    let mut one: serde_json::Value = serde_json::from_str(&file).unwrap();
    one["frames"].as_array_mut().unwrap().truncate(1);
    fs::write(scan.join("transforms.json"), one.to_string()).unwrap();
    drex(["reconstruct", scan.to_str().unwrap(), "--out", out.to_str().unwrap()])
        .fails_with(&["photos to train on: 1"]);
    fs::write(scan.join("transforms.json"), file).unwrap();
    fs::create_dir(scan.join("masks")).unwrap();
    for i in 0..16 {
        let mask = scan.join(format!("masks/{}{}.png", i / 8, i % 8));
        picture::write_alpha(&mask, 80, 60, &[0.0; 80 * 60]).unwrap();
    }
    reconstruct(&scan, &out, &[]).fails_with(&["photos left to train on: 0", "00.png: its mask is empty"]);
    fs::remove_file(scan.join("transforms.json")).unwrap();
    let run = reconstruct(&scan, &out, &["--colmap=no-such-colmap"]);
    assert_eq!(run.code, 1);
    assert!(run.stderr.contains("no-such-colmap") && run.stderr.contains("install"), "{}", run.stderr);
    assert!(!out.exists(), "nothing half-written");
}
