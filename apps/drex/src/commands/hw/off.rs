//! `drex hw off` and `drex hw release`: torque off on a hand in any state.

use std::time::Duration;

use anyhow::{Context, Result, bail};
use drex_hw::SystemClock;
use drex_hw::allegro::{self, AllegroOff};
use drex_hw::dynamixel::SerialPort;
use drex_hw::leap::{self, MotorOff, TorqueState};
use serde_json::{Value, json};

use super::setup;
use crate::cli::{HandArg, HandArgs, ReleaseArgs};
use crate::ui::Ui;
use drex_hw::driver::{Setup, open_can};

/// Takes the torque off.
pub fn off(args: &HandArgs, ui: &Ui) -> Result<()> {
    let setup = setup(args)?;
    match args.hand {
        HandArg::Leap => {
            let motors = SerialPort::open(&args.port, setup.leap.baud)
                .and_then(|port| leap::switch_off(port, &setup.robot, &setup.leap))
                .context("torque unknown")?;
            report_leap(&motors, args, ui)
        }
        HandArg::Allegro => off_allegro(&setup, args, ui),
    }
}

/// Lets the force fall, then takes the torque off.
pub fn release(args: &ReleaseArgs, ui: &Ui) -> Result<()> {
    let (args, time) = (&args.hand, Duration::from_secs_f64(args.seconds));
    let setup = setup(args)?;
    match args.hand {
        HandArg::Leap => {
            let motors = SerialPort::open(&args.port, setup.leap.baud)
                .and_then(|port| leap::release(port, &setup.robot, &setup.leap, time))
                .context("torque unknown")?;
            report_leap(&motors, args, ui)
        }
        HandArg::Allegro => {
            ui.note("an Allegro hand does not tell its torques: it lets go at once");
            off_allegro(&setup, args, ui)
        }
    }
}

fn off_allegro(setup: &Setup, args: &HandArgs, ui: &Ui) -> Result<()> {
    let mut bus = open_can(&args.port).context("torque unknown")?;
    let state = allegro::switch_off(&mut *bus, &setup.allegro, &SystemClock::default())
        .context("torque unknown: the hand may still be on")?;
    let (name, text) = match state {
        AllegroOff::Off => ("off", "off: the hand answers and reports no poses any more"),
        AllegroOff::On => ("on", "STILL ON: the hand goes on reporting poses; switch its power off"),
        _ => ("unknown", "torque unknown: the hand said nothing; check cable and generation, or switch its power off"),
    };
    ui.answer(&json!({ "hand": "allegro", "torque": name }), format!("Allegro at {}\n  {text}", args.port.display()))?;
    if state != AllegroOff::Off {
        bail!("{text}");
    }
    Ok(())
}

fn report_leap(motors: &[MotorOff], args: &HandArgs, ui: &Ui) -> Result<()> {
    let mut text = format!("LEAP at {}\n", args.port.display());
    let mut lines: Vec<Value> = Vec::new();
    let mut open = Vec::new();
    for motor in motors {
        let (name, words) = match motor.torque {
            TorqueState::Off => ("off", "off"),
            TorqueState::On => ("on", "STILL ON"),
            _ => ("unknown", "torque unknown"),
        };
        let why = motor.fault.as_ref().map_or_else(String::new, |t| format!(": {t}"));
        text += &format!("  {:<10} motor {:<3} {words}{why}\n", motor.joint, motor.id);
        lines.push(json!({ "joint": motor.joint, "id": motor.id, "torque": name, "trouble": motor.fault }));
        if motor.torque != TorqueState::Off {
            open.push(format!("{} (motor {}): {words}{why}", motor.joint, motor.id));
        }
    }
    ui.answer(&json!({ "hand": "leap", "motors": lines }), text)?;
    if !open.is_empty() {
        bail!("{}; try again, or switch the hand's power off", open.join(", "));
    }
    Ok(())
}
