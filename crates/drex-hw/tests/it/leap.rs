//! The driver of the LEAP hand against the emulated one: bring-up, limits, contact, torque off.

use std::time::Duration;

use drex_hw::dynamixel::{Port, Timing};
use drex_hw::emulator::leap::{EmulatorPort, Fault, LeapEmulator, WriteRecord};
use drex_hw::leap::table::{self, MotorModel};
use drex_hw::leap::{LeapGains, LeapHand, LeapOptions, inspect};
use drex_hw::{Clock, Error, Hand, HandCommand, HandState, JointStatus};
use drex_robot::Robot;

fn robot() -> Robot {
    Robot::bundled("leap_right").expect("bundled")
}

fn options() -> LeapOptions {
    LeapOptions::right().with_soft_start(Duration::ZERO).with_timing(Timing::for_latency(Duration::ZERO))
}

fn connect(hand: &LeapEmulator) -> LeapHand<EmulatorPort> {
    LeapHand::connect(hand.port(), &robot(), options()).expect("connects")
}

/// Exchanges for `ms` milliseconds, one every 2 ms.
fn run(leap: &mut LeapHand<EmulatorPort>, hand: &LeapEmulator, command: Option<&HandCommand>, ms: u64) -> HandState {
    let mut state = HandState::new(16);
    let end = hand.now() + Duration::from_millis(ms);
    while hand.now() < end {
        leap.cycle(command, &mut state).expect("exchange");
        hand.pass(Duration::from_millis(2));
    }
    state
}

fn all(position: f64, limit: f64) -> HandCommand {
    HandCommand { position: vec![position; 16], effort_limit: vec![limit; 16] }
}

/// Motor of a joint of the model.
fn motor(leap: &impl Hand, j: usize) -> u8 {
    let wiring = LeapOptions::right().joints;
    wiring.iter().find(|w| w.name == leap.joints()[j]).expect("wired").id
}

fn writes_to(log: &[WriteRecord], id: u8) -> impl Iterator<Item = &WriteRecord> {
    log.iter().filter(move |w| w.id == id)
}

#[test]
fn torque_goes_on_last_of_all_for_every_motor() {
    let hand = LeapEmulator::new();
    (0..16).for_each(|id| hand.place(id, 2048.0 + 7.0 * f64::from(id)));
    hand.record_writes();
    let mut leap = connect(&hand);
    assert_eq!(hand.under_torque(), 0);
    leap.turn_on().expect("on");
    let log = hand.take_writes();
    assert_eq!(hand.under_torque(), 16);
    assert!(log.iter().all(|w| w.accepted), "{:?}", log.iter().find(|w| !w.accepted));
    for id in 0..16 {
        let at = |address: u16, value: &[u8]| writes_to(&log, id).position(|w| w.address == address && w.data == value);
        let order = [
            at(64, &[0]).expect("torque off first"),
            at(11, &[5]).expect("mode"),
            at(38, &200_u16.to_le_bytes()).expect("cap"),
            writes_to(&log, id).position(|w| w.address == 80).expect("gains"),
            at(102, &30_i16.to_le_bytes()).expect("small current"),
            at(116, &(2048 + 7 * i32::from(id)).to_le_bytes()).expect("goal is where it is"),
            writes_to(&log, id).position(|w| w.address == 98 && w.data != [0]).expect("watchdog"),
            at(64, &[1]).expect("torque on"),
        ];
        assert!(order.is_sorted(), "motor {id}: {order:?}");
        assert_eq!(order[7] + 1, writes_to(&log, id).count(), "nothing after it");
    }
    assert_eq!(hand.get(0, table::POSITION_P), Some(450));
    assert_eq!(hand.get(1, table::POSITION_P), Some(600));
    assert_eq!(hand.get(1, table::RETURN_DELAY), Some(0));
    assert_eq!(hand.get(1, table::SHUTDOWN), Some(52));
}

#[test]
fn registers_that_wear_out_are_written_once() {
    let hand = LeapEmulator::new();
    drop(connect(&hand));
    hand.record_writes();
    drop(connect(&hand));
    assert!(hand.take_writes().iter().all(|w| w.address >= 64));
}

#[test]
fn a_stale_goal_and_torque_that_is_already_on_do_not_make_it_jump() {
    let hand = LeapEmulator::new();
    for id in 0..16 {
        // Another program has left torque on, another mode and a goal far away; something holds the joint.
        hand.set(id, table::MODE, 3);
        hand.set_wall(id, f64::NEG_INFINITY, 2050.0);
        hand.set(id, table::GOAL_POSITION, 2900);
        hand.set(id, table::TORQUE_ENABLE, u8::from(id % 2 == 0));
    }
    hand.pass(Duration::from_millis(100));
    assert!(hand.get(0, table::PRESENT_CURRENT).expect("there") > 1000);
    let mut leap = connect(&hand);
    (0..16).for_each(|id| hand.set_wall(id, f64::NEG_INFINITY, f64::INFINITY));
    let before: Vec<f64> = (0..16).map(|id| hand.position(id).expect("there")).collect();
    for id in 0..16 {
        hand.set(id, table::GOAL_POSITION, 1200);
    }
    leap.turn_on().expect("on");
    run(&mut leap, &hand, None, 300);
    for id in 0..16 {
        let moved = hand.position(id).expect("there") - before[usize::from(id)];
        assert!(moved.abs() < 2.0, "motor {id} moved {moved} ticks");
        assert_eq!(hand.get(id, table::MODE), Some(5));
    }
}

#[test]
fn a_motor_without_power_since_it_was_set_up_is_set_up_again_first() {
    let hand = LeapEmulator::new();
    let mut leap = connect(&hand);
    hand.power_cycle(3);
    hand.pass(Duration::from_millis(300));
    hand.set(3, table::GOAL_POSITION, 1200);
    hand.inject(Fault::Deaf(6), 3);
    hand.inject(Fault::Mute(11), 2);
    hand.record_writes();
    leap.turn_on().expect("on");
    let log = hand.take_writes();
    let on = writes_to(&log, 3).position(|w| w.address == 64 && w.data == [1]).expect("torque on");
    assert!(writes_to(&log, 3).position(|w| w.address == 168).is_some_and(|map| map < on));
    run(&mut leap, &hand, None, 200);
    for id in 0..16 {
        assert!((hand.position(id).expect("there") - 2048.0).abs() < 2.0, "motor {id}");
        assert_eq!(hand.get(id, table::GOAL_CURRENT), Some(30));
    }
}

#[test]
fn whatever_a_motor_does_not_hear_it_is_guarded_or_without_torque() {
    let mut on = 0;
    for skipped in 0..14 {
        let hand = LeapEmulator::new();
        let mut leap = connect(&hand);
        // Deaf once, to a later question each time.
        hand.set(6, table::GOAL_POSITION, 1200);
        hand.inject_later(Fault::Deaf(6), skipped);
        if leap.turn_on().is_err() {
            assert_eq!(hand.under_torque(), 0);
            continue;
        }
        on += 1;
        for id in 0..16 {
            assert_eq!(hand.get(id, table::BUS_WATCHDOG), Some(2), "motor {id}, deaf to {skipped}");
            assert_eq!(hand.get(id, table::GOAL_POSITION), Some(2048));
            assert_eq!(hand.get(id, table::TORQUE_ENABLE), Some(1));
        }
    }
    assert_eq!(on, 14, "one lost instruction is no matter");
}

#[test]
fn joints_are_found_by_name_and_move_to_their_goals() {
    let hand = LeapEmulator::new();
    let mut leap = connect(&hand);
    leap.turn_on().expect("on");
    let mut command = all(0.0, 400.0);
    let j = leap.joints().iter().position(|n| n == "mf_pip").expect("there");
    command.position[j] = 0.5;
    let state = run(&mut leap, &hand, Some(&command), 1500);
    for i in 0..16 {
        let goal = if i == j { 0.5 } else { 0.0 };
        assert!((state.position[i] - goal).abs() < 0.03, "{}: {}", leap.joints()[i], state.position[i]);
        assert_eq!((state.age[i], state.status[i]), (0, JointStatus::Driven));
    }
    let ticks = hand.position(6).expect("mf_pip is motor 6");
    assert!((ticks - 2048.0 - 0.5 / table::RAD_PER_TICK).abs() < 20.0, "{ticks}");
}

#[test]
fn a_left_hand_turns_the_other_way_where_its_maker_built_it_so() {
    let hand = LeapEmulator::new();
    let robot = Robot::bundled("leap_left").expect("bundled");
    let mut left = LeapOptions::left().with_soft_start(Duration::ZERO);
    left.timing = options().timing;
    let mut leap = LeapHand::connect(hand.port(), &robot, left).expect("connects");
    leap.turn_on().expect("on");
    let state = run(&mut leap, &hand, Some(&all(0.3, 400.0)), 1500);
    assert!(state.position.iter().all(|q| (q - 0.3).abs() < 0.03), "{:?}", state.position);
    let ticks = 0.3 / table::RAD_PER_TICK;
    for (id, sign) in [(0, -1.0), (1, 1.0), (8, -1.0), (12, -1.0), (13, -1.0), (14, 1.0)] {
        let moved = hand.position(id).expect("there") - 2048.0;
        assert!((moved - sign * ticks).abs() < 20.0, "motor {id}: {moved}");
    }
    // What pushes a reversed joint to larger angles is a positive effort.
    hand.set_wall(0, 2048.0 - 250.0, f64::INFINITY);
    let j = leap.joints().iter().position(|n| n == "if_rot").expect("there");
    let state = run(&mut leap, &hand, Some(&all(0.9, 200.0)), 1000);
    assert_eq!(state.effort[j], 200.0);
}

#[test]
fn contact_current_is_the_limit() {
    for model in [MotorModel::Xc330M288, MotorModel::Xl330M288] {
        let hand = LeapEmulator::with_model(model);
        (0..16).for_each(|id| hand.set_wall(id, f64::NEG_INFINITY, 2148.0));
        let mut leap = LeapHand::connect(hand.port(), &robot(), options().with_cap_ma(400.0)).expect("connects");
        leap.turn_on().expect("on");
        for limit in [100.0, 200.0, 300.0, 400.0] {
            let state = run(&mut leap, &hand, Some(&all(0.6, limit)), 600);
            for j in 0..16 {
                assert!(
                    (state.effort[j] - limit).abs() <= 2.0,
                    "{}: {} for {limit}",
                    leap.joints()[j],
                    state.effort[j]
                );
                assert!((state.position[j] - 100.0 * table::RAD_PER_TICK).abs() < 0.002);
            }
        }
    }
}

#[test]
fn current_rises_softly() {
    let hand = LeapEmulator::new();
    let soft = options().with_cap_ma(550.0).with_soft_start(Duration::from_millis(200));
    let mut leap = LeapHand::connect(hand.port(), &robot(), soft).expect("connects");
    leap.turn_on().expect("on");
    let mut highest = Vec::new();
    for _ in 0..6 {
        run(&mut leap, &hand, Some(&all(0.6, 550.0)), 50);
        highest.push((0..16).filter_map(|id| hand.get(id, table::GOAL_CURRENT)).max().expect("16"));
    }
    assert!(highest[0] < 200 && highest.is_sorted(), "{highest:?}");
    assert_eq!(highest[5], 550);
}

#[test]
fn what_means_nothing_is_refused_and_the_hand_goes_on() {
    let hand = LeapEmulator::new();
    let mut leap = connect(&hand);
    leap.turn_on().expect("on");
    let good = all(0.2, 300.0);
    run(&mut leap, &hand, Some(&good), 20);
    let goals: Vec<_> = (0..16).map(|id| hand.get(id, table::GOAL_POSITION)).collect();
    let mut state = HandState::new(16);
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let (mut position, mut limit) = (good.clone(), good.clone());
        position.position[3] = bad;
        limit.effort_limit[3] = bad;
        for command in [position, limit] {
            let error = leap.cycle(Some(&command), &mut state).expect_err("refused").to_string();
            assert!(error.contains(leap.joints()[3].as_str()), "{error}");
            assert_eq!(state.age, vec![0; 16], "the joints are read all the same");
        }
    }
    let mut negative = good.clone();
    negative.effort_limit[0] = -1.0;
    assert!(leap.cycle(Some(&negative), &mut state).is_err());
    assert!(leap.cycle(Some(&HandCommand::new(15)), &mut state).is_err());
    assert_eq!(goals, (0..16).map(|id| hand.get(id, table::GOAL_POSITION)).collect::<Vec<_>>());
}

#[test]
fn dropping_the_hand_takes_the_torque_off_also_when_answers_are_lost() {
    let hand = LeapEmulator::new();
    let mut leap = connect(&hand);
    leap.turn_on().expect("on");
    run(&mut leap, &hand, Some(&all(0.1, 300.0)), 20);
    assert_eq!(hand.under_torque(), 16);
    hand.inject(Fault::Mute(4), 1);
    hand.inject(Fault::Deaf(5), 1);
    hand.inject(Fault::Noise, 2);
    drop(leap);
    assert_eq!(hand.under_torque(), 0);
}

#[test]
fn a_failed_start_leaves_no_torque() {
    let hand = LeapEmulator::new();
    let mut leap = connect(&hand);
    hand.fail(9, table::hardware_error::OVERHEAT);
    let error = leap.turn_on().expect_err("one motor is too hot").to_string();
    assert!(error.contains("motor 9") && error.contains("too hot"), "{error}");
    assert_eq!(hand.under_torque(), 0);
    assert!(leap.turn_on().is_ok(), "set up anew, with a reboot");
}

#[test]
fn silence_freezes_the_hand_where_it_is() {
    let hand = LeapEmulator::new();
    let mut leap = connect(&hand);
    leap.turn_on().expect("on");
    run(&mut leap, &hand, Some(&all(1.0, 300.0)), 30);
    // As a program that was killed: nothing is sent, not even torque off.
    std::mem::forget(leap);
    hand.pass(Duration::from_millis(41));
    let stopped: Vec<_> = (0..16).map(|id| hand.position(id).expect("there")).collect();
    hand.pass(Duration::from_secs(1));
    for id in 0..16 {
        assert_eq!(hand.get(id, table::BUS_WATCHDOG), Some(255), "motor {id}");
        let drift = hand.position(id).expect("there") - stopped[usize::from(id)];
        assert!(drift.abs() < 60.0, "motor {id} went on for {drift} ticks");
        assert!(hand.position(id).expect("there") < 2500.0, "motor {id} did not reach its goal");
    }
}

#[test]
fn a_loop_that_was_away_goes_on() {
    let hand = LeapEmulator::new();
    let mut leap = connect(&hand);
    leap.turn_on().expect("on");
    run(&mut leap, &hand, Some(&all(0.2, 300.0)), 100);
    hand.pass(Duration::from_millis(500));
    assert_eq!(hand.get(3, table::BUS_WATCHDOG), Some(255));
    leap.cycle(Some(&all(0.4, 300.0)), &mut HandState::new(16)).expect("exchange");
    assert_eq!(hand.get(3, table::BUS_WATCHDOG), Some(2), "at once, not when it is found frozen");
    let state = run(&mut leap, &hand, Some(&all(0.4, 300.0)), 1500);
    assert!(state.position.iter().all(|q| (q - 0.4).abs() < 0.03), "{:?}", state.position);
    assert_eq!(state.status, vec![JointStatus::Driven; 16]);
}

#[test]
fn a_turn_too_many_is_counted_and_a_wrong_horn_is_refused() {
    let hand = LeapEmulator::new();
    hand.place(2, 2048.0 + 4096.0 + 50.0);
    hand.place(7, 2048.0 - 8192.0 - 50.0);
    let mut leap = connect(&hand);
    let j = leap.joints().iter().position(|n| n == "if_pip").expect("motor 2");
    let state = run(&mut leap, &hand, None, 4);
    assert!((state.position[j] - 50.0 * table::RAD_PER_TICK).abs() < 1e-9, "also without torque");
    leap.turn_on().expect("whole turns are no matter");
    let state = run(&mut leap, &hand, Some(&all(0.2, 300.0)), 1500);
    assert!(state.position.iter().all(|q| (q - 0.2).abs() < 0.03), "{:?}", state.position);
    assert!((hand.position(2).expect("there") - 6144.0 - 130.0).abs() < 20.0);
    drop(leap);

    hand.place(1, 2048.0 - 1024.0);
    let mut leap = connect(&hand);
    let error = leap.turn_on().expect_err("a quarter turn off").to_string();
    let name = leap.joints().iter().position(|n| n == "if_mcp").map(|j| leap.joints()[j].clone()).expect("there");
    assert!(error.contains(&name) && error.contains("another zero") && !error.contains("::"), "{error}");
    assert_eq!(hand.under_torque(), 0);
}

#[test]
fn a_hand_is_inspected_before_use() {
    let hand = LeapEmulator::new();
    hand.set(3, table::HOMING_OFFSET, 40);
    hand.set(4, table::SHADOW_ID, 2);
    hand.set(5, table::PRESENT_VOLTAGE, 42);
    hand.set(6, table::PRESENT_TEMPERATURE, 66);
    hand.set(7, table::FIRMWARE, 45);
    hand.inject(Fault::Mute(8), 10);
    let mut bus = drex_hw::dynamixel::Bus::new(hand.port(), Timing::for_latency(Duration::ZERO));
    hand.record_writes();
    let findings = inspect(&mut bus, &LeapOptions::right()).expect("port");
    assert_eq!(hand.take_writes(), [], "a look changes nothing");
    let text: Vec<String> = findings.iter().map(ToString::to_string).collect();
    for words in [
        "motor 3: its homing offset is 40",
        "motor 4: it also listens to id 2",
        "motor 5: its supply is 4.2 V",
        "motor 6: it has 66 °C",
        "motors [7] have firmware below 46",
        "motor 8: motor 8 does not answer",
        "15 motors wait up to 500 µs",
    ] {
        assert!(text.iter().any(|t| t.starts_with(words)), "{words} is not in {text:#?}");
    }
    assert_eq!(findings.len(), 7, "{text:#?}");
}

#[test]
fn an_adapter_that_hesitates_is_named_with_the_command_that_mends_it() {
    struct Slow(EmulatorPort, std::path::PathBuf);
    impl Clock for Slow {
        fn now(&self) -> Duration {
            self.0.now()
        }
    }
    impl Port for Slow {
        fn name(&self) -> &str {
            self.0.name()
        }
        fn read(&mut self, buffer: &mut [u8], wait: Duration) -> std::io::Result<usize> {
            self.0.read(buffer, wait)
        }
        fn write_all(&mut self, bytes: &[u8]) -> std::io::Result<()> {
            self.0.write_all(bytes)
        }
        fn clear_input(&mut self) -> std::io::Result<()> {
            self.0.clear_input()
        }
        fn set_baud(&mut self, baud: u32) -> std::io::Result<()> {
            self.0.set_baud(baud)
        }
        fn reopen(&mut self) -> std::io::Result<()> {
            self.0.reopen()
        }
        fn latency_file(&self) -> Option<std::path::PathBuf> {
            Some(self.1.clone())
        }
    }
    let folder = tempfile::tempdir().expect("folder");
    let file = folder.path().join("latency_timer");
    for (ms, found) in [("16\n", true), ("1\n", false)] {
        std::fs::write(&file, ms).expect("file");
        let hand = LeapEmulator::new();
        let leap = LeapHand::connect(Slow(hand.port(), file.clone()), &robot(), options()).expect("connects");
        let fix = format!("echo 1 | sudo tee {}", file.display());
        assert_eq!(leap.findings().iter().any(|f| f.fix == fix), found, "{:?}", leap.findings());
    }
}

#[test]
fn hands_that_do_not_fit_are_refused_by_name() {
    let hand = LeapEmulator::new();
    hand.set(5, table::MODEL_NUMBER, 1200);
    let error = LeapHand::connect(hand.port(), &robot(), options()).expect_err("mixed").to_string();
    assert!(error.contains("motor 5") && error.contains("XL330"), "{error}");

    let hand = LeapEmulator::new();
    hand.inject(Fault::Mute(11), 100_000);
    let error = LeapHand::connect(hand.port(), &robot(), options()).expect_err("a motor is missing");
    assert!(error.to_string().contains("(motor 11): does not answer"), "{error}");

    let hand = LeapEmulator::new();
    (0..16).for_each(|id| hand.inject(Fault::Mute(id), 100_000));
    let error = LeapHand::connect(hand.port(), &robot(), options()).expect_err("no power");
    assert!(matches!(error, Error::NoMotors { .. }), "{error}");

    let hand = LeapEmulator::new();
    let allegro = Robot::bundled("allegro_right").expect("bundled");
    assert!(LeapHand::connect(hand.port(), &allegro, options()).is_err());
    for bad in [
        options().with_cap_ma(f64::NAN),
        options().with_cap_ma(3000.0),
        options().with_watchdog(Duration::from_secs(3)),
        options().with_gains(LeapGains { p: 20_000, i: 0, d: 0 }),
        {
            let mut twice = options();
            twice.joints[1].id = 0;
            twice
        },
    ] {
        assert!(matches!(LeapHand::connect(hand.port(), &robot(), bad), Err(Error::Value { .. })));
    }
    assert!(options().with_zero("if_nothing", 2048).is_err());
}

#[test]
fn one_motor_with_old_firmware_is_heard_too() {
    let hand = LeapEmulator::new();
    hand.set(7, table::FIRMWARE, 45);
    let mut leap = connect(&hand);
    let follow_ups = leap.bus_stats().follow_ups;
    let state = run(&mut leap, &hand, None, 20);
    assert_eq!(state.age, [0; 16]);
    assert_eq!(leap.bus_stats().follow_ups, follow_ups);
}

#[test]
fn motors_that_were_told_to_be_quiet_and_other_zeros() {
    let hand = LeapEmulator::new();
    (0..16).for_each(|id| hand.set(id, table::STATUS_LEVEL, 0));
    let zero = options().with_zero("th_ipl", 2000).expect("there");
    let mut leap = LeapHand::connect(hand.port(), &robot(), zero).expect("connects");
    leap.turn_on().expect("on");
    let state = run(&mut leap, &hand, None, 20);
    let j = leap.joints().iter().position(|n| n == "th_ipl").expect("there");
    assert_eq!(motor(&leap, j), 15);
    assert!((state.position[j] - 48.0 * table::RAD_PER_TICK).abs() < 1e-9);
}

#[test]
fn a_hand_that_answers_late_is_driven_too() {
    for ms in [10, 22, 35] {
        let hand = LeapEmulator::new();
        let port = hand.port().with_lateness(Duration::from_millis(ms));
        let mut late = options().with_watchdog(Duration::from_millis(200));
        late.timing = None;
        let mut leap = LeapHand::connect(port, &robot(), late).expect("connects");
        assert_eq!(leap.bus_stats().timeouts, 0);
        leap.turn_on().expect("on");
        let state = run(&mut leap, &hand, Some(&all(0.3, 400.0)), 1500);
        assert!(state.position.iter().all(|q| (q - 0.3).abs() < 0.03), "{ms} ms: {:?}", state.position);
        assert_eq!((state.age, state.status), (vec![0; 16], vec![JointStatus::Driven; 16]));
        drop(leap);
        assert_eq!(hand.under_torque(), 0);
    }
}

#[test]
fn a_silent_motor_holds_a_loop_up_for_a_bounded_time() {
    let hand = LeapEmulator::new();
    let mut late = options();
    late.timing = None;
    let port = hand.port().with_lateness(Duration::from_millis(1));
    let mut leap = LeapHand::connect(port, &robot(), late).expect("connects");
    let mut state = HandState::new(16);
    hand.inject(Fault::Mute(7), 1);
    let before = hand.now();
    leap.cycle(None, &mut state).expect("exchange");
    let took = hand.now() - before;
    assert!(took < Duration::from_millis(20), "{took:?}");
}

#[test]
fn why_nobody_answers_is_found_out() {
    let refused = |hand: &LeapEmulator, late: u64| {
        let port = hand.port().with_lateness(Duration::from_millis(late));
        let mut options = options();
        options.timing = None;
        LeapHand::connect(port, &robot(), options).expect_err("not as it should be").to_string()
    };
    let hand = LeapEmulator::new();
    (0..16).for_each(|id| hand.set(id, table::BAUD, 3));
    let error = refused(&hand, 0);
    assert!(error.contains("at a speed of 1000000 baud") && error.contains("4000000"), "{error}");
    assert!(!error.contains("::"), "{error}");

    for late in [70, 120, 200] {
        let error = refused(&LeapEmulator::new(), late);
        assert!(error.contains("answer later than 50 ms") && !error.contains("speed"), "{late} ms: {error}");
    }

    let hand = LeapEmulator::new();
    (0..16).for_each(|id| hand.set(id, table::MODEL_NUMBER, 1020));
    let error = refused(&hand, 0);
    assert!(error.contains("motor 1") && error.contains("1020") && !error.contains("answers"), "{error}");
}
