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

use std::path::{Path, PathBuf};

use anyhow::Result;
use drex_bench::tin::{PULSES, PUSH_HEIGHT_M, SIDES, TiltPush, WIDTH_M, merged, normal3, obj_text, plain_tin};
use drex_core::{Pose, PoseRecord, TriMesh, fsutil};
use drex_mesh::{Asset, AssetOptions, asset_from_mesh};
use drex_recording::JointPoses;
use drex_recording::readers::{GraspFile, write_grasps_json};
use drex_retarget::{WristFitOptions, fit_wrists};
use drex_robot::Robot;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SEED: u64 = 2026;
/// What the estimator has to find: of the twin with photos, and of the other.
const TRUE_MASSES_KG: [f64; 2] = [0.168, 0.236];
const TRUE_FRICTION: f64 = 0.6;
/// Natural frequency of the contact of tin and table, rad/s: much softer than the estimator assumes.
const CONTACT_RAD_S: f64 = 1400.0;
/// The printed tag beside the tin of the demo.
const TAG: &str = "tag36h11:7:0.04";
/// First guess of the mass, kg.
const PRIOR_KG: f64 = 0.5;
/// Demonstrations, and the noise of their joint angles.
const GRASPS: usize = 40;
const JOINT_SD_RAD: f64 = 0.03;
const MAKER: &str = "make_demo_data";

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
    fsutil::write_atomic(&demo.join("truth/tin.obj"), obj_text(&shells, &["tin", "collar", "lid"], MAKER).as_bytes())?;
    let cameras = photos::world_from_camera(SEED + 2).into_iter().map(|pose| PoseRecord::from(&(mesh_from_tin * pose)));
    let cameras = serde_json::to_string_pretty(&cameras.collect::<Vec<_>>())? + "\n";
    fsutil::write_atomic(&demo.join("truth/world_from_camera.json"), cameras.as_bytes())?;
    people::make(&asset_from_mesh(&merged(&shells)?, &AssetOptions::default())?, &demo.join("demos"), SEED + 3)?;

    let shells = plain_tin(SIDES)?;
    let tin = asset_from_mesh(&merged(&shells)?, &AssetOptions::default())?;
    let small = out.join("tin");
    fsutil::write_atomic(&small.join("scan/tin.obj"), obj_text(&shells, &["tin", "lid"], MAKER).as_bytes())?;
    make_push(&shells, &Pose::identity(), TRUE_MASSES_KG[1], "../../scan/tin.obj", &small.join("push/tilt"))?;
    make_grasps(&tin, &small.join("demos/grasps.json"))?;
    write_truth(TRUE_MASSES_KG[1], &tin, &small)
}

fn write_truth(mass_kg: f64, tin: &Asset, folder: &Path) -> Result<()> {
    let volume_cm3 = (1e8 * tin.report.volume_m3).round() / 100.0;
    let text = format!("{{\"mass_kg\": {mass_kg}, \"friction\": {TRUE_FRICTION}, \"volume_cm3\": {volume_cm3}}}\n");
    Ok(fsutil::write_atomic(&folder.join("truth.json"), text.as_bytes())?)
}

/// Rocks a tin about its far edge with two pulses and writes what a tracker and a force gauge would have recorded, in the frame of a mesh.
fn make_push(shells: &[TriMesh], mesh_from_tin: &Pose, mass_kg: f64, mesh: &str, folder: &Path) -> Result<()> {
    let push = TiltPush {
        shells,
        mesh_from_tin: *mesh_from_tin,
        mass_kg,
        friction: TRUE_FRICTION,
        contact_rad_s: CONTACT_RAD_S,
        half_width_m: WIDTH_M / 2.0,
        height_m: PUSH_HEIGHT_M,
        pulses: PULSES,
        prior_kg: PRIOR_KG,
        mesh,
        seed: SEED,
    };
    let recorded = push.simulate()?;
    eprintln!(
        "the tin leans by up to {:.1} degrees; it tips above {:.3} N",
        recorded.largest_lean_rad.to_degrees(),
        recorded.tipping_n
    );
    recorded.write(folder)
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
