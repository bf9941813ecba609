//! The loop itself.

use std::any::Any;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::time::Duration;

use super::fault_log::FaultLog;
use super::stats::Meter;
use super::{ControlOptions, Controller, JointFault, Joints, LoopStats};
use crate::{Clock, Error, Hand, HandCommand, HandState, JointStatus, Result};

/// How often a hand that does not take its torque off is told again at least, and the time between two tries after that.
const TRIES: usize = 3;
const RETRY: Duration = Duration::from_millis(5);
/// Cycles between two views of the statistics for others.
const PUBLISH: u64 = 64;
/// A cycle that begins this much later than one period after the one before comes after a stall: the program was stopped or starved.
const STALL: Duration = Duration::from_millis(50);

/// How long a hand that is silent when the controller is done is listened to: a moment without reports may be one in which this machine did
/// something else.
const LAST_LOOK: Duration = Duration::from_millis(100);

/// Why a loop ended.
#[derive(Debug)]
#[non_exhaustive]
pub enum StopReason {
    /// The controller was done.
    Done,
    /// Somebody pressed the emergency stop.
    Stopped,
    /// The hand or the controller failed.
    Failed(Error),
    /// Something panicked; the text is what it said.
    Panicked(String),
}

/// How a loop ended.
#[derive(Debug)]
#[non_exhaustive]
pub struct LoopReport {
    /// Why.
    pub stop_reason: StopReason,
    /// Whether the hand took its torque off; if not, its own watchdog has to, or the power switch.
    pub torque_off: Result<()>,
    /// How long that took from the end of the loop on, or until it was given up.
    pub off_took: Duration,
    /// Timing.
    pub stats: LoopStats,
    /// Cycles that the telemetry had no room for.
    pub unrecorded: u64,
    /// The last state that was read.
    pub state: HandState,
    /// Joints that something was wrong with, by their index in [`Hand::joints`], and what; empty if all went well.
    pub faults: Vec<(usize, JointFault)>,
}

/// Turns the hand on, unless it is only watched, runs `controller` at a fixed rate on this thread until it is done or something ends it, and turns the hand off.
/// After the first cycle nothing is allocated.
pub fn run(
    hand: &mut (impl Hand + ?Sized),
    controller: &mut (impl Controller + ?Sized),
    clock: &dyn Clock,
    options: ControlOptions,
) -> LoopReport {
    run_published(hand, controller, clock, options, &Mutex::default())
}

/// The same, with statistics for others to see while it runs.
pub(super) fn run_published(
    hand: &mut (impl Hand + ?Sized),
    controller: &mut (impl Controller + ?Sized),
    clock: &dyn Clock,
    mut options: ControlOptions,
    published: &Mutex<LoopStats>,
) -> LoopReport {
    let mut meter = Meter::new();
    let mut state = HandState::new(hand.joints().len());
    let mut faults = FaultLog::new(hand.joints().len());
    let turns = || turns(hand, controller, clock, &mut options, &mut meter, &mut faults, &mut state, published);
    // Whatever a panic left half done is only switched off.
    let stop_reason = match catch_unwind(AssertUnwindSafe(turns)) {
        Ok(Ok(reason)) => reason,
        Ok(Err(error)) => StopReason::Failed(error),
        Err(panic) => StopReason::Panicked(text(panic.as_ref())),
    };
    let begun = clock.now();
    let torque_off = turn_off(hand, clock, options.off_patience);
    let off_took = clock.now().saturating_sub(begun);
    let unrecorded = options.recorder.as_ref().map_or(0, |r| r.lost());
    LoopReport { stop_reason, torque_off, off_took, stats: meter.stats(), unrecorded, state, faults: faults.list() }
}

/// Tells the hand that its torque goes off, until it confirms it or there is no use in trying.
fn turn_off(hand: &mut (impl Hand + ?Sized), clock: &dyn Clock, patience: Duration) -> Result<()> {
    let begun = clock.now();
    let mut tries = 0;
    loop {
        let told = catch_unwind(AssertUnwindSafe(|| hand.turn_off()))
            .unwrap_or_else(|panic| Err(Error::value(text(panic.as_ref()), "switch the hand's power off")));
        tries += 1;
        let over = tries >= TRIES && clock.now().saturating_sub(begun) >= patience;
        if told.is_ok() || over || told.as_ref().is_err_and(Error::is_taken_over) {
            return told;
        }
        if tries >= TRIES {
            clock.wait_until(clock.now() + RETRY);
        }
    }
}

/// From torque on to the reason to stop.
#[expect(clippy::too_many_arguments, reason = "they outlive a panic, and so are the caller's")]
fn turns(
    hand: &mut (impl Hand + ?Sized),
    controller: &mut (impl Controller + ?Sized),
    clock: &dyn Clock,
    options: &mut ControlOptions,
    meter: &mut Meter,
    faults: &mut FaultLog,
    state: &mut HandState,
    published: &Mutex<LoopStats>,
) -> Result<StopReason> {
    let period = options.period()?;
    if options.is_stopped() {
        return Ok(StopReason::Stopped);
    }
    if !options.torque_off {
        hand.turn_on()?;
    }
    if !first_state(hand, clock, options, period, state)? {
        return Ok(StopReason::Stopped);
    }
    controller.begin(&Joints::of(hand), state)?;
    let mut command = HandCommand { position: state.position.clone(), effort_limit: hand.effort_caps().to_vec() };
    let mut lowering = Lowering::new(hand.effort_caps(), period);

    let begin = clock.now();
    let mut due = begin;
    let mut flow = ControlFlow::Continue(());
    // Since when the hand is out of reach, and for how long the controller's time stood still in all.
    let (mut lost, mut outage) = (None, Duration::ZERO);
    let (mut last, mut done) = (begin, None);
    loop {
        clock.wait_until(due);
        if options.is_stopped() {
            return Ok(StopReason::Stopped);
        }
        let began = clock.now();
        let stall = began.saturating_sub(std::mem::replace(&mut last, began) + period);
        if stall > STALL {
            meter.stall();
            // An outage is counted in full when it ends.
            outage += if lost.is_none() { stall } else { Duration::ZERO };
        }
        if lost.is_none() && done.is_none() {
            let time = began.saturating_sub(begin + outage);
            flow = controller.command(time.as_secs_f64(), state, &mut command)?;
            lowering.apply(&mut command.effort_limit, hand.effort_caps(), state, options, faults);
        }
        match hand.cycle((!options.torque_off).then_some(&command), state) {
            Ok(()) => {
                if let Some(since) = lost.take() {
                    let out = began.saturating_sub(since);
                    meter.outage(out);
                    outage += out;
                }
                faults.see(state);
            }
            Err(error) if error.is_final() => return Err(error),
            Err(error) => {
                meter.fail();
                faults.see(state);
                if began.saturating_sub(*lost.get_or_insert(began)) >= options.outage {
                    return Err(error);
                }
            }
        }
        state.check(hand.joints())?;
        let ended = clock.now();
        meter.cycle(due, began, ended);
        if let Some(recorder) = options.recorder.as_mut().filter(|_| lost.is_none()) {
            recorder.record(|sample| {
                sample.time_s = ended.saturating_sub(begin).as_secs_f64();
                sample.late_s = began.saturating_sub(due).as_secs_f64();
                sample.phase = controller.phase();
                sample.command.clone_from(&command);
                sample.state.copy_from(state);
            });
        }
        if flow.is_break() && lost.is_none() {
            let silent = state.status.contains(&JointStatus::Silent);
            if !silent || ended.saturating_sub(*done.get_or_insert(ended)) >= LAST_LOOK {
                return Ok(StopReason::Done);
            }
        }
        due += period;
        let behind = ended.saturating_sub(due);
        if behind >= period {
            let left_out = (behind.as_nanos() / period.as_nanos()) as u32;
            meter.miss(left_out.into());
            due += period * left_out;
        }
        if meter.is_nth(PUBLISH) {
            // Who looks must not hold up the loop: then the next time.
            if let Ok(mut seen) = published.try_lock() {
                *seen = meter.stats();
            }
        }
    }
}

/// Reads until every joint has told where it is; false if the emergency stop was pressed.
fn first_state(
    hand: &mut (impl Hand + ?Sized),
    clock: &dyn Clock,
    options: &ControlOptions,
    period: Duration,
    state: &mut HandState,
) -> Result<bool> {
    let begin = clock.now();
    loop {
        if options.is_stopped() {
            return Ok(false);
        }
        let now = clock.now();
        hand.cycle(None, state)?;
        if state.age.iter().all(|a| *a != u32::MAX) {
            state.check(hand.joints())?;
            return Ok(true);
        }
        if now.saturating_sub(begin) > options.first_state {
            let silent = hand.joints().iter().zip(&state.age).filter(|(_, a)| **a == u32::MAX);
            let names = silent.map(|(n, _)| n.as_str()).collect::<Vec<_>>().join(", ");
            return Err(Error::NeverRead { joints: names });
        }
        clock.wait_until(now + period);
    }
}

/// What heat, a low supply and the limiter take from the limits; nothing adds.
struct Lowering {
    /// Share of the cap that the supply leaves each joint.
    supply: Vec<f64>,
    /// Limits for the limiter.
    scratch: Vec<f64>,
    period_s: f64,
}

impl Lowering {
    fn new(caps: &[f64], period: Duration) -> Self {
        Self { supply: vec![1.0; caps.len()], scratch: caps.to_vec(), period_s: period.as_secs_f64() }
    }

    fn apply(
        &mut self,
        wanted: &mut [f64],
        caps: &[f64],
        state: &HandState,
        options: &mut ControlOptions,
        faults: &mut FaultLog,
    ) {
        if let Some(derating) = &options.derating {
            for (joint, (limit, cap)) in wanted.iter_mut().zip(caps).enumerate() {
                // A limit that is no number stays one, for the hand to refuse.
                if let Some(celsius) = state.temperature_c[joint] {
                    let share = derating.share(celsius);
                    if *limit > share * cap {
                        *limit = share * cap;
                        if share < 1.0 {
                            faults.derate(joint, celsius, share);
                        }
                    }
                }
                if let Some(volts) = state.voltage_v[joint] {
                    let left = &mut self.supply[joint];
                    *left = derating.share_at_supply(volts).min(*left + derating.recovery_per_s * self.period_s);
                    if *limit > *left * cap {
                        *limit = *left * cap;
                        if *left < 1.0 {
                            faults.sag(joint, volts, *left);
                        }
                    }
                }
            }
        }
        if let Some(limiter) = options.limiter.as_mut().filter(|_| self.scratch.len() == wanted.len()) {
            self.scratch.copy_from_slice(wanted);
            limiter(state, &mut self.scratch);
            for (limit, lowered) in wanted.iter_mut().zip(&self.scratch) {
                if !(*lowered >= *limit) {
                    // What is no number lowers to nothing.
                    *limit = lowered.max(0.0);
                }
            }
        }
    }
}

fn text(panic: &(dyn Any + Send)) -> String {
    let said = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    said.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "a panic without words".into())
}
