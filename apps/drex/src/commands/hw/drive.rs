//! `drex hw move` and `drex hw record`: a loop over a hand, its log and how well it kept time.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use drex_hw::control::{
    Behaviour, ControlOptions, EStop, Ended, JointTrouble, LoopReport, LoopStats, Stay, Trajectory, Waypoint, run,
    telemetry, write_csv,
};
use drex_hw::{Clock, Error, Hand, SystemClock};
use drex_recording::readers::read_joint_log_csv;
use serde_json::{Value, json};

use super::{Driver, Setup, angles, stop_button};
use crate::cli::{MoveArgs, RecordArgs};
use crate::ui::Ui;

/// Cycles of telemetry that may wait for the disk.
const WAITING_CYCLES: usize = 4000;
/// A joint this far from where it was sent has not arrived, rad.
const SHORT_RAD: f64 = 0.05;
/// How long a hand that does not confirm that its torque is off is told again; its guard goes on after that.
const OFF_PATIENCE: Duration = Duration::from_secs(5);
/// Time for the way to the first pose of a log that is played, s.
const TO_THE_LOG_S: f64 = 2.0;

/// How a loop is run.
pub struct Run<'a> {
    /// Ends it.
    pub stop: &'a EStop,
    /// Cycles per second.
    pub rate_hz: f64,
    /// How long the hand may be out of reach.
    pub outage: Duration,
    /// Without torque.
    pub limp: bool,
    /// Joint log.
    pub log: Option<&'a Path>,
}

/// Moves joints.
pub fn move_to(args: &MoveArgs, ui: &Ui) -> Result<()> {
    // Before there is a hand that could be left with its torque on.
    let stop = stop_button()?;
    let setup = Setup::of(args.hand.hand, &args.hand.link)?;
    let mut driver = Driver::guarded(&setup, &args.hand.port, &args.guard, args.run.rate)?;
    driver.ready_to_move(&args.allow, ui)?;
    let (cap, cap_json) = (driver.cap_text(), driver.cap_json());
    let mut goal = driver.read()?.position;
    let hand = driver.hand();
    if args.to == "rest" {
        goal.fill(0.0);
    } else {
        for (joint, angle) in angles(&args.to, hand.joints())? {
            let (low, high) = hand.limits()[joint];
            if !(low..=high).contains(&angle) {
                bail!("{} cannot be at {angle} rad: it goes from {low:.3} to {high:.3}", hand.joints()[joint]);
            }
            goal[joint] = angle;
        }
    }
    for (q, (low, high)) in goal.iter_mut().zip(hand.limits()) {
        *q = q.clamp(*low, *high);
    }
    let mut way =
        Trajectory::new(vec![Waypoint { time_s: args.seconds, position: goal.clone() }], hand.effort_caps().to_vec())?;
    let how = Run {
        stop: &stop,
        rate_hz: args.run.rate,
        outage: args.guard.outage,
        limp: false,
        log: args.run.log.as_deref(),
    };
    let report = drive(hand, &mut way, &SystemClock::default(), &how)?;
    let off: Vec<f64> = goal.iter().zip(&report.state.position).map(|(g, q)| (g - q).abs()).collect();
    let far = off.iter().copied().fold(0.0, f64::max);
    let short: Vec<(&String, f64)> = hand.joints().iter().zip(off).filter(|(_, off)| *off > SHORT_RAD).collect();
    let mut text = match short.is_empty() {
        true => format!("arrived to within {far:.3} rad\n"),
        false => "stopped short: something is in the way, or the cap is too low\n".to_owned(),
    };
    for (name, off) in &short {
        text += &format!("  {name} by {off:.3} rad\n");
    }
    text += &format!("  cap   {cap}\n");
    let short: Vec<Value> = short.iter().map(|(name, off)| json!({ "joint": name, "rad": off })).collect();
    let position = &report.state.position;
    let value = json!({
        "farthest_rad": far, "short": short, "position_rad": position, "cap": cap_json, "loop": stats(&report),
    });
    ui.answer(&value, text + &account(&report, hand.joints()))
}

/// Watches the limp hand, or plays a log.
pub fn record(args: &RecordArgs, ui: &Ui) -> Result<()> {
    let stop = stop_button()?;
    let setup = Setup::of(args.hand.hand, &args.hand.link)?;
    let mut driver = match args.play {
        Some(_) => Driver::guarded(&setup, &args.hand.port, &args.guard, args.rate)?,
        None => Driver::with(&setup, &args.hand.port)?,
    };
    let (mut cap, cap_json) = (String::new(), driver.cap_json());
    if args.play.is_some() {
        driver.ready_to_move(&args.allow, ui)?;
        cap = format!("  cap   {}\n", driver.cap_text());
    }
    let hand = driver.hand();
    let caps = hand.effort_caps().to_vec();
    let mut behaviour: Box<dyn Behaviour> = match &args.play {
        Some(file) => {
            let names = hand.joints().to_vec();
            let log = read_joint_log_csv(file, Some(&names))?;
            Box::new(Trajectory::from_log(&log, &names, caps, TO_THE_LOG_S)?)
        }
        None => Box::new(Stay::new(args.seconds, caps)),
    };
    let how = Run {
        stop: &stop,
        rate_hz: args.rate,
        outage: args.guard.outage,
        limp: args.play.is_none(),
        log: Some(&args.out),
    };
    let report = drive(hand, &mut behaviour, &SystemClock::default(), &how)?;
    let (cycles, told) = (report.stats.cycles, account(&report, hand.joints()));
    let text = format!("{cycles} cycles in {}\n{cap}{told}", args.out.display());
    ui.answer(&json!({ "out": args.out, "cap": cap_json, "loop": stats(&report) }), text)
}

/// Runs a behaviour to its end and writes the log beside it.
///
/// # Errors
/// If the hand fails, somebody stops it, its torque cannot be taken off, or the log cannot be written.
pub fn drive(
    hand: &mut dyn Hand,
    behaviour: &mut (impl Behaviour + ?Sized),
    clock: &dyn Clock,
    how: &Run<'_>,
) -> Result<LoopReport> {
    let mut options = ControlOptions::default()
        .with_rate_hz(how.rate_hz)
        .with_estop(how.stop)
        .with_outage(how.outage)
        .with_off_patience(OFF_PATIENCE);
    options.limp = how.limp;
    let Some(log) = how.log else {
        let report = run(hand, behaviour, clock, options);
        return ended(report, hand);
    };
    let (names, unit) = (hand.joints().to_vec(), hand.effort_unit());
    // Under its name only when it is whole.
    let part = log.with_extension("csv.part");
    let cannot = || format!("cannot write {}", part.display());
    let mut out = BufWriter::new(File::create(&part).with_context(cannot)?);
    let (recorder, mut cycles) = telemetry(names.len(), WAITING_CYCLES);
    let report = std::thread::scope(|scope| {
        let writer = scope.spawn(move || write_csv(&mut cycles, &names, unit, &mut out));
        let report = run(hand, behaviour, clock, options.with_recorder(recorder));
        match writer.join() {
            Ok(written) => written.with_context(cannot).map(|_| report),
            Err(_) => bail!("the writer of {} panicked", log.display()),
        }
    })?;
    std::fs::rename(&part, log).with_context(|| format!("cannot rename {} to {}", part.display(), log.display()))?;
    ended(report, hand)
}

/// A loop that did what it should, with all joints at the end and no hardware error on the way.
fn ended(report: LoopReport, hand: &dyn Hand) -> Result<LoopReport> {
    let joints = hand.joints();
    let off = off(&report);
    if report.torque_off.is_err() {
        bail!("{off}");
    }
    match report.ended {
        Ended::Done => {
            let lasting = report.troubles.iter().filter_map(|(j, t)| match t {
                JointTrouble::Ended(_) => Some(format!("{} {t}", joints[*j])),
                JointTrouble::HardwareError(code) => {
                    Some(format!("{} had a hardware error on the way: {}", joints[*j], hand.error_text(*code)))
                }
                _ => None,
            });
            let lasting: Vec<String> = lasting.collect();
            if !lasting.is_empty() {
                bail!("{off}, but {}: see drex hw status", lasting.join(", "));
            }
            Ok(report)
        }
        Ended::Stopped => bail!("stopped: {off}"),
        Ended::Failed(error) => Err(error).context(off),
        Ended::Panicked(what) => bail!("{off} after a fault of this program: {what}"),
        other => bail!("{other:?}: {off}"),
    }
}

/// What became of the torque.
fn off(report: &LoopReport) -> String {
    let why = match &report.ended {
        Ended::Failed(error) => format!(" The hand was left because of this: {error}"),
        _ => String::new(),
    };
    match &report.torque_off {
        Ok(()) if matches!(report.ended, Ended::Failed(Error::Port { .. })) => {
            format!(
                "torque off, {:.2} s after the hand was given up: it could be reached again",
                report.off_took.as_secs_f64()
            )
        }
        Ok(()) => "torque off".into(),
        #[cfg(unix)]
        Err(error) if error.taken_over().is_some() => error.taken_over().map_or_else(String::new, ToString::to_string),
        Err(unknown @ Error::TorqueUnknown { .. }) => format!("{unknown}.{why}"),
        Err(error) => format!("torque unknown: {error}. Switch the hand's power off.{why}"),
    }
}

/// What went wrong with joints on the way and was mended, and how well the loop kept time; with what to do where it did not.
pub fn account(report: &LoopReport, joints: &[String]) -> String {
    let mut text = String::new();
    for (j, trouble) in &report.troubles {
        text += &format!("  note  {} {trouble}\n", joints[*j]);
    }
    if report.stats.outages > 0 {
        let (times, seconds) = (report.stats.outages, report.stats.outage_s);
        text += &format!(
            "  note  the hand was out of reach {times} times, {seconds:.2} s in all: it came back and went on\n"
        );
    }
    text + &timing(&report.stats)
}

fn timing(stats: &LoopStats) -> String {
    let mut text = format!(
        "  loop  {:.0} cycles per second, late by {:.2} ms (99 %: {:.2} ms), busy {:.2} ms, {} missed",
        stats.rate_hz,
        1e3 * stats.late.p50_s,
        1e3 * stats.late.p99_s,
        1e3 * stats.busy.p50_s,
        stats.missed
    );
    if stats.stalls > 0 {
        text += &format!("\n  note  this program was held up {} times; the hand waited", stats.stalls);
    }
    if 20 * stats.missed > stats.cycles {
        text += "\n  note  more than one cycle in twenty was missed: lower --rate, or see drex hw status for latency timer and return delay";
    }
    text
}

/// The same for programs.
pub fn stats(report: &LoopReport) -> Value {
    let s = &report.stats;
    json!({
        "cycles": s.cycles, "missed": s.missed, "stalls": s.stalls, "failed": s.failed, "outages": s.outages, "outage_s": s.outage_s, "rate_hz": s.rate_hz,
        "late_p50_s": s.late.p50_s, "late_p99_s": s.late.p99_s, "late_max_s": s.late.max_s,
        "busy_p50_s": s.busy.p50_s, "busy_p99_s": s.busy.p99_s, "unrecorded": report.unrecorded,
    })
}
