//! `drex hw calibrate-zero`: zeros of a hand that somebody holds in a known pose, into its hand file.

use std::f64::consts::{FRAC_PI_2, PI};
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use drex_core::fsutil;
use drex_hw::dynamixel::SerialPort;
use drex_hw::leap::{self, LeapOptions, table};
use drex_hw::{Hand, HandState};
use serde_json::json;

use super::{angles, setup};
use crate::cli::{AllegroArg, CalibrateZeroArgs};
use crate::ui::Ui;
use drex_hw::driver::{Driver, HandFile, HandKind, Setup};

/// A joint that moves by more than this while it is read is not held, rad.
const STILL_RAD: f64 = 0.03;
/// Horns of LEAP's motors are mounted in steps of a quarter turn; a zero farther than this from all of them is a wrong pose, rad.
const HORN_RAD: f64 = 0.35;
/// Time between two readings.
const EVERY: Duration = Duration::from_millis(20);
/// Readings that there have to be, fresh in every joint.
const LEAST: usize = 10;

/// Reads, checks, writes.
pub fn run(args: &CalibrateZeroArgs, ui: &Ui) -> Result<()> {
    let setup = setup(&args.hand)?;
    let names: Vec<String> = setup.robot.joint_names().into_iter().map(str::to_owned).collect();
    // At rest a joint that cannot be at 0 is at the end of its range that is nearest.
    let limits: Vec<(f64, f64)> = setup.robot.joints.iter().map(|j| j.limits.unwrap_or((-PI, PI))).collect();
    let mut pose: Vec<f64> = limits.iter().map(|(low, high)| 0.0_f64.max(*low).min(*high)).collect();
    if args.pose != "rest" {
        angles(&args.pose, &names)?.into_iter().for_each(|(j, rad)| pose[j] = rad);
    }
    for (name, (rad, (low, high))) in names.iter().zip(pose.iter().zip(&limits)) {
        if !(*low..=*high).contains(rad) {
            bail!("{name} cannot be held at {rad} rad: it goes from {low:.3} to {high:.3}");
        }
    }
    let mut file = setup.file.clone().unwrap_or_else(|| HandFile::new(setup.hand));
    let offsets = if setup.hand == HandKind::Leap { homing_offsets(&setup, args)? } else { Vec::new() };
    let mut driver = Driver::connect(&setup, &args.hand.port)?;
    let held = read(driver.hand(), args.seconds, &names)?;
    let mut text = format!("zeros of {} joints in {}\n", names.len(), args.out.display());
    let mut zeros = Vec::new();
    for (j, name) in names.iter().enumerate() {
        let off_rad = held[j] - pose[j];
        let entry = file.joints.entry(name.clone()).or_default();
        let zero = match setup.hand {
            HandKind::Leap => {
                let offset = offsets.iter().find(|(n, _)| n == name).map_or(0, |(_, o)| *o);
                entry.homing_offset = (offset != 0).then_some(offset);
                leap_zero(&setup.leap, name, off_rad, offset)?
            }
            HandKind::Allegro => allegro_zero(&setup, name, off_rad)?,
        };
        entry.zero = Some(zero);
        text += &format!("  {name:<10} {zero:>7}   moved by {off_rad:+.3} rad\n");
        zeros.push(json!({ "joint": name, "zero": zero, "moved_rad": off_rad }));
    }
    if let Driver::Allegro(hand) = &mut driver {
        hand.wait_for_reports()?;
        file.serial = hand.serial().or(file.serial);
        let version = args.hand.link.allegro.unwrap_or(AllegroArg::V4);
        file.version = file.version.or(Some(version.into()));
    }
    // The hand is let go before the file is written: nothing is lost if that fails.
    drop(driver);
    fsutil::write_atomic(&args.out, file.text()?.as_bytes())?;
    text += &format!("  use it with --hand-file {}", args.out.display());
    ui.answer(&json!({ "out": args.out, "zeros": zeros }), text)
}

/// Homing offsets of the motors, ticks, of a hand that can be calibrated: all its motors answer, without torque or errors.
fn homing_offsets(setup: &Setup, args: &CalibrateZeroArgs) -> Result<Vec<(String, i32)>> {
    let port = SerialPort::open(&args.hand.port, setup.leap.baud)?;
    let found = leap::inspect_hand(port, &setup.robot, &setup.leap)?;
    let mut offsets = Vec::new();
    for motor in found.motors {
        let Some(reading) = &motor.reading else {
            bail!("{} (motor {}) does not answer: a zero of it would be made up", motor.joint, motor.id);
        };
        if reading.torque {
            bail!(
                "{} is under torque: take it off first with drex hw off, then hold the hand in the pose",
                motor.joint
            );
        }
        if let Some(trouble) = motor.fault {
            bail!("{} (motor {}): {trouble}; mend that first", motor.joint, motor.id);
        }
        offsets.push((motor.joint, reading.homing_offset));
    }
    Ok(offsets)
}

/// Mean angles of the joints, rad, while somebody holds them still.
fn read(hand: &mut dyn Hand, seconds: f64, names: &[String]) -> Result<Vec<f64>> {
    let mut state = HandState::new(names.len());
    let (mut sum, mut low, mut high) =
        (vec![0.0; names.len()], vec![f64::INFINITY; names.len()], vec![f64::NEG_INFINITY; names.len()]);
    let (begin, mut count) = (Instant::now(), 0);
    while count < LEAST || begin.elapsed().as_secs_f64() < seconds {
        hand.cycle(None, &mut state)?;
        if state.age.iter().all(|a| *a == 0) {
            for (j, q) in state.position.iter().enumerate() {
                (sum[j], low[j], high[j]) = (sum[j] + q, low[j].min(*q), high[j].max(*q));
            }
            count += 1;
        } else if begin.elapsed().as_secs_f64() > seconds + 3.0 {
            let silent = names.iter().zip(&state.age).filter(|(_, a)| **a > 0).map(|(n, _)| n.as_str());
            bail!("{} do not say where they are: check power and cables", silent.collect::<Vec<_>>().join(", "));
        }
        std::thread::sleep(EVERY);
    }
    let moving: Vec<String> = (0..names.len())
        .filter(|j| high[*j] - low[*j] > STILL_RAD)
        .map(|j| format!("{} by {:.3} rad", names[j], high[j] - low[j]))
        .collect();
    if !moving.is_empty() {
        bail!("the hand moved while it was read: {}; hold it still in the pose", moving.join(", "));
    }
    Ok(sum.into_iter().map(|s| s / f64::from(count as u32)).collect())
}

/// Zero of a motor whose joint is `off_rad` from where it reads, ticks within one turn.
fn leap_zero(options: &LeapOptions, name: &str, off_rad: f64, homing_offset: i32) -> Result<i32> {
    let Some(joint) = options.joints.iter().find(|j| j.name == name) else { bail!("no motor for joint {name}") };
    let sign = if joint.reversed { -1.0 } else { 1.0 };
    let zero = f64::from(joint.zero_ticks) + sign * off_rad / table::RAD_PER_TICK;
    // What the motor itself turned, without the offset that it adds, from the zero of a horn in its place.
    let turned = (zero - 2048.0 - f64::from(homing_offset)) * table::RAD_PER_TICK;
    let astray = turned - (turned / FRAC_PI_2).round() * FRAC_PI_2;
    if astray.abs() > HORN_RAD {
        bail!(
            "{name} would have its zero {:.0} degrees from where a horn can be mounted: that is not the pose, or its sign is wrong",
            astray.to_degrees()
        );
    }
    Ok((zero.round() as i32).rem_euclid(table::TICKS_PER_TURN))
}

/// Encoder counts at the zero of a joint that is `off_rad` from where it reads.
fn allegro_zero(setup: &Setup, name: &str, off_rad: f64) -> Result<i32> {
    let o = &setup.allegro;
    let Some(j) = o.names.iter().position(|n| n == name) else { bail!("no joint {name} on the wire") };
    let sign = if o.calibration[j].encoder_reversed { -1.0 } else { 1.0 };
    let per_count = o.rad_per_count() / o.gear_ratios[j];
    let zero = f64::from(o.calibration[j].offset_counts) + sign * off_rad / per_count;
    if (zero * per_count).abs() > PI {
        bail!(
            "{name} would have its zero {:.0} degrees from its encoder's: that is not the pose",
            (zero * per_count).to_degrees()
        );
    }
    Ok(zero.round() as i32)
}
