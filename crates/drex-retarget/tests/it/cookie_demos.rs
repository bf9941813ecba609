//! Recorded grasps of a real object; needs DREX_SHARED.

use drex_core::TablePlane;
use std::path::PathBuf;

use drex_mesh::{GridOptions, RepairOptions, read_mesh, repair, solid_object};
use drex_recording::readers::read_grasps;
use drex_retarget::{WristFitOptions, fit_wrists};
use drex_robot::{Robot, joint_order};
use nalgebra::Vector3;

#[test]
fn most_recorded_grasps_of_the_tin_have_a_wrist_pose() {
    let Some(shared) = std::env::var_os("DREX_SHARED").map(PathBuf::from) else {
        eprintln!("skipped: DREX_SHARED is not set");
        return;
    };
    let folder = shared.join("data/drex_real");
    let (mesh, _) = repair(&read_mesh(&folder.join("objects/cookie.stl")).unwrap(), &RepairOptions::default()).unwrap();
    let mut grid = GridOptions::default();
    grid.nodes = 48 * 48 * 48;
    grid.margin_m = Some(0.06);
    let table = TablePlane::under(&mesh.vertices, Vector3::z()).unwrap();
    let object = solid_object("tin", &mesh, &grid).unwrap().with_table(&table);
    let order: Vec<String> = joint_order::require("leap_sdk").unwrap().iter().map(|s| s.to_string()).collect();
    let poses = read_grasps(&folder.join("demos/cookie_leap_grasps.npy"), Some(&order)).unwrap();
    assert_eq!(poses.rows.len(), 132);
    let robot = Robot::bundled("leap_right").unwrap();
    // Every 22nd: six grasps spread over the recordings.
    let rows: Vec<Vec<f64>> =
        poses.rows.iter().step_by(22).map(|r| robot.joint_vector_full(&poses.names, r).unwrap()).collect();
    let mut options = WristFitOptions::default();
    options.initial_guesses = 256;
    options.kept = (32, 8);
    let fits = fit_wrists(&robot, &rows, &object, &options).unwrap();
    let accepted = fits.iter().filter(|f| f.evaluation.passed).count();
    let held = fits.iter().filter(|f| f.grasp.grip_force_n.is_some_and(|n| n < 10.0 * object.weight_n())).count();
    eprintln!("{accepted} of {} accepted, {held} carry the tin with less than ten times its weight", fits.len());
    assert!(accepted >= 5 && held >= 4, "{accepted} {held}");
}
