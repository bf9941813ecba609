//! A recorded push: what the files say, checked and brought to one clock and one frame.
//!
//! [`PushConfig`] is `push.toml` as it stands on disk; [`PushRecording`] is the push itself, whatever layout it came from.

use std::path::PathBuf;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::{Pose, Trajectory};

/// A push, ready for identification. Times are seconds of one clock that starts at the first pose.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct PushRecording {
    /// A name for reports.
    pub name: String,
    /// The object's mesh file. Poses are poses of this mesh's frame.
    pub mesh: PathBuf,
    /// Pose of the object's mesh frame over time, in `track_frame`.
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
    /// What acts on the object.
    pub drive: Drive,
    /// Readings that were asked for or came along, for the report ("104 poses over 6.9 s, largest gap 0.11 s").
    pub notes: Vec<String>,
}

/// The frame of a pose track.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum TrackFrame {
    /// Poses in the world: z up, the table known.
    World,
    /// Poses in a camera whose own pose nobody recorded; the up direction of the resting object is known instead.
    Camera {
        /// Up, as a unit vector in the object's mesh frame, while it rests on the table before the push.
        up_in_mesh: Vector3<f64>,
        /// Horizontal direction of the push, in the object's mesh frame, if it is known.
        push_in_mesh: Option<Vector3<f64>>,
    },
}

/// Standard deviations of a pose track.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseNoise {
    /// Per axis, metres.
    pub position_m: f64,
    /// Per axis of the rotation vector, radians.
    pub rotation_rad: f64,
}

/// What the object stands on: a table plane and boxes fixed to it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Support {
    /// Height of the table top in the world, metres.
    #[serde(default)]
    pub table_height_m: f64,
    /// Coulomb friction of object against support, if known.
    #[serde(default)]
    pub friction: Option<f64>,
    /// Fixed boxes on the table, such as a step.
    #[serde(default)]
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

/// A force over time, held constant from each sample to the next (zero-order hold), zero outside.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceProfile {
    /// Sample times, seconds, increasing.
    pub times_s: Vec<f64>,
    /// Force in the world frame, newtons, per sample.
    pub forces_n: Vec<Vector3<f64>>,
    /// Where it acts, in the object's mesh frame, metres.
    pub point_in_object: Point3<f64>,
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

/// Measured fingertip motion.
#[derive(Debug, Clone, PartialEq)]
pub struct EncoderTrack {
    /// Seconds.
    pub times_s: Vec<f64>,
    /// Tip positions in the world, metres.
    pub positions: Vec<Point3<f64>>,
    /// Tip velocities in the world, m/s.
    pub velocities: Vec<Vector3<f64>>,
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
    pub joints: crate::joints::JointLog,
}
