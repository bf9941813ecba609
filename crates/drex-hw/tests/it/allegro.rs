//! The Allegro driver with an emulated hand: start, stop, limits, faults.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use drex_hw::allegro::{
    AllegroCommand, AllegroHand, AllegroInfo, AllegroOptions, AllegroReport, AllegroVersion, JointCalibration,
    switch_off,
};
use drex_hw::can::{CanBus, CanFrame, MemoryCan};
use drex_hw::emulator::allegro::{AllegroEmulator, EmulatorBus};
use drex_hw::torque_current::{Nominal, TorqueCurrentModel};
use drex_hw::{Clock, Hand, HandCommand, HandState, JointStatus, Result};
use drex_robot::Robot;
use proptest::prelude::*;

const VERSIONS: [AllegroVersion; 3] = [AllegroVersion::V3, AllegroVersion::V4, AllegroVersion::V5];
const CYCLE: Duration = Duration::from_millis(3);

fn robot() -> Robot {
    Robot::bundled("allegro_right").unwrap()
}

/// A hand at a pose inside its limits, and its driver.
fn driven(options: AllegroOptions) -> (AllegroEmulator, AllegroHand<EmulatorBus>) {
    let hand = placed(options.clone());
    let driver = AllegroHand::connect_with_clock(hand.bus(), &robot(), options, hand.clock()).unwrap();
    (hand, driver)
}

/// A hand at a pose inside its limits.
fn placed(options: AllegroOptions) -> AllegroEmulator {
    let (hand, robot) = (AllegroEmulator::with_options(options.clone()), robot());
    for (wire, name) in options.names.iter().enumerate() {
        let (low, high) = robot.joints[robot.require_joint(name).unwrap()].limits.unwrap();
        hand.place(wire, 0.2_f64.clamp(low + 0.05, high - 0.05));
    }
    hand
}

/// Exchanges `n` times, one every [`CYCLE`].
fn run(hand: &AllegroEmulator, driver: &mut impl Hand, command: Option<&HandCommand>, state: &mut HandState, n: usize) {
    for _ in 0..n {
        let next = hand.now() + CYCLE;
        driver.cycle(command, state).unwrap();
        hand.clock().wait_until(next);
    }
}

fn torques_heard(hand: &AllegroEmulator) -> Vec<[i16; 4]> {
    let torque = |h: drex_hw::emulator::allegro::ReceivedCommand| match h.command {
        AllegroCommand::Torque { wire, .. } => Some(wire),
        _ => None,
    };
    hand.take_record().into_iter().filter_map(torque).collect()
}

#[test]
fn what_the_hand_says_about_itself_can_be_waited_for() {
    for version in VERSIONS {
        let (hand, mut driver) = driven(AllegroOptions::new(version));
        assert_eq!((driver.info(), driver.stats().frames), (None, 0));
        let before = hand.now();
        assert!(driver.wait_for_reports().unwrap());
        assert!(hand.now() - before < Duration::from_millis(50));
        assert_eq!(driver.info().map(|i| i.left), Some(false));
        assert_eq!(driver.serial().is_some(), version != AllegroVersion::V3);
        let mut state = HandState::new(16);
        driver.cycle(None, &mut state).unwrap();
        assert!(state.age.iter().all(|a| *a < 5));
        // A finger is missing.
        hand.mute(1, true);
        hand.pass(Duration::from_millis(50));
        let before = hand.now();
        assert!(!driver.wait_for_reports().unwrap());
        let waited = hand.now() - before;
        assert!((Duration::from_millis(400)..Duration::from_millis(600)).contains(&waited), "{waited:?}");
    }
    // Nobody at the other end.
    let (here, _there) = MemoryCan::pair();
    let hand = AllegroEmulator::new(AllegroVersion::V4).in_real_time();
    let options = AllegroOptions::new(AllegroVersion::V4);
    let mut driver = AllegroHand::connect_with_clock(here, &robot(), options, hand.clock()).unwrap();
    assert!(!driver.wait_for_reports().unwrap());
    assert_eq!(driver.stats().frames, 0);
}

#[test]
fn the_model_and_the_drivers_agree_on_what_the_motors_give() {
    let caps = |version| AllegroOptions::new(version).torque_caps_nm();
    let robot = robot();
    let effort = robot.effort_limits().unwrap();
    for (name, cap) in drex_robot::joint_order::ALLEGRO_ROS.iter().zip(caps(AllegroVersion::V4)) {
        assert!((effort[robot.require_joint(name).unwrap()] - cap).abs() < 1e-12, "{name}: {effort:?}");
    }
    assert!(caps(AllegroVersion::V5).iter().all(|c| (c - 0.240 / 1.43).abs() < 1e-12));
    // LEAP's are those of 550 mA, by the model that public simulations of it use.
    let model = TorqueCurrentModel::nominal(Nominal::LeapSimulation).unwrap();
    let leap = Robot::bundled("leap_right").unwrap().effort_limits().unwrap();
    assert!(leap.iter().all(|l| (l - model.torque_nm(550.0).unwrap()).abs() < 0.005), "{leap:?}");
}

#[test]
fn no_torque_before_all_fingers_have_shown_themselves() {
    for version in VERSIONS {
        let hand = AllegroEmulator::new(version);
        hand.mute(2, true);
        hand.record();
        let mut driver =
            AllegroHand::connect_with_clock(hand.bus(), &robot(), AllegroOptions::new(version), hand.clock()).unwrap();
        let error = driver.turn_on().unwrap_err().to_string();
        assert!(error.contains("never seen: ring"), "{error}");
        let mut state = HandState::new(16);
        run(&hand, &mut driver, Some(&HandCommand::new(16)), &mut state, 5);
        drop(driver);
        assert_eq!(torques_heard(&hand), Vec::<[i16; 4]>::new(), "{version:?}");
        assert!(!hand.is_on());
    }
}

#[test]
fn joints_go_where_they_are_told_and_stop_when_the_driver_is_dropped() {
    for version in VERSIONS {
        let (hand, mut driver) = driven(AllegroOptions::new(version));
        hand.set_watchdog(None);
        let before = hand.positions();
        driver.turn_on().unwrap();
        let mut state = HandState::new(16);
        run(&hand, &mut driver, None, &mut state, 30);
        let moved = before.iter().zip(hand.positions()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(moved < 0.01, "{version:?}: moved by {moved} rad when torque went on");

        let mut command = HandCommand::new(16);
        command.position.copy_from_slice(&state.position);
        command.position.iter_mut().zip(driver.limits()).for_each(|(q, l)| *q = (*q + 0.3).min(l.1));
        command.effort_limit.copy_from_slice(driver.effort_caps());
        run(&hand, &mut driver, Some(&command), &mut state, 400);
        for (q, goal) in state.position.iter().zip(&command.position) {
            assert!((q - goal).abs() < 0.01, "{version:?}: {q} instead of {goal} rad");
        }
        assert!(state.status.iter().all(|s| *s == JointStatus::Driven));
        assert!(state.velocity.iter().all(|v| v.abs() < 0.05));

        hand.set_wall(1, f64::NEG_INFINITY, 0.3);
        run(&hand, &mut driver, Some(&command), &mut state, 50);
        assert!(hand.torques_nm()[1] > 0.01);
        drop(driver);
        assert!(!hand.is_on() && hand.torques_nm() == [0.0; 16]);
        while hand.say().is_some() {}
        hand.pass(Duration::from_millis(50));
        assert_eq!(hand.say(), None, "still reports");
    }
}

#[test]
fn on_a_wall_the_torque_is_the_limit() {
    for version in VERSIONS {
        let (hand, mut driver) = driven(AllegroOptions::new(version));
        driver.turn_on().unwrap();
        let names: Vec<String> = driver.joints().to_vec();
        let (mut command, mut state) = (HandCommand::new(16), HandState::new(16));
        for (j, name) in names.iter().enumerate() {
            let wire = AllegroOptions::new(version).names.iter().position(|n| n == name).unwrap();
            let wall = hand.positions()[wire] + 0.02;
            hand.set_wall(wire, f64::NEG_INFINITY, wall);
            command.position[j] = driver.limits()[j].1;
        }
        for limit in [0.02, 0.05, 0.1] {
            command.effort_limit.fill(limit);
            run(&hand, &mut driver, Some(&command), &mut state, 200);
            for wire in 0..16 {
                let joint = names.iter().position(|n| *n == AllegroOptions::new(version).names[wire]).unwrap();
                // Where the end of the range is near, the position loop asks for less than the limit.
                let room = driver.limits()[joint].1 - hand.positions()[wire];
                if room * AllegroOptions::new(version).gains[wire].kp > limit {
                    let contact = hand.contact_torques_nm()[wire];
                    assert!((contact - limit).abs() < 1e-3, "{version:?} {wire}: {contact} instead of {limit} N m");
                    assert!((state.effort[joint] - limit).abs() < 1e-3);
                }
            }
        }
    }
}

#[test]
fn old_poses_mean_no_torque_until_new_ones_come() {
    let (hand, mut driver) = driven(AllegroOptions::new(AllegroVersion::V4));
    hand.set_watchdog(None);
    driver.turn_on().unwrap();
    hand.set_wall(1, f64::NEG_INFINITY, 0.25);
    let (mut command, mut state) = (HandCommand::new(16), HandState::new(16));
    command.position.copy_from_slice(&[0.4; 16]);
    command.effort_limit.fill(0.1);
    run(&hand, &mut driver, Some(&command), &mut state, 100);
    assert!(hand.torques_nm()[1] > 0.05);
    hand.mute(3, true);
    run(&hand, &mut driver, Some(&command), &mut state, 5);
    assert!(hand.torques_nm()[1] > 0.05, "poses of 15 ms are still good");
    run(&hand, &mut driver, Some(&command), &mut state, 4);
    assert_eq!(hand.torques_nm(), [0.0; 16]);
    assert!(state.status.contains(&JointStatus::Silent) && driver.stats().stale > 0);
    hand.mute(3, false);
    run(&hand, &mut driver, Some(&command), &mut state, 20);
    assert!(hand.torques_nm()[1] > 0.05 && !state.status.contains(&JointStatus::Silent));
}

#[test]
fn poses_that_stay_away_are_an_error() {
    let (hand, mut driver) = driven(AllegroOptions::new(AllegroVersion::V4));
    driver.turn_on().unwrap();
    let (mut command, mut state) = (HandCommand::new(16), HandState::new(16));
    command.effort_limit.fill(0.1);
    run(&hand, &mut driver, Some(&command), &mut state, 20);
    hand.mute(2, true);
    // 20 ms until they are old, and half a second.
    run(&hand, &mut driver, Some(&command), &mut state, 170);
    hand.pass(Duration::from_millis(30));
    let error = driver.cycle(Some(&command), &mut state).unwrap_err().to_string();
    assert!(error.contains("no poses of ring for 0.5 s"), "{error}");
    assert_eq!(hand.torques_nm(), [0.0; 16]);
    // It goes on when they come back, as after an outage.
    hand.mute(2, false);
    hand.pass(CYCLE);
    run(&hand, &mut driver, Some(&command), &mut state, 20);
    assert!(hand.torques_nm() != [0.0; 16]);
    // A pause of the program is no failure of the hand.
    hand.pass(Duration::from_secs(2));
    run(&hand, &mut driver, Some(&command), &mut state, 20);
    driver.turn_off().unwrap();
    hand.pass(Duration::from_secs(2));
    driver.cycle(None, &mut state).unwrap();
}

#[test]
fn nonsense_is_refused_and_the_last_command_holds() {
    let (hand, mut driver) = driven(AllegroOptions::new(AllegroVersion::V5));
    driver.turn_on().unwrap();
    let (mut good, mut state) = (HandCommand::new(16), HandState::new(16));
    run(&hand, &mut driver, None, &mut state, 3);
    good.position.copy_from_slice(&state.position);
    good.effort_limit.fill(0.1);
    run(&hand, &mut driver, Some(&good), &mut state, 100);
    let before = hand.positions();
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut command = good.clone();
        command.position[5] = bad;
        assert!(driver.cycle(Some(&command), &mut state).is_err());
        command = good.clone();
        command.effort_limit[5] = bad;
        assert!(driver.cycle(Some(&command), &mut state).is_err());
    }
    assert!(driver.cycle(Some(&HandCommand::new(15)), &mut state).is_err());
    let mut negative = good.clone();
    negative.effort_limit[0] = -0.1;
    assert!(driver.cycle(Some(&negative), &mut state).is_err());
    run(&hand, &mut driver, None, &mut state, 50);
    let moved = before.iter().zip(hand.positions()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(moved < 0.01, "moved by {moved} rad");
}

#[test]
fn a_motor_that_reports_an_error_gets_no_torque() {
    let (hand, mut driver) = driven(AllegroOptions::new(AllegroVersion::V5));
    driver.turn_on().unwrap();
    let (mut command, mut state) = (HandCommand::new(16), HandState::new(16));
    command.position.fill(0.5);
    command.effort_limit.fill(0.1);
    hand.fail(5, 32);
    run(&hand, &mut driver, Some(&command), &mut state, 5);
    assert_eq!(hand.torques_nm()[5], 0.0);
    assert!(hand.torques_nm().iter().any(|t| *t != 0.0));
    assert_eq!(state.status.iter().filter(|s| **s == JointStatus::Faulted(32)).count(), 1);
    drop(driver);

    let (hand, mut driver) = driven(AllegroOptions::new(AllegroVersion::V5));
    hand.fail(5, 32);
    let error = driver.turn_on().unwrap_err().to_string();
    assert!(error.contains("mfj1 reports error 0x20"), "{error}");
}

#[test]
fn a_hand_that_is_not_where_it_can_be_gets_no_torque() {
    let (hand, mut driver) = driven(AllegroOptions::new(AllegroVersion::V4));
    hand.place(6, 3.0);
    hand.record();
    let error = driver.turn_on().unwrap_err().to_string();
    assert!(error.contains("mfj2") && error.contains("calibrate-zero"), "{error}");
    assert!(torques_heard(&hand).is_empty());
}

#[test]
fn a_hand_that_is_another_than_was_said_gets_no_torque() {
    let refusal = |version, wire_per_nm, info| {
        let options = AllegroOptions::new(version).with_wire_per_nm(wire_per_nm);
        let hand = placed(options.clone());
        hand.set_info(info);
        let mut driver = AllegroHand::connect_with_clock(hand.bus(), &robot(), options, hand.clock()).unwrap();
        hand.record();
        let told = driver.turn_on();
        assert!(torques_heard(&hand).is_empty());
        assert_eq!(driver.info(), Some(info));
        told.err().map(|e| e.to_string())
    };
    let info = |hardware, left, status| AllegroInfo { hardware, firmware: 0, left, status };
    let (v3, v4, v5) = (AllegroVersion::V3, AllegroVersion::V4, AllegroVersion::V5);
    assert!(refusal(v4, 1200.0, info(0x0500, false, 0)).unwrap().contains("choose version 5"));
    assert!(refusal(v5, 1430.0, info(0x0402, false, 0)).unwrap().contains("choose version 4"));
    assert!(refusal(v4, 1200.0, info(0x0300, false, 0)).unwrap().contains("set 800 wire units"));
    assert_eq!(refusal(v4, 800.0, info(0x0300, false, 0)), None);
    for (version, hardware) in [(v3, 0x0300), (v4, 0x0402), (v5, 0x0500)] {
        assert!(refusal(version, 800.0, info(hardware, true, 0)).unwrap().contains("left hand"));
        assert_eq!(refusal(version, 800.0, info(hardware, false, 0)), None);
    }
    assert!(refusal(v4, 1200.0, info(0x0402, false, 5)).unwrap().contains("motors on, a motor does not answer"));
    // With the model of a left hand it is no surprise.
    let (left, hand) = (Robot::bundled("allegro_left").unwrap(), AllegroEmulator::new(v4));
    hand.place(12, 0.5);
    hand.set_info(info(0x0402, true, 0));
    let mut driver = AllegroHand::connect_with_clock(hand.bus(), &left, AllegroOptions::new(v4), hand.clock()).unwrap();
    driver.turn_on().unwrap();
    // Firmware that leaves the version out is taken at the user's word.
    assert_eq!(refusal(v5, 1430.0, info(0, false, 0)), None);
}

#[test]
fn errors_say_what_to_change_and_name_nothing_of_the_source() {
    type Change = fn(&mut AllegroOptions);
    let changes: [(Change, &str); 6] = [
        (|o| o.wire_per_nm = 0.0, "0 wire units per N m; give"),
        (|o| o.gains[3].kd = f64::NAN, "NaN; give"),
        (|o| o.wire_caps[0] = 500, "500 on the wire for ffj0; give 0 to 375"),
        (|o| o.calibration[1].offset_counts = 1 << 21, "2097152 counts; give"),
        (|o| o.stale = Duration::ZERO, "stale; give"),
        (|o| o.velocity_filter_s = 2.0, "2 s; give 0 to 1 s"),
    ];
    for (change, text) in changes {
        let mut options = AllegroOptions::new(AllegroVersion::V4);
        change(&mut options);
        let (bus, _there) = MemoryCan::pair();
        let error = AllegroHand::connect(bus, &robot(), options).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains(text) && !error.contains("::"), "{error}");
    }
    let (hand, mut driver) = driven(AllegroOptions::new(AllegroVersion::V4));
    hand.place(6, 3.0);
    assert!(!driver.turn_on().unwrap_err().to_string().contains("::"));
    let error = driver.cycle(Some(&HandCommand::new(15)), &mut HandState::new(16)).unwrap_err().to_string();
    assert!(!error.contains("::"), "{error}");
}

#[test]
fn each_joint_has_its_own_temperature() {
    let mut options = AllegroOptions::new(AllegroVersion::V4);
    options.temperature_period_ms = 10;
    let (hand, driver) = driven(options.clone());
    (0..16).for_each(|wire| hand.heat(wire, 30 + wire as u8));
    // In a box a hand is the same hand.
    let mut driver: Box<dyn Hand> = Box::new(driver);
    driver.turn_on().unwrap();
    assert_eq!(driver.joints(), robot().joint_names());
    let (begin, mut state) = (hand.clock().now(), HandState::new(16));
    while hand.clock().now() < begin + Duration::from_millis(50) {
        driver.cycle(None, &mut state).unwrap();
        let then = hand.clock().now() + CYCLE;
        Box::new(hand.clock()).wait_until(then);
        assert!(hand.clock().now() >= then);
    }
    for (wire, name) in options.names.iter().enumerate() {
        let joint = driver.joints().iter().position(|n| n == name).unwrap();
        assert_eq!(state.temperature_c[joint], Some(30.0 + wire as f64), "{name}");
    }
}

#[test]
fn reports_come_back_as_they_were_said() {
    let info = AllegroInfo { hardware: 0x0405, firmware: 0x0102, left: true, status: 5 };
    for version in VERSIONS {
        let v5 = version == AllegroVersion::V5;
        for finger in 0..4 {
            let pose = AllegroReport::Pose { finger, counts: [-300, 0, 1, 32767] };
            let frame = pose.encode(version).unwrap();
            assert_eq!(AllegroReport::decode(version, &frame), Some(pose), "{version:?}");
        }
        let mut reports = vec![AllegroReport::Info(info), AllegroReport::Serial(*b"SAHB0123")];
        reports.extend((0..4).map(|finger| AllegroReport::Temperature { finger, celsius: [20, 31, 42, 255] }));
        for (finger, motor) in [(0, 0), (2, 15)].into_iter().filter(|_| v5) {
            reports.push(AllegroReport::Fingertips { finger, pascal: [-70_000, 123_456] });
            reports.push(AllegroReport::MotorError { motor, code: 9 });
        }
        for report in reports.into_iter().filter(|_| version != AllegroVersion::V3) {
            let frame = report.encode(version).unwrap();
            assert_eq!(AllegroReport::decode(version, &frame), Some(report), "{version:?}");
        }
    }
}

#[test]
fn zeros_and_directions_of_a_certain_hand() {
    let mut calibration = [JointCalibration::NONE; 16];
    calibration[1] = JointCalibration { offset_counts: 1500, encoder_reversed: true, motor_reversed: true };
    calibration[12] = JointCalibration { offset_counts: -4000, encoder_reversed: false, motor_reversed: true };
    let options = AllegroOptions::new(AllegroVersion::V3).with_calibration(calibration);
    let (hand, mut driver) = driven(options);
    driver.turn_on().unwrap();
    let (mut command, mut state) = (HandCommand::new(16), HandState::new(16));
    command.position.copy_from_slice(&[0.4; 16]);
    command.effort_limit.fill(0.2);
    run(&hand, &mut driver, Some(&command), &mut state, 400);
    assert!((hand.positions()[1] - 0.4).abs() < 0.01 && (hand.positions()[12] - 0.4).abs() < 0.01);
}

#[test]
fn an_unplugged_bus_is_an_error_and_the_next_stop_still_works() {
    let (hand, mut driver) = driven(AllegroOptions::new(AllegroVersion::V4));
    driver.turn_on().unwrap();
    let (mut command, mut state) = (HandCommand::new(16), HandState::new(16));
    command.position.fill(0.5);
    command.effort_limit.fill(0.1);
    run(&hand, &mut driver, Some(&command), &mut state, 3);
    hand.unplug();
    assert!(driver.cycle(Some(&command), &mut state).is_err());
    assert!(driver.turn_off().is_err());
    assert!(hand.is_on());
    hand.plug();
    drop(driver);
    assert!(!hand.is_on());
}

/// A bus whose adapter refuses the next so many frames.
struct Refusing {
    bus: EmulatorBus,
    next: Arc<AtomicU64>,
    refused: u64,
}

impl CanBus for Refusing {
    fn name(&self) -> &str {
        "refusing"
    }

    fn send(&mut self, frame: &CanFrame) -> Result<()> {
        if self.next.load(Ordering::Relaxed) == 0 {
            return self.bus.send(frame);
        }
        self.next.fetch_sub(1, Ordering::Relaxed);
        self.refused += 1;
        Ok(())
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<CanFrame>> {
        self.bus.receive(timeout)
    }

    fn refused(&self) -> u64 {
        self.refused
    }
}

#[test]
fn what_the_adapter_refuses_is_an_error_and_the_stop_is_repeated() {
    let options = AllegroOptions::new(AllegroVersion::V4);
    let hand = placed(options.clone());
    hand.set_watchdog(None);
    let next = Arc::new(AtomicU64::new(0));
    let bus = Refusing { bus: hand.bus(), next: next.clone(), refused: 0 };
    let mut driver = AllegroHand::connect_with_clock(bus, &robot(), options, hand.clock()).unwrap();
    driver.turn_on().unwrap();
    let mut state = HandState::new(16);
    run(&hand, &mut driver, None, &mut state, 5);
    next.store(4, Ordering::Relaxed);
    driver.cycle(None, &mut state).unwrap();
    let error = driver.cycle(None, &mut state).unwrap_err().to_string();
    assert!(error.contains("refused 4 frames") && error.contains("termination"), "{error}");
    run(&hand, &mut driver, None, &mut state, 5);
    // The first stop, four torques and two commands, is lost.
    next.store(6, Ordering::Relaxed);
    driver.turn_off().unwrap();
    assert!(!hand.is_on());
    driver.turn_on().unwrap();
    assert!(hand.is_on());
    next.store(1000, Ordering::Relaxed);
    let error = driver.turn_off().unwrap_err().to_string();
    assert!(error.contains("refused 6 frames") && error.contains("switch its power off"), "{error}");
    next.store(0, Ordering::Relaxed);
    assert!(hand.is_on());
    drop(driver);
    assert!(!hand.is_on());
}

#[test]
fn a_hand_serves_any_bus_until_told_to_stop() {
    let (mut here, mut there) = MemoryCan::pair();
    let hand = AllegroEmulator::new(AllegroVersion::V4).in_real_time();
    let stop = Arc::new(AtomicBool::new(false));
    let server = {
        let (hand, stop) = (hand.clone(), stop.clone());
        std::thread::spawn(move || hand.serve(&mut there, &stop))
    };
    here.send(&CanFrame::remote_frame(0x80 << 2, 0).unwrap()).unwrap();
    let info = here.receive(Duration::from_secs(5)).unwrap().unwrap();
    assert_eq!((info.id(), info.len()), (0x80 << 2, 7));
    stop.store(true, Ordering::Relaxed);
    server.join().unwrap().unwrap();
}

/// A bus that notes the largest number sent to each joint, and on which frames of strangers arrive between those of the hand.
struct Watched {
    bus: EmulatorBus,
    strangers: Vec<CanFrame>,
    turn: u32,
    version: AllegroVersion,
    largest: Arc<std::sync::Mutex<[u16; 16]>>,
}

impl CanBus for Watched {
    fn name(&self) -> &str {
        self.bus.name()
    }

    fn send(&mut self, frame: &CanFrame) -> Result<()> {
        if let Some(AllegroCommand::Torque { finger, wire }) = AllegroCommand::decode(self.version, frame) {
            let mut largest = self.largest.lock().unwrap();
            for (k, w) in wire.iter().enumerate() {
                let most = &mut largest[4 * usize::from(finger) + k];
                *most = (*most).max(w.unsigned_abs());
            }
        }
        self.bus.send(frame)
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<CanFrame>> {
        // Every third frame is a stranger's.
        self.turn += 1;
        match self.strangers.is_empty() || !self.turn.is_multiple_of(3) {
            true => self.bus.receive(timeout),
            false => Ok(self.strangers.pop()),
        }
    }
}

fn any_frame() -> impl Strategy<Value = CanFrame> {
    let data = prop::collection::vec(any::<u8>(), 0..=8);
    // Mostly such as a hand could send, in one of the versions.
    let id = prop_oneof![0..0x800_u16, (0x20..0x24_u16).prop_map(|m| m << 2), (3..7_u16).prop_map(|s| 0x3d0 | s)];
    (id, data, 0..20_u8).prop_map(|(id, data, remote)| match remote {
        0 => CanFrame::remote_frame(id, data.len() as u8).unwrap(),
        _ => CanFrame::data_frame(id, &data).unwrap(),
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Whatever else is said on the bus: nobody panics, and no number on the wire is above what is allowed.
    #[test]
    fn strangers_on_the_bus_do_no_harm(
        which in 0..3_usize,
        strangers in prop::collection::vec(any_frame(), 0..400),
        to_the_hand in prop::collection::vec(any_frame(), 0..40),
    ) {
        let version = VERSIONS[which];
        let options = AllegroOptions::new(version);
        let hand = placed(options.clone());
        let largest = Arc::new(std::sync::Mutex::new([0; 16]));
        let bus = Watched { bus: hand.bus(), strangers, turn: 0, version, largest: largest.clone() };
        let mut driver = AllegroHand::connect_with_clock(bus, &robot(), options.clone(), hand.clock()).unwrap();
        // A pose that somebody else made up may well be one that is refused.
        let _ = driver.turn_on();
        let (mut command, mut state) = (HandCommand::new(16), HandState::new(16));
        command.effort_limit.copy_from_slice(driver.effort_caps());
        for frame in &to_the_hand {
            hand.hear(frame);
            let next = hand.now() + CYCLE;
            driver.cycle(Some(&command), &mut state).unwrap();
            hand.clock().wait_until(next);
        }
        prop_assert!(state.position.iter().chain(&state.velocity).chain(&state.effort).all(|x| x.is_finite()));
        drop(driver);
        prop_assert!(!hand.is_on());
        for (n, cap) in largest.lock().unwrap().iter().zip(options.wire_caps) {
            prop_assert!(*n <= cap.unsigned_abs());
        }
    }

    /// Whatever is commanded, no number on the wire is above what was asked or allowed, and no joint is driven out of its range.
    #[test]
    fn torques_and_angles_stay_in_their_limits(
        which in 0..3_usize,
        commands in prop::collection::vec((prop::num::f64::ANY, -20.0..20.0_f64, 0.0..2.0_f64), 1..12),
    ) {
        let version = VERSIONS[which];
        let options = AllegroOptions::new(version);
        let hand = placed(options.clone());
        let largest = Arc::new(std::sync::Mutex::new([0; 16]));
        let bus = Watched { bus: hand.bus(), strangers: Vec::new(), turn: 0, version, largest: largest.clone() };
        let robot = robot();
        let mut driver = AllegroHand::connect_with_clock(bus, &robot, options.clone(), hand.clock()).unwrap();
        driver.turn_on().unwrap();
        let (mut command, mut state) = (HandCommand::new(16), HandState::new(16));
        for (wild, position, limit) in commands {
            command.position.fill(position);
            command.position[3] = wild;
            command.effort_limit.fill(limit);
            *largest.lock().unwrap() = [0; 16];
            for _ in 0..60 {
                let next = hand.now() + CYCLE;
                let told = driver.cycle(Some(&command), &mut state);
                prop_assert_eq!(told.is_err(), !wild.is_finite());
                hand.clock().wait_until(next);
            }
            for (wire, n) in largest.lock().unwrap().iter().enumerate() {
                let cap = f64::from(options.wire_caps[wire]);
                let asked = if wild.is_finite() { limit * options.wire_per_nm } else { f64::INFINITY };
                prop_assert!(f64::from(*n) <= cap.min(asked + 1e-6), "{} on the wire, {} asked, {} allowed", n, asked, cap);
            }
            for (wire, q) in hand.positions().iter().enumerate() {
                let (low, high) = driver.limits()[robot.require_joint(&options.names[wire]).unwrap()];
                prop_assert!((low - 0.1..=high + 0.1).contains(q), "{} at {} of {} to {}", options.names[wire], q, low, high);
            }
        }
    }
}

#[test]
fn a_hand_without_a_driver_is_switched_off_or_said_not_to_be() {
    use drex_hw::allegro::{AllegroOff, reports_poses, switch_off};
    for version in VERSIONS {
        let options = AllegroOptions::new(version);
        let (hand, mut driver) = driven(options.clone());
        hand.set_watchdog(None);
        driver.turn_on().expect("on");
        let command = HandCommand { position: vec![0.5; 16], effort_limit: vec![0.1; 16] };
        let mut state = HandState::new(16);
        for _ in 0..50 {
            driver.cycle(Some(&command), &mut state).expect("exchange");
            hand.pass(Duration::from_millis(2));
        }
        // A driver that was killed: the hand goes on pressing.
        std::mem::forget(driver);
        hand.pass(Duration::from_secs(1));
        assert!(hand.torques_nm().iter().any(|t| *t != 0.0));
        assert!(reports_poses(&mut hand.bus(), &options, &hand.clock()).expect("bus"));
        assert_eq!(switch_off(&mut hand.bus(), &options, &hand.clock()).expect("bus"), AllegroOff::Off);
        assert!(!hand.is_on() && hand.torques_nm() == [0.0; 16]);
        assert!(!reports_poses(&mut hand.bus(), &options, &hand.clock()).expect("bus"));
        assert_eq!(switch_off(&mut hand.bus(), &options, &hand.clock()).expect("bus"), AllegroOff::Off, "again");
    }
}

#[test]
fn a_geared_joint_turns_less_and_presses_harder() {
    let mut ratios = [1.0; 16];
    ratios[1] = 2.0;
    let (plain, geared) =
        (AllegroOptions::new(AllegroVersion::V5), AllegroOptions::new(AllegroVersion::V5).with_gear_ratios(ratios));
    assert_eq!(geared.torque_caps_nm()[1], 2.0 * plain.torque_caps_nm()[1]);
    assert_eq!(geared.torque_caps_nm()[0], plain.torque_caps_nm()[0]);
    let (hand, robot) = (AllegroEmulator::with_options(geared.clone()), robot());
    hand.place(1, 0.4);
    let seen = |options: AllegroOptions| {
        let mut driver = AllegroHand::connect_with_clock(hand.bus(), &robot, options, hand.clock()).expect("connects");
        driver.wait_for_reports().expect("bus");
        let mut state = HandState::new(16);
        driver.cycle(None, &mut state).expect("exchange");
        state.position[robot.require_joint("ffj1").unwrap()]
    };
    // Who does not know of the gear reads twice the angle.
    assert!((seen(geared) - 0.4).abs() < 2e-3 && (seen(plain) - 0.8).abs() < 2e-3);
    let capped = AllegroOptions::new(AllegroVersion::V5).with_gear_ratios(ratios).with_cap_nm(0.1);
    assert!(capped.torque_caps_nm().iter().all(|c| (0.098..=0.1).contains(c)), "{:?}", capped.torque_caps_nm());
    assert_eq!(AllegroOptions::new(AllegroVersion::V5).with_gentle_caps().wire_caps, [120; 16]);
    // A cap that is a whole number on the wire is that number, however it was rounded on the way.
    for k in 1..200_i16 {
        let options = AllegroOptions::new(AllegroVersion::V5);
        let cap_nm = f64::from(k) / options.wire_per_nm;
        assert_eq!(options.with_cap_nm(cap_nm).wire_caps[0], k);
    }
}

#[test]
fn a_hand_whose_adapter_refuses_frames_is_not_said_to_be_off() {
    let options = AllegroOptions::new(AllegroVersion::V4);
    let hand = placed(options.clone());
    // What it refused before does not count.
    let mut bus = Refusing { bus: hand.bus(), next: Arc::new(AtomicU64::new(4)), refused: 3 };
    let error = switch_off(&mut bus, &options, &hand.clock()).unwrap_err().to_string();
    assert!(error.contains("refused 4 frames") && error.contains("switch its power off"), "{error}");
}
