//! From a [`PushConfig`] to a [`PushRecording`]: reads the files it names and brings them to one frame and one clock.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;

use super::*;
use crate::clock::{Clock, parse_utc_offset};
use crate::readers::{
    BopSelection, FrameTimes, read_action_csv, read_bop_csv, read_force_csv, read_foundation_pose_folder,
    read_foundation_pose_log, read_joint_log_csv, read_pose_csv, read_proprio_csv,
};
use drex_core::fsutil;
use drex_core::pose::pose_from_wxyz;

impl PushConfig {
    /// Reads everything that the configuration names; relative paths start at `folder`.
    ///
    /// # Errors
    /// If an entry contradicts another, a file it names cannot be read or is malformed, the recordings do not overlap in time, or
    /// a stated constant cannot be true of a tabletop.
    pub fn load(&self, folder: &Path) -> Result<PushRecording> {
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
        let drive = self.read_drive(folder, &track, zero, &mut notes)?;

        let name = self.name.clone().unwrap_or_else(|| {
            fsutil::absolute(folder).file_name().map_or_else(|| "push".to_owned(), |n| n.to_string_lossy().into_owned())
        });
        let unit = |v: [f64; 3]| Vector3::from(v).normalize();
        let track_frame = match self.track.frame {
            FrameKind::Camera if self.track.world_from_camera.is_none() => TrackFrame::Camera {
                of_mesh: self.track.tracked_from_mesh.is_some(),
                up: self.track.up_in_mesh.map(unit),
                push: self.track.push_in_mesh.map(unit),
            },
            FrameKind::Camera | FrameKind::World => TrackFrame::World,
        };
        let mesh = folder.join(&self.mesh);
        let mesh_sd_m = match self.mesh_sd_m {
            None => mesh_sd_m(&mesh)?,
            stated => stated,
        };
        notes.extend(mesh_sd_m.map(|sd| format!("the mesh is known to {:.1} mm", 1e3 * sd)));
        let recording = PushRecording {
            mesh_sd_m,
            track_frame,
            noise: self.track.noise,
            support: self.support.clone(),
            gravity: self.gravity_m_s2.into(),
            mass_prior_kg: self.mass_prior_kg,
            initial_pose: self.start.pose.map(|p| p.pose("[start] pose")).transpose()?,
            starts_at_rest: self.start.at_rest,
            parameters: self.parameters.clone(),
            sources: self.clone().files_mut().into_iter().map(|f| folder.join(f)).collect(),
            nominal_start: self.start.nominal_position_m.map(Into::into),
            notes,
            ..PushRecording::new(name, mesh, track, drive)
        };
        recording.check()?;
        if !recording.mesh.is_file() {
            let missing = std::io::Error::new(std::io::ErrorKind::NotFound, "the mesh of the pushed object is missing");
            return Err(Error::io("read", &recording.mesh, missing));
        }
        Ok(recording)
    }

    /// The paths of the recordings that it names; the mesh is not among them.
    pub(crate) fn files_mut(&mut self) -> Vec<&mut PathBuf> {
        let mut files = vec![&mut self.track.file];
        files.extend(self.force.as_mut().map(|f| &mut f.file));
        if let Some(finger) = &mut self.finger {
            files.push(&mut finger.commands);
            files.extend(finger.encoder.as_mut());
        }
        files.extend(self.hand.as_mut().map(|h| &mut h.joints));
        files
    }

    /// The track of the mesh frame on the common clock, not yet shifted to the start; in the world where the camera's pose is known.
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
        let track = match &t.world_from_camera {
            Some(pose) => track.left_mul(&pose.pose("[track] world_from_camera")?),
            None => track,
        };
        Ok(track.shifted(t.clock.offset_s.unwrap_or(0.0)))
    }

    /// What moved the object, with the start at time zero.
    fn read_drive(&self, folder: &Path, track: &Trajectory, zero: f64, notes: &mut Vec<String>) -> Result<Drive> {
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
                Some(encoder) => {
                    let file = folder.join(encoder);
                    let mut encoder = read_proprio_csv(&file)?;
                    shift(&mut encoder.times_s, &finger.clock);
                    note(&file, "encoder samples", "encoder samples", &encoder.times_s)?;
                    Some(encoder)
                }
                None => None,
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
    pub(super) fn pose(&self, entry: &str) -> Result<Pose> {
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

/// How well a mesh is known that was made of photos: the voxel in the `scan.json` beside it, metres, to a tenth of a millimetre as it is
/// printed; `None` without such a file, or with one of something else.
///
/// # Errors
/// If the file cannot be read or is no JSON.
pub fn mesh_sd_m(mesh: &Path) -> Result<Option<f64>> {
    let file = mesh.with_file_name("scan.json");
    if !file.is_file() {
        return Ok(None);
    }
    let scan: serde_json::Value = fsutil::from_json(&file, &fsutil::read_text(&file)?)?;
    let voxel_m = scan.pointer("/fusion/voxel_m").and_then(serde_json::Value::as_f64);
    Ok(voxel_m.map(|v| (1e4 * v).round() / 1e4).filter(|v| *v > 0.0))
}
