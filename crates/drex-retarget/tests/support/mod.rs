//! Recorded hands and what the reference made of them, from the shared folder.
#![allow(clippy::unwrap_used, clippy::print_stdout, dead_code)]

use std::path::{Path, PathBuf};

use drex_demo::{Demonstration, HandFrame, KEYPOINTS, Side};
use drex_retarget::Objective;
use drex_robot::joint_order;
use nalgebra::Point3;
use serde_json::Value;

pub const SEQUENCES: [&str; 4] =
    ["dexmv_relocate_mustard", "dexret_human_video", "manus_subject000", "mimic_index_mcp_video"];
pub const HANDS: [&str; 2] = ["leap_right", "allegro_right"];

/// The shared folder, or a line that says why nothing was tested.
pub fn shared() -> Option<PathBuf> {
    let found = std::env::var_os("DREX_SHARED").map(PathBuf::from);
    if found.is_none() {
        println!("skipped: DREX_SHARED is not set");
    }
    found
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

/// A sequence in the frame of the camera.
pub fn demonstration(shared: &Path, sequence: &str) -> Demonstration {
    read(shared, sequence, "keypoints")
}

/// The same in the operator frames of its hands, with the digits that the reference saw.
pub fn canonical(shared: &Path, sequence: &str) -> Demonstration {
    read(shared, sequence, "canonical")
}

fn read(shared: &Path, sequence: &str, points_key: &str) -> Demonstration {
    let file = json(&shared.join("data/demos").join(sequence).join("hand.json"));
    let frames = file["frames"].as_array().unwrap().iter().map(|f| {
        let mut points = [None; KEYPOINTS];
        for (point, p) in points.iter_mut().zip(f[points_key].as_array().unwrap()) {
            *point = Some(Point3::from_slice(&numbers(p)));
        }
        HandFrame::new(f["t"].as_f64().unwrap(), points)
    });
    Demonstration::new(sequence, Side::Right, frames.collect())
}

/// What the reference found.
pub struct Golden {
    /// Objective per frame.
    pub objectives: Vec<f64>,
    /// Base (x, y, z, roll, pitch, yaw) where it floats, and joints in the order of the bundled model.
    pub frames: Vec<(Vec<f64>, Vec<f64>)>,
    /// Mean length of the differences, where the file has it.
    pub error_mm: Option<f64>,
}

pub fn golden(shared: &Path, sequence: &str, hand: &str, objective: Objective) -> Option<Golden> {
    let method = match objective {
        Objective::Vector => "vector",
        Objective::DexPilot => "dexpilot",
        _ => "position",
    };
    let other = if hand == "leap_right" { "leap_hand" } else { "allegro_hand" };
    let path = shared.join("data/demos").join(sequence).join(format!("golden_{other}_{method}.json"));
    if !path.exists() {
        return None;
    }
    let file = json(&path);
    let names: Vec<&str> = file["joint_names"].as_array().unwrap().iter().map(|n| n.as_str().unwrap()).collect();
    let robot = drex_robot::Robot::bundled(hand).unwrap();
    let frames = file["frames"].as_array().unwrap();
    let placed = frames.iter().map(|f| {
        let values = numbers(&f["q"]);
        let (mut base, mut q) = (Vec::new(), vec![0.0; robot.dof()]);
        for (name, value) in names.iter().zip(values) {
            match joint_order::alias(hand, name) {
                Some(name) => q[robot.joint_index(name).unwrap()] = value,
                None => base.push(value),
            }
        }
        (base, q)
    });
    Some(Golden {
        objectives: frames.iter().map(|f| f["obj"].as_f64().unwrap()).collect(),
        frames: placed.collect(),
        error_mm: file["err_mm_mean"].as_f64(),
    })
}

pub fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, n) = values.into_iter().fold((0.0, 0), |(s, n), v| (s + v, n + 1));
    sum / f64::from(n.max(1))
}
