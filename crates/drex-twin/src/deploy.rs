//! Everything that driving the hand takes, in one file; and the grasp itself, with a hand or an emulated one.

use std::path::PathBuf;
use std::time::Duration;

use crate::Result;
use crate::error::Context;
use drex_core::fsutil;
use drex_hw::allegro::AllegroVersion;
use drex_hw::control::{EStop, GraspPlan};
use drex_hw::driver::{self, Driver, GraspResult, GuardSettings, HandKind, Run, Setup, SetupOptions};
use drex_hw::leap::FindingKind;
use drex_hw::leap::table::MotorModel;
use drex_hw::torque_current::{LimitMode, LimitOptions, Nominal, TorqueCurrentModel, torque_limits_nm};
use drex_robot::Robot;
use drex_trial::{Reach, TrialOptions};
use serde::Serialize;

use crate::Progress;
use crate::predict::{Prediction, Predictor};

/// Layout of the file.
const SCHEMA: u32 = 2;
/// Current with which LEAP's fingers close, and least current of a joint that only keeps its place, mA.
const CLOSING_MA: f64 = 60.0;
const FLOOR_MA: f64 = 20.0;
/// Torque with which Allegro's fingers close, and least torque of a joint that only keeps its place, N m.
const CLOSING_NM: f64 = 0.04;
const FLOOR_NM: f64 = 0.02;

/// `deploy.json`.
#[derive(Serialize)]
struct Deployment<'a> {
    schema: u32,
    written_by: &'static str,
    weights: Weights,
    units: Units,
    #[serde(rename = "force_law")]
    grip_force_policy: GripForcePolicy,
    grasp: &'a Prediction,
    /// Angles of the joints before the fingers close, and what closing fingers are commanded.
    open_rad: Vec<f64>,
    closed_rad: Vec<f64>,
    limits: Limits,
}

/// How hard each joint may press, and why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Limits {
    /// Unit of the efforts: mA or N m.
    pub unit: &'static str,
    /// Largest effort of each joint while the fingers close.
    pub closing: Vec<f64>,
    /// Largest effort of each joint in the hold.
    pub force: Vec<f64>,
    /// Torque-current model; absent where the hand takes torques.
    pub law: Option<TorqueCurrentModel>,
    /// Motors that the model is of; absent where the hand takes torques.
    pub motor: Option<&'static str>,
    /// Whether the motors were assumed, not found.
    pub motor_assumed: bool,
    /// Largest limit that a joint may get.
    pub cap: f64,
    /// Least and largest torque that published torque-current models give at the largest limit, N m.
    pub published_nm: Option<(f64, f64)>,
    /// Torque that each joint lacks, N m.
    pub short_nm: Vec<f64>,
    /// What is to be said of the cap.
    #[serde(skip)]
    warning: Option<String>,
}

/// Which network it is.
#[derive(Serialize)]
struct Weights {
    policy: String,
    file: String,
    sha256: String,
}

#[derive(Serialize)]
struct Units {
    joints: &'static str,
    length: &'static str,
    mass: &'static str,
    force: &'static str,
    torque: &'static str,
    current: &'static str,
}

/// How the grip force came about.
#[derive(Serialize)]
struct GripForcePolicy {
    what: &'static str,
    /// Largest torque of each joint, model order, N m.
    torque_limits_nm: Vec<f64>,
    margin: f64,
    shake_m_s2: f64,
}

/// The hand that carries a grasp out.
#[derive(Debug, Clone)]
pub enum DeployTo {
    /// None: the file is written and nothing moves.
    Nothing,
    /// An emulated hand in its own time.
    Emulated,
    /// The hand at a port, behind a guard if there are settings of one, in spite of the findings that are allowed.
    Port {
        /// Serial port or CAN interface.
        port: PathBuf,
        /// Settings of the guard; `None` drives the hand without one.
        guard: Option<GuardSettings>,
        /// Findings in spite of which the hand moves.
        allowed: Vec<FindingKind>,
    },
}

/// How a grasp is deployed.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct DeployOptions {
    /// Hand that carries the grasp out.
    pub to: DeployTo,
    /// How the hand is driven.
    pub setup: SetupOptions,
    /// File to write; `None`: `deploy.json` beside the network.
    pub out: Option<PathBuf>,
    /// File of the torque-current model of the motors; `None`: the data sheet's of the motors found.
    pub torque_model: Option<PathBuf>,
    /// Whether all joints get the current that the joint needs that needs most, as in the paper.
    pub uniform: bool,
    /// Time of the hold, s.
    pub hold_s: f64,
    /// Rate of the control loop, cycles per second.
    pub rate_hz: f64,
    /// Longest time for which the hand may be out of reach.
    pub outage: Duration,
    /// File of the joint log.
    pub log: Option<PathBuf>,
}

impl Default for DeployOptions {
    /// Writes the file and moves nothing; a hold of 3 s at 400 cycles per second.
    fn default() -> Self {
        Self {
            to: DeployTo::Nothing,
            setup: SetupOptions::default(),
            out: None,
            torque_model: None,
            uniform: false,
            hold_s: 3.0,
            rate_hz: 400.0,
            outage: Duration::from_secs(3),
            log: None,
        }
    }
}

/// What a hand was commanded, and what it did with it.
pub struct Deployed {
    /// `deploy.json`.
    pub file: PathBuf,
    /// How the fingers open and close.
    pub reach: Reach,
    /// How hard each joint may press.
    pub limits: Limits,
    /// What became of the grasp, if there was a hand.
    pub done: Option<GraspResult>,
}

/// Writes the file for a grasp that can hold, and grasps with the hand that the arguments name, if any.
///
/// # Errors
/// If there is no driver for the hand, the file cannot be written, or the hand fails.
pub fn deploy(
    predictor: &Predictor,
    prediction: &Prediction,
    options: &DeployOptions,
    stop: &EStop,
    progress: &dyn Progress,
) -> Result<Deployed> {
    let setup = Setup::for_model(&prediction.grasp.hand, &options.setup)?;
    // The motors decide what a current gives.
    let mut driver = match &options.to {
        DeployTo::Port { port, guard, allowed } => {
            let mut driver = Driver::guarded(&setup, port, guard.as_ref(), options.rate_hz)?;
            driver.ready_to_move(allowed)?.iter().for_each(|warning| progress.note(warning));
            Some(driver)
        }
        DeployTo::Nothing | DeployTo::Emulated => None,
    };
    let reach = prediction.reach.clone();
    let found = driver.as_ref().and_then(Driver::model);
    let limits = limits(options, &setup, found, prediction)?;
    if let Some(warning) = limits.warning.as_ref().filter(|_| driver.is_none()) {
        progress.note(warning);
    }
    let file = write(options, predictor, prediction, (&reach.open, &reach.closed), &limits)?;
    let poses = [reach.open.clone(), reach.open.clone(), reach.closed.clone()];
    let (closing, force) = (limits.closing.clone(), limits.force.clone());
    let plan = match setup.hand {
        HandKind::Leap => GraspPlan::leap(poses, closing, force),
        HandKind::Allegro => GraspPlan::allegro(poses, closing, force),
    };
    let plan = plan.with_hold_s(options.hold_s);
    let DeployOptions { rate_hz, outage, .. } = *options;
    let run = Run { stop, rate_hz, outage, torque_off: false, log: options.log.as_deref() };
    let done = match (&mut driver, &options.to) {
        (Some(driver), _) => Some(driver::grasp(driver.hand(), &drex_hw::SystemClock::default(), plan, &run)?),
        (None, DeployTo::Emulated) => Some(driver::grasp_emulated(&setup, plan, &reach.grasp, &run)?),
        (None, _) => None,
    };
    Ok(Deployed { file, reach, limits, done })
}

/// Lowers the largest torque of each joint to what the hand that is driven takes, where its version takes less than the model says.
///
/// # Errors
/// If the setup is not one of this hand.
pub fn limit_to_driver(robot: &mut Robot, setup: &SetupOptions) -> Result<()> {
    if !matches!(HandKind::of_model(&robot.name), Ok((HandKind::Allegro, _))) {
        return Ok(());
    }
    let setup = Setup::for_model(&robot.name, setup)?;
    for (name, cap) in setup.allegro.names.iter().zip(setup.most_nm) {
        for joint in robot.joints.iter_mut().filter(|j| j.name == *name) {
            joint.effort_limit = Some(joint.effort_limit.map_or(cap, |e| e.min(cap)));
        }
    }
    Ok(())
}

/// Limits under which the joints give the torques of the grip force, with motors that were `found` at a port.
fn limits(
    options: &DeployOptions,
    setup: &Setup,
    found: Option<MotorModel>,
    prediction: &Prediction,
) -> Result<Limits> {
    let torques_nm = &prediction.joint_torques_nm;
    if setup.hand == HandKind::Allegro {
        let allegro = &setup.allegro;
        let wire_caps = allegro.torque_caps_nm();
        let wire = |name: &String| allegro.names.iter().position(|n| n == name);
        let caps: Vec<f64> =
            prediction.grasp.joint_names.iter().map(|n| wire(n).map_or(0.0, |j| wire_caps[j])).collect();
        let force = torque_limits_nm(torques_nm, FLOOR_NM, &caps)?;
        let short_nm = torques_nm.iter().zip(&force).map(|(t, f)| (t.abs() - f).max(0.0)).collect();
        let closing = caps.iter().map(|c| CLOSING_NM.min(*c)).collect();
        // A V5 is sent currents: what they give is as uncertain as with LEAP.
        let most_ma = force.iter().copied().fold(0.0, f64::max) * allegro.wire_per_nm;
        let spread = (allegro.version == AllegroVersion::V5).then(|| Nominal::spread_nm(Nominal::V5, most_ma));
        let limits = Limits {
            unit: "N m",
            closing,
            force,
            law: None,
            motor: None,
            motor_assumed: false,
            cap: caps.iter().copied().fold(0.0, f64::max),
            published_nm: spread.transpose()?,
            short_nm,
            warning: None,
        };
        return Ok(limits);
    }
    let model = found.unwrap_or_else(|| setup.expected_motors());
    let models = model.torque_current_models();
    let law: TorqueCurrentModel = match &options.torque_model {
        Some(file) => fsutil::from_json(file, &fsutil::read_text(file)?)?,
        None => TorqueCurrentModel::nominal(models[0])?,
    };
    let mode = if options.uniform { LimitMode::Uniform } else { LimitMode::Jacobian };
    let cap = setup.leap.cap_ma.unwrap_or(model.gentle_cap_ma());
    model.check_cap_ma(cap)?;
    let limit = LimitOptions::default().with_mode(mode).with_range_ma(FLOOR_MA.min(cap), cap);
    let laws = vec![law.clone(); torques_nm.len()];
    let force = limit.limits_ma(&laws, torques_nm)?;
    let most_ma = force.iter().copied().fold(0.0, f64::max);
    let short_nm = limit.short_nm(&laws, torques_nm, &force)?;
    Ok(Limits {
        unit: "mA",
        closing: vec![CLOSING_MA.min(cap); torques_nm.len()],
        force,
        law: Some(law),
        motor: Some(model.name()),
        motor_assumed: found.is_none(),
        cap,
        published_nm: Some(Nominal::spread_nm(models, most_ma)?),
        short_nm,
        warning: driver::cap_warning(model, cap),
    })
}

fn write(
    options: &DeployOptions,
    predictor: &Predictor,
    prediction: &Prediction,
    (open_rad, closed_rad): (&[f64], &[f64]),
    limits: &Limits,
) -> Result<PathBuf> {
    let card = predictor.folder.join("policy.json");
    let card: serde_json::Value = fsutil::from_json(&card, &fsutil::read_text(&card)?)?;
    let field = |name: &str| {
        let text = card.get(name).and_then(|v| v.as_str()).map(str::to_owned);
        text.with_context(|| {
            format!("{} has no \"{name}\": train the policy again", predictor.folder.join("policy.json").display())
        })
    };
    let trial = TrialOptions::default();
    let deployment = Deployment {
        schema: SCHEMA,
        written_by: concat!("drex ", env!("CARGO_PKG_VERSION")),
        weights: Weights {
            policy: predictor.folder.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default(),
            file: field("weights_file")?,
            sha256: field("weights_sha256")?,
        },
        units: Units { joints: "rad", length: "m", mass: "kg", force: "N", torque: "N m", current: "mA" },
        grip_force_policy: GripForcePolicy {
            what: "smallest sum of normal forces that carries the weight and shakes in every direction at the lowest friction assumed, times the margin, within the torques of the motors",
            torque_limits_nm: predictor.robot.effort_limits()?,
            margin: trial.law.margin,
            shake_m_s2: trial.shake_m_s2,
        },
        grasp: prediction,
        open_rad: open_rad.to_vec(),
        closed_rad: closed_rad.to_vec(),
        limits: limits.clone(),
    };
    let out = match &options.out {
        Some(out) => out.clone(),
        // The network's folder is policy/network of a twin.
        None if predictor.folder.ends_with("policy/network") => predictor.folder.with_file_name("deploy.json"),
        None => predictor.folder.join("deploy.json"),
    };
    fsutil::write_atomic(&out, &serde_json::to_vec_pretty(&deployment).map_err(crate::Error::json)?)?;
    Ok(out)
}
