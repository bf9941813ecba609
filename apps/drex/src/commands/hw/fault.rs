//! Faults of `drex hw emulate --fault`.

use std::time::Duration;

use anyhow::{Context, Result, bail};
use drex_hw::emulator::leap::{Fault, LeapEmulator};
use drex_hw::leap::{LeapOptions, table};

/// Questions that a mute motor leaves unanswered: all that an afternoon brings.
const FOR_EVER: u32 = u32::MAX;

/// Plays the faults of `texts`, each NAME=VALUE; how long the USB adapter holds answers back.
///
/// # Errors
/// If there is no such fault or joint, or a value makes no sense.
pub fn play(hand: &LeapEmulator, options: &LeapOptions, texts: &[String]) -> Result<Duration> {
    let (mut volts, mut ohms, mut latency) = (5.0, 0.0, Duration::ZERO);
    for text in texts {
        let (name, value) = text.split_once('=').with_context(|| format!("\"{text}\" is not FAULT=VALUE"))?;
        let (joint, number) = value.split_once(':').unwrap_or((value, ""));
        let id = || {
            let joint = options.joints.iter().find(|j| j.name == joint);
            joint.map(|j| j.id).with_context(|| format!("--fault {text}: there is no joint \"{joint}\"", joint = value))
        };
        let within = |text: &str, low: f64, high: f64| -> Result<f64> {
            let number: f64 =
                text.parse().with_context(|| format!("--fault {name}={value}: \"{text}\" is no number"))?;
            if !(low..=high).contains(&number) {
                bail!("--fault {name}={value}: give {low} to {high}");
            }
            Ok(number)
        };
        match name {
            "supply" => volts = within(value, 0.0, 12.0)?,
            "supply-resistance" => ohms = within(value, 0.0, 10.0)?,
            "latency" => latency = Duration::from_secs_f64(1e-3 * within(value, 0.0, 255.0)?),
            "stuck-encoder" => hand.stick_encoder(id()?, true),
            "current-sensor" => hand.set_current_sensor(id()?, within(number, 0.1, 10.0)?),
            "homing-offset" => {
                let (id, ticks) = (id()?, within(number, -1_044_479.0, 1_044_479.0)? as i32);
                hand.set(id, table::HOMING_OFFSET, ticks);
                hand.place(id, hand.position(id).unwrap_or_default() + f64::from(ticks));
            }
            "hardware-error" => hand.fail(id()?, within(number, 1.0, 63.0)? as u8),
            "mute" => hand.inject(Fault::Mute(id()?), FOR_EVER),
            _ => bail!(
                "there is no fault \"{name}\"; there are supply, supply-resistance, latency, stuck-encoder, current-sensor, homing-offset, hardware-error and mute"
            ),
        }
    }
    if (volts, ohms) != (5.0, 0.0) {
        hand.set_supply(volts, ohms);
    }
    Ok(latency)
}
