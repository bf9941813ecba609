//! Pushes simulated by MuJoCo: a folder `<object>/<scenario>` with `meta.json` and csv files, the mesh one level up.
//!
//! `meta.json` holds what a robot would know. Files of the truth beside it are never opened.

use std::path::Path;
use std::str::FromStr;

use drex_core::trajectory::PoseNoise;
use drex_core::{Error, Result, fsutil};
use serde::Deserialize;

use crate::{
    FingerConfig, FingerImpedance, ForceConfig, FrameKind, PoseConfig, PushConfig, PushRecording, StartConfig, Support,
    SupportBox, TrackConfig, TrackFormat,
};

/// Which of the inputs that a simulated push offers its recording has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Inputs {
    /// Quality of the pose track.
    pub poses: PoseQuality,
    /// Quality of the force record.
    pub force: ForceQuality,
}

/// Quality of the pose track of a simulated push.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PoseQuality {
    /// White noise of known size.
    #[default]
    Noisy,
    /// Noise, bias, clock offset, gaps, outliers.
    Hard,
    /// The exact poses.
    Clean,
}

/// Quality of the force record of a simulated push.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ForceQuality {
    /// The force as a sensor would give it.
    #[default]
    Noisy,
    /// The force as it was applied.
    Exact,
}

impl FromStr for PoseQuality {
    type Err = Error;

    fn from_str(s: &str) -> Result<Self> {
        match s {
            "noisy" => Ok(Self::Noisy),
            "hard" => Ok(Self::Hard),
            "clean" => Ok(Self::Clean),
            _ => Err(Error::value(format!("`{s}` is no kind of pose track"), "choose noisy, hard or clean")),
        }
    }
}

impl FromStr for ForceQuality {
    type Err = Error;

    fn from_str(s: &str) -> Result<Self> {
        match s {
            "noisy" => Ok(Self::Noisy),
            "exact" => Ok(Self::Exact),
            _ => Err(Error::value(format!("`{s}` is no kind of force record"), "choose noisy or exact")),
        }
    }
}

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

/// The push in the folder `scenario` as a `push.toml` whose paths start at that folder.
///
/// # Errors
/// If `meta.json` cannot be read or is malformed, or its samples are not held from each to the next.
pub fn push_config(scenario: &Path, inputs: Inputs) -> Result<PushConfig> {
    let file = scenario.join("meta.json");
    let meta: Meta = fsutil::from_json(&file, &fsutil::read_text(&file)?)?;
    if meta.hold.as_deref().is_some_and(|h| h != "zero-order") {
        let what = format!("hold `{}` is not known", meta.hold.unwrap_or_default());
        return Err(Error::content(file, None, what, "samples of force and command must be held (zero-order)"));
    }
    let poses = match inputs.poses {
        PoseQuality::Noisy => "pose_noisy.csv",
        PoseQuality::Hard => "pose_hard.csv",
        PoseQuality::Clean => "pose_clean.csv",
    };
    let force = match inputs.force {
        ForceQuality::Noisy => "force_noisy.csv",
        ForceQuality::Exact => "force.csv",
    };
    let white = meta.noise.and_then(|n| n.noisy).filter(|_| inputs.poses == PoseQuality::Noisy);
    let encoder = scenario.join("proprio.csv").is_file().then(|| "proprio.csv".into());
    let finger = meta.finger.map(|f| FingerConfig {
        commands: "action.csv".into(),
        encoder,
        clock: Default::default(),
        impedance: FingerImpedance {
            radius_m: f.radius,
            mass_kg: f.mass,
            armature_kg: f.armature,
            damping_ns_m: f.damping,
            kp_n_m: f.kp,
            kv_ns_m: f.kv,
            friction: f.mu,
            home_m: f.home,
        },
    });
    let force = meta.force_point_body.filter(|_| finger.is_none()).map(|point_in_object_m| ForceConfig {
        file: force.into(),
        point_in_object_m,
        clock: Default::default(),
    });
    let track = TrackConfig {
        noise: white.map(|n| PoseNoise { position_m: n.pos_sd, rotation_rad: n.rot_sd_deg.to_radians() }),
        ..TrackConfig::new(poses, TrackFormat::PoseCsv, FrameKind::World)
    };
    Ok(PushConfig {
        name: Some(format!("{}/{}", meta.object, meta.scenario)),
        gravity_m_s2: meta.gravity,
        mass_prior_kg: meta.mass_prior,
        support: Support {
            friction: meta.friction_object_table,
            boxes: meta.step.iter().map(|s| SupportBox { center_m: [s.x, 0.0, s.half[2]], half_m: s.half }).collect(),
            ..Support::default()
        },
        start: StartConfig {
            pose: meta
                .initial_pose
                .map(|[x, y, z, qw, qx, qy, qz]| PoseConfig { position_m: [x, y, z], quat_wxyz: [qw, qx, qy, qz] }),
            at_rest: meta.initial_velocity_known,
            time_s: Some(0.0),
            nominal_position_m: None,
        },
        force,
        finger,
        ..PushConfig::new("../object.obj", track)
    })
}

/// The push in the folder `scenario`, read where it stands.
///
/// # Errors
/// As [`push_config`] and [`PushConfig::load`].
pub fn load(scenario: &Path, inputs: Inputs) -> Result<PushRecording> {
    push_config(scenario, inputs)?.load(scenario)
}
