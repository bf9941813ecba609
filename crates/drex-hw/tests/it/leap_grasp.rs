//! Grasps with the emulated LEAP hand under the control loop, in its own time: currents, heat, an unplugged port.

use std::cell::Cell;
use std::time::Duration;

use drex_hw::control::{ControlOptions, Derating, GraspController, GraspPhase, GraspPlan, LoopReport, StopReason, run};
use drex_hw::dynamixel::Timing;
use drex_hw::emulator::leap::{EmulatorPort, LeapEmulator};
use drex_hw::leap::{LeapHand, LeapOptions, table};
use drex_hw::{Clock, Hand};
use drex_robot::Robot;

const FORCE_MA: f64 = 240.0;
/// Forward joints of index, middle and ring, in the order of the wire.
const CLOSING: [u8; 3] = [1, 5, 9];

/// The emulator's time as the loop's; whoever passes by puts the plug back 300 ms after it was pulled.
struct Mender {
    emulator: LeapEmulator,
    pulled: Cell<Option<Duration>>,
}

impl Clock for Mender {
    fn now(&self) -> Duration {
        self.emulator.now()
    }

    fn wait_until(&self, then: Duration) {
        self.emulator.wait_until(then);
        let now = self.now();
        if !self.emulator.plugged() {
            let since = self.pulled.get().unwrap_or(now);
            self.pulled.set(Some(since));
            if now - since > Duration::from_millis(300) {
                self.emulator.plug();
            }
        }
    }
}

struct Bench {
    emulator: LeapEmulator,
    hand: LeapHand<EmulatorPort>,
    plan: GraspPlan,
}

/// A hand over an object that meets the closing joints at 0.6 rad.
fn bench() -> Bench {
    let robot = Robot::bundled("leap_right").unwrap();
    let emulator = LeapEmulator::new();
    let options = LeapOptions::right().with_cap_ma(550.0).with_timing(Timing::for_latency(Duration::ZERO));
    let mut open = vec![0.0; 16];
    let mut closed = vec![0.0; 16];
    let mut force = vec![100.0; 16];
    robot.clamp_to_limits(&mut open);
    closed.copy_from_slice(&open);
    for id in CLOSING {
        let wired = options.joints.iter().find(|j| j.id == id).unwrap();
        let j = robot.require_joint(&wired.name).unwrap();
        (closed[j], force[j]) = (1.2, FORCE_MA);
        emulator.set_wall(id, f64::NEG_INFINITY, 2048.0 + 0.6 / table::RAD_PER_TICK);
    }
    let hand = LeapHand::connect(emulator.port(), &robot, options).unwrap();
    let plan = GraspPlan::leap([open.clone(), open, closed], vec![100.0; 16], force).with_hold_s(1.0);
    Bench { emulator, hand, plan }
}

impl Bench {
    fn grasp(&mut self, grasp: &mut GraspController, options: ControlOptions) -> LoopReport {
        run(&mut self.hand, grasp, &self.emulator, options)
    }
}

#[test]
fn the_current_that_holds_is_the_limit() {
    let mut bench = bench();
    let mut grasp = GraspController::new(bench.plan.clone());
    let report = bench.grasp(&mut grasp, ControlOptions::default());
    assert!(matches!(report.stop_reason, StopReason::Done) && report.torque_off.is_ok(), "{:?}", report.stop_reason);
    let outcome = grasp.outcome();
    assert!(!outcome.missed && !outcome.lost, "{outcome:?}");
    let touched: Vec<usize> = (0..16).filter(|j| outcome.contacts[*j].is_some()).collect();
    assert_eq!(touched.len(), 3);
    for j in touched {
        let contact = outcome.contacts[j].unwrap();
        assert!((contact.position - 0.6).abs() < 0.01 && contact.reachable_effort > FORCE_MA);
        assert!((outcome.held_effort[j] - FORCE_MA).abs() < 0.02 * FORCE_MA, "{} mA", outcome.held_effort[j]);
    }
    assert_eq!(bench.emulator.under_torque(), 0);
}

#[test]
fn a_hot_motor_holds_with_less() {
    let mut bench = bench();
    (0..16).for_each(|id| bench.emulator.set(id, table::PRESENT_TEMPERATURE, 60));
    let cap = bench.hand.effort_caps()[0];
    let warm = Derating { from_c: 55.0, to_c: 65.0, ..Derating::default() };
    let allowed = warm.share(60.0) * cap;
    bench.plan.force_effort.iter_mut().filter(|f| **f > 200.0).for_each(|f| *f = 0.9 * cap);
    let mut grasp = GraspController::new(bench.plan.clone());
    bench.grasp(&mut grasp, ControlOptions::default().with_derating(Some(warm)));
    let held = grasp.outcome().held_effort.iter().copied().fold(0.0, f64::max);
    assert!((held - allowed).abs() < 0.02 * allowed, "{held} of {allowed} mA");
}

#[test]
fn a_plug_that_is_pulled_and_put_back_costs_a_moment() {
    for outage in [Duration::from_secs(1), Duration::ZERO] {
        let mut bench = bench();
        let mut grasp = GraspController::new(bench.plan.clone());
        let (handle, emulator) = (grasp.handle(), bench.emulator.clone());
        let mut held = 0;
        let options = ControlOptions::default().with_outage(outage).with_limiter(move |_, _| {
            held += u32::from(handle.phase() == GraspPhase::Hold);
            if held == 100 {
                emulator.unplug();
            }
        });
        let clock = Mender { emulator: bench.emulator.clone(), pulled: Cell::new(None) };
        let report = run(&mut bench.hand, &mut grasp, &clock, options);
        if outage.is_zero() {
            // The hand cannot be told while the plug is out; dropping it tries once more.
            assert!(matches!(report.stop_reason, StopReason::Failed(_)) && report.torque_off.is_err());
            bench.emulator.plug();
            drop(bench.hand);
        } else {
            assert!(
                matches!(report.stop_reason, StopReason::Done) && report.stats.failed > 50,
                "{:?}",
                report.stop_reason
            );
            assert!(!grasp.outcome().lost && bench.hand.reconnects() > 0);
        }
        assert_eq!(bench.emulator.under_torque(), 0);
    }
}
