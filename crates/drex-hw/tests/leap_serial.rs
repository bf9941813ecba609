//! A LEAP hand at a serial port in real time: only one process gets it, when that is killed the hand freezes and is free, and a plug
//! may be pulled.
#![cfg(unix)]

use std::path::Path;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use drex_hw::dynamixel::SerialPort;
use drex_hw::emulator::leap::LeapEmulator;
use drex_hw::emulator::pty::PtyServer;
use drex_hw::leap::{LeapHand, LeapOptions, table};
use drex_hw::{Error, Hand, HandCommand, HandState, JointStatus};
use drex_robot::Robot;

/// Where the process that is to be killed finds the hand.
const PORT: &str = "DREX_TEST_LEAP_PORT";

struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        // It may be gone already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn wait(what: &str, reached: impl Fn() -> bool) {
    let begun = Instant::now();
    while !reached() {
        assert!(begun.elapsed() < Duration::from_secs(20), "{what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn options() -> LeapOptions {
    // A machine that is busy may hold a program up for longer than the usual 40 ms.
    LeapOptions::right().with_watchdog(Duration::from_millis(200))
}

/// Started by the test below in a process of its own; alone it does nothing.
#[test]
fn drives_until_it_is_killed() {
    let Ok(path) = std::env::var(PORT) else { return };
    let robot = Robot::bundled("leap_right").expect("bundled");
    let mut leap = LeapHand::open(path, &robot, options()).expect("opens");
    leap.turn_on().expect("on");
    let (command, mut state) =
        (HandCommand { position: vec![0.3; 16], effort_limit: vec![100.0; 16] }, HandState::new(16));
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_secs(30) {
        leap.cycle(Some(&command), &mut state).expect("exchange");
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn the_hand_of_a_killed_program_freezes_and_is_free() {
    let folder = tempfile::tempdir().expect("folder");
    let link = folder.path().join("leap");
    let hand = LeapEmulator::new().in_real_time();
    let server = PtyServer::serve(hand.clone(), Some(&link)).expect("pty");
    let mut driver = Killed(
        Command::new(std::env::current_exe().expect("this program"))
            .args(["--exact", "drives_until_it_is_killed", "--nocapture"])
            .env(PORT, Path::new(&link))
            .spawn()
            .expect("starts"),
    );
    wait("it drives", || hand.under_torque() == 16);

    let error = SerialPort::open(&link, 4_000_000).expect_err("it has the bus").to_string();
    assert!(error.contains(&format!("process {}", driver.0.id())), "{error}");

    driver.0.kill().expect("runs");
    driver.0.wait().expect("ends");
    wait("all motors freeze", || (0..16).all(|id| hand.get(id, table::BUS_WATCHDOG) == Some(255)));
    assert_eq!(hand.under_torque(), 16, "it holds what it has");

    let robot = Robot::bundled("leap_right").expect("bundled");
    let leap = LeapHand::open(server.path(), &robot, options()).expect("the bus is free");
    assert_eq!(hand.under_torque(), 0, "the next program begins without torque");
    drop(leap);
}

#[test]
fn a_plug_that_was_pulled_and_put_back_is_no_end() {
    let folder = tempfile::tempdir().expect("folder");
    let link = folder.path().join("leap");
    let hand = LeapEmulator::new().in_real_time();
    let server = PtyServer::serve(hand.clone(), Some(&link)).expect("pty");
    let robot = Robot::bundled("leap_right").expect("bundled");
    let mut leap = LeapHand::open(server.path(), &robot, options()).expect("opens");
    leap.turn_on().expect("on");
    let (command, mut state) =
        (HandCommand { position: vec![0.3; 16], effort_limit: vec![100.0; 16] }, HandState::new(16));
    let mut until = |what: &str, reached: &dyn Fn(&drex_hw::Result<()>, &HandState) -> bool| {
        let begun = Instant::now();
        loop {
            let done = leap.cycle(Some(&command), &mut state);
            if reached(&done, &state) {
                return;
            }
            assert!(begun.elapsed() < Duration::from_secs(20), "{what}: {done:?} {:?}", state.status);
            std::thread::sleep(Duration::from_millis(2));
        }
    };
    let driven = |done: &drex_hw::Result<()>, s: &HandState| done.is_ok() && s.status == [JointStatus::Driven; 16];
    until("it drives", &driven);
    hand.unplug();
    until("it is missed", &|done, s| matches!(done, Err(Error::Port { .. })) && s.age.iter().all(|a| *a > 0));
    wait("all motors freeze", || (0..16).all(|id| hand.get(id, table::BUS_WATCHDOG) == Some(255)));
    hand.plug();
    until("it is back", &driven);
    until("it goes on", &|_, s| s.position.iter().all(|q| (q - 0.3).abs() < 0.05));
    assert_eq!(leap.reconnects(), 1);
    drop(leap);
    assert_eq!(hand.under_torque(), 0);
}
