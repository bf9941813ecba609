//! Arguments of `identify`, `plan-push` and `calibrate-hand`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use drex_mesh::LengthUnit;
use drex_sysid::Parameter;

use super::OnOff;
use super::values::{direction, named_prior, named_value, positive, range};

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
    /// Write the result to this file as well, with the law of the mass and trajectories.
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
