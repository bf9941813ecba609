//! `drex hw`: hands on the bench.

mod calibrate;
mod calibrate_zero;
mod drive;
mod emulate;
#[cfg(unix)]
mod fault;
mod look;
mod off;

use anyhow::{Context, Result, bail};
use drex_hw::control::EStop;
use drex_hw::driver::{Driver, GraspResult, Setup, cap_range};
use drex_hw::{EffortUnit, Hand};
use serde_json::{Value, json};

use crate::cli::{AllowArgs, HandArgs, HwCommand};
use crate::ui::Ui;

/// Does one of them.
pub fn run(command: &HwCommand, ui: &Ui) -> Result<()> {
    match command {
        HwCommand::Ping(args) => look::ping(args, ui),
        HwCommand::Status(args) => look::status(args, ui),
        HwCommand::Off(args) => off::off(args, ui),
        HwCommand::Release(args) => off::release(args, ui),
        HwCommand::Move(args) => drive::move_to(args, ui),
        HwCommand::Record(args) => drive::record(args, ui),
        HwCommand::Calibrate(args) => calibrate::run(args, ui),
        HwCommand::CalibrateZero(args) => calibrate_zero::run(args, ui),
        HwCommand::Emulate(args) => emulate::run(args, ui),
        HwCommand::Guard => serve_guard(),
    }
}

/// A stop that Ctrl-C and SIGTERM press.
///
/// # Errors
/// If the system refuses.
pub fn stop_button() -> Result<EStop> {
    let stop = EStop::new();
    #[cfg(unix)]
    drex_hw::control::stop_on_signals(&stop)?;
    Ok(stop)
}

/// `name=rad,…` for joints of a hand.
fn angles(text: &str, names: &[String]) -> Result<Vec<(usize, f64)>> {
    text.split(',')
        .map(|part| {
            let (name, angle) = part.split_once('=').with_context(|| format!("\"{part}\" is not JOINT=RAD"))?;
            let joint = names.iter().position(|n| n == name.trim());
            let joint = joint
                .with_context(|| format!("there is no joint \"{}\"; there are {}", name.trim(), names.join(", ")))?;
            let angle: f64 = angle.trim().parse().with_context(|| format!("\"{angle}\" is no angle in rad"))?;
            if !angle.is_finite() {
                bail!("the angle of {name} is {angle}");
            }
            Ok((joint, angle))
        })
        .collect()
}

/// The setup of a hand on the command line.
fn setup(hand: &HandArgs) -> Result<Setup> {
    Ok(Setup::of(hand.hand.into(), &hand.link.options())?)
}

/// Refuses to move a hand that is not as it should be, unless that is allowed by name, and notes a warning.
fn ready_to_move(driver: &mut Driver, allow: &AllowArgs, ui: &Ui) -> Result<()> {
    let warning = driver.ready_to_move(&allow.kinds()).map_err(with_allow_flag)?;
    warning.iter().for_each(|warning| ui.note(warning));
    Ok(())
}

/// The error, and behind findings that may be allowed the flag that does it.
pub fn with_allow_flag(error: impl Into<anyhow::Error>) -> anyhow::Error {
    let error = error.into();
    let message = format!("{error:#}");
    if message.contains("allow it by name") { anyhow::anyhow!("{message} (--allow)") } else { error }
}

/// Is the guard of the program at the standard input.
fn serve_guard() -> Result<()> {
    #[cfg(unix)]
    return Ok(drex_hw::guard::serve()?);
    #[cfg(not(unix))]
    bail!("there is no guard on this system");
}

/// How efforts of a hand are written.
fn unit(hand: &dyn Hand) -> &'static str {
    match hand.effort_unit() {
        EffortUnit::Milliampere => "mA",
        _ => "N m",
    }
}

/// The cap in force and what it is measured by.
fn cap_text(driver: &mut Driver) -> String {
    let model = driver.model();
    let hand = driver.hand();
    let (low, high) = cap_range(hand.effort_caps());
    let unit = unit(hand);
    let each = if low == high { format!("{high} {unit}") } else { format!("{low:.3} to {high:.3} {unit}") };
    match model {
        Some(model) => format!(
            "{each} per joint ({}: start with {} mA, the authors of LEAP recommend at most {} mA, it stalls at {} mA)",
            model.name(),
            model.gentle_cap_ma(),
            model.recommended_cap_ma(),
            model.peak_ma()
        ),
        None => format!("{each} per joint"),
    }
}

/// The cap in force for programs.
fn cap_json(driver: &mut Driver) -> Value {
    let motor = driver.model().map(drex_hw::leap::table::MotorModel::name);
    let hand = driver.hand();
    json!({ "per_joint": hand.effort_caps(), "unit": unit(hand), "motor": motor })
}

/// In words; efforts in `unit`.
pub fn grasp_text(done: &GraspResult, joints: &[String], unit: &str) -> String {
    let touching = done.outcome.contacts.iter().flatten().count();
    let mut text = match (done.outcome.missed, done.outcome.lost) {
        (true, _) => format!("  grasp    missed: {touching} joints touched; the hand opened again\n"),
        (_, true) => "  grasp    lost while it held; the hand opened\n".to_owned(),
        _ => format!("  grasp    {touching} joints pressed, held, and opened again\n"),
    };
    for (j, name) in joints.iter().enumerate() {
        if let Some(contact) = &done.outcome.contacts[j] {
            let (held, force) = (done.outcome.held_effort.get(j).copied().unwrap_or(0.0), done.force[j]);
            text +=
                &format!("    {name:<8} touched at {:.3} rad, held {held:.3} of {force:.3} {unit}\n", contact.position);
        }
    }
    text + &drive::account(&done.report, joints)
}

/// For programs.
pub fn grasp_json(done: &GraspResult, joints: &[String]) -> Value {
    json!({
        "missed": done.outcome.missed, "lost": done.outcome.lost, "contacts": done.contacts(joints),
        "loop": drive::stats(&done.report),
    })
}
