//! A recorded push: what the files say, checked and brought to one clock and one frame.
//!
//! [`PushConfig`] is `push.toml` as it stands on disk; [`PushRecording`] is the push itself, whatever layout it came
//! from. [`PushRecording::load`] reads all layouts.

mod assemble;
mod toml;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

pub use self::assemble::mesh_sd_m;
pub use self::toml::{
    ClockConfig, ClockKind, FingerConfig, ForceConfig, FrameKind, Free, HandConfig, PoseConfig, PushConfig,
    StartConfig, StatedParameter, TrackConfig, TrackFormat,
};
use crate::clock::{Span, overlap};
use crate::series::{EncoderTrack, ForceProfile, JointLog};
use drex_core::pose::MAX_POSITION_M;
use drex_core::trajectory::PoseNoise;
use drex_core::{Error, Pose, Result, Trajectory};

/// A push, ready for identification. Times are seconds of one clock whose zero is the start: the moment at which
/// `initial_pose` and `starts_at_rest` hold (the first pose, where nothing else is known).
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct PushRecording {
    /// A name for reports.
    pub name: String,
    /// The object's mesh file. Poses are poses of this mesh's frame.
    pub mesh: PathBuf,
    /// How well the mesh is known where it is not exact: standard deviation of its surface, metres. A mesh with a `scan.json` beside it,
    /// as `drex asset` and a twin make of photos, is known to a voxel. Zero states that it is exact.
    pub mesh_sd_m: Option<f64>,
    /// Pose of the object's mesh frame over time, in `track_frame` (which says when it is another frame of the object).
    pub track: Trajectory,
    /// The frame that the track is given in.
    pub track_frame: TrackFrame,
    /// What is known of the noise of the track; `None` where it is to be estimated from the track.
    pub noise: Option<PoseNoise>,
    /// What the object stands on.
    pub support: Support,
    /// Gravity in the world frame, m/s².
    pub gravity: Vector3<f64>,
    /// First guess of the mass, kg, if somebody made one. It is a prior, never an answer.
    pub mass_prior_kg: Option<f64>,
    /// Initial pose in the world, if it is known from elsewhere than the track.
    pub initial_pose: Option<Pose>,
    /// Whether the object is known to start at rest.
    pub starts_at_rest: bool,
    /// Roughly where the tracked object stood in the world, if somebody wrote it down; good to centimetres.
    pub nominal_start: Option<Point3<f64>>,
    /// What acts on the object.
    pub drive: Drive,
    /// What is stated of single parameters, by name.
    pub parameters: BTreeMap<String, StatedParameter>,
    /// The files and folders it was read from, the mesh not among them.
    pub sources: Vec<PathBuf>,
    /// Readings that were asked for or came along, for the report ("104 poses over 6.9 s, largest gap 0.11 s").
    pub notes: Vec<String>,
}

impl PushRecording {
    /// A recording of `drive` acting on the object of `mesh`, tracked in the world, on a table at height zero with
    /// unknown friction, nothing else known.
    pub fn new(name: impl Into<String>, mesh: impl Into<PathBuf>, track: Trajectory, drive: Drive) -> Self {
        Self {
            name: name.into(),
            mesh: mesh.into(),
            mesh_sd_m: None,
            track,
            track_frame: TrackFrame::World,
            noise: None,
            support: Support::default(),
            gravity: Vector3::new(0.0, 0.0, -9.81),
            mass_prior_kg: None,
            initial_pose: None,
            starts_at_rest: false,
            nominal_start: None,
            drive,
            parameters: BTreeMap::new(),
            sources: Vec::new(),
            notes: Vec::new(),
        }
    }

    /// Reads a push from a `push.toml` or a folder that holds one.
    ///
    /// # Errors
    /// If there is no such file, one of the files it leads to cannot be read or is malformed, or the recordings do not
    /// overlap in time. Messages name file, place and remedy.
    pub fn load(path: &Path) -> Result<Self> {
        const REMEDY: &str = "describe the push in a push.toml; `drex import` makes one from other layouts";
        let file = if path.is_dir() { path.join("push.toml") } else { path.to_path_buf() };
        if path.is_dir() && !file.is_file() {
            return Err(Error::content(path, None, "the folder holds no push.toml", REMEDY));
        }
        if file.is_file() && file.extension().is_none_or(|e| e != "toml") {
            return Err(Error::content(&file, None, "the file is no push.toml", REMEDY));
        }
        let config = PushConfig::read(&file)?;
        let mut recording = config.load(folder_of(&file)).map_err(|e| Error::at(&file, None, e))?;
        recording.sources.insert(0, file);
        Ok(recording)
    }

    /// The same push as if the encoder of the fingertip had not been recorded.
    pub fn without_encoder(mut self) -> Self {
        if let Drive::Finger(finger) = &mut self.drive
            && finger.encoder.take().is_some()
        {
            self.notes.push("the encoder is left out".into());
        }
        self
    }

    /// Checks that the stated constants can be true of a tabletop.
    fn check(&self) -> Result<()> {
        let mut facts = vec![("the size of gravity (m/s²)", self.gravity.norm(), 1e-3, 100.0)];
        facts.extend(self.support.friction.map(|f| ("the friction of object and support", f, 0.0, 10.0)));
        facts.extend(self.mesh_sd_m.map(|sd| ("mesh_sd_m, the standard deviation of the mesh (m)", sd, 0.0, 1.0)));
        facts.extend(self.mass_prior_kg.map(|m| ("the first guess of the mass (kg)", m, 1e-6, 1e3)));
        for b in &self.support.boxes {
            facts.extend(b.half_m.map(|h| ("half an edge of a support box (m)", h, 1e-6, MAX_POSITION_M)));
        }
        if let Some(noise) = self.noise {
            facts.push(("the noise of positions (m)", noise.position_m, 1e-9, 1.0));
            facts.push(("the noise of rotations (rad)", noise.rotation_rad, 1e-9, 1.0));
        }
        if let Drive::Finger(push) = &self.drive {
            let i = &push.impedance;
            facts.extend([
                ("the radius of the fingertip (m)", i.radius_m, 1e-6, 1.0),
                ("the mass of the fingertip (kg)", i.mass_kg, 0.0, 100.0),
                ("the armature of the finger (kg)", i.armature_kg, 0.0, 1e9),
                ("the damping of the finger (N s/m)", i.damping_ns_m, 0.0, 1e9),
                ("the stiffness of the finger (N/m)", i.kp_n_m, 1e-6, 1e12),
                ("the velocity gain of the finger (N s/m)", i.kv_ns_m, 0.0, 1e9),
                ("the friction of the fingertip", i.friction, 0.0, 10.0),
            ]);
        }
        match facts.into_iter().find(|(_, value, least, most)| !(least..=most).contains(&value)) {
            None => Ok(()),
            Some((what, value, least, most)) => Err(Error::value(
                format!("{what} is given as {value}, outside {least} to {most}"),
                "check the number and its unit",
            )),
        }
    }
}

/// The folder that relative paths of `file` start from.
fn folder_of(file: &Path) -> &Path {
    match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Checks that the samples at `times_s` meet the track; `what` names them. Returns a note for the report.
fn check_overlap(file: &Path, track: &Trajectory, what: &str, times_s: &[f64]) -> Result<String> {
    let (Some((first_s, last_s)), Some(first), Some(last)) = (track.span_s(), times_s.first(), times_s.last()) else {
        return Err(Error::content(file, None, format!("the pose track or the {what} is empty"), "record again"));
    };
    let shared = overlap(Span { what: "pose track", first_s, last_s }, Span { what, first_s: *first, last_s: *last })
        .map_err(|e| Error::at(file, None, e))?;
    Ok(format!("pose track and {what} overlap from {:.3} to {:.3} s", shared.0, shared.1))
}

/// "104 poses over 6.900 s (0.000 to 6.900 s), largest gap 0.110 s".
fn sampling_note(what: &str, times_s: &[f64]) -> String {
    let (Some(first), Some(last)) = (times_s.first(), times_s.last()) else {
        return format!("no {what}");
    };
    let gap = times_s.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
    format!("{} {what} over {:.3} s ({first:.3} to {last:.3} s), largest gap {gap:.3} s", times_s.len(), last - first)
}

/// The frame of a pose track.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum TrackFrame {
    /// Poses in the world: z up, the table known.
    World,
    /// Poses in a camera whose own pose nobody recorded. What is not known here can be found in the track.
    Camera {
        /// Whether the poses are those of the mesh's frame; if not, they are those of the frame that the tracker uses, whose
        /// place in the mesh is not known.
        of_mesh: bool,
        /// Up, as a unit vector in that frame, while the object rests on the table before the push, if it is known.
        up: Option<Vector3<f64>>,
        /// Horizontal direction of the push, unit vector in that frame at rest, if it is known.
        push: Option<Vector3<f64>>,
    },
}

/// What the object stands on: a table plane and boxes fixed to it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Support {
    /// Height of the table top in the world, metres.
    #[serde(default)]
    pub table_height_m: f64,
    /// Coulomb friction of object against support, if known.
    #[serde(default)]
    pub friction: Option<f64>,
    /// Fixed boxes on the table, such as a step.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub boxes: Vec<SupportBox>,
}

/// A fixed box, axis-aligned in the world.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SupportBox {
    /// Centre, metres, world.
    pub center_m: [f64; 3],
    /// Half extents, metres.
    pub half_m: [f64; 3],
}

/// What moved the object, as far as the recording knows.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum Drive {
    /// A known force at a point fixed to the object.
    Force(ForceProfile),
    /// A compliant fingertip that was commanded along a path.
    Finger(FingerPush),
    /// A robot hand whose joints were logged.
    Hand(HandPush),
    /// Nothing touched the object but its support (a toss, a slide to rest).
    Nothing,
}

/// A commanded compliant fingertip: force = kp (command − q) − (kv + damping) q̇.
#[derive(Debug, Clone, PartialEq)]
pub struct FingerPush {
    /// Commanded tip positions in the world.
    pub command_times_s: Vec<f64>,
    /// One per command time, metres.
    pub commands: Vec<Point3<f64>>,
    /// Encoder: measured tip positions in the world; `None` if not recorded or not to be used.
    pub encoder: Option<EncoderTrack>,
    /// Impedance and shape.
    pub impedance: FingerImpedance,
}

/// The fingertip: a sphere on three slides with a position servo.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FingerImpedance {
    /// Sphere radius, m.
    pub radius_m: f64,
    /// Moving mass, kg.
    pub mass_kg: f64,
    /// Reflected actuator inertia per axis, kg.
    pub armature_kg: f64,
    /// Joint damping, N s/m.
    pub damping_ns_m: f64,
    /// Position gain, N/m.
    pub kp_n_m: f64,
    /// Velocity gain, N s/m.
    pub kv_ns_m: f64,
    /// Friction of the tip against the object.
    pub friction: f64,
    /// Tip position of zero joint coordinates, world, m.
    pub home_m: [f64; 3],
}

/// A logged robot hand.
#[derive(Debug, Clone, PartialEq)]
pub struct HandPush {
    /// Robot model: a bundled name (`allegro_right`) or a path to URDF or MJCF.
    pub robot: String,
    /// Pose of the hand's base in the world.
    pub world_from_base: Pose,
    /// Joint log on the same clock as the track.
    pub joints: JointLog,
}
