//! Exchanges with a LEAP hand at a serial port cost no memory; the emulated hand has a thread of its own, which does not count.
#![cfg(unix)]
#![allow(clippy::unwrap_used)] // a test may stop at the first surprise

use std::time::Duration;

use drex_hw::emulator::leap::LeapEmulator;
use drex_hw::emulator::pty::PtyServer;
use drex_hw::leap::{LeapHand, LeapOptions};
use drex_hw::{Hand, HandCommand, HandState};
use drex_robot::Robot;

/// More exchanges than lie between two looks at the motors' health.
const EXCHANGES: usize = 300;

#[test]
fn exchanges_cost_no_memory() {
    let server = PtyServer::serve(LeapEmulator::new().in_real_time(), None).unwrap();
    let robot = Robot::bundled("leap_right").unwrap();
    // A busy machine must not look like a silent hand.
    let options = LeapOptions::right().with_watchdog(Duration::ZERO);
    let mut hand = LeapHand::open(server.path(), &robot, options).unwrap();
    let mut state = HandState::new(16);
    hand.turn_on().unwrap();
    hand.cycle(None, &mut state).unwrap();
    let mut command = HandCommand { position: state.position.clone(), effort_limit: vec![50.0; 16] };
    let mut fresh = 0;
    let mut exchange = |times: usize| {
        allocation_counter::measure(|| {
            for _ in 0..times {
                command.position[2] += 1e-4;
                hand.cycle(Some(&command), &mut state).unwrap();
                fresh += usize::from(state.age.iter().all(|a| *a == 0));
            }
        })
        .count_total
    };
    // The first ones may still find out what the motors can do.
    exchange(EXCHANGES);
    assert_eq!(exchange(EXCHANGES), 0);
    assert!(fresh > EXCHANGES, "{fresh} of {} exchanges were answered", 2 * EXCHANGES);
}
