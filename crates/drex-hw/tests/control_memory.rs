//! The loop does not allocate: as many allocations for two thousand cycles as for a hundred.
#![allow(clippy::unwrap_used)] // a test may stop at the first surprise

use std::ops::ControlFlow;

use drex_hw::allegro::{AllegroHand, AllegroOptions, AllegroVersion};
use drex_hw::control::{
    ControlOptions, Controller, GraspController, GraspPlan, Joints, StopReason, Trajectory, Waypoint, run, telemetry,
};
use drex_hw::emulator::allegro::AllegroEmulator;
use drex_hw::{Hand, HandCommand, HandState, Result};
use drex_robot::Robot;

/// Allocations on this thread while the loop runs, and its cycles.
fn allocations(make: impl Fn(&HandState) -> Box<dyn Controller>) -> (u64, u64) {
    let emulator = AllegroEmulator::new(AllegroVersion::V4);
    emulator.place(12, 0.5);
    emulator.set_wall(1, f64::NEG_INFINITY, 0.3);
    let robot = Robot::bundled("allegro_right").unwrap();
    let mut hand = AllegroHand::connect_with_clock(
        emulator.bus(),
        &robot,
        AllegroOptions::new(AllegroVersion::V4),
        emulator.clock(),
    )
    .unwrap();
    let mut state = HandState::new(16);
    hand.turn_on().unwrap();
    hand.cycle(None, &mut state).unwrap();
    let mut controller = make(&state);
    // Room for fewer cycles than there are: what finds none must not allocate either.
    let (recorder, _reader) = telemetry(16, 50);
    let options = ControlOptions::default().with_recorder(recorder).with_limiter(|_, _| ());
    let mut report = None;
    let clock = emulator.clock();
    let counted = allocation_counter::measure(|| report = Some(run(&mut hand, &mut controller, &clock, options)));
    let report = report.unwrap();
    assert!(matches!(report.stop_reason, StopReason::Done), "{:?}", report.stop_reason);
    (counted.count_total, report.stats.cycles)
}

fn waypoint(state: &HandState, time_s: f64) -> Box<dyn Controller> {
    let goal = Waypoint { time_s, position: state.position.clone() };
    Box::new(Trajectory::new(vec![goal], vec![0.1; 16]).unwrap())
}

/// Forgets that it must not allocate.
struct Careless(Box<dyn Controller>);

impl Controller for Careless {
    fn begin(&mut self, joints: &Joints<'_>, state: &HandState) -> Result<()> {
        self.0.begin(joints, state)
    }

    fn command(&mut self, time_s: f64, state: &HandState, command: &mut HandCommand) -> Result<ControlFlow<()>> {
        command.position = command.position.clone();
        self.0.command(time_s, state, command)
    }
}

#[test]
fn cycles_of_a_trajectory_cost_no_memory() {
    let (few, some) = allocations(|s| waypoint(s, 0.25));
    let (more, many) = allocations(|s| waypoint(s, 5.0));
    assert!(some > 90 && many > 1900);
    assert_eq!(few, more);
    // The count would show it.
    let (careless, _) = allocations(|s| Box::new(Careless(waypoint(s, 0.25))));
    assert!(careless >= few + some);
}

#[test]
fn cycles_of_a_grasp_cost_no_memory() {
    let grasp = |hold_s: f64| {
        allocations(move |state| {
            let pose = state.position.clone();
            let mut closed = pose.clone();
            let robot = Robot::bundled("allegro_right").unwrap();
            closed[robot.require_joint("ffj1").unwrap()] = 0.6;
            let plan = GraspPlan::allegro([pose.clone(), pose, closed], vec![0.05; 16], vec![0.1; 16]);
            Box::new(GraspController::new(plan.with_least_contacts(1).with_hold_s(hold_s)))
        })
    };
    let ((few, some), (more, many)) = (grasp(0.1), grasp(5.0));
    assert!(many > some + 1900, "{some} and {many} cycles");
    assert_eq!(few, more);
}
