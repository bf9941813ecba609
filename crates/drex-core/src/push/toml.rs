//! `push.toml`: which files make a push, in which formats, frames and clocks, and what is known.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::*;
use crate::clock::{Clock, parse_utc_offset};
use crate::fsutil;
use crate::joints::JointLog;
use crate::pose::pose_from_wxyz;
use crate::readers::{
    BopSelection, FrameTimes, read_action_csv, read_bop_csv, read_force_csv, read_foundation_pose_folder,
    read_foundation_pose_log, read_joint_log_csv, read_pose_csv, read_proprio_csv,
};

/// `push.toml`. Paths are relative to the folder of the file. At most one of `force`, `finger`, `hand` is there; with
/// none of them nothing but gravity and the support acted on the object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PushConfig {
    /// Version of this format: 1.
    pub schema: u32,
    /// Name for reports; the name of the folder if left out.
    pub name: Option<String>,
    /// The object's mesh.
    pub mesh: PathBuf,
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
    /// Whether the poses are given in the world or in a camera whose pose is unknown.
    pub frame: FrameKind,
    /// For a camera: up in the mesh frame while the object rests before the push.
    pub up_in_mesh: Option<[f64; 3]>,
    /// For a camera: horizontal direction of the push in the mesh frame, if known.
    pub push_in_mesh: Option<[f64; 3]>,
    /// Pose of the mesh frame in the tracked frame, if the tracker used another frame.
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
    /// A camera whose own pose is unknown.
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

/// Kinds of clocks; see [`Clock`].
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

impl PushConfig {
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
    fn check(&self) -> Result<()> {
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
        match (t.frame, &t.up_in_mesh) {
            (FrameKind::Camera, None) => {
                return refuse(
                    "[track] frame = \"camera\" needs up_in_mesh".into(),
                    "give the up direction of the resting object in its mesh frame, such as [0, 0, 1]",
                );
            }
            (FrameKind::World, Some(_)) => {
                return refuse(
                    "[track] up_in_mesh has no meaning in the world".into(),
                    "remove it or set frame = \"camera\"",
                );
            }
            _ => {}
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

    /// Reads everything that the configuration names; relative paths start at `folder`.
    ///
    /// # Errors
    /// As [`PushRecording::load`].
    pub fn load(&self, folder: &Path, choice: &InputChoice) -> Result<PushRecording> {
        self.check()?;
        let track_file = folder.join(&self.track.file);
        let track = self.read_track(&track_file)?;
        // Everything is shifted so that the start is at zero.
        let first = track.span_s().map_or(0.0, |s| s.0);
        let absolute = self.track.clock.kind != ClockKind::Relative;
        let zero = match self.start.time_s {
            Some(t) => t,
            None if self.start.pose.is_some() && !absolute => 0.0,
            None => first,
        };
        let track = track.shifted(-zero);
        let mut notes = vec![sampling_note("poses", track.times_s())];
        let drive = self.read_drive(folder, choice, &track, zero, &mut notes)?;

        let name = self.name.clone().unwrap_or_else(|| {
            fsutil::absolute(folder).file_name().map_or_else(|| "push".to_owned(), |n| n.to_string_lossy().into_owned())
        });
        let track_frame = match (self.track.frame, self.track.up_in_mesh) {
            (FrameKind::Camera, Some(up)) => TrackFrame::Camera {
                up_in_mesh: Vector3::from(up).normalize(),
                push_in_mesh: self.track.push_in_mesh.map(|p| Vector3::from(p).normalize()),
            },
            _ => TrackFrame::World,
        };
        Ok(PushRecording {
            track_frame,
            noise: self.track.noise,
            support: self.support.clone(),
            gravity: self.gravity_m_s2.into(),
            mass_prior_kg: self.mass_prior_kg,
            initial_pose: self.start.pose.map(|p| p.pose("[start] pose")).transpose()?,
            starts_at_rest: self.start.at_rest,
            nominal_start: self.start.nominal_position_m.map(Into::into),
            notes,
            ..PushRecording::new(name, folder.join(&self.mesh), track, drive)
        })
    }

    /// The track of the mesh frame on the common clock, not yet shifted to the start.
    fn read_track(&self, file: &Path) -> Result<Trajectory> {
        let t = &self.track;
        // `check` has made sure that the formats that need a rate have one.
        let fps = t.fps.unwrap_or(f64::NAN);
        let track = match t.format {
            TrackFormat::PoseCsv => read_pose_csv(file)?,
            TrackFormat::FoundationPoseLog => read_foundation_pose_log(file, &t.clock.clock()?)?,
            TrackFormat::FoundationPoseFolder => read_foundation_pose_folder(file, &FrameTimes::Fps(fps))?,
            TrackFormat::BopCsv => read_bop_csv(file, &BopSelection { fps, scene_id: t.scene_id, obj_id: t.obj_id })?,
        };
        let track = match &t.tracked_from_mesh {
            Some(pose) => track.right_mul(&pose.pose("[track] tracked_from_mesh")?),
            None => track,
        };
        Ok(track.shifted(t.clock.offset_s.unwrap_or(0.0)))
    }

    /// What moved the object, with the start at time zero.
    fn read_drive(
        &self,
        folder: &Path,
        choice: &InputChoice,
        track: &Trajectory,
        zero: f64,
        notes: &mut Vec<String>,
    ) -> Result<Drive> {
        let shift = |times_s: &mut Vec<f64>, clock: &ClockConfig| {
            for t in times_s {
                *t += clock.offset_s.unwrap_or(0.0) - zero;
            }
        };
        let mut note = |file: &Path, plural: &str, what: &str, times_s: &[f64]| {
            notes.push(sampling_note(plural, times_s));
            notes.push(check_overlap(file, track, what, times_s)?);
            Ok::<_, Error>(())
        };
        if let Some(force) = &self.force {
            let file = folder.join(&force.file);
            let mut profile = read_force_csv(&file, force.point_in_object_m.into())?;
            shift(&mut profile.times_s, &force.clock);
            note(&file, "forces", "force record", &profile.times_s)?;
            return Ok(Drive::Force(profile));
        }
        if let Some(finger) = &self.finger {
            let file = folder.join(&finger.commands);
            let mut commands = read_action_csv(&file)?;
            shift(&mut commands.times_s, &finger.clock);
            note(&file, "commands", "commands", &commands.times_s)?;
            let encoder = match &finger.encoder {
                Some(encoder) if choice.encoder => {
                    let file = folder.join(encoder);
                    let mut encoder = read_proprio_csv(&file)?;
                    shift(&mut encoder.times_s, &finger.clock);
                    note(&file, "encoder samples", "encoder samples", &encoder.times_s)?;
                    Some(encoder)
                }
                _ => None,
            };
            return Ok(Drive::Finger(FingerPush {
                command_times_s: commands.times_s,
                commands: commands.points,
                encoder,
                impedance: finger.impedance,
            }));
        }
        if let Some(hand) = &self.hand {
            let file = folder.join(&hand.joints);
            let mut joints: JointLog = read_joint_log_csv(&file, hand.joint_names.as_deref())?;
            shift(&mut joints.times_s, &hand.clock);
            note(&file, "joint samples", "joint log", &joints.times_s)?;
            let robot = if folder.join(&hand.robot).is_file() {
                folder.join(&hand.robot).to_string_lossy().into_owned()
            } else {
                hand.robot.clone()
            };
            let world_from_base = hand.world_from_base.pose("[hand] world_from_base")?;
            return Ok(Drive::Hand(HandPush { robot, world_from_base, joints }));
        }
        Ok(Drive::Nothing)
    }
}

impl PoseConfig {
    /// The pose; `entry` names it in messages.
    fn pose(&self, entry: &str) -> Result<Pose> {
        pose_from_wxyz(self.position_m, self.quat_wxyz).map_err(|e| match e {
            Error::Value { what, remedy } => Error::value(format!("{entry}: {what}"), remedy),
            other => other,
        })
    }
}

impl ClockConfig {
    /// The clock that stamps are parsed with.
    fn clock(&self) -> Result<Clock> {
        Ok(match (self.kind, &self.utc_offset) {
            (ClockKind::Relative, _) => Clock::Relative,
            (ClockKind::Unix, _) => Clock::Unix,
            (ClockKind::LocalIso, Some(offset)) => Clock::LocalIso { utc_offset_minutes: parse_utc_offset(offset)? },
            (ClockKind::LocalIso, None) => {
                return Err(Error::value(
                    "local_iso stamps need utc_offset",
                    "give local time minus UTC, such as \"-07:00\"",
                ));
            }
        })
    }
}
