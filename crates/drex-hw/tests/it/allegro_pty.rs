//! The Allegro driver over slcan at a pseudo-terminal, in real time.
#![cfg(unix)]

use std::time::{Duration, Instant};

use drex_hw::allegro::{AllegroHand, AllegroOptions, AllegroVersion};
use drex_hw::can::{Slcan, SlcanAdapter};
use drex_hw::emulator::allegro::AllegroEmulator;
use drex_hw::emulator::pty::PtyServer;
use drex_hw::{Hand, HandCommand, HandState};
use drex_robot::Robot;
use proptest::prelude::*;

/// A machine that starves the emulator for half a second gets other chances.
fn turn_on(driver: &mut impl Hand) {
    let begin = Instant::now();
    while let Err(error) = driver.turn_on() {
        assert!(begin.elapsed() < Duration::from_secs(20), "{error}");
    }
}

#[test]
fn a_joint_presses_with_its_limit_over_a_serial_port() {
    let hand = AllegroEmulator::new(AllegroVersion::V5).in_real_time();
    hand.place(12, 0.5);
    hand.set_wall(1, f64::NEG_INFINITY, 0.1);
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("can");
    let server = PtyServer::serve(SlcanAdapter::new(hand.bus()), Some(&link)).unwrap();
    assert_eq!(server.path(), link);

    let robot = Robot::bundled("allegro_right").unwrap();
    let options = AllegroOptions::new(AllegroVersion::V5).with_pose_wait(Duration::from_millis(4));
    let bus = Slcan::open(&link).unwrap();
    assert!(Slcan::open(&link).is_err(), "two programs at one port");
    let mut driver = AllegroHand::connect(bus, &robot, options).unwrap();
    turn_on(&mut driver);
    assert_eq!(driver.serial().as_deref(), Some("EMULATED"));
    let (mut command, mut state) = (HandCommand::new(16), HandState::new(16));
    let joint = robot.require_joint("ffj1").unwrap();
    driver.cycle(None, &mut state).unwrap();
    command.position.copy_from_slice(&state.position);
    command.position[joint] = 0.9;
    command.effort_limit.fill(0.08);
    // Until it presses, or for as long as the slowest machine may take.
    let begin = Instant::now();
    let pressing = || (hand.contact_torques_nm()[1] - 0.08).abs() < 1e-3;
    while !pressing() && begin.elapsed() < Duration::from_secs(10) {
        driver.cycle(Some(&command), &mut state).unwrap();
    }
    assert!(pressing(), "{} N m", hand.contact_torques_nm()[1]);
    drop(driver);
    // The last commands are on their way through the terminal.
    let begin = Instant::now();
    while hand.is_on() && begin.elapsed() < Duration::from_secs(10) {
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(!hand.is_on());
    drop(server);
    assert!(!link.exists());
}

#[test]
fn an_adapter_that_was_pulled_and_put_back_is_opened_again() {
    let hand = AllegroEmulator::new(AllegroVersion::V4).in_real_time();
    hand.place(12, 0.5);
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("can");
    let _server = PtyServer::serve(SlcanAdapter::new(hand.bus()), Some(&link)).unwrap();
    let robot = Robot::bundled("allegro_right").unwrap();
    let options = AllegroOptions::new(AllegroVersion::V4);
    let mut driver = AllegroHand::connect(Slcan::open(&link).unwrap(), &robot, options).unwrap();
    turn_on(&mut driver);
    let (mut command, mut state) = (HandCommand::new(16), HandState::new(16));
    command.effort_limit.fill(0.1);
    let joint = robot.require_joint("ffj1").unwrap();
    command.position[joint] = 0.4;
    let mut until = |what: &str, reached: &dyn Fn(&drex_hw::Result<()>, &HandState) -> bool| {
        let begin = Instant::now();
        loop {
            let done = driver.cycle(Some(&command), &mut state);
            if reached(&done, &state) {
                return;
            }
            assert!(begin.elapsed() < Duration::from_secs(20), "{what}: {done:?}");
            std::thread::sleep(Duration::from_millis(2));
        }
    };
    until("it is driven", &|done, s| done.is_ok() && s.age == [0; 16]);
    hand.unplug();
    until("it is missed", &|done, _| matches!(done, Err(drex_hw::Error::Port { .. })));
    hand.plug();
    until("it arrives", &|done, s| done.is_ok() && (s.position[joint] - 0.4).abs() < 0.05);
    driver.turn_off().unwrap();
    let begin = Instant::now();
    while hand.is_on() && begin.elapsed() < Duration::from_secs(10) {
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(!hand.is_on());
}

#[test]
fn an_adapter_refuses_what_it_does_not_know_and_is_deaf_while_closed() {
    let hand = AllegroEmulator::new(AllegroVersion::V4);
    let mut adapter = SlcanAdapter::new(hand.bus());
    let mut answer = |text: &[u8]| {
        let mut reply = Vec::new();
        adapter.take(text, &mut reply).unwrap();
        reply
    };
    assert_eq!(answer(b"\rC\rO\rt1000\r"), b"\r\x07\x07\x07");
    assert!(!hand.is_on());
    assert_eq!(
        answer(b"S8\rO\rO\rt1000\rr2000\r"),
        [b"\r\r\x07\r\r".as_slice(), b"t200702040104000000\r"].concat()[..]
    );
    assert!(hand.is_on());
}

proptest! {
    #[test]
    fn noise_costs_an_adapter_nothing_but_its_line(noise in prop::collection::vec(any::<u8>(), 0..2000)) {
        let mut adapter = SlcanAdapter::new(AllegroEmulator::new(AllegroVersion::V4).bus());
        let mut reply = Vec::new();
        adapter.take(&noise, &mut reply).unwrap();
        reply.clear();
        adapter.take(b"\rV\r", &mut reply).unwrap();
        prop_assert_eq!(reply.last(), Some(&b'\r'));
    }
}
