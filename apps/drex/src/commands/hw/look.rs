//! `drex hw ping` and `drex hw status`: who is there, and how it is doing.

use anyhow::{Result, bail};
use drex_hw::allegro::{AllegroVersion, reports_poses};
use drex_hw::dynamixel::{Bus, Port, SerialPort, Timing};
use drex_hw::leap::table::MotorModel;
use drex_hw::leap::{self, MotorReading};
use drex_hw::{JointStatus, SystemClock};
use serde::Serialize;

use super::{setup, unit};
use crate::cli::{HandArg, HandArgs};
use crate::ui::Ui;
use drex_hw::driver::{Driver, Setup, open_can};

/// A motor that answered.
#[derive(Serialize)]
struct Motor {
    id: u8,
    model: u16,
    name: &'static str,
    firmware: u8,
    alert: bool,
}

/// Who answers.
pub fn ping(args: &HandArgs, ui: &Ui) -> Result<()> {
    match args.hand {
        HandArg::Leap => ping_leap(args, ui),
        HandArg::Allegro => {
            let Driver::Allegro(mut hand) = Driver::connect(&setup(args)?, &args.port)? else { return Ok(()) };
            hand.wait_for_reports()?;
            if hand.stats().frames == 0 {
                bail!("nothing was heard of the hand: check its power, the cable and its generation (--allegro)");
            }
            let info = hand.info();
            let value = serde_json::json!({
                "hand": "allegro",
                "serial": hand.serial(),
                "hardware": info.map(|i| format!("{:x}.{:02x}", i.hardware >> 8, i.hardware & 0xff)),
                "firmware": info.map(|i| format!("{:x}.{:02x}", i.firmware >> 8, i.firmware & 0xff)),
                "left": info.map(|i| i.left),
                "frames": hand.stats().frames,
            });
            let known = |k: &str| value[k].as_str().map_or("not told", |v| v).to_owned();
            let text = format!(
                "Allegro at {}\n  serial    {}\n  hardware  {}\n  firmware  {}",
                args.port.display(),
                known("serial"),
                known("hardware"),
                known("firmware")
            );
            ui.answer(&value, text)
        }
    }
}

fn ping_leap(args: &HandArgs, ui: &Ui) -> Result<()> {
    let setup = setup(args)?;
    let port = SerialPort::open(&args.port, setup.leap.baud)?;
    let timing = port.latency().map_or_else(Timing::default, Timing::for_latency);
    let motors: Vec<Motor> = Bus::new(port, timing)
        .scan()?
        .into_iter()
        .map(|p| Motor {
            id: p.id,
            model: p.model,
            name: MotorModel::from_number(p.model).map_or("not a motor of LEAP", MotorModel::name),
            firmware: p.firmware,
            alert: p.alert,
        })
        .collect();
    let wanted: Vec<u8> = setup.leap.joints.iter().map(|j| j.id).collect();
    let missing: Vec<u8> = wanted.into_iter().filter(|id| motors.iter().all(|m| m.id != *id)).collect();
    if motors.is_empty() {
        bail!(
            "no motor answers at {} with {} baud: check the hand's power and cable, and --baud (motors leave the factory at 57600)",
            args.port.display(),
            setup.leap.baud
        );
    }
    let mut text = format!("{} motors at {}", motors.len(), args.port.display());
    for m in &motors {
        let alert = if m.alert { "  HARDWARE ERROR: see drex hw status" } else { "" };
        text += &format!("\n  {:3}  {} (model {}), firmware {}{alert}", m.id, m.name, m.model, m.firmware);
    }
    if !missing.is_empty() {
        text += &format!("\n  no answer from {missing:?}: a cable, an id, or another speed");
    }
    ui.answer(&serde_json::json!({ "hand": "leap", "motors": motors, "missing": missing }), text)
}

/// A joint in `status`.
#[derive(Serialize)]
struct JointLine {
    name: String,
    position_rad: Option<f64>,
    velocity_rad_s: Option<f64>,
    effort: Option<f64>,
    temperature_c: Option<f64>,
    voltage_v: Option<f64>,
    /// `None` where the hand does not tell.
    torque: Option<bool>,
    /// Register 98: 0 is off, 1 to 127 the silence in 20 ms after which the motor freezes, 255 that it has.
    watchdog: Option<u8>,
    homing_offset_ticks: Option<i32>,
    status: String,
    trouble: Option<String>,
}

/// A hand as it was found.
struct Found {
    joints: Vec<JointLine>,
    findings: Vec<String>,
    unit: &'static str,
    /// What somebody has to do something about.
    alarms: Vec<String>,
}

/// Angles, efforts, temperatures, watchdogs, findings.
///
/// # Errors
/// If the hand cannot be read; and, after the answer, if torque is on and nobody drives, a joint is silent or has a hardware error.
pub fn status(args: &HandArgs, ui: &Ui) -> Result<()> {
    let setup = setup(args)?;
    let Found { joints, findings, unit, alarms } = match args.hand {
        HandArg::Leap => look_at_leap(&setup, args)?,
        HandArg::Allegro => look_at_allegro(&setup, args)?,
    };
    let mut text = format!("{:?} at {}\n", args.hand, args.port.display());
    text += &format!(
        "  {:<10} {:>9} {:>9} {:>6} {:>6} {:>7} {:>9}  state\n",
        "joint", "rad", unit, "°C", "V", "offset", "watchdog"
    );
    let number = |value: Option<f64>, digits: usize| value.map_or_else(|| "-".into(), |v| format!("{v:.digits$}"));
    for j in &joints {
        let trouble = j.trouble.as_ref().map_or_else(String::new, |t| format!(": {t}"));
        let line = format!(
            "  {:<10} {:>9} {:>9} {:>6} {:>6} {:>7} {:>9}  {}{trouble}\n",
            j.name,
            number(j.position_rad, 4),
            number(j.effort, 3),
            number(j.temperature_c, 0),
            number(j.voltage_v, 1),
            number(j.homing_offset_ticks.map(f64::from), 0),
            watchdog(j.watchdog),
            j.status
        );
        text += &line;
    }
    for finding in &findings {
        text += &format!("  note  {finding}\n");
    }
    let value = serde_json::json!({
        "hand": setup.robot.name, "effort_unit": unit, "joints": joints, "findings": findings, "alarms": alarms,
    });
    ui.answer(&value, text)?;
    if !alarms.is_empty() {
        bail!("{}", alarms.join("; "));
    }
    Ok(())
}

/// The watchdog's register in words.
fn watchdog(register: Option<u8>) -> String {
    match register {
        None => "-".into(),
        Some(0) => "off".into(),
        Some(255) => "TRIPPED".into(),
        Some(units) => format!("{} ms", 20 * u32::from(units)),
    }
}

/// Reads without writing: torque stays as it is, and one dead motor hides no other.
fn look_at_leap(setup: &Setup, args: &HandArgs) -> Result<Found> {
    // Whoever opens the port has its lock: no other process holds it, and torque that is on is driven by nobody.
    let port = SerialPort::open(&args.port, setup.leap.baud)?;
    let found = leap::inspect_hand(port, &setup.robot, &setup.leap)?;
    let findings = found.findings.iter().map(ToString::to_string).collect();
    let state = |reading: Option<&MotorReading>| match reading {
        Some(r) if r.torque && r.is_frozen() => "torque on, frozen by its watchdog, driven by nobody",
        Some(r) if r.torque => "torque on, driven by nobody",
        Some(r) if r.is_frozen() => "torque off, watchdog tripped",
        Some(_) => "torque off",
        None => "silent",
    };
    let line = |m: leap::MotorInspection| {
        let reading = m.reading.as_ref();
        JointLine {
            name: m.joint,
            position_rad: reading.map(|r| r.position),
            velocity_rad_s: reading.map(|r| r.velocity),
            effort: reading.map(|r| r.current_ma),
            temperature_c: reading.map(|r| r.health.temperature_c),
            voltage_v: reading.map(|r| r.health.voltage_v),
            torque: reading.map(|r| r.torque),
            watchdog: reading.map(|r| r.watchdog),
            homing_offset_ticks: reading.map(|r| r.homing_offset),
            status: state(reading).to_owned(),
            trouble: m.fault,
        }
    };
    let joints: Vec<JointLine> = found.motors.into_iter().map(line).collect();
    let mut alarms = Vec::new();
    let on = joints.iter().filter(|j| j.torque == Some(true)).count();
    if on > 0 {
        alarms.push(format!("torque is on in {on} joints and nobody drives them: drex hw off, or drex hw release"));
    }
    alarms.extend(joints.iter().filter_map(|j| Some(format!("{}: {}", j.name, j.trouble.as_deref()?))));
    Ok(Found { joints, findings, unit: "mA", alarms })
}

/// Reading an Allegro hand takes its torques off: it reports only to who has switched it on anew.
fn look_at_allegro(setup: &Setup, args: &HandArgs) -> Result<Found> {
    let mut bus = open_can(&args.port)?;
    let left_on = reports_poses(&mut *bus, &setup.allegro, &SystemClock::default())?;
    let mut driver = Driver::over_can(setup, bus)?;
    let state = driver.read()?;
    let hand = driver.hand();
    let line = |(j, name): (usize, &String)| JointLine {
        name: name.clone(),
        position_rad: Some(state.position[j]),
        velocity_rad_s: Some(state.velocity[j]),
        effort: Some(state.effort[j]),
        temperature_c: state.temperature_c[j],
        voltage_v: state.voltage_v[j],
        torque: None,
        watchdog: None,
        homing_offset_ticks: None,
        status: match state.status[j] {
            JointStatus::TorqueOff => "torque off".into(),
            other => format!("{other:?}").to_lowercase(),
        },
        trouble: (state.hardware_error[j] != 0).then(|| hand.error_text(state.hardware_error[j])),
    };
    let joints: Vec<JointLine> = hand.joints().iter().enumerate().map(line).collect();
    let mut alarms: Vec<String> = Vec::new();
    if left_on {
        alarms.push("the hand was on and nobody drove it; reading it has taken its torques off".into());
    }
    alarms.extend(joints.iter().filter_map(|j| Some(format!("{}: {}", j.name, j.trouble.as_deref()?))));
    let mut findings = Vec::new();
    if setup.allegro.version == AllegroVersion::V5 && setup.allegro.gear_ratios == [1.0; 16] {
        findings.push(
            "a V5 Plus has geared joints 1, 5 and 9 (ffj1, mfj1, rfj1); which serial numbers are of one, sources disagree on: if this is one, \
             give these joints gear_ratio = 2.0 in its hand file"
                .into(),
        );
    }
    let unit = unit(hand);
    Ok(Found { joints, findings, unit, alarms })
}
