//! A controller that is run on a hand to its end, with its log.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::time::Duration;

use crate::control::{
    ControlOptions, Controller, EStop, JointFault, LoopReport, StopReason, run, telemetry, write_csv,
};
use crate::{Clock, Error, Hand, Result};

/// Cycles of telemetry that may wait for the disk.
const WAITING_CYCLES: usize = 4000;
/// How long a hand that does not confirm that its torque is off is told again; its guard goes on after that.
const OFF_PATIENCE: Duration = Duration::from_secs(5);

/// How a controller is run.
pub struct Run<'a> {
    /// Stop button that ends the run.
    pub stop: &'a EStop,
    /// Rate of the loop, cycles per second.
    pub rate_hz: f64,
    /// Longest time for which the hand may be out of reach.
    pub outage: Duration,
    /// Whether the hand stays without torque.
    pub torque_off: bool,
    /// File of the joint log, if there is to be one.
    pub log: Option<&'a Path>,
}

/// Runs a controller to its end and writes the log beside it.
///
/// # Errors
/// If the hand fails, somebody stops it, its torque cannot be taken off, or the log cannot be written.
pub fn run_logged(
    hand: &mut dyn Hand,
    controller: &mut (impl Controller + ?Sized),
    clock: &dyn Clock,
    how: &Run<'_>,
) -> Result<LoopReport> {
    let mut options = ControlOptions::default()
        .with_rate_hz(how.rate_hz)
        .with_estop(how.stop)
        .with_outage(how.outage)
        .with_off_patience(OFF_PATIENCE);
    options.torque_off = how.torque_off;
    let Some(log) = how.log else {
        let report = run(hand, controller, clock, options);
        return checked(report, hand);
    };
    let (names, unit) = (hand.joints().to_vec(), hand.effort_unit());
    // Under its name only when it is whole.
    let part = log.with_extension("csv.part");
    let cannot_write = |e| Error::File(drex_core::Error::io("write", &part, e));
    let mut out = BufWriter::new(File::create(&part).map_err(cannot_write)?);
    let (recorder, mut cycles) = telemetry(names.len(), WAITING_CYCLES);
    let report = std::thread::scope(|scope| {
        let writer = scope.spawn(move || write_csv(&mut cycles, &names, unit, &mut out));
        let report = run(hand, controller, clock, options.with_recorder(recorder));
        match writer.join() {
            Ok(written) => written.map_err(cannot_write).map(|_| report),
            Err(_) => Err(Error::NotAllowed(format!("the writer of {} panicked", log.display()))),
        }
    })?;
    std::fs::rename(&part, log).map_err(|e| drex_core::Error::io("write", log, e))?;
    checked(report, hand)
}

/// A loop that did what it should, with all joints at the end and no hardware error on the way.
fn checked(report: LoopReport, hand: &dyn Hand) -> Result<LoopReport> {
    let joints = hand.joints();
    let off = off(&report);
    if report.torque_off.is_err() {
        return Err(Error::NotAllowed(off));
    }
    match report.stop_reason {
        StopReason::Done => {
            let lasting = report.faults.iter().filter_map(|(j, t)| match t {
                JointFault::Lasting(_) => Some(format!("{} {t}", joints[*j])),
                JointFault::HardwareError(code) => {
                    Some(format!("{} had a hardware error on the way: {}", joints[*j], hand.error_text(*code)))
                }
                _ => None,
            });
            let lasting: Vec<String> = lasting.collect();
            if !lasting.is_empty() {
                let what = format!("{off}, but {}: see drex hw status", lasting.join(", "));
                return Err(Error::NotAllowed(what));
            }
            Ok(report)
        }
        StopReason::Stopped => Err(Error::NotAllowed(format!("stopped: {off}"))),
        StopReason::Failed(error) => Err(Error::RunEnded { off, source: Box::new(error) }),
        StopReason::Panicked(what) => Err(Error::NotAllowed(format!("{off} after a fault of this program: {what}"))),
    }
}

/// What became of the torque.
fn off(report: &LoopReport) -> String {
    let why = match &report.stop_reason {
        StopReason::Failed(error) => format!(" The hand was left because of this: {error}"),
        _ => String::new(),
    };
    match &report.torque_off {
        Ok(()) if matches!(report.stop_reason, StopReason::Failed(Error::Port { .. })) => {
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
