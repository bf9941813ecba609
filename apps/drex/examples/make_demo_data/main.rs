//! Makes the bundled data: twins of two tea tins.
//!
//! ```sh
//! cargo run --release -p drex --example make_demo_data -- data
//! ```
//!
//! `demo`: photos of a printed one, a push that is simulated, clips of a person's hand; `drex demo` runs on it. `tin`: the mesh of a plain
//! one, a push, joint angles of the LEAP hand around it; small, for tests. A push is simulated with a softer contact and a shorter step than the
//! estimator uses, and what it "records" is noisy. The true masses go to `truth.json`, which no stage reads; `drex demo`
//! prints it beside the estimate at the end.

mod caddy;
mod people;
mod photos;
mod print;

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use drex_core::{MassProperties, Pose, PoseRecord, TriMesh, fsutil, pose};
use drex_diffsim::{
    AppliedForce, Body, Collider, ConvexPolyhedron, ForcePoint, Model, Part, Scene, State, StaticBody, rollout,
};
use drex_mesh::{Asset, AssetOptions, asset_from_mesh};
use drex_recording::JointPoses;
use drex_recording::readers::{GraspFile, write_grasps_json};
use drex_recording::{
    ClockConfig, ForceConfig, FrameKind, PoseConfig, PushConfig, StartConfig, Support, TrackConfig, TrackFormat,
};
use drex_retarget::{WristFitOptions, fit_wrists};
use drex_robot::Robot;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SEED: u64 = 2026;
/// What the estimator has to find: of the twin with photos, and of the other.
const TRUE_MASSES_KG: [f64; 2] = [0.168, 0.236];
const TRUE_FRICTION: f64 = 0.6;
/// The printed tag beside the tin of the demo.
const TAG: &str = "tag36h11:7:0.04";
/// The plain tin and its lid: octagonal prisms, distance between opposite sides (the demo's tin has the same) and height in metres.
const TIN: (f64, f64) = (0.062, 0.070);
const LID: (f64, f64) = (0.046, 0.012);
/// Height at which the push acts, metres.
const PUSH_HEIGHT_M: f64 = 0.066;
/// Noise of the simulated tracker and of the force record.
const POSITION_SD_M: f64 = 0.002;
const ROTATION_SD_RAD: f64 = PI / 180.0;
const FORCE_SD_N: f64 = 0.02;
/// Demonstrations, and the noise of their joint angles.
const GRASPS: usize = 40;
const JOINT_SD_RAD: f64 = 0.03;

fn main() -> Result<()> {
    let out = std::env::args().nth(1).map_or_else(|| PathBuf::from("data"), PathBuf::from);

    let shells = caddy::shells()?;
    let tin = asset_from_mesh(&merged(&shells)?, &AssetOptions::default())?;
    let demo = out.join("demo");
    photos::make(&tin.visual, &TAG.parse()?, &demo.join("scan"), SEED + 2)?;
    write_truth(TRUE_MASSES_KG[0], &tin, &demo)?;
    // Push and people are tracked with the mesh that is made of the photos, in its frame.
    let mesh_from_tin = photos::mesh_from_world(SEED + 2)?;
    let shells = shells.map(|shell| shell.transformed(&mesh_from_tin));
    make_push(&shells, &mesh_from_tin, TRUE_MASSES_KG[0], "../../splat/object.obj", &demo.join("push/tilt"))?;
    fsutil::write_atomic(&demo.join("truth/tin.obj"), obj(&shells, &["tin", "collar", "lid"]).as_bytes())?;
    let cameras = photos::world_from_camera(SEED + 2).into_iter().map(|pose| PoseRecord::from(&(mesh_from_tin * pose)));
    let cameras = serde_json::to_string_pretty(&cameras.collect::<Vec<_>>())? + "\n";
    fsutil::write_atomic(&demo.join("truth/world_from_camera.json"), cameras.as_bytes())?;
    people::make(&asset_from_mesh(&merged(&shells)?, &AssetOptions::default())?, &demo.join("demos"), SEED + 3)?;

    let shells = [prism(TIN, 0.0)?, prism(LID, TIN.1)?];
    let tin = asset_from_mesh(&merged(&shells)?, &AssetOptions::default())?;
    let small = out.join("tin");
    fsutil::write_atomic(&small.join("scan/tin.obj"), obj(&shells, &["tin", "lid"]).as_bytes())?;
    make_push(&shells, &Pose::identity(), TRUE_MASSES_KG[1], "../../scan/tin.obj", &small.join("push/tilt"))?;
    make_grasps(&tin, &small.join("demos/grasps.json"))?;
    write_truth(TRUE_MASSES_KG[1], &tin, &small)
}

fn write_truth(mass_kg: f64, tin: &Asset, folder: &Path) -> Result<()> {
    let volume_cm3 = (1e8 * tin.report.volume_m3).round() / 100.0;
    let text = format!("{{\"mass_kg\": {mass_kg}, \"friction\": {TRUE_FRICTION}, \"volume_cm3\": {volume_cm3}}}\n");
    Ok(fsutil::write_atomic(&folder.join("truth.json"), text.as_bytes())?)
}

/// A closed octagonal prism standing on z = `bottom_m`.
fn prism((across_m, height_m): (f64, f64), bottom_m: f64) -> Result<TriMesh> {
    const N: u32 = 8;
    let radius = across_m / 2.0 / (PI / f64::from(N)).cos();
    let ring = |z: f64| {
        (0..N).map(move |i| {
            let angle = 2.0 * PI * (f64::from(i) + 0.5) / f64::from(N);
            Point3::new(radius * angle.cos(), radius * angle.sin(), z)
        })
    };
    let vertices = ring(bottom_m).chain(ring(bottom_m + height_m)).collect();
    let mut faces = Vec::new();
    for i in 0..N {
        let j = (i + 1) % N;
        faces.push([i, j, N + j]);
        faces.push([i, N + j, N + i]);
    }
    for i in 1..N - 1 {
        faces.push([0, i + 1, i]);
        faces.push([N, N + i, N + i + 1]);
    }
    Ok(TriMesh::new(vertices, faces)?)
}

/// The shells one after the other as OBJ text.
fn obj(shells: &[TriMesh], names: &[&str]) -> String {
    let mut text = String::from("# A tea tin, metres, z up, standing on z = 0. Made by make_demo_data.\n");
    let mut first = 1;
    for (shell, name) in shells.iter().zip(names) {
        let _ = writeln!(text, "o {name}");
        for v in &shell.vertices {
            let _ = writeln!(text, "v {:.6} {:.6} {:.6}", v.x, v.y, v.z);
        }
        for f in &shell.faces {
            let _ = writeln!(text, "f {} {} {}", f[0] + first, f[1] + first, f[2] + first);
        }
        first += shell.vertices.len() as u32;
    }
    text
}

/// Rocks a tin about its far edge with two pulses and writes what a tracker and a force gauge would have recorded, in the frame of a mesh.
fn make_push(shells: &[TriMesh], mesh_from_tin: &Pose, mass_kg: f64, mesh: &str, folder: &Path) -> Result<()> {
    let parts = shells.iter().map(|s| s.mass_properties(1.0)).collect::<Result<Vec<_>, _>>()?;
    let body = MassProperties::combined(&parts).context("the tin has no volume")?.with_mass(mass_kg);
    let pieces = shells.iter().map(|s| ConvexPolyhedron::from_points(&s.vertices)).collect::<Result<Vec<_>, _>>()?;

    let mut model = Model::new(vec![Body::new(&body, mass_kg, Arc::new(Collider::convex(pieces)))]);
    model.dt_s = 1e-4;
    model.contact.frequency_rad_s = 1400.0;
    let mut scene: Scene<f64> = Scene::empty();
    scene.static_bodies.push(StaticBody::table(0.0, TRUE_FRICTION));
    let tipping_n = mass_kg * 9.81 * (TIN.0 / 2.0) / PUSH_HEIGHT_M;
    let point = mesh_from_tin * Point3::new(-TIN.0 / 2.0, 0.0, PUSH_HEIGHT_M);
    let forward = mesh_from_tin * Vector3::x();
    let times: Vec<f64> = (0..=160).map(|i| f64::from(i) / 100.0).collect();
    let forces: Vec<Vector3<f64>> = times
        .iter()
        .map(|&t| forward * tipping_n * (1.25 * pulse(t, 0.30, 0.20) + 1.22 * pulse(t, 0.95, 0.22)))
        .collect();
    scene.forces.push(AppliedForce::new(Part::Body(0), &times, &forces, ForcePoint::Body(point))?);

    let frames: Vec<f64> = (0..48).map(|i| f64::from(i) / 30.0).collect();
    let start = Pose::translation(0.0, 0.0, 0.0);
    let record = rollout(&model, &scene, &State::at_rest(start), &frames)?;

    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut poses_csv = String::from("t,x,y,z,qw,qx,qy,qz\n");
    let mut highest_tilt: f64 = 0.0;
    for (t, p) in frames.iter().zip(&record.bodies[0].poses) {
        highest_tilt = highest_tilt.max(p.rotation.angle());
        let shake = UnitQuaternion::from_scaled_axis(normal3(&mut rng) * ROTATION_SD_RAD);
        let noisy =
            Pose::from_parts((p.translation.vector + normal3(&mut rng) * POSITION_SD_M).into(), shake * p.rotation);
        let (x, q) = pose::to_wxyz(&noisy);
        let _ = writeln!(
            poses_csv,
            "{t:.4},{:.5},{:.5},{:.5},{:.6},{:.6},{:.6},{:.6}",
            x[0], x[1], x[2], q[0], q[1], q[2], q[3]
        );
    }
    let mut force_csv = String::from("t,fx,fy,fz\n");
    for (t, f) in times.iter().zip(&forces) {
        let f = f + normal3(&mut rng) * FORCE_SD_N;
        let _ = writeln!(force_csv, "{t:.2},{:.4},{:.4},{:.4}", f.x, f.y, f.z);
    }
    let config = PushConfig {
        schema: 1,
        name: Some("tilt".into()),
        mesh: mesh.into(),
        gravity_m_s2: [0.0, 0.0, -9.81],
        mass_prior_kg: Some(0.5),
        mesh_sd_m: None,
        track: TrackConfig {
            file: "poses.csv".into(),
            format: TrackFormat::PoseCsv,
            fps: None,
            scene_id: None,
            obj_id: None,
            clock: ClockConfig::default(),
            frame: FrameKind::World,
            world_from_camera: None,
            up_in_mesh: None,
            push_in_mesh: None,
            tracked_from_mesh: None,
            noise: None,
        },
        support: Support { table_height_m: 0.0, friction: None, boxes: Vec::new() },
        start: StartConfig {
            pose: Some(PoseConfig { position_m: [0.0; 3], quat_wxyz: [1.0, 0.0, 0.0, 0.0] }),
            at_rest: true,
            time_s: Some(0.0),
            nominal_position_m: None,
        },
        force: Some(ForceConfig {
            file: "force.csv".into(),
            point_in_object_m: point.into(),
            clock: ClockConfig::default(),
        }),
        finger: None,
        hand: None,
        parameters: BTreeMap::new(),
    };
    fsutil::write_atomic(&folder.join("poses.csv"), poses_csv.as_bytes())?;
    fsutil::write_atomic(&folder.join("force.csv"), force_csv.as_bytes())?;
    fsutil::write_atomic(&folder.join("push.toml"), config.to_toml_string()?.as_bytes())?;
    eprintln!("the tin leans by up to {:.1} degrees; it tips above {tipping_n:.3} N", highest_tilt.to_degrees());
    Ok(())
}

/// Grasps of the tin: hands closed by random amounts, put onto the surface with large corrections allowed, then
/// recorded as joint angles with noise and without the wrist, as a retargeted human demonstration would be.
fn make_grasps(tin: &Asset, file: &Path) -> Result<()> {
    let robot = Robot::bundled("leap_right")?;
    let object = tin.to_object("tin")?;
    let mut fit = WristFitOptions::default().with_seed(SEED);
    fit.max_finger_correction_rad = 0.5;
    let mut rng = ChaCha8Rng::seed_from_u64(SEED + 1);
    let closed: Vec<Vec<f64>> = (0..2 * GRASPS).map(|_| closed_hand(&robot, &mut rng)).collect();
    let fits = fit_wrists(&robot, &closed, &object, &fit)?;
    let rows: Vec<Vec<f64>> = fits
        .iter()
        .filter(|f| f.evaluation.passed && f.grasp.grip_force_n.is_some())
        .take(GRASPS)
        .map(|f| {
            f.grasp.joints_rad.iter().map(|q| ((q + JOINT_SD_RAD * normal3(&mut rng).x) * 1e4).round() / 1e4).collect()
        })
        .collect();
    eprintln!("{} grasps of {} tries", rows.len(), closed.len());
    let names = robot.joint_names().into_iter().map(str::to_owned).collect();
    Ok(write_grasps_json(file, &GraspFile::new(&JointPoses { names, rows }))?)
}

/// A hand that closes: each finger curls by its own amount, side joints stay near the middle, the thumb opposes.
fn closed_hand(robot: &Robot, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let mut q = robot.mid_range();
    for finger in robot.fingers() {
        let curl: f64 = 0.25 + 0.35 * rng.random::<f64>();
        for &j in &finger.joints {
            if let Some((lo, hi)) = robot.joints[j].limits {
                let sideways = lo < -0.8 && hi > 0.8 && !finger.is_thumb;
                let at = if sideways { 0.5 + 0.1 * normal3(rng).x } else { curl + 0.08 * normal3(rng).x };
                q[j] = lo + at.clamp(0.0, 1.0) * (hi - lo);
            }
        }
    }
    q
}

/// All shells as one mesh.
fn merged(shells: &[TriMesh]) -> Result<TriMesh> {
    let mut all = TriMesh::default();
    for shell in shells {
        all.append(shell);
    }
    Ok(TriMesh::new(all.vertices, all.faces)?)
}

/// A half sine of height one.
fn pulse(t: f64, start_s: f64, length_s: f64) -> f64 {
    let s = (t - start_s) / length_s;
    if (0.0..=1.0).contains(&s) { (PI * s).sin() } else { 0.0 }
}

/// Three independent standard normal numbers.
fn normal3(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| drex_core::stats::normal_pair(rng.random(), 2.0 * PI * rng.random::<f64>())[0])
}
