//! The command line.

mod grasp;
mod help;
mod hw;
mod retarget;

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};
use drex_core::Pose;
use drex_core::pose::pose_from_wxyz;
use drex_mesh::{KnownDistance, LengthUnit};
use drex_recording::convert::mujoco_push::{ForceQuality, PoseQuality};
use drex_sfm::marker::Marker;
use drex_splat::train::{DensityChoice, Preset};
use drex_sysid::Parameter;
use drex_twin::scan::ObjectClick;
use nalgebra::{Point3, Similarity3};

pub use grasp::{DeployArgs, GraspArgs};
pub use help::command;
pub use hw::{
    AllegroArg, AllowArgs, CalibrateArgs, CalibrateZeroArgs, EmulateArgs, GuardArgs, HandArg, HandArgs, HwCommand,
    LinkArgs, MotorArg, MoveArgs, RecordArgs, ReleaseArgs, RunArgs,
};
pub use retarget::{DetectorArg, HandsArgs, ObjectiveArg, ReadingArgs, RetargetArgs};

/// From a scan, a recorded push and human grasps to a weighed digital twin and a grasp with the right force.
#[derive(Debug, Parser)]
#[command(
    name = "drex",
    version,
    max_term_width = 110,
    after_help = "drex SUBCOMMAND --help says more, with examples; drex doctor says what this machine has and lacks.\n\
        Exit status: 0 done (a verdict such as \"not identifiable\" is an answer), 1 failed, 2 wrong usage."
)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// Options of every subcommand.
    #[command(flatten)]
    pub common: Common,
}

/// Options that every subcommand takes.
#[derive(Debug, Args)]
#[command(next_help_heading = "Everywhere")]
pub struct Common {
    /// Print one JSON object on stdout; everything else goes to stderr.
    #[arg(long, global = true)]
    pub json: bool,
    /// Seed of everything random; overrides the manifest's.
    #[arg(long, global = true, value_name = "N")]
    pub seed: Option<u64>,
    /// Number of worker threads, at most 1024; results do not depend on it.
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Memory that a file may take; also of the whole command, but for those that train, simulate or move a hand [default: 4].
    #[arg(long, global = true, value_name = "GB", value_parser = positive)]
    pub max_memory: Option<f64>,
    /// Time that the command may take [default: 60 for `drex mesh`, none for others].
    #[arg(long, global = true, value_name = "S", value_parser = positive)]
    pub max_seconds: Option<f64>,
    /// Log more to stderr (repeat for more).
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
}

/// The subcommands, in the order of the path from scan to grasp.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Find where photos were taken from, and sparse points, with a report; or say why not.
    Sfm(SfmArgs),
    /// Cut the object out of photos: a mask for each, to look at and to correct.
    Masks(MasksArgs),
    /// Train Gaussians for looks and for geometry from photos, and write depth maps.
    Reconstruct(ReconstructArgs),
    /// Make a sim-ready asset of a mesh or a scan: closed, in convex pieces, with mass properties, as MJCF.
    Asset(AssetArgs),
    /// Check, convert or look at meshes.
    #[command(subcommand)]
    Mesh(MeshCommand),
    /// Weigh an object from recorded pushes, or say why they cannot.
    Identify(IdentifyArgs),
    /// Rank pushes of an object by how well they would weigh it.
    PlanPush(PlanPushArgs),
    /// Find the joint friction of a hand in logs of its runs, for `identify --hand`.
    CalibrateHand(CalibrateHandArgs),
    /// Draw Gaussians from the cameras of a scan or on an orbit.
    ///
    /// With --object and --trajectory an object moves through the scene.
    Render(RenderArgs),
    /// Find a person's hand in a video, with a detector that is installed on this machine.
    Hands(HandsArgs),
    /// Map a person's hand to a robot hand: by vectors, or with contacts on the object.
    Retarget(RetargetArgs),
    /// Fit the demonstrated grasps to the object and train the grasp network on them.
    Train(TwinArgs),
    /// Judge the predicted grasps by the static check.
    Evaluate(TwinArgs),
    /// Predict a grasp and its force for an object that stands somewhere.
    Grasp(GraspArgs),
    /// Write what driving the hand takes into one file, and grasp with a hand or an emulated one.
    Deploy(DeployArgs),
    /// Look at, move, record, calibrate or emulate a hand.
    #[command(subcommand)]
    Hw(HwCommand),
    /// Do every stage of a twin folder whose inputs changed, then write report.html.
    Run(TwinArgs),
    /// Write report.html again (and what it needs).
    Report(TwinArgs),
    /// Run the whole path on bundled data.
    Demo(DemoArgs),
    /// Make twin folders from recordings in other layouts.
    Import(ImportArgs),
    /// Say what is on this machine and what is missing for which feature.
    Doctor,
    /// Print the completions of a shell.
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
    /// Print the manual page of drex, or write those of all subcommands.
    Man(ManArgs),
}

/// `drex man`.
#[derive(Debug, Args)]
pub struct ManArgs {
    /// Folder for drex.1 and a page for each subcommand, such as ~/.local/share/man/man1.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

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
    /// Folder to write: splat/appearance.ply, splat/surface.ply, splat/report.json, depth/.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// How much time it may take: minutes, tens of minutes, hours.
    #[arg(long, value_enum, default_value_t = PresetArg::Default)]
    pub preset: PresetArg,
    /// How Gaussians are born and removed: Markov chain Monte Carlo or adaptive density control.
    #[arg(long, value_enum, default_value_t = DensityArg::Mcmc)]
    pub density: DensityArg,
    /// Hold out every N-th photo by name and score the sets on them.
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
    /// Steps of each set [default: the preset's].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub iterations: Option<u32>,
    /// Most Gaussians of each set [default: the preset's].
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
    /// Write both sets in this format too: spz (small, for the web) or splat; repeatable.
    #[arg(long, value_enum, value_name = "FORMAT")]
    pub also: Vec<SplatFormat>,
    /// Draw on the GPU (needs a build with `--features wgpu`).
    #[arg(long)]
    pub gpu: bool,
    /// The programs that may be called.
    #[command(flatten)]
    pub programs: ProgramArgs,
}

/// How long other programs may take.
#[derive(Debug, Clone, Args)]
pub struct ToolArgs {
    /// Stop ffmpeg, or a step of COLMAP, that has not ended after this many minutes.
    #[arg(long, value_name = "MINUTES", default_value_t = 720.0, value_parser = positive)]
    pub tool_limit: f64,
}

impl Default for ToolArgs {
    fn default() -> Self {
        Self { tool_limit: 720.0 }
    }
}

impl ToolArgs {
    /// As a duration.
    pub fn limit(&self) -> Duration {
        Duration::try_from_secs_f64(60.0 * self.tool_limit).unwrap_or(Duration::MAX)
    }
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
    /// How much time the Gaussians may take, where there are no depth maps yet.
    #[arg(long, value_enum, default_value_t = PresetArg::Fast)]
    pub preset: PresetArg,
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

/// `drex mesh`.
#[derive(Debug, Subcommand)]
pub enum MeshCommand {
    /// Judge a mesh file, or a written asset (its folder or MJCF), by the rules of simulation; exit status 1 if one fails.
    Check(MeshCheckArgs),
    /// Repair, simplify if asked, and write in another format (by the name's ending).
    Convert(MeshConvertArgs),
    /// Draw meshes into a PNG, each in a colour of its own.
    Picture(MeshPictureArgs),
}

/// `drex mesh check`.
#[derive(Debug, Args)]
pub struct MeshCheckArgs {
    /// Mesh file, folder of an asset, or its object.xml.
    pub file: PathBuf,
    /// Unit of a mesh file: m, cm, mm, in, or auto (told by the size).
    #[arg(long, value_name = "UNIT", default_value = "auto")]
    pub unit: LengthUnit,
}

/// `drex mesh convert`.
#[derive(Debug, Args)]
pub struct MeshConvertArgs {
    /// STL, OBJ, PLY, GLTF or GLB file.
    pub input: PathBuf,
    /// File to write: .obj, .stl, .ply or .glb.
    pub output: PathBuf,
    /// Faces wanted.
    #[arg(long, value_name = "N")]
    pub faces: Option<usize>,
    /// Largest distance between the simplified and the given surface, in the file's unit.
    #[arg(long, value_name = "LENGTH", value_parser = positive)]
    pub max_error: Option<f64>,
}

/// `drex mesh picture`.
#[derive(Debug, Args)]
pub struct MeshPictureArgs {
    /// STL, OBJ, PLY, GLTF or GLB files.
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// PNG file to write.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Pixels of each side.
    #[arg(long, value_name = "PX", default_value_t = 640, value_parser = clap::value_parser!(u32).range(16..=8192))]
    pub size: u32,
    /// Direction of the eye from +x towards +y, degrees.
    #[arg(long, value_name = "DEGREES", default_value_t = 35.0, allow_hyphen_values = true)]
    pub azimuth: f64,
    /// Height of the eye over the horizon, degrees.
    #[arg(long, value_name = "DEGREES", default_value_t = 25.0, allow_hyphen_values = true)]
    pub elevation: f64,
}

/// `drex identify`.
#[derive(Debug, Args)]
pub struct IdentifyArgs {
    /// push.toml, or a folder with one; several pushes of one object are used together. Or a twin folder: its pushes and its prior.
    #[arg(required = true, value_name = "PUSH")]
    pub pushes: Vec<PathBuf>,
    /// Whether to use the fingertip's encoder, where there is one.
    #[arg(long, value_enum, default_value_t = OnOff::On)]
    pub encoder: OnOff,
    /// Estimate this parameter too (friction, clock_offset, center_x, ...); repeatable.
    #[arg(long, value_name = "NAME")]
    pub free: Vec<Parameter>,
    /// Take this value for a parameter; repeatable. With a fixed mass, the rest is fitted and nothing is weighed.
    #[arg(long, value_name = "NAME=VALUE", value_parser = named_value)]
    pub fix: Vec<(Parameter, f64)>,
    /// Expect this value with this standard deviation (of the logarithm, for a number that is positive by nature); repeatable.
    #[arg(long, value_name = "NAME=MEAN,SD", value_parser = named_prior)]
    pub prior: Vec<(Parameter, [f64; 2])>,
    /// First guess of the mass: kilograms, a material ("wood"), or a JSON file with somebody's answer. What the push alone says does not
    /// depend on it; the posterior of both is printed apart. --prior mass=MEAN,SD takes part in the estimate itself.
    #[arg(long, value_name = "KG|MATERIAL|FILE")]
    pub guess: Option<String>,
    /// How to look for the mass; adam is the D-REX paper's way, for comparison: it gives no interval.
    #[arg(long, value_enum, default_value_t = MethodArg::Lm)]
    pub method: MethodArg,
    /// Joint friction of the hand that pushed, from `drex calibrate-hand`; without it, it is found in the free motions of the
    /// same logs.
    #[arg(long, value_name = "FILE")]
    pub hand: Option<PathBuf>,
    /// Write the result to this file as well, with likelihood profile and trajectories.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

impl IdentifyArgs {
    /// Whether an option says something about the estimate.
    pub fn states_something(&self) -> bool {
        let stated = [self.free.is_empty(), self.fix.is_empty(), self.prior.is_empty(), self.guess.is_none()];
        let plain = [self.hand.is_none(), self.out.is_none(), self.method == MethodArg::Lm, self.encoder == OnOff::On];
        !stated.into_iter().chain(plain).all(|left_out| left_out)
    }
}

/// How the mass is looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MethodArg {
    /// Scan and Levenberg-Marquardt, with interval and verdict.
    Lm,
    /// Adam on the logarithm of the mass, from the first guess.
    Adam,
}

/// `drex plan-push`.
#[derive(Debug, Args)]
pub struct PlanPushArgs {
    /// Mesh of the object: STL, OBJ, PLY, GLTF or GLB.
    pub mesh: PathBuf,
    /// Range of masses that are thought possible, kg.
    #[arg(long, value_name = "LOW,HIGH", default_value = "0.05,1", value_parser = range)]
    pub masses: [f64; 2],
    /// Friction of the object on the table; unknown if left out.
    #[arg(long, value_name = "MU", value_parser = positive)]
    pub friction: Option<f64>,
    /// Height of a step that the object can be put on so that one end sticks out, m.
    #[arg(long, value_name = "M", value_parser = positive)]
    pub step: Option<f64>,
    /// Direction in the mesh that points up while the object stands [default: 0,0,1].
    #[arg(long, value_name = "X,Y,Z", value_parser = direction, allow_hyphen_values = true)]
    pub up: Option<[f64; 3]>,
    /// Unit of the mesh's coordinates: m, cm, mm, in, or auto (told by the size).
    #[arg(long, value_name = "UNIT", default_value = "auto")]
    pub unit: LengthUnit,
    /// TOML file with reaction_s, `[force]` and `[finger]` in place of the options below.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["max_force", "stiffness"])]
    pub robot: Option<PathBuf>,
    /// The robot pushes with a measured force of at most this, N.
    #[arg(long, value_name = "N", value_parser = positive)]
    pub max_force: Option<f64>,
    /// Noise of that force per sample at 100 Hz, N.
    #[arg(long, value_name = "N", default_value_t = 0.03, value_parser = positive)]
    pub force_noise: f64,
    /// It can push but not pull up.
    #[arg(long)]
    pub no_lift: bool,
    /// The robot pushes with a compliant fingertip of this stiffness, N/m.
    #[arg(long, value_name = "N/M", value_parser = positive)]
    pub stiffness: Option<f64>,
    /// Largest force of the fingertip, N.
    #[arg(long, value_name = "N", default_value_t = 10.0, value_parser = positive)]
    pub max_tip_force: f64,
    /// Fastest fingertip, m/s.
    #[arg(long, value_name = "M/S", default_value_t = 0.4, value_parser = positive)]
    pub max_speed: f64,
    /// Longest way of the fingertip, m.
    #[arg(long, value_name = "M", default_value_t = 0.15, value_parser = positive)]
    pub stroke: f64,
    /// Whether the fingertip's encoder is recorded.
    #[arg(long, value_enum, default_value_t = OnOff::On)]
    pub encoder: OnOff,
    /// Hand whose torque limits bound the force of the fingertip: a bundled name or a URDF or MJCF file.
    #[arg(long, value_name = "NAME|FILE")]
    pub hand: Option<String>,
    /// Try pushes that make the object fall over, too.
    #[arg(long)]
    pub topple: bool,
    /// Write the plan to this file as well.
    #[arg(long, value_name = "plan.toml")]
    pub out: Option<PathBuf>,
}

/// `drex calibrate-hand`.
#[derive(Debug, Args)]
pub struct CalibrateHandArgs {
    /// Pushes by one hand, each a push.toml or a folder with one, or a folder of such folders.
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// Where to write the calibration (JSON).
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
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

/// on or off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum OnOff {
    /// Use it.
    On,
    /// Leave it out.
    Off,
}

/// Subcommands on a twin folder.
#[derive(Debug, Args)]
pub struct TwinArgs {
    /// twin.toml, or the folder that holds it.
    #[arg(default_value = "twin.toml")]
    pub twin: PathBuf,
    /// How long other programs may take.
    #[command(flatten)]
    pub tools: ToolArgs,
}

/// `drex demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Folder for the demo's twin and report.
    #[arg(long, value_name = "DIR", default_value = "drex-demo")]
    pub out: PathBuf,
}

/// `drex import`.
#[derive(Debug, Args)]
pub struct ImportArgs {
    /// Layout of the source.
    #[command(subcommand)]
    pub source: ImportSource,
}

/// Layouts that can be imported.
#[derive(Debug, Subcommand)]
pub enum ImportSource {
    /// Recordings of the D-REX authors, a folder with runs/, objects/ and demos/, as one twin folder per object.
    DRex {
        /// The folder of the recordings; every run in it has a run.json.
        #[arg(value_name = "RECORDINGS")]
        dir: PathBuf,
        /// Where to make one twin folder per object.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        /// Only this object.
        #[arg(long, value_name = "NAME")]
        object: Option<String>,
    },
    /// One run of an Allegro hand, a folder with run.json, joint_states.csv and object_poses.txt, as a push.
    AllegroRun {
        /// The folder of the run.
        #[arg(value_name = "RUN")]
        run: PathBuf,
        /// Folder for push.toml and what it names.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
    /// One push that MuJoCo simulated, a folder with meta.json and csv files, as a push.
    MujocoPush {
        /// The folder of the push; the object's mesh lies one level up.
        #[arg(value_name = "SET/OBJECT/SCENARIO")]
        scenario: PathBuf,
        /// Which of its pose tracks to take.
        #[arg(long, default_value = "noisy", value_name = "noisy|hard|clean")]
        poses: PoseQuality,
        /// Which of its force records to take.
        #[arg(long, default_value = "noisy", value_name = "noisy|exact")]
        force: ForceQuality,
        /// Folder for push.toml and what it names.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() && v > 0.0 => Ok(v),
        _ => Err("expected a positive number".into()),
    }
}

fn named_value(text: &str) -> Result<(Parameter, f64), String> {
    let (name, value) = text.split_once('=').ok_or("expected NAME=VALUE, such as friction=0.4")?;
    let parameter = name.trim().parse::<Parameter>().map_err(|e| e.to_string())?;
    Ok((parameter, value.trim().parse().map_err(|_| format!("`{value}` is no number"))?))
}

fn named_prior(text: &str) -> Result<(Parameter, [f64; 2]), String> {
    let (head, sd) = text.rsplit_once(',').ok_or("expected NAME=MEAN,SD, such as friction=0.4,0.1")?;
    let (parameter, mean) = named_value(head)?;
    Ok((parameter, [mean, sd.trim().parse().map_err(|_| format!("`{sd}` is no number"))?]))
}

fn range(text: &str) -> Result<[f64; 2], String> {
    let (lo, hi) = text.split_once(',').ok_or("expected LOW,HIGH, such as 0.05,0.5")?;
    let (lo, hi) = (positive(lo.trim())?, positive(hi.trim())?);
    if lo <= hi { Ok([lo, hi]) } else { Err("expected the smaller number first".into()) }
}

fn known_distance(text: &str) -> Result<KnownDistance, String> {
    let wrong = || "expected two marks and metres, such as A-C=0.12".to_owned();
    let (marks, metres) = text.split_once('=').ok_or_else(wrong)?;
    let (from, to) = marks.split_once('-').ok_or_else(wrong)?;
    let distance_m = positive(metres.trim())?;
    Ok(KnownDistance { from: from.trim().to_owned(), to: to.trim().to_owned(), distance_m })
}

fn region(text: &str) -> Result<[Point3<f64>; 2], String> {
    let [x0, y0, z0, x1, y1, z1] = numbers(text)?;
    if x0 < x1 && y0 < y1 && z0 < z1 {
        Ok([Point3::new(x0, y0, z0), Point3::new(x1, y1, z1)])
    } else {
        Err("the second corner must be above the first along x, y and z".into())
    }
}

fn pose(text: &str) -> Result<Pose, String> {
    let [x, y, z, qw, qx, qy, qz] = numbers(text)?;
    pose_from_wxyz([x, y, z], [qw, qx, qy, qz]).map_err(|e| e.to_string())
}

fn direction(text: &str) -> Result<[f64; 3], String> {
    match numbers(text)? {
        d if d.iter().map(|v| v * v).sum::<f64>() > 1e-12 => Ok(d),
        _ => Err("expected a direction as three numbers X,Y,Z, not all zero".into()),
    }
}

fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let numbers = text.split(',').map(|s| s.trim().parse().ok().filter(|v: &f64| v.is_finite()));
    let numbers: Option<Vec<f64>> = numbers.collect();
    numbers.and_then(|v| v.try_into().ok()).ok_or_else(|| format!("expected {N} numbers with commas between them"))
}

fn size(text: &str) -> Result<[usize; 2], String> {
    let sides = text.split_once(['x', 'X']).and_then(|(w, h)| Some([w.trim().parse().ok()?, h.trim().parse().ok()?]));
    sides.filter(|[w, h]| *w > 0 && *h > 0).ok_or_else(|| "expected WIDTHxHEIGHT in pixels, such as 640x480".into())
}

fn similarity(text: &str) -> Result<Similarity3<f64>, String> {
    if !text.contains(',') {
        return Ok(Similarity3::from_scaling(positive(text)?));
    }
    let [s, x, y, z, qw, qx, qy, qz] = numbers(text)?;
    let pose = pose_from_wxyz([x, y, z], [qw, qx, qy, qz]).map_err(|e| e.to_string())?;
    if s > 0.0 { Ok(Similarity3::from_isometry(pose, s)) } else { Err("expected a positive scale".into()) }
}
