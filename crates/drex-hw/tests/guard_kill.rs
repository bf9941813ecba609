//! Torque goes off whatever dies: a small version of the example of the same name, with deadlines that a busy machine keeps.
#![cfg(unix)]
#![allow(clippy::unwrap_used)] // a test may stop at the first surprise

#[path = "../examples/guard_kill/bench.rs"]
mod bench;

use std::time::Duration;

use bench::{Bench, Event, Model, TASK};

/// This program drives and guards as one of the tests below.
fn role(name: &str) -> Vec<String> {
    ["--exact", name, "--nocapture"].map(String::from).to_vec()
}

/// Started by the tests below in a process of its own; alone it does nothing.
#[test]
fn drive() {
    if std::env::var_os(TASK).is_some() {
        eprintln!("{}", bench::drive(role).unwrap());
    }
}

/// The same.
#[test]
fn guard() {
    if std::env::var_os(TASK).is_some() {
        drex_hw::guard::serve().unwrap();
    }
}

const EVENTS: [Event; 6] =
    [Event::Kill, Event::Stop, Event::HangUp, Event::GuardKilled, Event::GuardStopped, Event::GuardTold];

/// A few moments of each event; `LONGEST` of the bench is their deadline, a heartbeat that a starved program keeps their start.
fn torque_goes_off(model: Model, events: &[Event]) {
    let bench = Bench::new(model).unwrap();
    for (k, event) in events.iter().enumerate() {
        let moment = Duration::from_millis(30 + 17 * k as u64);
        // A machine so busy that a program is starved for a second gets another chance.
        let mut trials = (0..5).filter_map(|_| bench.trial(*event, moment, Duration::from_millis(1000), role).unwrap());
        let took = trials.next().unwrap_or_else(|| panic!("{model:?} {event:?}: the torque was off before"));
        assert!(took < Duration::from_secs(15), "{model:?} {event:?}: {took:?}");
    }
}

#[test]
fn a_leap_hand_has_its_torque_off_whatever_dies() {
    torque_goes_off(Model::Leap, &EVENTS);
}

#[test]
fn a_mute_motor_is_off_when_it_is_back() {
    torque_goes_off(Model::Leap, &[Event::MuteKill, Event::MuteHangUp]);
}

#[test]
fn an_allegro_hand_has_its_torque_off_whatever_dies() {
    torque_goes_off(Model::AllegroV4, &EVENTS);
    torque_goes_off(Model::AllegroV5, &EVENTS);
}
