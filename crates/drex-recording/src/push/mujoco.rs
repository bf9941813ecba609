//! Simulated pushes: a folder `<object>/<scenario>` with `meta.json` and csv files, the mesh one level up.
//!
//! `meta.json` holds what a robot would know. Truth files beside it are never opened.

use std::path::Path;

use nalgebra::Vector3;
use serde::Deserialize;

use super::*;
use crate::readers::{read_action_csv, read_force_csv, read_pose_csv, read_proprio_csv};
use drex_core::fsutil;
use drex_core::pose::pose_from_wxyz;

/// `meta.json`, as far as it is used.
#[derive(Deserialize)]
struct Meta {
    object: String,
    scenario: String,
    gravity: [f64; 3],
    friction_object_table: Option<f64>,
    mass_prior: Option<f64>,
    hold: Option<String>,
    force_point_body: Option<[f64; 3]>,
    finger: Option<Finger>,
    step: Option<Step>,
    initial_pose: Option<[f64; 7]>,
    #[serde(default)]
    initial_velocity_known: bool,
    noise: Option<Noise>,
}

#[derive(Deserialize)]
struct Finger {
    radius: f64,
    mass: f64,
    armature: f64,
    damping: f64,
    kp: f64,
    kv: f64,
    mu: f64,
    home: [f64; 3],
}

/// A box on the table: centre at (x, 0, half height).
#[derive(Deserialize)]
struct Step {
    half: [f64; 3],
    x: f64,
}

#[derive(Deserialize)]
struct Noise {
    noisy: Option<WhiteNoise>,
}

#[derive(Deserialize)]
struct WhiteNoise {
    pos_sd: f64,
    rot_sd_deg: f64,
}

const COMMANDS: &str = "action.csv";
const ENCODER: &str = "proprio.csv";

/// Reads the push that `file`, a `meta.json`, describes.
pub(super) fn load(file: &Path, choice: &InputChoice) -> Result<PushRecording> {
    let meta: Meta = fsutil::from_json(file, &fsutil::read_text(file)?)?;
    let folder = folder_of(file);
    if meta.hold.as_deref().is_some_and(|h| h != "zero-order") {
        let what = format!("hold `{}` is not known", meta.hold.unwrap_or_default());
        return Err(Error::content(file, None, what, "samples of force and command must be held (zero-order)"));
    }
    let pose_file = folder.join(format!("pose_{}.csv", choice.poses.as_str()));
    let track = read_pose_csv(&pose_file)?;
    let mut notes = vec![sampling_note("poses", track.times_s())];
    let mut sources = vec![pose_file];

    let drive = match (meta.finger, meta.force_point_body) {
        (Some(finger), _) => {
            let push = finger_push(folder, &track, finger, choice, &mut notes)?;
            sources.push(folder.join(COMMANDS));
            sources.extend(push.encoder.is_some().then(|| folder.join(ENCODER)));
            Drive::Finger(push)
        }
        (None, Some(point)) => {
            let name = match choice.force {
                ForceChoice::Noisy => "force_noisy.csv",
                ForceChoice::Exact => "force.csv",
            };
            let force = read_force_csv(&folder.join(name), point.into())?;
            notes.push(sampling_note("forces", &force.times_s));
            notes.push(check_overlap(&folder.join(name), &track, "force record", &force.times_s)?);
            sources.push(folder.join(name));
            Drive::Force(force)
        }
        (None, None) => Drive::Nothing,
    };
    let white = meta.noise.and_then(|n| n.noisy);
    let noise = white
        .filter(|_| choice.poses == PoseChoice::Noisy)
        .map(|n| PoseNoise { position_m: n.pos_sd, rotation_rad: n.rot_sd_deg.to_radians() });
    let initial_pose = match meta.initial_pose {
        Some([x, y, z, qw, qx, qy, qz]) => {
            Some(pose_from_wxyz([x, y, z], [qw, qx, qy, qz]).map_err(|e| Error::at(file, None, e))?)
        }
        None => None,
    };
    let boxes = meta.step.iter().map(|s| SupportBox { center_m: [s.x, 0.0, s.half[2]], half_m: s.half }).collect();
    Ok(PushRecording {
        noise,
        support: Support { table_height_m: 0.0, friction: meta.friction_object_table, boxes },
        gravity: Vector3::from(meta.gravity),
        mass_prior_kg: meta.mass_prior,
        initial_pose,
        starts_at_rest: meta.initial_velocity_known,
        sources,
        notes,
        ..PushRecording::new(format!("{}/{}", meta.object, meta.scenario), folder.join("../object.obj"), track, drive)
    })
}

fn finger_push(
    folder: &Path,
    track: &Trajectory,
    finger: Finger,
    choice: &InputChoice,
    notes: &mut Vec<String>,
) -> Result<FingerPush> {
    let action_file = folder.join(COMMANDS);
    let action = read_action_csv(&action_file)?;
    notes.push(sampling_note("commands", &action.times_s));
    notes.push(check_overlap(&action_file, track, "commands", &action.times_s)?);
    let encoder_file = folder.join(ENCODER);
    let encoder = if choice.encoder && encoder_file.is_file() { Some(read_proprio_csv(&encoder_file)?) } else { None };
    if let Some(encoder) = &encoder {
        notes.push(sampling_note("encoder samples", &encoder.times_s));
        notes.push(check_overlap(&encoder_file, track, "encoder samples", &encoder.times_s)?);
    }
    Ok(FingerPush {
        command_times_s: action.times_s,
        commands: action.points,
        encoder,
        impedance: FingerImpedance {
            radius_m: finger.radius,
            mass_kg: finger.mass,
            armature_kg: finger.armature,
            damping_ns_m: finger.damping,
            kp_n_m: finger.kp,
            kv_ns_m: finger.kv,
            friction: finger.mu,
            home_m: finger.home,
        },
    })
}
