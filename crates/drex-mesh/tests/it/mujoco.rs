//! What MuJoCo makes of the assets. Runs where a Python with `mujoco` is found: the one named by DREX_PYTHON, else python3.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{PNG, cuboid, joined, shared, stapler};
use drex_core::mesh::convex_hull;
use drex_core::{ConvexPart, Pose, TriMesh};
use drex_mesh::{
    Asset, AssetOptions, Background, SceneOptions, Texture, TextureMap, articulated_asset, asset_from_mesh, build_asset,
};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

/// A Python that can import mujoco.
fn python() -> Option<String> {
    let python = std::env::var("DREX_PYTHON").unwrap_or_else(|_| "python3".into());
    match Command::new(&python).args(["-c", "import mujoco, numpy"]).output() {
        Ok(output) if output.status.success() => Some(python),
        Ok(_) => {
            eprintln!("skipped: {python} cannot import mujoco; `pip install mujoco`, or name a Python in DREX_PYTHON");
            None
        }
        Err(e) => {
            eprintln!("skipped: {python} does not run ({e}); name a Python with mujoco in DREX_PYTHON");
            None
        }
    }
}

fn run(python: &str, script: &str, arguments: &[String]) -> String {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/peers").join(script);
    let output = Command::new(python).arg(script).args(arguments).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    eprint!("{text}");
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    text
}

fn model(out: &Path, file: &str) -> String {
    out.join("asset").join(file).display().to_string()
}

fn with_mass(mass_kg: f64) -> AssetOptions {
    let mut options = AssetOptions::default();
    options.mass_kg = Some(mass_kg);
    options
}

fn prism(sides: usize, radius: f64, height: f64) -> TriMesh {
    let points: Vec<_> = (0..2 * sides)
        .map(|i| {
            let a = std::f64::consts::TAU * (i / 2) as f64 / sides as f64;
            Point3::new(radius * a.cos(), radius * a.sin(), if i % 2 == 0 { 0.0 } else { height })
        })
        .collect();
    convex_hull(&points).unwrap()
}

#[test]
fn every_stable_pose_rests_from_ten_grams_to_five_kilograms() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let letter =
        joined(&[cuboid([-0.05, 0.0, 0.0], [0.05, 0.02, 0.03]), cuboid([-0.01, -0.06, 0.0], [0.01, 0.0, 0.03])]);
    let table = joined(&[
        cuboid([-0.05, -0.05, 0.06], [0.05, 0.05, 0.07]),
        cuboid([-0.05, -0.05, 0.0], [-0.04, -0.04, 0.06]),
        cuboid([0.04, -0.05, 0.0], [0.05, -0.04, 0.06]),
        cuboid([-0.05, 0.04, 0.0], [-0.04, 0.05, 0.06]),
        cuboid([0.04, 0.04, 0.0], [0.05, 0.05, 0.06]),
    ]);
    let shapes = [
        ("brick", cuboid([0.0; 3], [0.063, 0.042, 0.021])),
        ("nut", prism(6, 0.02, 0.012)),
        ("letter", letter),
        ("table", table),
    ];
    let mut models = Vec::new();
    let mut poses = 0;
    for (name, mesh) in &shapes {
        for mass_kg in [0.01, 0.3, 5.0] {
            let out = folder.path().join(format!("{name}_{mass_kg}"));
            let mut asset = asset_from_mesh(mesh, &with_mass(mass_kg)).unwrap();
            if *name == "brick" {
                let uv = vec![[[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]]; asset.visual.faces.len()];
                asset.texture = Some(TextureMap { uv, picture: Texture::new(PNG) });
            }
            asset.write(&out).unwrap();
            poses += asset.stable_poses.iter().take(16).filter(|p| p.probability >= 0.005).count();
            models.push(model(&out, "object.xml"));
        }
    }
    models.insert(0, "--strict".into());
    let text = run(&python, "mujoco_rest.py", &models);
    assert_eq!(text.lines().filter(|l| l.contains(" rest_")).count(), poses);
}

#[test]
fn golden_shapes_and_scans_rest() {
    let (Some(python), Some(data)) = (python(), shared()) else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut arguments = vec!["--strict".to_string()];
    for file in [
        "golden/mesh/box.obj",
        "golden/mesh/bracket.obj",
        "drex_real/objects/bluelego_convex.stl",
        "objects/061_foam_brick.obj",
    ] {
        let mesh = data.join(file);
        let out = folder.path().join(mesh.file_stem().unwrap());
        build_asset(&mesh, &with_mass(0.2)).unwrap().write(&out).unwrap();
        arguments.push(model(&out, "object.xml"));
    }
    run(&python, "mujoco_rest.py", &arguments);
}

#[test]
fn an_articulated_object_moves_about_its_axes() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (parts, joints) = stapler();
    let asset = articulated_asset(&parts, &joints, &with_mass(0.3)).unwrap();
    asset.write(folder.path()).unwrap();
    let file = model(folder.path(), "object.xml");
    run(&python, "mujoco_rest.py", &["--strict".into(), file.clone()]);

    // The URDF says the same; MuJoCo wants the folder of its meshes apart.
    let urdf = std::fs::read_to_string(folder.path().join("asset/object.urdf")).unwrap();
    let compiler = "<mujoco><compiler meshdir=\"../mesh\" fusestatic=\"false\"/></mujoco>\n</robot>";
    let with_folder = folder.path().join("asset/with_folder.urdf");
    std::fs::write(&with_folder, urdf.replace("</robot>", compiler)).unwrap();

    let (angle, shift) = (0.7, 0.02);
    let setting = [format!("hinge={angle}"), format!("rail={shift}")];
    let of_urdf = run(&python, "mujoco_kinematics.py", &[&[with_folder.display().to_string()], &setting[..]].concat());
    let text = run(&python, "mujoco_kinematics.py", &[&[file], &setting[..]].concat());
    let about_hinge = {
        let origin = Translation3::new(-0.05, 0.0, 0.022);
        let turn = UnitQuaternion::from_axis_angle(&-Vector3::y_axis(), angle);
        origin * turn * origin.inverse()
    };
    let world = asset.world_from_mesh_at_rest;
    let expected = [
        ("base", world),
        ("arm", world * about_hinge),
        ("tray", world * about_hinge * Translation3::new(shift, 0.0, 0.0)),
        ("foot", world),
    ];
    let place = |text: &str, name: &str| {
        let line = text.lines().find(|l| l.split(' ').next() == Some(name)).unwrap();
        let n: Vec<f64> = line.split(' ').skip(1).map(|n| n.parse().unwrap()).collect();
        drex_core::pose::pose_from_wxyz([n[0], n[1], n[2]], [n[3], n[4], n[5], n[6]]).unwrap()
    };
    for (name, pose) in expected {
        let found = place(&text, name);
        assert!(drex_core::pose::pose_difference(&pose, &found).norm() < 1e-9, "{name}: {found} is not {pose}");
        // Links of the URDF have their frames at their joints; its root is the world (MuJoCo has no name for it).
        if name != "base" {
            let joint = joints.iter().find(|j| j.child == name).unwrap();
            let expected = world.inverse() * pose * Translation3::from(joint.origin);
            let found = place(&of_urdf, name);
            assert!(drex_core::pose::pose_difference(&expected, &found).norm() < 1e-9, "{name}: {found}, {expected}");
        }
    }
}

fn brick() -> Asset {
    asset_from_mesh(&cuboid([-0.03, -0.02, -0.01], [0.03, 0.02, 0.01]), &with_mass(0.1)).unwrap()
}

#[test]
fn a_scene_has_background_robot_and_object() {
    let (Some(python), Some(data)) = (python(), shared()) else { return };
    for robot in ["leap_hand/mjcf/right_hand.xml", "allegro_hand/mjcf/right_hand.xml", "panda/mjcf/panda_collision.xml"]
    {
        let folder = tempfile::tempdir().unwrap();
        let mut scene = SceneOptions::default();
        let step = cuboid([0.2, -0.1, 0.0], [0.4, 0.1, 0.05]);
        scene.background = Some(Background { visual: step.clone(), convex_parts: vec![ConvexPart::of_hull(step)] });
        // On the step.
        scene.world_from_object = Some(Pose::translation(0.3, 0.0, 0.06));
        scene.robot = Some(data.join("robots").join(robot));
        scene.world_from_robot = Pose::translation(-0.8, 0.0, 0.3);
        brick().write_with_scene(&scene, folder.path()).unwrap();
        let file = model(folder.path(), "scene.xml");
        let text = run(&python, "mujoco_rest.py", std::slice::from_ref(&file));
        let drift: f64 = text.split("drifts ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!(drift < 0.1, "{text}");
        let bodies = run(&python, "mujoco_kinematics.py", &[file]);
        let at = |name: &str| -> Vec<f64> {
            let line = bodies.lines().find(|l| l.starts_with(name)).unwrap();
            line.split(' ').skip(1).take(3).map(|n| n.parse().unwrap()).collect()
        };
        assert_eq!(at("object "), [0.3, 0.0, 0.06]);
        assert!(at("robot_")[0] < -0.3, "{bodies}");
    }
}

#[test]
fn a_robot_that_is_not_there_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut scene = SceneOptions::default();
    scene.robot = Some(PathBuf::from("no/such/hand.xml"));
    let message = brick().write_with_scene(&scene, folder.path()).unwrap_err().to_string();
    assert!(message.contains("no/such/hand.xml"), "{message}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}
