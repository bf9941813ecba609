//! Grasps with the emulated Allegro hand, in its own time.

use std::sync::{Arc, Mutex};

use drex_hw::allegro::{AllegroHand, AllegroOptions, AllegroVersion};
use drex_hw::control::{
    ControlOptions, Controller, EStop, GraspController, GraspPhase, GraspPlan, Joints, LoopReport, StopReason,
    Trajectory, Waypoint, run,
};
use drex_hw::emulator::allegro::{AllegroEmulator, EmulatorBus};
use drex_hw::{Clock, Hand, HandCommand, HandState};
use drex_robot::Robot;
use proptest::prelude::*;

/// Joints that close, by name.
const CLOSING: [&str; 4] = ["ffj1", "mfj1", "rfj1", "thj2"];
const FORCE_NM: f64 = 0.15;

struct Bench {
    emulator: AllegroEmulator,
    hand: AllegroHand<EmulatorBus>,
    plan: GraspPlan,
    /// Wire index of the joints that close.
    closing: Vec<usize>,
}

/// A hand over an object that meets each closing joint at 0.5 rad.
fn bench(version: AllegroVersion) -> Bench {
    let robot = Robot::bundled("allegro_right").unwrap();
    let options = AllegroOptions::new(version);
    let emulator = AllegroEmulator::new(version);
    let closing: Vec<usize> = CLOSING.iter().map(|n| options.names.iter().position(|w| w == n).unwrap()).collect();
    let mut open = vec![0.0; 16];
    robot.clamp_to_limits(&mut open);
    for (wire, name) in options.names.iter().enumerate() {
        emulator.place(wire, open[robot.require_joint(name).unwrap()]);
    }
    closing.iter().for_each(|j| emulator.set_wall(*j, f64::NEG_INFINITY, 0.5));
    let mut pre_grasp = open.clone();
    let mut closed = open.clone();
    let mut force = vec![0.08; 16];
    for name in CLOSING {
        let j = robot.require_joint(name).unwrap();
        (pre_grasp[j], closed[j], force[j]) = (0.25, 0.8, FORCE_NM);
    }
    let hand = AllegroHand::connect_with_clock(emulator.bus(), &robot, options, emulator.clock()).unwrap();
    let plan = GraspPlan::allegro([open, pre_grasp, closed], vec![0.08; 16], force).with_hold_s(1.0);
    Bench { emulator, hand, plan, closing }
}

impl Bench {
    fn grasp(&mut self, grasp: &mut GraspController, options: ControlOptions) -> LoopReport {
        run(&mut self.hand, grasp, &self.emulator.clock(), options)
    }
}

#[test]
fn it_closes_feels_the_object_presses_with_the_force_and_lets_go() {
    for version in [AllegroVersion::V3, AllegroVersion::V4, AllegroVersion::V5] {
        let mut bench = bench(version);
        let mut grasp = GraspController::new(bench.plan.clone());
        let handle = grasp.handle();
        // What the object feels in the last half of the hold and, in all phases, at most.
        let felt = Arc::new(Mutex::new((Vec::new(), 0.0_f64)));
        let (emulator, closing, feel) = (bench.emulator.clone(), bench.closing.clone(), felt.clone());
        let options = ControlOptions::default().with_limiter(move |_, _| {
            let torques = emulator.contact_torques_nm();
            let mut felt = feel.lock().unwrap();
            for j in &closing {
                felt.1 = felt.1.max(torques[*j]);
                if handle.phase() == GraspPhase::Hold {
                    felt.0.push(torques[*j]);
                }
            }
        });
        let report = bench.grasp(&mut grasp, options);
        assert!(
            matches!(report.stop_reason, StopReason::Done) && report.torque_off.is_ok(),
            "{:?}",
            report.stop_reason
        );
        assert_eq!(report.stats.missed, 0);

        let outcome = grasp.outcome();
        assert!(!outcome.missed && !outcome.lost && outcome.began_s.iter().all(Option::is_some));
        // Who is at the goal does not wait for the hand to settle.
        let began = |phase: GraspPhase| outcome.began_s[phase as usize].unwrap();
        let opened = began(GraspPhase::PreGrasp) - began(GraspPhase::Open);
        assert!(opened < 0.5 * bench.plan.settle_s, "{opened} s");
        let touched: Vec<&str> =
            (0..16).filter(|j| outcome.contacts[*j].is_some()).map(|j| bench.hand.joints()[j].as_str()).collect();
        assert_eq!(touched.len(), 4, "{touched:?}");
        for (name, (contact, held)) in bench.hand.joints().iter().zip(outcome.contacts.iter().zip(&outcome.held_effort))
        {
            let Some(contact) = contact else { continue };
            assert!(CLOSING.contains(&name.as_str()) && (contact.position - 0.5).abs() < 2e-3, "{name}: {contact:?}");
            assert!(contact.reachable_effort > FORCE_NM);
            assert!((held - FORCE_NM).abs() < 0.02 * FORCE_NM, "{version:?} {name}: {held} N m");
        }
        let felt = felt.lock().unwrap();
        assert!(felt.0.len() > 1000);
        for torque in &felt.0[felt.0.len() / 2..] {
            assert!((torque - FORCE_NM).abs() < 0.02 * FORCE_NM, "{version:?}: the object feels {torque} N m");
        }
        assert!(felt.1 < 1.01 * FORCE_NM, "never more than the force");
        assert!(!bench.emulator.is_on());
        for j in &bench.closing {
            assert!(bench.emulator.positions()[*j] < 0.2, "open again");
        }
    }
}

#[test]
fn limits_rise_no_faster_than_they_may() {
    let mut bench = bench(AllegroVersion::V4);
    let mut grasp = GraspController::new(bench.plan.clone());
    let seen = Arc::new(Mutex::new((vec![0.0; 16], 0.0_f64)));
    let look = seen.clone();
    let options = ControlOptions::default().with_limiter(move |_, limits| {
        let mut seen = look.lock().unwrap();
        let jump = limits.iter().zip(&seen.0).map(|(a, b): (&f64, &f64)| (a - b).abs()).fold(0.0, f64::max);
        seen.1 = seen.1.max(jump);
        seen.0.copy_from_slice(limits);
    });
    bench.grasp(&mut grasp, options);
    let largest = seen.lock().unwrap().1;
    let per_cycle = bench.plan.effort_rate / 400.0;
    // A cycle may be late by what an exchange takes on the bus.
    assert!(largest > 0.5 * per_cycle && largest < 1.5 * per_cycle, "{largest} N m in one cycle, {per_cycle} allowed");
}

#[test]
fn where_there_is_nothing_the_hand_does_not_press() {
    let mut bench = bench(AllegroVersion::V4);
    bench.closing.iter().for_each(|j| bench.emulator.set_wall(*j, f64::NEG_INFINITY, f64::INFINITY));
    let mut grasp = GraspController::new(bench.plan.clone());
    let report = bench.grasp(&mut grasp, ControlOptions::default());
    assert!(matches!(report.stop_reason, StopReason::Done));
    let outcome = grasp.outcome();
    assert!(outcome.missed && outcome.contacts.iter().all(Option::is_none), "{outcome:?}");
    assert_eq!(outcome.began_s[GraspPhase::Hold as usize], None);
    // One finger alone is no grasp either.
    let mut bench = self::bench(AllegroVersion::V4);
    bench.closing[1..].iter().for_each(|j| bench.emulator.set_wall(*j, f64::NEG_INFINITY, f64::INFINITY));
    let mut grasp = GraspController::new(bench.plan.clone());
    bench.grasp(&mut grasp, ControlOptions::default());
    assert!(grasp.outcome().missed && grasp.outcome().contacts.iter().flatten().count() == 1);
    let mut grasp = GraspController::new(bench.plan.clone().with_least_contacts(1));
    bench.grasp(&mut grasp, ControlOptions::default());
    assert!(!grasp.outcome().missed && !grasp.outcome().lost);
}

#[test]
fn an_object_that_is_taken_away_opens_the_hand() {
    let mut bench = bench(AllegroVersion::V4);
    bench.plan.hold_s = None;
    let mut grasp = GraspController::new(bench.plan.clone());
    let (handle, emulator, closing) = (grasp.handle(), bench.emulator.clone(), bench.closing.clone());
    let (mut cycles, estop) = (0, EStop::new());
    let button = estop.clone();
    let options = ControlOptions::default().with_estop(&estop).with_limiter(move |_, _| {
        cycles += u32::from(handle.phase() == GraspPhase::Hold);
        if cycles == 100 {
            closing.iter().for_each(|j| emulator.set_wall(*j, f64::NEG_INFINITY, f64::INFINITY));
        }
        if cycles == 2000 {
            // It did not notice: the test fails, and ends.
            button.stop();
        }
    });
    let report = bench.grasp(&mut grasp, options);
    assert!(matches!(report.stop_reason, StopReason::Done) && grasp.outcome().lost && !grasp.outcome().missed);
    let began = |phase: GraspPhase| grasp.outcome().began_s[phase as usize].unwrap();
    let held = began(GraspPhase::Release) - began(GraspPhase::Hold);
    assert!(held < 0.75, "noticed after {held} s, the object left after 0.25 s");
}

#[test]
fn a_hold_ends_when_it_is_told_to() {
    let mut bench = bench(AllegroVersion::V5);
    bench.plan.hold_s = None;
    let mut grasp = GraspController::new(bench.plan.clone());
    let (handle, watch) = (grasp.handle(), grasp.handle());
    let (mut cycles, estop) = (0, EStop::new());
    let button = estop.clone();
    let options = ControlOptions::default().with_estop(&estop).with_limiter(move |_, _| {
        cycles += u32::from(watch.phase() == GraspPhase::Hold);
        if cycles == 200 {
            watch.release();
        }
        if cycles == 2000 {
            button.stop();
        }
    });
    let report = bench.grasp(&mut grasp, options);
    assert!(matches!(report.stop_reason, StopReason::Done) && handle.phase() == GraspPhase::Done);
    assert!(!grasp.outcome().lost);
}

#[test]
fn the_emergency_stop_drops_what_is_held() {
    let mut bench = bench(AllegroVersion::V4);
    let mut grasp = GraspController::new(bench.plan.clone());
    let estop = EStop::new();
    let (handle, button) = (grasp.handle(), estop.clone());
    let options = ControlOptions::default().with_estop(&estop).with_limiter(move |_, _| {
        if handle.phase() == GraspPhase::Hold {
            button.stop();
        }
    });
    let report = bench.grasp(&mut grasp, options);
    assert!(matches!(report.stop_reason, StopReason::Stopped) && report.torque_off.is_ok());
    assert!(!bench.emulator.is_on() && bench.emulator.torques_nm() == [0.0; 16]);
}

#[test]
fn plans_that_mean_nothing_are_refused() {
    let refused = |change: fn(&mut GraspPlan)| {
        let mut bench = bench(AllegroVersion::V4);
        change(&mut bench.plan);
        let report = bench.grasp(&mut GraspController::new(bench.plan.clone()), ControlOptions::default());
        assert!(!bench.emulator.is_on());
        matches!(report.stop_reason, StopReason::Failed(drex_hw::Error::Value { .. }))
    };
    assert!(refused(|p| p.closed[1] = 7.0));
    assert!(refused(|p| p.open[3] = f64::NAN));
    assert!(refused(|p| p.force_effort[2] = 5.0));
    assert!(refused(|p| p.force_effort[2] = -0.1));
    assert!(refused(|p| p.closing_effort[2] = 0.0));
    assert!(refused(|p| p.closed = p.pre_grasp.clone()));
    assert!(refused(|p| p.force_effort.truncate(3)));
    assert!(refused(|p| p.stiffness = 0.0));
    assert!(refused(|p| p.effort_rate = f64::NAN));
    assert!(refused(|p| p.hold_s = Some(-1.0)));
    assert!(!refused(|_| ()));
}

/// A value that a broken driver might read, mostly sane.
fn any_reading() -> impl Strategy<Value = f64> {
    prop_oneof![9 => -1.0..1.0_f64, 1 => prop::num::f64::ANY]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever is read, goals stay in the joints' ranges, limits below their caps, and neither jumps; what is no number is refused.
    #[test]
    fn nothing_that_is_read_drives_a_joint_too_far(
        readings in prop::collection::vec((any_reading(), any_reading(), any_reading(), 0.0..0.02_f64), 1..400),
    ) {
        let bench = bench(AllegroVersion::V4);
        let joints = Joints::of(&bench.hand);
        let mut state = HandState::new(16);
        state.age.fill(0);
        let mut grasp = GraspController::new(bench.plan.clone());
        grasp.begin(&joints, &state).unwrap();
        let (mut time, mut command) = (0.0, HandCommand::new(16));
        let mut last: Option<HandCommand> = None;
        for (k, (q, v, e, dt)) in readings.into_iter().enumerate() {
            time += dt;
            state.position[k % 16] = q;
            state.velocity[k % 16] = v;
            state.effort[k % 16] = e;
            let sane = state.check(joints.names).is_ok();
            prop_assert_eq!(grasp.command(time, &state, &mut command).is_ok(), sane);
            if !sane {
                return Ok(());
            }
            prop_assert!(command.check(joints.names).is_ok());
            for j in 0..16 {
                let (low, high) = joints.limits[j];
                prop_assert!((low..=high).contains(&command.position[j]) && command.effort_limit[j] <= joints.effort_caps[j]);
                if let Some(last) = &last {
                    let moved = (command.position[j] - last.position[j]).abs();
                    let rose = (command.effort_limit[j] - last.effort_limit[j]).abs();
                    prop_assert!(moved <= bench.plan.speed_rad_per_s * dt + 1e-12 && rose <= bench.plan.effort_rate * dt + 1e-12);
                }
            }
            last = Some(command.clone());
        }
    }
}

#[test]
fn a_trajectory_ends_when_all_joints_are_there_or_after_its_time_to_settle() {
    let took = |goal: f64| {
        let mut bench = bench(AllegroVersion::V4);
        let mut position = bench.plan.open.clone();
        let j = bench.hand.joints().iter().position(|n| n == CLOSING[0]).unwrap();
        position[j] = goal;
        let way = vec![Waypoint { time_s: 1.0, position }];
        let mut trajectory = Trajectory::new(way, vec![0.1; 16]).unwrap().with_settle_s(5.0);
        let report = run(&mut bench.hand, &mut trajectory, &bench.emulator.clock(), ControlOptions::default());
        assert!(matches!(report.stop_reason, StopReason::Done), "{:?}", report.stop_reason);
        bench.emulator.clock().now().as_secs_f64()
    };
    let (there, blocked) = (took(0.4), took(0.8));
    assert!(there < 1.5 && blocked < 3.0, "{there} s, {blocked} s");
}
