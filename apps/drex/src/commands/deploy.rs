//! `drex deploy`: everything that driving the hand takes, in one file; and the grasp itself, with a hand or an emulated one.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use drex_core::fsutil;
use drex_hw::allegro::AllegroVersion;
use drex_hw::control::{EStop, GraspPlan};
use drex_hw::law::{LimitMode, LimitOptions, Nominal, TorqueLaw, torque_limits_nm};
use drex_hw::leap::table::MotorModel;
use drex_robot::Robot;
use drex_trial::{Reach, TrialOptions};
use serde::Serialize;
use serde_json::json;

use super::hw;
use crate::cli::{DeployArgs, HandArg};
use crate::predict::{Prediction, Ready};
use crate::timings::{self, Timing};
use crate::ui::Ui;

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
    force_law: ForceLaw,
    grasp: &'a Prediction,
    /// Angles of the joints before the fingers close, and what closing fingers are told.
    open_rad: Vec<f64>,
    closed_rad: Vec<f64>,
    limits: Limits,
}

/// How hard each joint may press, and why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Limits {
    /// mA or N m.
    pub unit: &'static str,
    /// While the fingers close,
    pub closing: Vec<f64>,
    /// and with the force.
    pub force: Vec<f64>,
    /// Of current and torque; absent where the hand takes torques.
    law: Option<TorqueLaw>,
    /// Motors that the law is of, and whether they were found or assumed; absent where the hand takes torques.
    motor: Option<&'static str>,
    motor_assumed: bool,
    /// Largest limit that a joint may get.
    cap: f64,
    /// Least and largest torque that published torque-current models give at the largest limit, N m.
    published_nm: Option<(f64, f64)>,
    /// Torque that the motors lack, N m.
    short_nm: Vec<f64>,
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

/// How the squeeze came about.
#[derive(Serialize)]
struct ForceLaw {
    what: &'static str,
    /// Largest torque of each joint, model order, N m.
    torque_limits_nm: Vec<f64>,
    margin: f64,
    shake_m_s2: f64,
}

/// What a hand was told, and what it did with it.
pub struct Deployed {
    /// `deploy.json`.
    pub file: PathBuf,
    /// How the fingers open and close.
    pub reach: Reach,
    /// How hard each joint may press.
    pub limits: Limits,
    /// What became of the grasp, if there was a hand.
    pub done: Option<hw::Done>,
}

/// Predicts, writes the file, and grasps if there is a hand.
pub fn run(args: &DeployArgs, seed: Option<u64>, ui: &Ui) -> Result<()> {
    // Before there is a hand that could be left with its torque on.
    let stop = hw::stop_button()?;
    let mut ready = Ready::of(&args.grasp, seed)?;
    limit_to_driver(&mut ready.robot, args)?;
    let grasp = ready.predict()?;
    if let Some(reason) = &grasp.cannot_hold {
        bail!("there is no grasp to deploy: {reason}");
    }
    let begun = Instant::now();
    let Deployed { file, limits, done, .. } = deploy(args, &ready, &grasp, &stop, ui)?;
    let mut timing = Timing::of(begun.elapsed().as_secs_f64());
    timing.input = Some(args.grasp.twin_or_policy.clone());
    timing.parts = [("network", grasp.network_ms), ("force", grasp.force_ms)]
        .map(|(part, ms)| (part.to_owned(), 1e-3 * ms))
        .into();
    timings::record(&ready.root, "deploy", timing)?;
    let most = limits.force.iter().copied().fold(0.0, f64::max);
    let short = limits.short_nm.iter().copied().fold(0.0, f64::max);
    let mut text = format!(
        "{}: {:.2} N on {:.0} g, at most {most:.3} {}\n  written  {}\n",
        grasp.hand,
        grasp.squeeze_n,
        1e3 * grasp.mass_kg,
        limits.unit,
        file.display()
    );
    text += &limits.text();
    if short > 0.0 {
        text += &format!(
            "  note     the limits leave a joint {short:.3} N m short of the grip force: the cap is {:.3} {}, --cap raises it\n",
            limits.cap, limits.unit
        );
    }
    match &done {
        Some(done) => text += &done.text(&grasp.joint_names, limits.unit),
        None => text += "  note     no hand moved: give --port PATH or --emulate",
    }
    let driven = done.as_ref().map(|d| d.json(&grasp.joint_names));
    ui.answer(&json!({ "out": file, "hand": grasp.hand, "limits": limits, "driven": driven }), text)
}

/// Writes the file for a grasp that can hold, and grasps with the hand that the arguments name, if any.
///
/// # Errors
/// If there is no driver for the hand, the file cannot be written, or the hand fails.
pub fn deploy(args: &DeployArgs, ready: &Ready, grasp: &Prediction, stop: &EStop, ui: &Ui) -> Result<Deployed> {
    let setup = hw::Setup::for_model(&grasp.hand, &args.link)?;
    let reach = ready.reach(grasp)?;
    // The motors decide what a current gives.
    let guarded = |port| hw::Driver::guarded(&setup, port, &args.guard, args.run.rate);
    let mut driver = args.port.as_deref().map(guarded).transpose()?;
    if let Some(driver) = &mut driver {
        driver.ready_to_move(&args.allow, ui)?;
    }
    let found = driver.as_ref().and_then(hw::Driver::model);
    let limits = limits(args, &setup, found, grasp)?;
    if let Some(warning) = limits.warning.as_ref().filter(|_| driver.is_none()) {
        ui.note(warning);
    }
    let file = write(args, ready, grasp, (&reach.open, &reach.closed), &limits)?;
    let poses = [reach.open.clone(), reach.open.clone(), reach.closed.clone()];
    let (closing, force) = (limits.closing.clone(), limits.force.clone());
    let plan = match setup.hand {
        HandArg::Leap => GraspPlan::leap(poses, closing, force),
        HandArg::Allegro => GraspPlan::allegro(poses, closing, force),
    };
    let plan = plan.with_hold_s(args.hold);
    let how =
        hw::Run { stop, rate_hz: args.run.rate, outage: args.guard.outage, limp: false, log: args.run.log.as_deref() };
    let done = match &mut driver {
        Some(driver) => Some(hw::grasp(driver.hand(), &drex_hw::SystemClock::default(), plan, &how)?),
        None if args.emulate => Some(hw::grasp_emulated(&setup, plan, &reach.grasp, &how)?),
        None => None,
    };
    Ok(Deployed { file, reach, limits, done })
}

/// No joint is asked for more than the hand that is driven takes, where its version takes less than the model says.
fn limit_to_driver(robot: &mut Robot, args: &DeployArgs) -> Result<()> {
    if !matches!(hw::kind(&robot.name), Ok((HandArg::Allegro, _))) {
        return Ok(());
    }
    let setup = hw::Setup::for_model(&robot.name, &args.link)?;
    for (name, cap) in setup.allegro.names.iter().zip(setup.most_nm) {
        for joint in robot.joints.iter_mut().filter(|j| j.name == *name) {
            joint.effort_limit = Some(joint.effort_limit.map_or(cap, |e| e.min(cap)));
        }
    }
    Ok(())
}

/// Limits under which the joints give the torques of the grip force, with motors that were `found` at a port.
fn limits(args: &DeployArgs, setup: &hw::Setup, found: Option<MotorModel>, grasp: &Prediction) -> Result<Limits> {
    let torques_nm = &grasp.joint_torques_nm;
    if setup.hand == HandArg::Allegro {
        let options = &setup.allegro;
        let wire_caps = options.torque_caps_nm();
        let wire = |name: &String| options.names.iter().position(|n| n == name);
        let caps: Vec<f64> = grasp.joint_names.iter().map(|n| wire(n).map_or(0.0, |j| wire_caps[j])).collect();
        let force = torque_limits_nm(torques_nm, FLOOR_NM, &caps)?;
        let short_nm = torques_nm.iter().zip(&force).map(|(t, f)| (t.abs() - f).max(0.0)).collect();
        let closing = caps.iter().map(|c| CLOSING_NM.min(*c)).collect();
        // A V5 is sent currents: what they give is as uncertain as with LEAP.
        let most_ma = force.iter().copied().fold(0.0, f64::max) * options.wire_per_nm;
        let spread = (options.version == AllegroVersion::V5).then(|| Nominal::spread_nm(Nominal::V5, most_ma));
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
    let law: TorqueLaw = match &args.law {
        Some(file) => fsutil::from_json(file, &fsutil::read_text(file)?)?,
        None => TorqueLaw::nominal(models[0])?,
    };
    let mode = if args.uniform { LimitMode::Uniform } else { LimitMode::Jacobian };
    let cap = setup.leap.cap_ma.unwrap_or(model.gentle_cap_ma());
    model.check_cap_ma(cap)?;
    let options = LimitOptions::default().with_mode(mode).with_range_ma(FLOOR_MA.min(cap), cap);
    let laws = vec![law.clone(); torques_nm.len()];
    let force = options.limits_ma(&laws, torques_nm)?;
    let most_ma = force.iter().copied().fold(0.0, f64::max);
    let short_nm = options.short_nm(&laws, torques_nm, &force)?;
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
        warning: hw::above_recommended(model, cap),
    })
}

impl Limits {
    /// The cap in force, the motors, and what is not known of them.
    fn text(&self) -> String {
        let mut text = match self.motor {
            Some(motor) => {
                let known = if self.motor_assumed { " (assumed: no hand was asked)" } else { "" };
                format!("  motors   {motor}{known}, cap {} mA per joint\n", self.cap)
            }
            None => format!("  cap      {:.3} N m at most per joint\n", self.cap),
        };
        let uncalibrated = self.law.as_ref().is_none_or(|law| !law.is_calibrated());
        if let Some((low, high)) = self.published_nm.filter(|_| uncalibrated) {
            let most = self.force.iter().copied().fold(0.0, f64::max);
            text += &format!(
                "  note     nobody has calibrated these motors: at {most:.3} {} published torque-current models give {low:.3} to {high:.3} N m; drex hw calibrate\n",
                self.unit
            );
        }
        text
    }
}

fn write(
    args: &DeployArgs,
    ready: &Ready,
    grasp: &Prediction,
    (open_rad, closed_rad): (&[f64], &[f64]),
    limits: &Limits,
) -> Result<PathBuf> {
    let card = ready.folder.join("policy.json");
    let card: serde_json::Value = fsutil::from_json(&card, &fsutil::read_text(&card)?)?;
    let field = |name: &str| {
        let text = card.get(name).and_then(|v| v.as_str()).map(str::to_owned);
        text.with_context(|| {
            format!("{} has no \"{name}\": train the policy again", ready.folder.join("policy.json").display())
        })
    };
    let options = TrialOptions::default();
    let deployment = Deployment {
        schema: SCHEMA,
        written_by: concat!("drex ", env!("CARGO_PKG_VERSION")),
        weights: Weights {
            policy: ready.folder.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default(),
            file: field("weights_file")?,
            sha256: field("weights_sha256")?,
        },
        units: Units { joints: "rad", length: "m", mass: "kg", force: "N", torque: "N m", current: "mA" },
        force_law: ForceLaw {
            what: "smallest sum of normal forces that carries the weight and shakes in every direction at the lowest friction believed in, times the margin, within the torques of the motors",
            torque_limits_nm: ready.robot.effort_limits()?,
            margin: options.law.margin,
            shake_m_s2: options.shake_m_s2,
        },
        grasp,
        open_rad: open_rad.to_vec(),
        closed_rad: closed_rad.to_vec(),
        limits: limits.clone(),
    };
    let out = match &args.out {
        Some(out) => out.clone(),
        // The network's folder is policy/network of a twin.
        None if ready.folder.ends_with("policy/network") => ready.folder.with_file_name("deploy.json"),
        None => ready.folder.join("deploy.json"),
    };
    fsutil::write_atomic(&out, &serde_json::to_vec_pretty(&deployment)?)?;
    Ok(out)
}
