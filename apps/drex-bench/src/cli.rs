//! Arguments of `drex-bench`, and where its answers go.

use std::io::Write as _;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use drex_bench::generate::MassClass;
use drex_trial::Engine;
use serde::Serialize;

use crate::experiments::Experiment;

/// How well drex grasps: objects, synthetic demonstrations, experiments, tables.
#[derive(Debug, Parser)]
#[command(name = "drex-bench", version, max_term_width = 110)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// Answer with one JSON object on stdout.
    #[arg(long, global = true)]
    pub json: bool,
    /// Seed of everything random.
    #[arg(long, global = true, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Worker threads [default: one per core].
    #[arg(long, global = true, value_name = "N")]
    pub threads: Option<std::num::NonZeroUsize>,
    /// Log more on stderr.
    #[arg(short, long, global = true)]
    pub verbose: bool,
}

/// Where the answer goes: text for a person, or JSON.
#[derive(Debug, Clone, Copy)]
pub struct Output {
    pub json: bool,
}

impl Output {
    /// Writes the answer to stdout.
    pub fn answer(self, value: &impl Serialize, text: impl AsRef<str>) -> anyhow::Result<()> {
        let line = if self.json { serde_json::to_string(value)? } else { text.as_ref().trim_end().to_owned() };
        // A closed pipe is the reader's decision.
        let _ = writeln!(std::io::stdout(), "{line}");
        Ok(())
    }
}

/// The benches.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Make demonstrations for the objects of the bench and say how many grasps hold on paper.
    Demos(DemosArgs),
    /// Lift, hold and shake: how often the policy's grasps hold, against its rivals and against what the hand can do at all.
    Grasp(GraspArgs),
    /// Make random objects: boxes, cylinders, letters and bottles of 20 g to 1.5 kg, each as a mesh with its exact mass properties.
    Objects(ObjectsArgs),
    /// Make many small twin folders: tins of random sizes and masses, each with a simulated push and grasps of its own.
    Twins(TwinsArgs),
    /// Make verified grasps of random objects for a network that is trained on many: a file for each object, those that are there are kept.
    GraspData(GraspDataArgs),
    /// Train a network that proposes grasps on the files that `grasp-data` made.
    GraspTrain(GraspTrainArgs),
    /// How the grasps of a network hold on objects of categories that it has not seen, beside those of a search.
    Unseen(UnseenArgs),
    /// Make the tables of `benches/results` again: a file for each, with its command, seed, commit and core-minutes.
    Tables(TablesArgs),
}

/// What the benches have in common.
#[derive(Debug, Args)]
pub struct Common {
    /// TOML list of objects in place of the made ones: an `object` table for each, with name, mesh, mass_kg and perhaps friction, max_force_n,
    /// damaged_at_n, up, unit.
    #[arg(long, value_name = "FILE.toml")]
    pub objects: Option<PathBuf>,
    /// Only the objects of these names; repeatable.
    #[arg(long, value_name = "NAME")]
    pub only: Vec<String>,
    /// Robot hand: leap, allegro, or a file as `drex retarget` takes it.
    #[arg(long, value_name = "NAME|FILE", default_value = "leap")]
    pub hand: String,
    /// Most that any joint gives, N m [default: what the hand's model says].
    #[arg(long, value_name = "N_M", value_parser = positive)]
    pub torque_cap: Option<f64>,
    /// Folder for grasps (kept for the next run), tables and plots.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Demonstrations per object.
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..=400))]
    pub clips: u32,
}

/// `drex-bench demos`.
#[derive(Debug, Args)]
pub struct DemosArgs {
    #[command(flatten)]
    pub common: Common,
    /// Pictures of this many grasps of each object, into --out.
    #[arg(long, value_name = "N", default_value_t = 0, requires = "out")]
    pub pictures: usize,
}

/// Engine of the evaluated trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum EngineArg {
    /// MuJoCo; only in builds with that feature.
    Mujoco,
    /// The project's own simulator.
    Diffsim,
}

impl From<EngineArg> for Engine {
    fn from(arg: EngineArg) -> Self {
        match arg {
            EngineArg::Mujoco => Self::Mujoco,
            EngineArg::Diffsim => Self::Diffsim,
        }
    }
}

/// `drex-bench grasp`.
#[derive(Debug, Args)]
pub struct GraspArgs {
    #[command(flatten)]
    pub common: Common,
    /// What is compared.
    #[arg(long, value_enum)]
    pub experiment: Experiment,
    /// Rollouts of each cell of the table; all cells have the same ones.
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub rollouts: u32,
    /// Engine of the evaluated trials.
    #[arg(long = "judge", value_enum, default_value_t = EngineArg::Diffsim)]
    pub engine: EngineArg,
    /// Passes of the training over the demonstrations [default: the policy's].
    #[arg(long, value_name = "N")]
    pub epochs: Option<usize>,
    /// Grasps that are practised in the simulator before they are learned, those that need least force; 0: none.
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub practice: u32,
    /// Factor on the grip force that just survives the shakes; 1 leaves nothing for errors of mass, contacts and motors.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.25, value_parser = margin)]
    pub margin: f64,
    /// Carry every command out in drex-diffsim as well, and say how often the two engines agree.
    #[arg(long)]
    pub compare: bool,
    /// Beside each row of a network: without the network, without practice, without the dry run of the closing, with one force for all.
    #[arg(long)]
    pub ablations: bool,
}

/// `drex-bench objects`.
#[derive(Debug, Args)]
pub struct ObjectsArgs {
    /// Number of objects, numbered from 0; the first ones are the same whatever the number.
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub count: u32,
    /// How their mass is spread; shapes and frictions do not depend on it.
    #[arg(long, value_enum, default_value_t = MassClass::Solid)]
    pub mass: MassClass,
    /// Folder for NAME/object.obj and NAME/object.json.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// `drex-bench twins`.
#[derive(Debug, Args)]
pub struct TwinsArgs {
    /// Number of twins, numbered from 0; the first ones are the same whatever the number.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub count: u32,
    /// Number of broken twins beside them, each with one fault; the faults take turns.
    #[arg(long, value_name = "K", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=100_000))]
    pub broken: u32,
    /// Folder for the twins twin-000, twin-001, ... and broken-0, broken-1, ...
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// `drex-bench grasp-data`.
#[derive(Debug, Args)]
pub struct GraspDataArgs {
    /// Objects of categories that no network is trained on.
    #[arg(long)]
    pub held_out: bool,
    /// Robot hand: leap, allegro, or a file as `drex retarget` takes it.
    #[arg(long, value_name = "NAME|FILE", default_value = "leap")]
    pub hand: String,
    /// Number of the first object.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub first: u64,
    /// Number of objects; the first ones are the same whatever the number.
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub count: u64,
    /// Pinches that the search looks at for each object.
    #[arg(long, value_name = "N", default_value_t = 8_000)]
    pub pinches: usize,
    /// Power grasps that it tries.
    #[arg(long, value_name = "N", default_value_t = 150)]
    pub powers: usize,
    /// Grasps that are closed and labelled at most, for each object.
    #[arg(long, value_name = "N", default_value_t = 150)]
    pub closed: usize,
    /// Of these, how many are climbed from, to neighbours that carry more.
    #[arg(long, value_name = "N", default_value_t = 10)]
    pub climbed: usize,
    /// How many of all are simulated.
    #[arg(long, value_name = "N", default_value_t = 4)]
    pub simulated: usize,
    /// Folder for NAME.json.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// `drex-bench grasp-train`.
#[derive(Debug, Args)]
pub struct GraspTrainArgs {
    /// Folder of `grasp-data`.
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// Robot hand: leap, allegro, or a file as `drex retarget` takes it.
    #[arg(long, value_name = "NAME|FILE", default_value = "leap")]
    pub hand: String,
    /// Steps of the optimiser.
    #[arg(long, value_name = "N", default_value_t = 6000)]
    pub steps: usize,
    /// Prototypes of grasps.
    #[arg(long, value_name = "N", default_value_t = 256)]
    pub prototypes: usize,
    /// The network, a safetensors file.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// `drex-bench unseen`.
#[derive(Debug, Args)]
pub struct UnseenArgs {
    /// A network of `grasp-train` [default: the one that ships for the hand].
    #[arg(long, value_name = "FILE")]
    pub network: Option<PathBuf>,
    /// Robot hand: leap, allegro, or a file as `drex retarget` takes it.
    #[arg(long, value_name = "NAME|FILE", default_value = "leap")]
    pub hand: String,
    /// Number of the first object.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub first: u64,
    /// Number of objects.
    #[arg(long, value_name = "K", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub count: u64,
    /// Rollouts of each object and way.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub rollouts: u32,
    /// Pinches that the exhaustive search looks at; a fiftieth as many power grasps are tried.
    #[arg(long, value_name = "N", default_value_t = 20_000)]
    pub search: usize,
    /// Engine of the evaluated trials.
    #[arg(long = "judge", value_enum, default_value_t = EngineArg::Diffsim)]
    pub engine: EngineArg,
}

/// `drex-bench tables`.
#[derive(Debug, Args)]
pub struct TablesArgs {
    /// Only the tables of these names; repeatable.
    #[arg(long, value_name = "NAME")]
    pub only: Vec<String>,
    /// Engine of the evaluated trials.
    #[arg(long = "judge", value_enum, default_value_t = EngineArg::Diffsim)]
    pub engine: EngineArg,
    /// Folder for NAME.md.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

fn margin(text: &str) -> Result<f64, String> {
    let factor: f64 = text.parse().map_err(|_| format!("\"{text}\" is no number"))?;
    if (1.0..=10.0).contains(&factor) { Ok(factor) } else { Err("give 1 to 10".into()) }
}

/// A finite number above zero.
fn positive(text: &str) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| format!("\"{text}\" is no number"))?;
    if number > 0.0 && number.is_finite() { Ok(number) } else { Err("give a number above zero".into()) }
}
