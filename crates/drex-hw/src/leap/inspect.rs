//! What a look at a hand finds before it is used: settings that make it slow or unsafe, and how to mend them.

use std::time::Duration;

use super::options::LeapOptions;
use super::table::{self, MotorModel};
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

/// Something that is not as it should be.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Finding {
    /// The motor; `None` concerns all.
    pub motor: Option<u8>,
    /// What was found.
    pub what: String,
    /// How to mend it.
    pub fix: String,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.motor {
            Some(id) => write!(f, "motor {id}: {}; {}", self.what, self.fix),
            None => write!(f, "{}; {}", self.what, self.fix),
        }
    }
}

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
    vec![Finding { motor: None, what, fix: format!("echo 1 | sudo tee {file}") }]
}

pub(super) fn inspect_motors<P: Port>(bus: &mut Bus<P>, options: &LeapOptions) -> Result<Vec<Finding>> {
    let mut findings = Vec::new();
    let (mut delayed, mut old, mut models) = (Vec::new(), Vec::new(), Vec::new());
    for joint in &options.joints {
        let id = joint.id;
        let mut say = |what: String, fix: &str| findings.push(Finding { motor: Some(id), what, fix: fix.into() });
        let (head, tail) = match read_table(bus, id) {
            Err(lost @ Error::Port { .. }) => return Err(lost),
            Err(error) => {
                say(error.to_string(), "nothing else is known of it");
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
            say(
                "its drive mode is not 0, it may turn the other way or switch itself on".into(),
                "connecting sets it to 0",
            );
        }
        if table::STARTUP.in_block(0, &head) != 0 {
            say("it does things by itself when power comes".into(), "connecting sets register 60 to 0");
        }
        let shadow = table::SHADOW_ID.in_block(0, &head);
        if shadow < 253 {
            say(format!("it also listens to id {shadow}"), "set register 12 to 255");
        }
        let offset = table::HOMING_OFFSET.in_block(0, &head);
        if offset != 0 {
            say(
                format!("its homing offset is {offset} ticks"),
                "set register 20 to 0, or take it into the zero of this joint",
            );
        }
        let errors = table::HARDWARE_ERROR.in_block(0, &head);
        if errors != 0 {
            say(table::hardware_error_text(errors), "connecting reboots it; find out why first");
        }
        let voltage = table::PRESENT_VOLTAGE.in_block(TAIL, &tail);
        if !VOLTAGES.contains(&voltage) {
            say(format!("its supply is {:.1} V", f64::from(voltage) / 10.0), "give 5 V that stay 5 V under load");
        }
        let celsius = table::PRESENT_TEMPERATURE.in_block(TAIL, &tail);
        if celsius >= HOT_C {
            say(format!("it has {celsius} °C"), "let it cool; it switches off at its limit of 70 °C");
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
    let mut say = |what: String, fix: String| findings.push(Finding { motor: None, what, fix });
    if let Some(longest) = delayed.iter().map(|(_, delay)| *delay).max() {
        let (count, us) = (delayed.len(), 2 * u32::from(longest));
        say(format!("{count} motors wait up to {us} µs before they answer"), "connecting sets register 9 to 0".into());
    }
    if !old.is_empty() {
        let what = format!("motors {old:?} have firmware below {FAST_FIRMWARE} and cannot answer together");
        say(what, "update it with the maker's program; until then the loop is slower".into());
    }
    if models.iter().any(|m| m != &models[0] || MotorModel::from_number(*m).is_none()) {
        say(
            format!("motors of models {models:?}"),
            "build the hand with XC330-M288 (1240) or XL330-M288 (1200) alone".into(),
        );
    }
    findings
}
