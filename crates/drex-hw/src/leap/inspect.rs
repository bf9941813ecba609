//! What a look at a hand finds before it is used: settings that make it slow or unsafe, and how to mend them.

use std::time::Duration;

use super::finding::{Finding, FindingKind};
use super::options::LeapOptions;
use super::table::{self, MotorModel, RAD_PER_TICK};
use crate::dynamixel::{Bus, Port};
use crate::{Error, Result};

/// Firmware from which on motors answer fast sync reads.
pub(super) const FAST_FIRMWARE: u8 = 46;
/// Largest latency of an adapter that a fast loop bears.
const LATENCY: Duration = Duration::from_millis(1);
/// Supply voltages at which the motors' numbers hold, 0.1 V.
const VOLTAGES: std::ops::RangeInclusive<u16> = 45..=55;
/// From here on a motor is hot, °C.
const HOT_C: u8 = 60;

/// Bytes of the table up to the hardware errors, and the parts of them that are read.
const HEAD: usize = 71;
const DEFINED: [std::ops::Range<usize>; 4] = [0..14, 20..24, 60..61, 70..71];
/// Where supply and temperature are.
const TAIL: u16 = table::PRESENT_VOLTAGE.address;

/// Looks at the adapter and the motors of a hand without changing anything.
///
/// # Errors
/// If the port fails; motors that do not answer are a finding.
pub fn inspect<P: Port>(bus: &mut Bus<P>, options: &LeapOptions) -> Result<Vec<Finding>> {
    let mut findings = inspect_port(bus.port());
    findings.extend(inspect_motors(bus, options)?);
    Ok(findings)
}

pub(super) fn inspect_port<P: Port>(port: &P) -> Vec<Finding> {
    let Some(latency) = port.latency().filter(|l| *l > LATENCY) else { return Vec::new() };
    let file = port.latency_file().map_or_else(|| "its latency_timer".into(), |f| f.display().to_string());
    let what = format!("the USB adapter holds every answer back for {} ms", latency.as_millis());
    let fix = format!("echo 1 | sudo tee {file}");
    vec![Finding { kind: FindingKind::UsbLatency, motor: None, what, fix }]
}

pub(super) fn inspect_motors<P: Port>(bus: &mut Bus<P>, options: &LeapOptions) -> Result<Vec<Finding>> {
    let mut findings = Vec::new();
    let (mut delayed, mut old, mut models) = (Vec::new(), Vec::new(), Vec::new());
    for joint in &options.joints {
        let id = joint.id;
        let mut say = |kind, what: String, fix: &str| {
            findings.push(Finding { kind, motor: Some(id), what, fix: fix.into() });
        };
        let (head, tail) = match read_table(bus, id) {
            Err(lost @ Error::Port { .. }) => return Err(lost),
            Err(error) => {
                say(FindingKind::Silent, error.to_string(), "nothing else is known of it");
                continue;
            }
            Ok(read) => read,
        };
        models.push(table::MODEL_NUMBER.in_block(0, &head));
        let delay = table::RETURN_DELAY.in_block(0, &head);
        if delay != 0 {
            delayed.push((id, delay));
        }
        if table::FIRMWARE.in_block(0, &head) < FAST_FIRMWARE {
            old.push(id);
        }
        if table::DRIVE_MODE.in_block(0, &head) != 0 {
            let what = "its drive mode is not 0, it may turn the other way or switch itself on".into();
            say(FindingKind::DriveMode, what, "connecting sets it to 0");
        }
        if table::STARTUP.in_block(0, &head) != 0 {
            let what = "it does things by itself when power comes".into();
            say(FindingKind::Startup, what, "connecting sets register 60 to 0");
        }
        let shadow = table::SHADOW_ID.in_block(0, &head);
        if shadow < 253 {
            let what = format!("it also listens to id {shadow}");
            say(FindingKind::SecondId, what, "set register 12 to 255 with the maker's program");
        }
        let (offset, known) = (table::HOMING_OFFSET.in_block(0, &head), joint.homing_offset_ticks);
        if offset != known {
            let degrees = (f64::from(offset) - f64::from(known)) * RAD_PER_TICK.to_degrees();
            let expected = if known == 0 { String::new() } else { format!(" instead of the {known} of its zero") };
            let what =
                format!("its homing offset is {offset} ticks{expected}: {} is {degrees:.0} degrees off", joint.name);
            let fix = "take it into the zero of this joint (drex hw calibrate-zero), or set register 20 back with the maker's program";
            say(FindingKind::HomingOffset, what, fix);
        }
        let errors = table::HARDWARE_ERROR.in_block(0, &head);
        if errors != 0 {
            let fix = "find out why first; connecting has rebooted it, or will";
            say(FindingKind::HardwareError, table::hardware_error_text(errors), fix);
        }
        let voltage = table::PRESENT_VOLTAGE.in_block(TAIL, &tail);
        if !VOLTAGES.contains(&voltage) {
            let low = voltage < *VOLTAGES.start();
            let kind = if low { FindingKind::LowVoltage } else { FindingKind::HighVoltage };
            let what = format!("its supply is {:.1} V", f64::from(voltage) / 10.0);
            say(kind, what, "give 5 V that stay 5 V under load");
        }
        let celsius = table::PRESENT_TEMPERATURE.in_block(TAIL, &tail);
        if celsius >= HOT_C {
            let what = format!("it has {celsius} °C");
            say(FindingKind::Hot, what, "let it cool; it switches off at its limit of 70 °C");
        }
    }
    findings.extend(common(&delayed, &old, &models));
    Ok(findings)
}

/// A motor's table up to its hardware errors, and its supply and temperature. Between them are addresses that mean nothing: a motor
/// refuses to read across those.
fn read_table<P: Port>(bus: &mut Bus<P>, id: u8) -> Result<([u8; HEAD], [u8; 3])> {
    let (mut head, mut tail) = ([0; HEAD], [0; 3]);
    for span in DEFINED {
        bus.read(id, span.start as u16, &mut head[span])?;
    }
    bus.read(id, TAIL, &mut tail)?;
    Ok((head, tail))
}

/// What concerns more than one motor.
fn common(delayed: &[(u8, u8)], old: &[u8], models: &[u16]) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut say = |kind, what: String, fix: String| findings.push(Finding { kind, motor: None, what, fix });
    if let Some(longest) = delayed.iter().map(|(_, delay)| *delay).max() {
        let (count, us) = (delayed.len(), 2 * u32::from(longest));
        let what = format!("{count} motors wait up to {us} µs before they answer");
        say(FindingKind::ReturnDelay, what, "connecting sets register 9 to 0".into());
    }
    if !old.is_empty() {
        let what = format!("motors {old:?} have firmware below {FAST_FIRMWARE} and cannot answer together");
        say(FindingKind::OldFirmware, what, "update it with the maker's program; until then the loop is slower".into());
    }
    if models.iter().any(|m| m != &models[0] || MotorModel::from_number(*m).is_none()) {
        say(
            FindingKind::MixedModels,
            format!("motors of models {models:?}"),
            "build the hand with XC330-M288 (1240) or XL330-M288 (1200) alone".into(),
        );
    }
    findings
}
