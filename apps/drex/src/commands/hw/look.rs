//! `drex hw ping` and `drex hw status`: who is there, and how it is doing.

use anyhow::{Result, bail};
use drex_hw::dynamixel::{Bus, Port, SerialPort, Timing};
use drex_hw::leap::table::MotorModel;
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
            let mut driver = Driver::open(args.hand, &args.port, &args.link)?;
            // All fingers have told where they are, and what else the hand has to say has come before.
            driver.read()?;
            let Driver::Allegro(hand) = driver else { return Ok(()) };
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
struct JointStatus {
    name: String,
    position_rad: f64,
    velocity_rad_s: f64,
    effort: f64,
    temperature_c: Option<f64>,
    status: String,
    trouble: Option<String>,
}

/// Angles, efforts, temperatures, findings.
pub fn status(args: &HandArgs, ui: &Ui) -> Result<()> {
    let mut driver = Driver::open(args.hand, &args.port, &args.link)?;
    let state = driver.read()?;
    let (mut findings, mut troubles, mut volts) = (Vec::new(), vec![None; state.position.len()], None);
    if let Driver::Leap(hand) = &driver {
        findings = hand.findings().iter().map(ToString::to_string).collect();
        hand.troubles().for_each(|(j, text)| troubles[j] = Some(text.to_owned()));
        volts = hand.health().flatten().map(|h| h.voltage_v).reduce(f64::min);
    }
    let hand = driver.hand();
    let unit = unit(hand);
    let joints: Vec<JointStatus> = hand
        .joints()
        .iter()
        .zip(troubles)
        .enumerate()
        .map(|(j, (name, trouble))| JointStatus {
            name: name.clone(),
            position_rad: state.position[j],
            velocity_rad_s: state.velocity[j],
            effort: state.effort[j],
            temperature_c: state.temperature_c[j],
            status: format!("{:?}", state.status[j]).to_lowercase(),
            trouble,
        })
        .collect();
    let mut text = format!("{:?} at {}: no torque\n", args.hand, args.port.display());
    text += &format!("  {:<10} {:>9} {:>9} {:>6}  state\n", "joint", "rad", unit, "°C");
    for j in &joints {
        let celsius = j.temperature_c.map_or_else(|| "-".into(), |c| format!("{c:.0}"));
        let trouble = j.trouble.as_ref().map_or_else(String::new, |t| format!(": {t}"));
        let line =
            format!("  {:<10} {:>9.4} {:>9.3} {celsius:>6}  {}{trouble}\n", j.name, j.position_rad, j.effort, j.status);
        text += &line;
    }
    if let Some(volts) = volts {
        text += &format!("  lowest supply {volts:.1} V\n");
    }
    for finding in &findings {
        text += &format!("  note  {finding}\n");
    }
    let value = serde_json::json!({
        "hand": args.hand.robot(), "effort_unit": unit, "joints": joints, "lowest_supply_v": volts, "findings": findings,
    });
    ui.answer(&value, text)
}
