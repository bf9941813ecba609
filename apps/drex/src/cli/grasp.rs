//! `drex grasp` and `drex deploy`.

use std::path::PathBuf;

use clap::Args;
use drex_core::Pose;
use drex_twin::PredictOptions;
use drex_twin::deploy::{DeployOptions, DeployTo};

use super::values::{interval, pose, positive};
use super::{AllowArgs, GuardArgs, HandArg, LinkArgs, RunArgs};

/// `drex grasp`.
#[derive(Debug, Args)]
pub struct GraspArgs {
    /// twin.toml or its folder, after `drex train`; or the folder of a policy, with --mesh.
    #[arg(value_name = "TWIN|POLICY")]
    pub twin_or_policy: PathBuf,
    /// Mesh of the object, for the folder of a policy; metres, z up.
    #[arg(long, value_name = "FILE")]
    pub mesh: Option<PathBuf>,
    /// Robot hand that will grasp [default: the one that the policy is for].
    #[arg(long, value_name = "NAME|FILE")]
    pub hand: Option<String>,
    /// Pose of the object's mesh frame in the world: x,y,z in metres and a quaternion [default: at rest on the table z = 0].
    #[arg(long, value_name = "X,Y,Z,QW,QX,QY,QZ", value_parser = pose, allow_hyphen_values = true)]
    pub pose: Option<Pose>,
    /// Mass of the object, kg [default: the twin's].
    #[arg(long, value_name = "KG", value_parser = positive)]
    pub mass: Option<f64>,
    /// Friction between hand and object, or the ends of an interval that it is in [default: the twin's, or 0.3,0.8].
    #[arg(long, value_name = "MU|LOW,HIGH", value_parser = interval)]
    pub friction: Option<(f64, f64)>,
    /// Most that any joint gives, N m [default: the twin's, or what the hand's model says].
    #[arg(long, value_name = "N_M", value_parser = positive)]
    pub torque_cap: Option<f64>,
}

/// `drex deploy`.
#[derive(Debug, Args)]
pub struct DeployArgs {
    /// What is grasped, as for `drex grasp`.
    #[command(flatten)]
    pub grasp: GraspArgs,
    /// File to write [default: policy/deploy.json of the twin, deploy.json of the policy].
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Grasp with the hand at this port: a serial port, of Allegro that of an slcan adapter, or a CAN interface.
    #[arg(long, value_name = "PATH", conflicts_with = "emulate")]
    pub port: Option<PathBuf>,
    /// Grasp with an emulated hand.
    #[arg(long)]
    pub emulate: bool,
    /// Law of current and torque of the motors, from `drex hw calibrate` [default: the data sheet's of the motors found].
    #[arg(long, value_name = "FILE")]
    pub law: Option<PathBuf>,
    /// All joints get the current that the joint needs that needs most, as in the paper.
    #[arg(long)]
    pub uniform: bool,
    /// How long to hold, s.
    #[arg(long, value_name = "S", default_value_t = Self::HOLD_S, value_parser = positive)]
    pub hold: f64,
    /// How the hand is driven.
    #[command(flatten)]
    pub link: LinkArgs,
    /// Rate and log.
    #[command(flatten)]
    pub run: RunArgs,
    /// What can go wrong.
    #[command(flatten)]
    pub guard: GuardArgs,
    /// In spite of what.
    #[command(flatten)]
    pub allow: AllowArgs,
}

impl DeployArgs {
    const HOLD_S: f64 = 3.0;

    /// The same as a library takes it.
    pub fn options(&self) -> DeployOptions {
        let mut options = DeployOptions::default();
        options.to = match &self.port {
            Some(port) => {
                DeployTo::Port { port: port.clone(), guard: self.guard.settings(), allowed: self.allow.kinds() }
            }
            None if self.emulate => DeployTo::Emulated,
            None => DeployTo::Nothing,
        };
        options.setup = self.link.options();
        options.out.clone_from(&self.out);
        options.torque_model.clone_from(&self.law);
        (options.uniform, options.hold_s, options.rate_hz) = (self.uniform, self.hold, self.run.rate);
        options.outage = self.guard.outage;
        options.log.clone_from(&self.run.log);
        options
    }
}

impl GraspArgs {
    /// The same as a library takes it.
    pub fn options(&self) -> PredictOptions {
        PredictOptions {
            // A hand by its family's name is its right one.
            hand: self.hand.as_ref().map(|h| HandArg::of_family(h).map_or(h.clone(), |f| f.robot().to_owned())),
            world_from_object: self.pose,
            mass_kg: self.mass,
            friction: self.friction,
            torque_cap_nm: self.torque_cap,
        }
    }
}
