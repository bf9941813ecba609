//! Recordings that the simulator is held against. Everything that calls the simulator is in `engine`.
#![allow(dead_code)] // not every test uses every helper

pub mod cube;
pub mod engine;
pub mod fit;
pub mod shapes;

use std::path::{Path, PathBuf};

use drex_core::{MassProperties, Pose};
use drex_diffsim::Geom;
use drex_recording::convert::mujoco_push::{self, ForceQuality, Inputs, PoseQuality};
use drex_recording::{Drive, SupportBox};
use nalgebra::{Matrix3, Point3, Quaternion, UnitQuaternion, Vector3};
use serde_json::Value;

/// The folder of shared data, or `None` with a note that the test is skipped.
pub fn shared() -> Option<PathBuf> {
    let folder = std::env::var_os("DREX_SHARED").map(PathBuf::from);
    if folder.is_none() {
        eprintln!("skipped: DREX_SHARED is not set");
    }
    folder
}

/// A recorded push with the truth that only a test may know.
pub struct Push {
    pub object: String,
    pub scenario: String,
    /// The primitives that the reference moved.
    pub shapes: Vec<Geom>,
    /// The same object as the convex parts of its mesh.
    pub pieces: Vec<Geom>,
    pub properties: MassProperties,
    pub friction: f64,
    pub boxes: Vec<SupportBox>,
    pub start: Pose,
    /// Velocity of the centre of mass, world, m/s.
    pub velocity: Vector3<f64>,
    /// World, rad/s.
    pub spin: Vector3<f64>,
    pub drive: Drive,
    pub times_s: Vec<f64>,
    pub poses: Vec<Pose>,
}

impl Push {
    /// Reads `<root>/<object>/<scenario>` with exact poses and force and the true parameters, or `None` where the
    /// object has no such scenario.
    pub fn load(root: &Path, object: &str, scenario: &str) -> Option<Self> {
        let folder = root.join(object).join(scenario);
        if !folder.is_dir() {
            return None;
        }
        let exact = Inputs { poses: PoseQuality::Clean, force: ForceQuality::Exact };
        let recording = mujoco_push::load(&folder, exact).unwrap();
        let truth: Value = serde_json::from_str(&std::fs::read_to_string(folder.join("truth.json")).unwrap()).unwrap();
        let list = |key: &str| -> Option<Vec<f64>> {
            Some(truth[key].as_array()?.iter().map(|x| x.as_f64().unwrap()).collect())
        };
        let com = Point3::from_slice(&list("com_body").unwrap());
        let q = list("inertia_quat").unwrap();
        let axes = UnitQuaternion::new_normalize(Quaternion::new(q[0], q[1], q[2], q[3])).to_rotation_matrix();
        let principal = Matrix3::from_diagonal(&Vector3::from_vec(list("inertia_principal").unwrap()));
        let properties = MassProperties {
            mass_kg: truth["mass"].as_f64().unwrap(),
            center_of_mass: com,
            inertia: axes.matrix() * principal * axes.matrix().transpose(),
        };
        let start = recording.initial_pose.unwrap();
        // A free joint's velocity: that of the frame's origin in the world, then the spin in the body's axes.
        let v = list("initial_velocity").unwrap_or_else(|| vec![0.0; 6]);
        let spin = start.rotation * Vector3::new(v[3], v[4], v[5]);
        let velocity = Vector3::new(v[0], v[1], v[2]) + spin.cross(&(start.rotation * com.coords));
        Some(Self {
            object: object.into(),
            scenario: scenario.into(),
            shapes: shapes::primitives(&folder.join("scene.xml")),
            pieces: shapes::pieces(&recording.mesh),
            properties,
            friction: truth["mu"].as_f64().unwrap(),
            boxes: recording.support.boxes.clone(),
            start,
            velocity,
            spin,
            drive: recording.drive.clone(),
            times_s: recording.track.times_s().to_vec(),
            poses: recording.track.poses().to_vec(),
        })
    }

    /// Root mean square of the distance of the frame's origins (mm) and of the angle between the poses (degrees) over
    /// the first `frames`.
    pub fn rms(&self, simulated: &[Pose], frames: usize) -> (f64, f64) {
        let (mut mm2, mut deg2) = (0.0, 0.0);
        for (a, b) in simulated.iter().zip(&self.poses).take(frames) {
            mm2 += (a.translation.vector - b.translation.vector).norm_squared() * 1e6;
            deg2 += a.rotation.angle_to(&b.rotation).to_degrees().powi(2);
        }
        let n = frames.min(self.poses.len()) as f64;
        ((mm2 / n).sqrt(), (deg2 / n).sqrt())
    }

    /// Frames up to the last one in which the fingertip is within half a millimetre of the object.
    pub fn frames_touched(&self) -> usize {
        let Drive::Finger(finger) = &self.drive else { return self.times_s.len() };
        let Some(encoder) = &finger.encoder else { return self.times_s.len() };
        let touching = |k: &usize| {
            let i = encoder.times_s.partition_point(|t| *t < self.times_s[*k]).min(encoder.times_s.len() - 1);
            let before = i.saturating_sub(1);
            let step = encoder.times_s[i] - encoder.times_s[before];
            let s = if step > 0.0 { (self.times_s[*k] - encoder.times_s[before]) / step } else { 0.0 };
            let tip = encoder.positions[before] + (encoder.positions[i] - encoder.positions[before]) * s;
            let local = self.poses[*k].inverse() * tip;
            shapes::gap(&self.shapes, &local) < finger.impedance.radius_m + 5e-4
        };
        (0..self.times_s.len()).rev().find(touching).map_or(0, |k| k + 1)
    }
}

/// What the reference shows between its own step sizes and contact softnesses: the largest RMS in millimetres and in
/// degrees.
pub fn sensitivity(root: &Path, object: &str, scenario: &str) -> (f64, f64) {
    let text = std::fs::read_to_string(root.join("sensitivity.csv")).unwrap();
    let rows = text.lines().map(|l| l.split(',').collect::<Vec<_>>()).filter(|r| r[0] == object && r[1] == scenario);
    rows.fold((0.0, 0.0), |a: (f64, f64), r| (a.0.max(r[3].parse().unwrap()), a.1.max(r[5].parse().unwrap())))
}
