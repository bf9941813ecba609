//! `drex bench`.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};
use drex_trial::Judge;

use super::positive;
use crate::bench::experiments::Experiment;

/// `drex bench`.
#[derive(Debug, Subcommand)]
pub enum BenchCommand {
    /// Make demonstrations for the objects of the bench and say how many grasps hold on paper.
    Demos(DemosArgs),
    /// Lift, hold and shake: how often the policy's grasps hold, against its rivals and against what the hand can do at all.
    Grasp(GraspBenchArgs),
}

/// What the benches have in common.
#[derive(Debug, Args)]
pub struct BenchCommon {
    /// TOML list of objects in place of the made ones: an `object` table for each, with name, mesh, mass_kg and perhaps friction, max_force_n,
    /// up, unit.
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

/// `drex bench demos`.
#[derive(Debug, Args)]
pub struct DemosArgs {
    #[command(flatten)]
    pub common: BenchCommon,
    /// Pictures of this many grasps of each object, into --out.
    #[arg(long, value_name = "N", default_value_t = 0, requires = "out")]
    pub pictures: usize,
}

/// Which engine judges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum JudgeArg {
    /// MuJoCo; only in builds with that feature.
    Mujoco,
    /// The project's own simulator.
    Diffsim,
}

impl From<JudgeArg> for Judge {
    fn from(arg: JudgeArg) -> Self {
        match arg {
            JudgeArg::Mujoco => Self::Mujoco,
            JudgeArg::Diffsim => Self::Diffsim,
        }
    }
}

/// `drex bench grasp`.
#[derive(Debug, Args)]
pub struct GraspBenchArgs {
    #[command(flatten)]
    pub common: BenchCommon,
    /// What is compared.
    #[arg(long, value_enum)]
    pub experiment: Experiment,
    /// Rollouts of each cell of the table; all cells have the same ones.
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub rollouts: u32,
    /// The engine.
    #[arg(long, value_enum, default_value_t = JudgeArg::Diffsim)]
    pub judge: JudgeArg,
    /// Passes of the training over the demonstrations [default: the policy's].
    #[arg(long, value_name = "N")]
    pub epochs: Option<usize>,
    /// Grasps that are practised in the simulator before they are learned, those that need least force; 0: none.
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub practice: u32,
    /// Factor on the squeeze that just survives the shakes; 1 leaves nothing for errors of mass, contacts and motors.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.25, value_parser = margin)]
    pub margin: f64,
    /// Carry every command out in drex-diffsim as well, and say how often the two engines agree.
    #[arg(long)]
    pub compare: bool,
}

fn margin(text: &str) -> Result<f64, String> {
    let factor: f64 = text.parse().map_err(|_| format!("\"{text}\" is no number"))?;
    if (1.0..=10.0).contains(&factor) { Ok(factor) } else { Err("give 1 to 10".into()) }
}
