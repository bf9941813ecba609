//! `drex hw ping` and `drex hw status`: who is there, and how it is doing.

use anyhow::{Result, bail};
use drex_hw::dynamixel::{Bus, Port, SerialPort, Timing};
use drex_hw::leap;
use drex_hw::leap::table::MotorModel;
use drex_robot::Robot;
use serde::Serialize;

use super::{Driver, leap_options, unit};
use crate::cli::{HandArg, HandArgs};
use crate::ui::Ui;

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
            let Driver::Allegro(mut hand) = Driver::open(args.hand, &args.port, &args.link)? else { return Ok(()) };
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
    let port = SerialPort::open(&args.port, args.link.baud)?;
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
    let wanted: Vec<u8> = leap_options(&args.link).joints.iter().map(|j| j.id).collect();
    let missing: Vec<u8> = wanted.into_iter().filter(|id| motors.iter().all(|m| m.id != *id)).collect();
    if motors.is_empty() {
        bail!(
            "no motor answers at {} with {} baud: check the hand's power and cable, and --baud (motors leave the factory at 57600)",
            args.port.display(),
            args.link.baud
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
    status: String,
    trouble: Option<String>,
}

/// Angles, efforts, temperatures, findings.
pub fn status(args: &HandArgs, ui: &Ui) -> Result<()> {
    let (joints, findings, unit) = match args.hand {
        HandArg::Leap => look_at_leap(args)?,
        HandArg::Allegro => look_at_allegro(args)?,
    };
    let mut text = format!("{:?} at {}\n", args.hand, args.port.display());
    text += &format!("  {:<10} {:>9} {:>9} {:>6} {:>6}  state\n", "joint", "rad", unit, "°C", "V");
    let number = |value: Option<f64>, digits: usize| value.map_or_else(|| "-".into(), |v| format!("{v:.digits$}"));
    for j in &joints {
        let trouble = j.trouble.as_ref().map_or_else(String::new, |t| format!(": {t}"));
        let line = format!(
            "  {:<10} {:>9} {:>9} {:>6} {:>6}  {}{trouble}\n",
            j.name,
            number(j.position_rad, 4),
            number(j.effort, 3),
            number(j.temperature_c, 0),
            number(j.voltage_v, 1),
            j.status
        );
        text += &line;
    }
    for finding in &findings {
        text += &format!("  note  {finding}\n");
    }
    let value = serde_json::json!({
        "hand": args.hand.robot(), "effort_unit": unit, "joints": joints, "findings": findings,
    });
    ui.answer(&value, text)
}

/// Reads without writing: torque stays as it is, and one dead motor hides no other.
fn look_at_leap(args: &HandArgs) -> Result<(Vec<JointLine>, Vec<String>, &'static str)> {
    let robot = Robot::bundled(args.hand.robot())?;
    let port = SerialPort::open(&args.port, args.link.baud)?;
    let found = leap::look(port, &robot, &leap_options(&args.link))?;
    let lines = found.motors.into_iter().map(|m| {
        let reading = m.reading.as_ref();
        let status = match reading.map(|r| r.torque) {
            Some(true) => "driven",
            Some(false) => "limp",
            None => "silent",
        };
        JointLine {
            name: m.joint,
            position_rad: reading.map(|r| r.position),
            velocity_rad_s: reading.map(|r| r.velocity),
            effort: reading.map(|r| r.current_ma),
            temperature_c: reading.map(|r| r.health.temperature_c),
            voltage_v: reading.map(|r| r.health.voltage_v),
            status: status.to_owned(),
            trouble: m.trouble,
        }
    });
    Ok((lines.collect(), found.findings.iter().map(ToString::to_string).collect(), "mA"))
}

fn look_at_allegro(args: &HandArgs) -> Result<(Vec<JointLine>, Vec<String>, &'static str)> {
    let mut driver = Driver::open(args.hand, &args.port, &args.link)?;
    let state = driver.read()?;
    let hand = driver.hand();
    let line = |(j, name): (usize, &String)| JointLine {
        name: name.clone(),
        position_rad: Some(state.position[j]),
        velocity_rad_s: Some(state.velocity[j]),
        effort: Some(state.effort[j]),
        temperature_c: state.temperature_c[j],
        voltage_v: None,
        status: format!("{:?}", state.status[j]).to_lowercase(),
        trouble: None,
    };
    Ok((hand.joints().iter().enumerate().map(line).collect(), Vec::new(), unit(hand)))
}
