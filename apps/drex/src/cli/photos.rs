//! Arguments of `sfm`, `masks`, `reconstruct`, `asset` and `render`: from photos to a solid, and back to pictures.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use drex_core::Pose;
use drex_mesh::{KnownDistance, LengthUnit};
use drex_sfm::marker::Marker;
use drex_splat::train::{DensityChoice, Preset};
use drex_twin::manifest::{ObjectClick, ScanPreset};
use nalgebra::{Point3, Similarity3};

use super::ToolArgs;
use super::values::{direction, known_distance, numbers, pose, positive, region, similarity, size};

/// `drex sfm`.
#[derive(Debug, Args)]
pub struct SfmArgs {
    /// Folder of photos (JPEG, PNG), in it or in images/, photos/ or input/; or a video.
    #[arg(value_name = "PHOTOS|VIDEO")]
    pub photos: PathBuf,
    /// Folder to write: sparse/0 and more (COLMAP's binary models), transforms.json, report.json, cameras.png.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Folder of masks named like the photos: white is all that keeps its shape together, black is not looked at. For objects that
    /// turn while the camera stands still; photos taken round an object are better without.
    #[arg(long, value_name = "DIR")]
    pub masks: Option<PathBuf>,
    /// A printed AprilTag in the photos and the width of its black border in metres: gives the model metres, up and origin.
    #[arg(long, value_name = "tag36h11:ID:SIDE_M")]
    pub marker: Option<Marker>,
    /// Calibration of the camera, which is kept: a 3 x 3 matrix, or fx fy cx cy k1 k2 p1 p2, pixels, as OpenCV has them.
    #[arg(long, value_name = "K.txt")]
    pub camera: Option<PathBuf>,
    /// The ffmpeg program.
    #[arg(long, value_name = "PROGRAM", default_value = "ffmpeg")]
    pub ffmpeg: PathBuf,
    /// How long it may take.
    #[command(flatten)]
    pub tools: ToolArgs,
}

/// Programs that find cameras and take frames for `masks` and `reconstruct`.
#[derive(Debug, Args)]
pub struct ProgramArgs {
    /// Let COLMAP, or this program, find the cameras of photos that have none.
    #[arg(long, value_name = "PROGRAM", num_args = 0..=1, require_equals = true, default_missing_value = "colmap")]
    pub colmap: Option<PathBuf>,
    /// The ffmpeg program.
    #[arg(long, value_name = "PROGRAM", default_value = "ffmpeg")]
    pub ffmpeg: PathBuf,
    /// How long they may take.
    #[command(flatten)]
    pub tools: ToolArgs,
}

/// `drex masks`.
#[derive(Debug, Args)]
pub struct MasksArgs {
    /// Folder with photos, with their cameras (a COLMAP model or transforms.json) or alone: then as `drex sfm` finds them; or a
    /// video, of which ffmpeg takes frames.
    #[arg(value_name = "PHOTOS|VIDEO")]
    pub scan: PathBuf,
    /// Folder to write: masks/NAME.png for each photo (white is the object), masks/report.json; sfm/ where cameras were found.
    /// Masks that somebody changed are kept.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// A pixel of a photo that shows the object, where several things stand on the table, such as 512,300@IMG_1001.jpg.
    #[arg(long, value_name = "X,Y@PHOTO", conflicts_with = "region")]
    pub object: Option<ObjectClick>,
    /// Box of the object in the frame and unit of the scan, where it is not alone: lower and upper corner.
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", value_parser = region, allow_hyphen_values = true)]
    pub region: Option<[Point3<f64>; 2]>,
    /// Up in the frame of the scan, as X,Y,Z [default: away from the table].
    #[arg(long, value_name = "X,Y,Z", value_parser = direction, allow_hyphen_values = true)]
    pub up: Option<[f64; 3]>,
    /// The programs that may be called.
    #[command(flatten)]
    pub programs: ProgramArgs,
}

/// `drex reconstruct`.
#[derive(Debug, Args)]
pub struct ReconstructArgs {
    /// Folder with photos, with their cameras (a COLMAP model or transforms.json) or alone: then as `drex sfm` finds them; or a
    /// video, of which ffmpeg takes frames.
    pub scan: PathBuf,
    /// Folder to write: splat/appearance.ply and splat/report.json; where `drex asset` made an asset of the same scan, Gaussians
    /// are born on its mesh.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// How much time it may take: minutes, tens of minutes, hours.
    #[arg(long, value_enum, default_value_t = PresetArg::Default)]
    pub preset: PresetArg,
    /// How Gaussians are born and removed: Markov chain Monte Carlo or adaptive density control.
    #[arg(long, value_enum, default_value_t = DensityArg::Mcmc)]
    pub density: DensityArg,
    /// Hold out every N-th photo by name and score the Gaussians on them.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(usize))]
    pub hold_out: Option<usize>,
    /// Folder of the masks (white is the object) [default: SCAN/masks].
    #[arg(long, value_name = "DIR")]
    pub masks: Option<PathBuf>,
    /// Train the whole scene even where there are masks of the object.
    #[arg(long)]
    pub whole_scene: bool,
    /// Longest side of the photos in training, pixels [default: the preset's].
    #[arg(long, value_name = "PX")]
    pub max_side: Option<usize>,
    /// Steps of training [default: the preset's].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub iterations: Option<u32>,
    /// Most Gaussians [default: the preset's].
    #[arg(long, value_name = "N")]
    pub max_gaussians: Option<usize>,
    /// Give each photo an affine colour of its own, for photos of differing exposure.
    #[arg(long)]
    pub exposure: bool,
    /// Refine the cameras' poses.
    #[arg(long)]
    pub refine_poses: bool,
    /// Steps between checkpoints; 0 for none.
    #[arg(long, value_name = "N", default_value_t = 1000)]
    pub checkpoint_every: u32,
    /// Go on from the checkpoints of a run that was stopped.
    #[arg(long)]
    pub resume: bool,
    /// Megabytes of photos kept in memory.
    #[arg(long, value_name = "MB", default_value_t = 1024)]
    pub memory_mb: usize,
    /// Write them in this format too: spz (small, for the web) or splat; repeatable.
    #[arg(long, value_enum, value_name = "FORMAT")]
    pub also: Vec<SplatFormat>,
    /// Draw on the GPU (needs a build with `--features wgpu`).
    #[arg(long)]
    pub gpu: bool,
    /// The programs that may be called.
    #[command(flatten)]
    pub programs: ProgramArgs,
}

/// Formats of Gaussians beside PLY; both lose precision.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum SplatFormat {
    /// Niantic's, compressed.
    Spz,
    /// 32 bytes a Gaussian, colour from one side only.
    Splat,
}

/// See [`drex_splat::train::Preset`].
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum PresetArg {
    /// Minutes on one core.
    Fast,
    /// Tens of minutes.
    Default,
    /// Hours.
    Best,
}

impl From<PresetArg> for Preset {
    fn from(preset: PresetArg) -> Self {
        match preset {
            PresetArg::Fast => Self::Fast,
            PresetArg::Default => Self::Default,
            PresetArg::Best => Self::Best,
        }
    }
}

impl From<PresetArg> for ScanPreset {
    fn from(preset: PresetArg) -> Self {
        match preset {
            PresetArg::Fast => Self::Fast,
            PresetArg::Default => Self::Default,
            PresetArg::Best => Self::Best,
        }
    }
}

/// See [`drex_splat::train::DensityChoice`].
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum DensityArg {
    /// Clone, split, prune.
    Adaptive,
    /// Relocation and noise, up to a cap.
    Mcmc,
}

impl From<DensityArg> for DensityChoice {
    fn from(density: DensityArg) -> Self {
        match density {
            DensityArg::Adaptive => Self::Adaptive,
            DensityArg::Mcmc => Self::Mcmc,
        }
    }
}

/// `drex asset`.
#[derive(Debug, Args)]
pub struct AssetArgs {
    /// STL, OBJ, PLY, GLTF or GLB file; a scan (a folder of photos or a video, as for `reconstruct`, or an RGB-D recording with
    /// cam_K.txt and poses of the object); or a twin.toml whose object has parts and joints.
    pub input: PathBuf,
    /// Folder to write: mesh/, asset/object.xml; for scans also what `reconstruct` writes.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Mass of the object, kg; without it the density is assumed and said so.
    #[arg(long, value_name = "KG", value_parser = positive, conflicts_with = "density")]
    pub mass: Option<f64>,
    /// Density, kg/m³ [default: 1000].
    #[arg(long, value_name = "KG_M3", value_parser = positive)]
    pub density: Option<f64>,
    /// Hollow inside, with walls of this thickness, metres.
    #[arg(long, value_name = "M", value_parser = positive)]
    pub wall: Option<f64>,
    /// Convex pieces at most [default: the manifest's, or 20].
    #[arg(long, value_name = "N")]
    pub pieces: Option<NonZeroUsize>,
    /// Unit of the mesh's coordinates: m, cm, mm, in, or auto (told by the size).
    #[arg(long, value_name = "UNIT", default_value = "auto")]
    pub unit: LengthUnit,
    /// Direction in the mesh or scan that points up while the object stands on the table, as X,Y,Z [default: 0,0,1; glTF:
    /// 0,1,0; scans: away from the table].
    #[arg(long, value_name = "X,Y,Z", value_parser = direction, allow_hyphen_values = true)]
    pub up: Option<[f64; 3]>,
    /// Coulomb friction written into the MJCF [default: the manifest's, or 0.5].
    #[arg(long, value_name = "MU", value_parser = positive)]
    pub friction: Option<f64>,
    /// MJCF of a robot to put into asset/scene.xml, by reference.
    #[arg(long, value_name = "FILE")]
    pub robot: Option<PathBuf>,
    /// Mesh of the static scene for asset/scene.xml.
    #[arg(long, value_name = "FILE")]
    pub background: Option<PathBuf>,
    /// Measured pose of the mesh frame in the robot's world for asset/scene.xml: x,y,z in metres and a quaternion.
    #[arg(long, value_name = "X,Y,Z,QW,QX,QY,QZ", value_parser = pose, allow_hyphen_values = true)]
    pub pose: Option<Pose>,
    /// What scans need.
    #[command(flatten)]
    pub scan: ScanArgs,
}

/// Options of `drex asset` for scans.
#[derive(Debug, Args)]
#[command(next_help_heading = "Scans")]
pub struct ScanArgs {
    /// Metres per unit of the scan.
    #[arg(long, value_name = "M", value_parser = positive)]
    pub scale: Option<f64>,
    /// Known distance between two marks, metres, such as A-C=0.12; repeatable.
    #[arg(long, value_name = "A-B=M", value_parser = known_distance, conflicts_with = "scale")]
    pub distance: Vec<KnownDistance>,
    /// A printed AprilTag in the photos and the width of its black border in metres: gives the scale.
    #[arg(long, value_name = "tag36h11:ID:SIDE_M", conflicts_with_all = ["scale", "distance"])]
    pub marker: Option<Marker>,
    /// Pixels of the marks in the photos: {"photo.jpg": {"A": [x, y]}} [default: SCAN/marks.json].
    #[arg(long, value_name = "FILE")]
    pub marks: Option<PathBuf>,
    /// Folder of the object's poses in an RGB-D recording [default: annotated_poses, ob_in_cam or poses in it].
    #[arg(long, value_name = "DIR")]
    pub poses: Option<PathBuf>,
    /// Folder of the masks (white is the object) [default: SCAN/masks].
    #[arg(long, value_name = "DIR")]
    pub masks: Option<PathBuf>,
    /// How carefully depth is looked for, where there are no depth maps yet.
    #[arg(long, value_enum, default_value_t = PresetArg::Fast)]
    pub preset: PresetArg,
    /// Look for depth on the GPU (needs a build with `--features wgpu`).
    #[arg(long)]
    pub gpu: bool,
    /// Box of the object in the frame and unit of the scan, where it is not alone: lower and upper corner.
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", value_parser = region, allow_hyphen_values = true)]
    pub region: Option<[Point3<f64>; 2]>,
    /// A pixel of a photo that shows the object, where several things stand on the table, such as 512,300@IMG_1001.jpg.
    #[arg(long, value_name = "X,Y@PHOTO", conflicts_with = "region")]
    pub object: Option<ObjectClick>,
    /// Side of a voxel, metres [default: by the size of the object and of a pixel on it].
    #[arg(long, value_name = "M", value_parser = positive)]
    pub voxel: Option<f64>,
    /// Let COLMAP, or this program, find the cameras of photos that have none.
    #[arg(long, value_name = "PROGRAM", num_args = 0..=1, require_equals = true, default_missing_value = "colmap")]
    pub colmap: Option<PathBuf>,
    /// How long other programs may take.
    #[command(flatten)]
    pub tools: ToolArgs,
}

/// `drex render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// Gaussians: PLY, SPZ or SPLAT.
    pub splat: PathBuf,
    /// Folder for the pictures; maps go to depth/ and normal/ in it.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Take the cameras of this scan (COLMAP model or transforms.json), one picture a view.
    #[arg(long, value_name = "SCAN", conflicts_with = "orbit")]
    pub cameras: Option<PathBuf>,
    /// Of those cameras take only the view with this name.
    #[arg(long, value_name = "NAME", requires = "cameras")]
    pub view: Option<String>,
    /// Number of cameras on a circle round the scene [default: 60, or one a picture with --trajectory].
    #[arg(long, value_name = "N")]
    pub orbit: Option<NonZeroUsize>,
    /// Centre of the circle, scene units [default: the middle of the Gaussians].
    #[arg(long, value_name = "X,Y,Z", value_parser = numbers::<3>, allow_hyphen_values = true, conflicts_with = "cameras")]
    pub center: Option<[f64; 3]>,
    /// Radius of the circle, scene units [default: shows the whole scene].
    #[arg(long, value_name = "R", value_parser = positive, conflicts_with = "cameras")]
    pub radius: Option<f64>,
    /// Height of the circle over the centre as an angle, degrees.
    #[arg(long, value_name = "DEG", default_value_t = 25.0, allow_hyphen_values = true, conflicts_with = "cameras")]
    pub elevation: f64,
    /// Direction that is up in the scene; scans by COLMAP often have 0,-1,0.
    #[arg(long, value_name = "X,Y,Z", value_parser = direction, default_value = "0,0,1", allow_hyphen_values = true, conflicts_with = "cameras")]
    pub up: [f64; 3],
    /// Angle of view from left to right, degrees.
    #[arg(long, value_name = "DEG", default_value_t = 50.0, value_parser = positive, conflicts_with = "cameras")]
    pub fov: f64,
    /// Size of the pictures [default: 640x480, or that of the scan's photos].
    #[arg(long, value_name = "WxH", value_parser = size)]
    pub size: Option<[usize; 2]>,
    /// Colour behind everything, 0 to 1.
    #[arg(long, value_name = "R,G,B", value_parser = numbers::<3>, default_value = "0,0,0")]
    pub background: [f64; 3],
    /// The Gaussians are surfels although their file does not say so.
    #[arg(long)]
    pub surfels: bool,
    /// Correct the opacity of splats smaller than a pixel, for sets trained that way.
    #[arg(long)]
    pub antialias: bool,
    /// Write expected depth, scene units, as well.
    #[arg(long, value_enum, value_name = "npy|exr")]
    pub depth: Option<MapFormat>,
    /// Write normals (camera frame: x right, y down, z forward) as well; surfels only.
    #[arg(long, value_enum, value_name = "npy|exr")]
    pub normal: Option<MapFormat>,
    /// Gaussians of an object that moves over the scene.
    #[arg(long, value_name = "SPLAT", requires = "trajectory")]
    pub object: Option<PathBuf>,
    /// Its poses in the scene's frame, csv with t,x,y,z,qw,qx,qy,qz (s, m).
    #[arg(long, value_name = "POSES.csv", requires = "object")]
    pub trajectory: Option<PathBuf>,
    /// Pictures per second of the trajectory.
    #[arg(long, value_name = "1/S", default_value_t = 30.0, value_parser = positive)]
    pub fps: f64,
    /// Maps the object's Gaussians to the frame its poses are of: metres per unit of the Gaussians, then a pose.
    #[arg(long, value_name = "SCALE[,X,Y,Z,QW,QX,QY,QZ]", value_parser = similarity, requires = "object", allow_hyphen_values = true)]
    pub object_from_splat: Option<Similarity3<f64>>,
    /// The same for the Gaussians of the scene.
    #[arg(long, value_name = "SCALE[,X,Y,Z,QW,QX,QY,QZ]", value_parser = similarity, allow_hyphen_values = true)]
    pub scene_from_splat: Option<Similarity3<f64>>,
}

/// How maps are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MapFormat {
    /// NumPy arrays.
    Npy,
    /// OpenEXR pictures.
    Exr,
}
