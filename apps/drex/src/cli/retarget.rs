//! `drex hands` and `drex retarget`.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use drex_demo::{DemoUnit, KeyPointOrder, Side};
use drex_mesh::LengthUnit;
use drex_retarget::{Objective, Scale};

use super::values::{direction, positive};

/// `drex hands`.
#[derive(Debug, Args)]
pub struct HandsArgs {
    /// Video of one hand, or whatever the command of `--detector command` takes.
    pub video: PathBuf,
    /// JSON file of key points to write, for `drex retarget`.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// What finds the hand.
    #[arg(long, value_enum, default_value_t = DetectorArg::Mediapipe)]
    pub detector: DetectorArg,
    /// The Python that has mediapipe: pip install "mediapipe==0.10.14" opencv-python-headless.
    #[arg(long, value_name = "PROGRAM", default_value = "python3")]
    pub python: String,
    /// Least confidence of a detection, 0 to 1 (mediapipe).
    #[arg(long, value_name = "P", default_value_t = 0.5)]
    pub confidence: f64,
    /// Ending of the file that the command writes: json, jsonl, npz, npy or csv.
    #[arg(long, value_name = "ENDING", default_value = "json")]
    pub format: String,
    /// Stop the detector after this many seconds.
    #[arg(long, value_name = "S", default_value_t = 3600.0, value_parser = positive)]
    pub timeout: f64,
    /// Command of `--detector command`, after `--`; {video} and {out} stand for the video and for the file to write.
    #[arg(last = true)]
    pub command: Vec<String>,
    /// How the key points are read.
    #[command(flatten)]
    pub reading: ReadingArgs,
}

/// What finds hands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum DetectorArg {
    /// MediaPipe's Python package.
    Mediapipe,
    /// A command of your own, such as one that runs HaMeR.
    Command,
}

/// `drex retarget`.
#[derive(Debug, Args)]
pub struct RetargetArgs {
    /// Key points of a hand over time: JSON, JSON lines, NPY, NPZ or CSV (`drex hands` makes one from a video). `-` reads one JSON
    /// frame per line from stdin, {"t": 0.03, "keypoints": [[x, y, z], ...]}, and answers each with a line.
    pub demo: PathBuf,
    /// Robot hand: leap, allegro, leap_left, allegro_left, a URDF or MJCF file, or a mapping file that names one.
    #[arg(long, value_name = "NAME|FILE")]
    pub hand: String,
    /// Mapping file (TOML) that says where fingertips, wrist and palm of the model are [default: derived from the model].
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// What the robot hand is to have in common with the person's.
    #[arg(long, value_enum, default_value_t = ObjectiveArg::Vector)]
    pub objective: ObjectiveArg,
    /// Mesh of the object (STL, OBJ, PLY, GLTF, GLB), for the grasp objective and for pictures.
    #[arg(long, value_name = "MESH", required_if_eq("objective", "grasp"))]
    pub object: Option<PathBuf>,
    /// Take the convex hull of that mesh, for a scan with holes in an object without hollows.
    #[arg(long, requires = "object")]
    pub object_hull: bool,
    /// Folder of reconstructed points of the object, a file per frame (OBJ, PLY, NPY, XYZ; the number in the name is the frame): the
    /// mesh is registered to them, with scale, for the poses and the metre of the recording.
    #[arg(long, value_name = "DIR", requires = "object", conflicts_with = "object_poses")]
    pub object_points: Option<PathBuf>,
    /// Unit of the mesh's coordinates: m, cm, mm, in, or auto (told by the size).
    #[arg(long, value_name = "UNIT", default_value = "auto")]
    pub unit: LengthUnit,
    /// Direction that points up in the frame of the recording [default: the file's, or the object's z axis in the first frame].
    #[arg(long, value_name = "X,Y,Z", value_parser = direction, allow_hyphen_values = true)]
    pub up: Option<[f64; 3]>,
    /// Size of the robot hand over the person's: a factor, or auto [default: auto; position: 1].
    #[arg(long, value_name = "FACTOR|auto", value_parser = scale, allow_hyphen_values = true)]
    pub scale: Option<ScaleArg>,
    /// Share of the new angles in the filtered ones (q_filtered), above 0 to 1; 1 for no filter [default: 0.2; position: 1].
    #[arg(long, value_name = "ALPHA", value_parser = positive, allow_hyphen_values = true)]
    pub low_pass: Option<f64>,
    /// Make at most this many grasps of the accepted frames: turned by the object's symmetries, with noise, solved again (grasp
    /// objective).
    #[arg(long, value_name = "N")]
    pub augment: Option<NonZeroUsize>,
    /// JSON file to write.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// PNG to write: robot hand and object, frames side by side.
    #[arg(long, value_name = "FILE")]
    pub picture: Option<PathBuf>,
    /// Show every N-th frame in the picture.
    #[arg(long, value_name = "N", default_value_t = NonZeroUsize::new(10).expect("10 is not 0"))]
    pub every: NonZeroUsize,
    /// How the demonstration is read.
    #[command(flatten)]
    pub reading: ReadingArgs,
}

/// Options for reading demonstrations.
#[derive(Debug, Args)]
#[command(next_help_heading = "Reading the demonstration")]
pub struct ReadingArgs {
    /// Which hand it is [default: what the file says, or right].
    #[arg(long, value_enum)]
    pub side: Option<SideArg>,
    /// The recording is a mirror image, as selfie cameras make them.
    #[arg(long)]
    pub mirrored: bool,
    /// Unit of its lengths [default: what the file says, or m].
    #[arg(long, value_enum, value_name = "UNIT")]
    pub demo_unit: Option<DemoUnitArg>,
    /// Order of key points that have no names.
    #[arg(long, value_enum, default_value_t = OrderArg::Openpose)]
    pub order: OrderArg,
    /// Frames per second [default: what the file says, or 30].
    #[arg(long, value_name = "HZ", value_parser = positive)]
    pub fps: Option<f64>,
    /// First and last frame to take, such as 24-73, counted from 0.
    #[arg(long, value_name = "A-B", value_parser = frames)]
    pub frames: Option<[usize; 2]>,
    /// Object poses from another file or folder: NPY, NPZ, CSV, or FoundationPose's text files.
    #[arg(long, value_name = "PATH")]
    pub object_poses: Option<PathBuf>,
    /// Your MANO model as NPZ, for recordings that hold MANO parameters alone.
    #[arg(long, value_name = "FILE")]
    pub mano_model: Option<PathBuf>,
    /// MANO's axis angles are offsets from the flat hand, not from its mean pose.
    #[arg(long)]
    pub mano_flat_hand: bool,
    /// Focal length of the camera in pixels, for HaMeR.
    #[arg(long, value_name = "PX", value_parser = positive)]
    pub focal: Option<f64>,
}

/// See [`drex_retarget::Objective`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ObjectiveArg {
    /// Vectors from the wrist to the fingertips.
    Vector,
    /// The same and the vectors between fingertips, with pinches drawn together.
    Dexpilot,
    /// Positions of fingertips and middle joints; the wrist floats.
    Position,
    /// Contacts with the object over the whole clip, no penetration, no self-collision.
    Grasp,
}

impl ObjectiveArg {
    /// The name as files write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vector => "vector",
            Self::Dexpilot => "dexpilot",
            Self::Position => "position",
            Self::Grasp => "grasp",
        }
    }
}

impl From<ObjectiveArg> for Objective {
    fn from(objective: ObjectiveArg) -> Self {
        match objective {
            // The grasp objective stays close to the result of the vectors.
            ObjectiveArg::Vector | ObjectiveArg::Grasp => Self::Vector,
            ObjectiveArg::Dexpilot => Self::DexPilot,
            ObjectiveArg::Position => Self::Position,
        }
    }
}

/// Which hand.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum SideArg {
    /// The right hand.
    Right,
    /// The left hand.
    Left,
}

impl From<SideArg> for Side {
    fn from(side: SideArg) -> Self {
        match side {
            SideArg::Right => Self::Right,
            SideArg::Left => Self::Left,
        }
    }
}

/// Unit of a demonstration.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum DemoUnitArg {
    /// Metres.
    M,
    /// Centimetres.
    Cm,
    /// Millimetres.
    Mm,
}

impl From<DemoUnitArg> for DemoUnit {
    fn from(unit: DemoUnitArg) -> Self {
        match unit {
            DemoUnitArg::M => Self::M,
            DemoUnitArg::Cm => Self::Cm,
            DemoUnitArg::Mm => Self::Mm,
        }
    }
}

/// Order of key points.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum OrderArg {
    /// Wrist, thumb, index, middle, ring, little: also MediaPipe's and HaMeR's.
    Openpose,
    /// MANO's own: wrist, index, middle, little, ring, thumb, then the tips.
    Mano,
}

impl From<OrderArg> for KeyPointOrder {
    fn from(order: OrderArg) -> Self {
        match order {
            OrderArg::Openpose => Self::OpenPose,
            OrderArg::Mano => Self::Mano,
        }
    }
}

/// `auto` or a factor.
#[derive(Debug, Clone, Copy)]
pub struct ScaleArg(pub Scale);

fn scale(text: &str) -> Result<ScaleArg, String> {
    if text == "auto" { Ok(ScaleArg(Scale::Auto)) } else { positive(text).map(|s| ScaleArg(Scale::Fixed(s))) }
}

fn frames(text: &str) -> Result<[usize; 2], String> {
    let range = text.split_once('-').and_then(|(a, b)| Some([a.trim().parse().ok()?, b.trim().parse().ok()?]));
    range.filter(|[a, b]| a <= b).ok_or_else(|| "expected FIRST-LAST, such as 24-73".into())
}
