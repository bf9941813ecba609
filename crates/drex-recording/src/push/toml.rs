//! `push.toml`: which files make a push, in which formats, frames and clocks, and what is known.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::{FingerImpedance, Support};
use drex_core::pose::to_wxyz;
use drex_core::trajectory::PoseNoise;
use drex_core::{Error, Pose, Result, fsutil};

/// `push.toml`. Paths are relative to the folder of the file. At most one of `force`, `finger`, `hand` is there; with
/// none of them nothing but gravity and the support acted on the object.
///
/// A force of known size and direction, poses in the world:
///
/// ```toml
/// schema = 1
/// mesh = "../../scan/brick.obj"
/// mesh_sd_m = 0.001                  # of a scan: how well its surface is known; a voxel of scan.json beside it if left out
/// mass_prior_kg = 0.5                # a guess; never an answer
/// [track]
/// file = "pose.csv"
/// format = "pose_csv"
/// frame = "world"
/// noise = { position_m = 0.002, rotation_rad = 0.017 }   # left out: estimated from the track
/// [support]
/// friction = 0.45
/// boxes = [{ center_m = [-0.15, 0, 0.037], half_m = [0.15, 0.2, 0.037] }]
/// [start]
/// at_rest = true
/// pose = { position_m = [0, 0, 0.044], quat_wxyz = [1, 0, 0, 0] }
/// [force]
/// file = "force.csv"
/// point_in_object_m = [0.008, 0, -0.044]
/// [parameters]                                           # by the names that the identification gives them
/// friction = "free"                                      # to be estimated
/// force_gain = 1.02                                      # known
/// contact_height = { mean = 0.0, sd = 0.005 }            # known roughly
/// ```
///
/// A logged hand and a camera that nobody calibrated (of one that is, say `world_from_camera = { position_m, quat_wxyz }`
/// in place of what is found in the track); two clocks:
///
/// ```toml
/// schema = 1
/// mesh = "../../scan/ketchup.stl"
/// [track]
/// file = "object_poses.txt"
/// format = "foundation_pose_log"
/// clock = { kind = "local_iso", utc_offset = "-07:00" }
/// frame = "camera"
/// up_in_mesh = [0, 0, -1]            # this and the next two may be left out: they are then found in the track
/// push_in_mesh = [0, 1, 0]
/// tracked_from_mesh = { position_m = [0.001, -0.006, -0.041], quat_wxyz = [1, 0, 0, 0] }
/// [support]
/// table_height_m = 0.062
/// [hand]
/// robot = "allegro_right"
/// world_from_base = { position_m = [0.14, -0.08, 0.25], quat_wxyz = [0, 0, -1, 0] }
/// joints = "joint_states.csv"
/// joint_names = ["ffj0", "ffj1"]     # one per column position_0, position_1, …
/// clock = { kind = "unix" }
/// ```
///
/// A compliant fingertip has `[finger]` with `commands`, `encoder` (optional) and `impedance`; without `[force]`, `[finger]`
/// and `[hand]` nothing but gravity and the support acted (a toss).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PushConfig {
    /// Version of this format: 1.
    pub schema: u32,
    /// Name for reports; the name of the folder if left out.
    pub name: Option<String>,
    /// The object's mesh.
    pub mesh: PathBuf,
    /// How well the mesh is known, standard deviation of its surface, metres; 0 for exactly. If left out, the voxel of a `scan.json` beside
    /// the mesh, and exactly without one.
    pub mesh_sd_m: Option<f64>,
    /// Gravity in the world, m/s².
    #[serde(default = "standard_gravity")]
    pub gravity_m_s2: [f64; 3],
    /// First guess of the mass, kg.
    pub mass_prior_kg: Option<f64>,
    /// The pose track.
    pub track: TrackConfig,
    /// What the object stands on.
    #[serde(default)]
    pub support: Support,
    /// What is known of the start.
    #[serde(default)]
    pub start: StartConfig,
    /// A known force.
    pub force: Option<ForceConfig>,
    /// A compliant fingertip.
    pub finger: Option<FingerConfig>,
    /// A logged robot hand.
    pub hand: Option<HandConfig>,
    /// What is known of single parameters, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, StatedParameter>,
}

/// What a push says of a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum StatedParameter {
    /// `"free"`: it is to be estimated.
    Free(Free),
    /// Its value.
    Value(f64),
    /// What is expected of it.
    Expected {
        /// Expected value.
        mean: f64,
        /// Standard deviation; of the logarithm, for parameters that are positive by nature.
        sd: f64,
    },
}

/// The word `"free"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Free {
    /// To be estimated.
    Free,
}

fn standard_gravity() -> [f64; 3] {
    [0.0, 0.0, -9.81]
}

/// The pose track of a push.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrackConfig {
    /// File or folder.
    pub file: PathBuf,
    /// What it is.
    pub format: TrackFormat,
    /// Frames per second, for formats that number frames.
    pub fps: Option<f64>,
    /// Scene, for BOP files with several.
    pub scene_id: Option<u64>,
    /// Object, for BOP files with several.
    pub obj_id: Option<u64>,
    /// What its stamps count.
    #[serde(default)]
    pub clock: ClockConfig,
    /// Whether the poses are given in the world or in a camera.
    pub frame: FrameKind,
    /// For a camera: its pose in the world (x right, y down, z forward), if it is known; the poses are then brought to the
    /// world.
    pub world_from_camera: Option<PoseConfig>,
    /// For a camera of unknown pose: up in the mesh frame while the object rests before the push, if known; in the tracked
    /// frame, where `tracked_from_mesh` is left out.
    pub up_in_mesh: Option<[f64; 3]>,
    /// For a camera of unknown pose: horizontal direction of the push in the same frame, if known.
    pub push_in_mesh: Option<[f64; 3]>,
    /// Pose of the mesh frame in the tracked frame. Left out, poses in the world are those of the mesh frame; for a camera of
    /// unknown pose the two are taken to be the same unless the track contradicts it.
    pub tracked_from_mesh: Option<PoseConfig>,
    /// Standard deviations, if known.
    pub noise: Option<PoseNoise>,
}

/// Formats of pose tracks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum TrackFormat {
    /// `t,x,y,z,qw,qx,qy,qz`.
    PoseCsv,
    /// The log that FoundationPose's demo prints.
    FoundationPoseLog,
    /// FoundationPose's `ob_in_cam` folder; needs `fps`.
    FoundationPoseFolder,
    /// BOP results; needs `fps`.
    BopCsv,
}

/// Frame of a pose track on disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FrameKind {
    /// World: z up, the table known.
    World,
    /// A camera; its own pose may be unknown.
    Camera,
}

/// What the stamps of one file count, and how they come to the common clock: common time = file time + `offset_s`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClockConfig {
    /// Which clock.
    pub kind: ClockKind,
    /// Local time minus UTC such as `-07:00`, for [`ClockKind::LocalIso`].
    pub utc_offset: Option<String>,
    /// Seconds to add to this file's stamps.
    pub offset_s: Option<f64>,
}

/// Kinds of clocks; see [`crate::clock::Clock`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockKind {
    /// Seconds since a start that the recording shares.
    #[default]
    Relative,
    /// Seconds since 1970 UTC.
    Unix,
    /// ISO 8601 local time with `utc_offset`.
    LocalIso,
}

/// A pose on disk.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseConfig {
    /// Metres.
    pub position_m: [f64; 3],
    /// Unit quaternion w, x, y, z.
    pub quat_wxyz: [f64; 4],
}

/// What is known of the start of a push.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StartConfig {
    /// Pose of the mesh in the world at the start.
    pub pose: Option<PoseConfig>,
    /// Whether the object rests at the start.
    pub at_rest: bool,
    /// Time of the start on the common clock; if left out, zero where `pose` is given, else the first pose of the track.
    pub time_s: Option<f64>,
    /// Rough position of the object in the world.
    pub nominal_position_m: Option<[f64; 3]>,
}

/// A known force.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceConfig {
    /// `t,fx,fy,fz`: newtons in the world, each held until the next.
    pub file: PathBuf,
    /// Where it acts, metres in the mesh frame.
    pub point_in_object_m: [f64; 3],
    /// What its stamps count.
    #[serde(default)]
    pub clock: ClockConfig,
}

/// A compliant fingertip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FingerConfig {
    /// `t,x_cmd,y_cmd,z_cmd`: commanded tip positions in the world.
    pub commands: PathBuf,
    /// `t,x,y,z,vx,vy,vz`: measured tip motion in the world.
    pub encoder: Option<PathBuf>,
    /// What the stamps of both count.
    #[serde(default)]
    pub clock: ClockConfig,
    /// Gains and shape.
    pub impedance: FingerImpedance,
}

/// A logged robot hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandConfig {
    /// A bundled robot (`allegro_right`) or the path of a URDF or MJCF file.
    pub robot: String,
    /// Pose of the robot's base in the world.
    pub world_from_base: PoseConfig,
    /// Joint log.
    pub joints: PathBuf,
    /// Joint names of the columns `position_0`, `position_1`, …; not needed if the columns carry the names.
    pub joint_names: Option<Vec<String>>,
    /// What the stamps of the log count.
    #[serde(default)]
    pub clock: ClockConfig,
}

impl TrackConfig {
    /// A track in `file`, of which nothing else is known.
    pub fn new(file: impl Into<PathBuf>, format: TrackFormat, frame: FrameKind) -> Self {
        Self {
            file: file.into(),
            format,
            fps: None,
            scene_id: None,
            obj_id: None,
            clock: ClockConfig::default(),
            frame,
            world_from_camera: None,
            up_in_mesh: None,
            push_in_mesh: None,
            tracked_from_mesh: None,
            noise: None,
        }
    }
}

impl From<&Pose> for PoseConfig {
    fn from(pose: &Pose) -> Self {
        let (position_m, quat_wxyz) = to_wxyz(pose);
        Self { position_m, quat_wxyz }
    }
}

impl PushConfig {
    /// A push of the object of `mesh` by nothing but gravity and its support, of which nothing else is known.
    pub fn new(mesh: impl Into<PathBuf>, track: TrackConfig) -> Self {
        Self {
            schema: 1,
            name: None,
            mesh: mesh.into(),
            mesh_sd_m: None,
            gravity_m_s2: standard_gravity(),
            mass_prior_kg: None,
            track,
            support: Support::default(),
            start: StartConfig::default(),
            force: None,
            finger: None,
            hand: None,
            parameters: BTreeMap::new(),
        }
    }

    /// Reads a `push.toml`.
    ///
    /// # Errors
    /// If it cannot be read, is no TOML, or has an unknown, missing or ill-typed entry; with line and column.
    pub fn read(path: &Path) -> Result<Self> {
        let config: Self = fsutil::from_toml(path, &fsutil::read_text(path)?)?;
        config.check().map_err(|e| Error::at(path, None, e))?;
        Ok(config)
    }

    /// The file's text.
    ///
    /// # Errors
    /// If a path is not Unicode.
    pub fn to_toml_string(&self) -> Result<String> {
        ::toml::to_string(self)
            .map_err(|e| Error::value(format!("the push cannot be written as TOML: {e}"), "rename the file it names"))
    }

    /// Checks what the types cannot.
    pub(super) fn check(&self) -> Result<()> {
        let refuse = |what: String, remedy: &str| Err(Error::value(what, remedy));
        if self.schema != 1 {
            return refuse(
                format!("schema {} of push.toml is not known", self.schema),
                "write schema = 1 or use a newer drex",
            );
        }
        let drives = [self.force.is_some(), self.finger.is_some(), self.hand.is_some()];
        if drives.iter().filter(|d| **d).count() > 1 {
            return refuse(
                "more than one of [force], [finger], [hand] is given".into(),
                "keep the one that moved the object",
            );
        }
        if self.mass_prior_kg.is_some_and(|m| !(m > 0.0 && m.is_finite())) {
            return refuse("mass_prior_kg is not positive".into(), "give kilograms, or leave it out");
        }
        let t = &self.track;
        let of_camera = [
            ("world_from_camera", t.world_from_camera.is_some()),
            ("up_in_mesh", t.up_in_mesh.is_some()),
            ("push_in_mesh", t.push_in_mesh.is_some()),
        ];
        if t.frame == FrameKind::World
            && let Some((name, _)) = of_camera.iter().find(|(_, given)| *given)
        {
            return refuse(
                format!("[track] {name} has no meaning in the world"),
                "remove it or set frame = \"camera\"",
            );
        }
        if t.world_from_camera.is_some() && (t.up_in_mesh.is_some() || t.push_in_mesh.is_some()) {
            return refuse(
                "[track] world_from_camera already says what up_in_mesh and push_in_mesh would".into(),
                "remove these two, or world_from_camera",
            );
        }
        let poses = [
            ("[track] world_from_camera", t.world_from_camera.as_ref()),
            ("[track] tracked_from_mesh", t.tracked_from_mesh.as_ref()),
            ("[start] pose", self.start.pose.as_ref()),
            ("[hand] world_from_base", self.hand.as_ref().map(|h| &h.world_from_base)),
        ];
        for (name, pose) in poses {
            pose.map(|p| p.pose(name)).transpose()?;
        }
        for (name, vector) in [("up_in_mesh", &t.up_in_mesh), ("push_in_mesh", &t.push_in_mesh)] {
            if vector
                .is_some_and(|v| Vector3::from(v).try_normalize(1e-9).is_none_or(|u| !u.iter().all(|c| c.is_finite())))
            {
                return refuse(format!("[track] {name} is no direction"), "give a vector that is not zero");
            }
        }
        if matches!(t.format, TrackFormat::FoundationPoseFolder | TrackFormat::BopCsv) && t.fps.is_none() {
            return refuse("[track] this format numbers its frames and needs fps".into(), "add fps, such as fps = 30");
        }
        if t.clock.kind == ClockKind::LocalIso && t.format != TrackFormat::FoundationPoseLog {
            return refuse("[track] this format has no ISO stamps".into(), "set clock.kind to unix or relative");
        }
        let others = [
            self.force.as_ref().map(|f| &f.clock),
            self.finger.as_ref().map(|f| &f.clock),
            self.hand.as_ref().map(|h| &h.clock),
        ];
        for clock in others.into_iter().flatten() {
            if clock.kind == ClockKind::LocalIso {
                return refuse(
                    "only pose logs have ISO stamps".into(),
                    "set clock.kind of the other file to unix or relative",
                );
            }
            let absolute = [clock, &t.clock].map(|c| c.kind != ClockKind::Relative);
            if absolute[0] != absolute[1] && clock.offset_s.is_none() && t.clock.offset_s.is_none() {
                return refuse(
                    "one file counts from 1970 and the other from its own start".into(),
                    "state clock.offset_s: common time = file time + offset_s",
                );
            }
        }
        Ok(())
    }
}
