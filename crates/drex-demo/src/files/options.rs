//! What a reader of demonstrations is told.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::Side;

/// Order of the 21 key points in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum KeyPointOrder {
    /// OpenPose's, which is also MediaPipe's and that of HaMeR's output: wrist, thumb, index, middle, ring, little finger, each
    /// from the palm to the tip.
    #[default]
    OpenPose,
    /// MANO's own: wrist, three joints each of index, middle, little, ring finger and thumb; then the tips of thumb, index,
    /// middle, ring and little finger.
    Mano,
}

/// `MANO_INDEX[i]` is the place in MANO's own order of key point `i` of OpenPose's order.
pub(crate) const MANO_INDEX: [usize; crate::KEYPOINTS] =
    [0, 13, 14, 15, 16, 1, 2, 3, 17, 4, 5, 6, 18, 10, 11, 12, 19, 7, 8, 9, 20];

/// Frames per second that are assumed where neither the file nor an option says.
pub(super) const ASSUMED_FPS: f64 = 30.0;

/// Unit of lengths in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DemoUnit {
    /// Metres.
    M,
    /// Centimetres.
    Cm,
    /// Millimetres.
    Mm,
}

impl DemoUnit {
    /// Metres per unit.
    pub fn metres(self) -> f64 {
        match self {
            Self::M => 1.0,
            Self::Cm => 0.01,
            Self::Mm => 0.001,
        }
    }

    /// The unit that a file names.
    pub(crate) fn parse(name: &str) -> Option<Self> {
        match name.trim().to_ascii_lowercase().as_str() {
            "m" | "metre" | "metres" | "meter" | "meters" => Some(Self::M),
            "cm" | "centimetre" | "centimetres" | "centimeter" | "centimeters" => Some(Self::Cm),
            "mm" | "millimetre" | "millimetres" | "millimeter" | "millimeters" => Some(Self::Mm),
            _ => None,
        }
    }
}

/// How [`crate::Demonstration::load`] reads a file. The default takes the file at its word, and metres, 30 frames per second and
/// a right hand where it says nothing; each such assumption becomes a note of the demonstration.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct LoadOptions {
    /// Which hand it is. Overrules the file.
    pub side: Option<Side>,
    /// The recording is a mirror image (a selfie camera that flips its pictures): it is turned back, so that the key points are
    /// those of the hand that was there. The object's poses of such a recording are poses of a mirrored object and left out.
    pub mirrored: bool,
    /// Unit of every length. Overrules the file.
    pub unit: Option<DemoUnit>,
    /// Order of the key points, for files that do not name their points.
    pub order: KeyPointOrder,
    /// Frames per second: frame `i` is at `i / fps` seconds, whatever the file says.
    pub fps: Option<f64>,
    /// First frame to keep, counted from 0 in the file.
    pub first_frame: Option<usize>,
    /// Last frame to keep.
    pub last_frame: Option<usize>,
    /// A file or folder of object poses `source_from_object`: `.npy`/`.npz` (one per frame, n x 4 x 4, n x 3 x 4 or n x 7 with x, y, z,
    /// qw, qx, qy, qz), `.csv` (t, x, y, z, qw, qx, qy, qz; interpolated) or a folder of FoundationPose (one text file per frame).
    pub object_poses: Option<PathBuf>,
    /// The user's own MANO model of the hand's side as `.npz` ([`crate::ManoModel`]), for recordings of MANO parameters alone.
    pub mano_model: Option<PathBuf>,
    /// MANO's axis-angle parameters are offsets from the flat hand (`flat_hand_mean=True` of smplx and manopth). If not, they are
    /// offsets from the model's mean pose. Rotation matrices are always the joints' own.
    pub mano_flat_hand: bool,
    /// Focal length of the camera in pixels, for HaMeR: without it HaMeR's guess stands and depth is only as true as that.
    pub focal_px: Option<f64>,
}
