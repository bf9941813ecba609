//! The command line.

mod batch;
mod grasp;
mod help;
mod hw;
mod mesh;
mod photos;
mod push;
mod retarget;
mod values;

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};
use drex_recording::convert::mujoco_push::{ForceQuality, PoseQuality};

use values::positive;

pub use batch::{BatchArgs, BatchCommand, BatchPlace};
pub use grasp::{DeployArgs, GraspArgs};
pub use help::command;
pub use hw::{
    AllegroArg, AllowArgs, CalibrateArgs, CalibrateZeroArgs, EmulateArgs, GuardArgs, HandArg, HandArgs, HwCommand,
    LinkArgs, MotorArg, MoveArgs, RecordArgs, ReleaseArgs, RunArgs,
};
pub use mesh::{MeshCheckArgs, MeshCommand, MeshConvertArgs, MeshPictureArgs};
pub use photos::{AssetArgs, MapFormat, MasksArgs, ReconstructArgs, RenderArgs, SfmArgs, SplatFormat};
pub use push::{CalibrateHandArgs, IdentifyArgs, MethodArg, PlanPushArgs};
pub use retarget::{DetectorArg, HandsArgs, ObjectiveArg, ReadingArgs, RetargetArgs};

/// From a scan, a recorded push and human grasps to a weighed digital twin and a grasp with the right force.
#[derive(Debug, Parser)]
#[command(
    name = "drex",
    version,
    max_term_width = 110,
    after_help = "drex SUBCOMMAND --help says more, with examples; drex doctor says what this machine has and lacks.\n\
        Exit status: 0 done (a verdict such as \"not identifiable\" is an answer), 1 failed, 2 wrong usage, \
        75 another drex is at work on the folder: try again later."
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
    /// Run a folder of twins, or find grasps for a list of meshes: many objects, many machines.
    Batch(BatchArgs),
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

/// on or off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum OnOff {
    /// Use it.
    On,
    /// Leave it out.
    Off,
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
