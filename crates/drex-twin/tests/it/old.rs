//! A twin folder as a former version wrote it, with the keys and the layout of 23 November 2026: it opens, and says the same.

use std::fs;
use std::path::Path;

use drex_core::PoseRecord;
use drex_twin::Twin;
use drex_twin::records::{
    EVALUATION, EXECUTION, Evaluation, ExecutionFile, FITS, FitFile, MASS, MassFile, SCAN, ScanFile, TRIAL, TrialFile,
    read_json,
};

use crate::support::tin_copy;

/// With an error budget that later versions divide otherwise, and a closed form that they do not have.
const MASS_JSON: &str = r#"{
  "mass_kg": 0.236, "source": "identified", "ci95_kg": [0.22, 0.25], "sd_kg": 0.008, "grip_kg": 0.26, "prior": null,
  "push_ci95_kg": [0.22, null], "contradiction_sd": null,
  "posterior": {"mass_kg": [0.2, 0.236, 0.3], "cost": [9.0, 0.0, 9.0]},
  "identification": {
    "mass_kg": 0.236, "ci95_kg": [0.22, 0.25], "verdict": "identified", "mu_m_kg": null, "reason": "", "simulations": 40,
    "prior_kg": 0.5, "friction": 0.5, "sd_log_mass": 0.03,
    "error_budget": {"poses": 0.01, "sandwich": 1.0, "profile": 1.0, "force": 0.01, "force_factor": 0.0, "contact": 0.02},
    "estimates": [], "sensitivities": [], "assumptions": ["a rigid object"], "profile": [[0.2, 9.0], [0.236, 0.0], [0.3, null]],
    "pushes": [{"name": "tilt", "position_sd_m": 0.001, "rotation_sd_rad": 0.01, "rms_position_m": 0.001,
      "rms_rotation_rad": null, "outliers": 2, "clock_offset_s": null, "rms_encoder_m": null, "position_bias_m": null,
      "information": [], "closed_form": null, "times_s": [0.0], "observed": [[0, 0, 0.1, 1, 0, 0, 0]],
      "simulated": [[0, 0, 0.1, 1, 0, 0, 0]], "notes": []}]
  }
}"#;

const FITS_JSON: &str = r#"{
  "schema": 1, "hand": "leap_right", "joint_names": ["if_mcp", "if_rot"], "demonstrations": 1, "accepted": 1,
  "grasps": [{"demonstration": 0, "accepted": true, "reasons": [], "joints_rad": [0.5, 0.25], "largest_clipping_rad": 0.0,
    "correction_rad": [0.01, 0.0], "largest_correction_rad": 0.01,
    "object_from_base": {"translation_m": [0.0, 0.0, 0.1], "quat_wxyz": [1.0, 0.0, 0.0, 0.0]}, "penetration_mm": 0.5,
    "table_clearance_mm": 12.0, "touching": ["thumb", "index"], "squeeze_per_weight": 2.25}]
}"#;

const EVALUATION_JSON: &str = r#"{
  "mass_kg": 0.26, "friction": 0.5, "refined": [], "demonstrations": [],
  "predicted": [{"joints_rad": [0.5, 0.25], "object_from_base": {"translation_m": [0.0, 0.0, 0.1], "quat_wxyz": [1.0, 0.0, 0.0, 0.0]},
    "predicted_squeeze_n": 6.5, "weight": 0.75,
    "check": {"passed": true, "failures": [], "contacts": [{"finger": "thumb", "contacts": 2, "normal_n": 3.25}],
      "penetration_mm": 0.5, "table_penetration_mm": 0.0, "force_closure": true, "epsilon": 0.1, "min_weight": 0.05,
      "squeeze_n": 6.0, "friction_margin": 0.2, "torque_margin": 0.3, "mass_kg": 0.26, "friction": 0.5, "gamma": 1.25}}]
}"#;

const TRIAL_JSON: &str = r#"{
  "schema": 1, "hand": "leap_right", "joint_names": ["if_mcp"], "mass_kg": 0.26, "mass_median_kg": 0.236,
  "mass_ci95_kg": [0.22, 0.25], "mass_sd_kg": 0.008, "friction": [0.4, 0.6], "held": 1, "n": 1, "interval": [0.2, 1.0],
  "rollouts": [{"verdict": "success", "mass_kg": 0.24, "friction": 0.5, "proposal": 1, "squeeze_n": 6.5, "held_n": 6.4,
    "friction_used": 0.7}],
  "film": [{"time_s": 0.0, "world_from_base": {"translation_m": [0.0, 0.0, 0.1], "quat_wxyz": [1.0, 0.0, 0.0, 0.0]},
    "joints_rad": [0.5], "world_from_object": {"translation_m": [0.0, 0.0, 0.0], "quat_wxyz": [1.0, 0.0, 0.0, 0.0]},
    "finger_n": [3.25]}],
  "filmed": 0
}"#;

const EXECUTION_JSON: &str = r#"{
  "schema": 1, "hand": "leap_right", "emulated": true, "unit": "mA", "joint_names": ["if_mcp"], "open_rad": [0.1],
  "closed_rad": [0.6], "closing_limits": [60.0], "force_limits": [95.0], "held": true,
  "contacts": [{"joint": "if_mcp", "time_s": 1.5, "position_rad": 0.5, "effort_limit": 95.0, "held_effort": 94.0}]
}"#;

const SCAN_JSON: &str = r#"{
  "scan": {"scan": "scan", "metres_per_unit": 0.5, "scale_from": "marker", "up_from": "marker", "table_points": null,
    "table_rms_m": null, "up_in_mesh": [0, 0, 1], "others_on_table": 0,
    "mesh_from_scan": [[0.5, 0, 0, 0.1], [0, 0.5, 0, 0], [0, 0, 0.5, 0], [0, 0, 0, 1]]},
  "fusion": {"views": 40, "used_views": 39, "voxel_m": 0.001, "truncation_m": 0.004, "wall_m": null, "wall_below_resolution": false,
    "footprint_m": 0.001, "noise_m": 0.001, "spread_m": 0.001, "blocks": 1, "volume_bytes": 1, "volume_m3": 0.001,
    "seen_share": 0.9, "unseen_share": 0.1, "support_share": 0.1, "parts": 1, "dropped_parts": 0, "dropped": [], "filled_hollows": 0}
}"#;

fn write(twin: &Path, name: &str, text: &str) {
    let file = twin.join(name);
    fs::create_dir_all(file.parent().unwrap()).unwrap();
    fs::write(file, text).unwrap();
}

#[test]
fn what_a_former_version_wrote_is_read() {
    let (_dir, folder) = tin_copy();
    let all = [
        (MASS, MASS_JSON),
        (FITS, FITS_JSON),
        (EVALUATION, EVALUATION_JSON),
        (TRIAL, TRIAL_JSON),
        (EXECUTION, EXECUTION_JSON),
        (SCAN, SCAN_JSON),
    ];
    all.iter().for_each(|(name, text)| write(&folder, name, text));
    let record = "inputs_sha256 = \"1\"\nmade_by = \"drex 0.0.9\"\nseed = 1\noutputs_sha256 = {}\n";
    write(&folder, "twin.lock", &format!("[stage.identify]\n{record}\n[stage.asset]\n{record}"));
    let twin = Twin::open(&folder).unwrap();
    assert!(twin.lock.damage().is_empty(), "{:?}", twin.lock.damage());
    assert_eq!(twin.lock.stages()["asset"].made_by, "drex 0.0.9");
    let at = |name: &str| twin.path(name);
    let standing = PoseRecord { translation_m: [0.0, 0.0, 0.1], quat_wxyz: [1.0, 0.0, 0.0, 0.0] };

    let mass: MassFile = read_json(&at(MASS)).unwrap();
    let pushes = mass.identification.unwrap();
    assert_eq!((mass.mass_kg, mass.push_ci95_kg), (0.236, Some([Some(0.22), None])));
    assert_eq!((pushes.profile[2], pushes.pushes[0].outliers), ((0.3, f64::INFINITY), 2));
    assert!(pushes.error_budget.is_none(), "its parts have other meanings now");

    let fits: FitFile = read_json(&at(FITS)).unwrap();
    assert_eq!(fits.grasps[0].grip_force_per_weight, Some(2.25));
    assert_eq!((fits.grasps[0].object_from_base, fits.grasps[0].is_augmented()), (standing, false));

    let evaluation: Evaluation = read_json(&at(EVALUATION)).unwrap();
    let grasp = &evaluation.predicted[0];
    assert_eq!((grasp.predicted_grip_force_n, grasp.check.grip_force_n), (Some(6.5), Some(6.0)));
    assert_eq!((grasp.check.fingers[0].normal_n, grasp.check.epsilon), (3.25, Some(0.1)));

    let trial: TrialFile = read_json(&at(TRIAL)).unwrap();
    assert_eq!((trial.rollouts[0].grip_force_n, trial.recording[0].world_from_base), (6.5, standing));

    let execution: ExecutionFile = read_json(&at(EXECUTION)).unwrap();
    assert_eq!((execution.not_driven, execution.contacts[0].held_effort), (None, Some(94.0)));

    let scan: ScanFile = read_json(&at(SCAN)).unwrap();
    let mesh_from_scan = scan.mesh_from_scan().unwrap();
    assert!((mesh_from_scan.scale - 0.5).abs() < 1e-12 && !scan.made_masks && scan.scan.marker.is_none());
}
