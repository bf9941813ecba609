//! A demonstration: key points of a hand over time, and the pose of the object that it handled.

use drex_core::Pose;
use nalgebra::{Unit, UnitQuaternion, Vector3};

use crate::{KeyPoints, Side};

/// A recorded demonstration.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Demonstration {
    /// Name of the recording that it came from.
    pub source: String,
    /// Side of the hand that every frame's key points belong to.
    pub side: Side,
    /// The frames in the order of time.
    pub frames: Vec<HandFrame>,
    /// Up, against gravity, in the source frame, if the recording says.
    pub up: Option<Unit<Vector3<f64>>>,
    /// Remarks of the reader, one sentence each.
    pub notes: Vec<String>,
}

/// One frame of a demonstration.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct HandFrame {
    /// Number of the frame in the recording, from 0.
    pub index: usize,
    /// Time of the frame, s.
    pub t_s: f64,
    /// Key points in the source frame (camera, world), m.
    pub points: KeyPoints,
    /// Orientation of MANO's wrist, `source_from_wrist`, where the recording has it.
    pub source_from_mano_wrist: Option<UnitQuaternion<f64>>,
    /// Pose of the object's mesh frame in the source frame, where the recording has it.
    pub source_from_object: Option<Pose>,
    /// How sure the detector was that this is a hand, 0 to 1, where it says.
    pub score: Option<f64>,
}

impl HandFrame {
    /// A frame of key points only.
    pub fn new(t_s: f64, points: KeyPoints) -> Self {
        Self { index: 0, t_s, points, source_from_mano_wrist: None, source_from_object: None, score: None }
    }
}

impl Demonstration {
    /// A demonstration of these frames.
    pub fn new(source: impl Into<String>, side: Side, frames: Vec<HandFrame>) -> Self {
        Self { source: source.into(), side, frames, up: None, notes: Vec::new() }
    }
}
