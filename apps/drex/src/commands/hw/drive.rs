//! `drex hw move` and `drex hw record`: a loop over a hand, its log and how well it kept time.

use anyhow::{Result, bail};
use drex_hw::SystemClock;
use drex_hw::control::{Controller, HoldPosition, LoopReport, LoopStats, Trajectory, Waypoint};
use drex_recording::readers::read_joint_log_csv;
use serde_json::{Value, json};

use super::{angles, cap_json, cap_text, ready_to_move, setup, stop_button};
use crate::cli::{MoveArgs, RecordArgs};
use crate::ui::Ui;
use drex_hw::driver::{Driver, Run, run_logged};

/// A joint this far from where it was sent has not arrived, rad.
const SHORT_RAD: f64 = 0.05;
/// Time for the way to the first pose of a log that is played, s.
const TO_THE_LOG_S: f64 = 2.0;

/// Moves joints.
pub fn move_to(args: &MoveArgs, ui: &Ui) -> Result<()> {
    // Before there is a hand that could be left with its torque on.
    let stop = stop_button()?;
    let setup = setup(&args.hand)?;
    let mut driver = Driver::guarded(&setup, &args.hand.port, args.guard.settings().as_ref(), args.run.rate)?;
    ready_to_move(&mut driver, &args.allow, ui)?;
    let (cap, cap_json) = (cap_text(&mut driver), cap_json(&mut driver));
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
        torque_off: false,
        log: args.run.log.as_deref(),
    };
    let report = run_logged(hand, &mut way, &SystemClock::default(), &how)?;
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
    let setup = setup(&args.hand)?;
    let mut driver = match args.play {
        Some(_) => Driver::guarded(&setup, &args.hand.port, args.guard.settings().as_ref(), args.rate)?,
        None => Driver::connect(&setup, &args.hand.port)?,
    };
    let (mut cap, cap_json) = (String::new(), cap_json(&mut driver));
    if args.play.is_some() {
        ready_to_move(&mut driver, &args.allow, ui)?;
        cap = format!("  cap   {}\n", cap_text(&mut driver));
    }
    let hand = driver.hand();
    let caps = hand.effort_caps().to_vec();
    let mut controller: Box<dyn Controller> = match &args.play {
        Some(file) => {
            let names = hand.joints().to_vec();
            let log = read_joint_log_csv(file, Some(&names))?;
            Box::new(Trajectory::from_log(&log, &names, caps, TO_THE_LOG_S)?)
        }
        None => Box::new(HoldPosition::new(args.seconds, caps)),
    };
    let how = Run {
        stop: &stop,
        rate_hz: args.rate,
        outage: args.guard.outage,
        torque_off: args.play.is_none(),
        log: Some(&args.out),
    };
    let report = run_logged(hand, &mut controller, &SystemClock::default(), &how)?;
    let (cycles, told) = (report.stats.cycles, account(&report, hand.joints()));
    let text = format!("{cycles} cycles in {}\n{cap}{told}", args.out.display());
    ui.answer(&json!({ "out": args.out, "cap": cap_json, "loop": stats(&report) }), text)
}

/// What went wrong with joints on the way and was mended, and how well the loop kept time; with what to do where it did not.
pub fn account(report: &LoopReport, joints: &[String]) -> String {
    let mut text = String::new();
    for (j, trouble) in &report.faults {
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
