//! What the emulated LEAP hand does that a real one does: register boundaries, and faults that it can play.

use std::time::Duration;

use drex_hw::dynamixel::{Bus, Port, Timing};
use drex_hw::emulator::leap::{EmulatorPort, Fault, LeapEmulator};
use drex_hw::leap::table::{self, hardware_error};
use drex_hw::leap::{LeapHand, LeapOptions};
use drex_hw::{Clock, Error, Hand, HandCommand, HandState, JointStatus};
use drex_robot::Robot;

const LENGTH: u8 = 5;
const ACCESS: u8 = 7;

fn bus(hand: &LeapEmulator) -> Bus<EmulatorPort> {
    Bus::new(hand.port(), Timing::default())
}

#[test]
fn a_write_that_is_not_whole_registers_is_refused() {
    let hand = LeapEmulator::new();
    let mut bus = bus(&hand);
    let mut write = |address: u16, len: usize| match bus.write(3, address, &vec![0; len]) {
        Ok(_) => 0,
        Err(Error::Refused { number, .. }) => number,
        Err(other) => panic!("{other}"),
    };
    for (address, len, answer) in [
        (116, 4, 0),      // goal position
        (116, 2, LENGTH), // half of it
        (118, 2, LENGTH), // the other half
        (116, 5, ACCESS), // it and a register that is only read
        (102, 2, 0),      // goal current
        (102, 1, LENGTH),
        (102, 4, LENGTH), // and half of the goal velocity
        (102, 6, 0),      // and all of it
        (80, 6, 0),       // gains
        (80, 5, LENGTH),
        (168, 4, 0), // indirect addresses
        (169, 2, LENGTH),
        (208, 1, 0), // indirect data, byte by byte
        (66, 1, ACCESS),
        (132, 4, ACCESS),
        (86, 1, ACCESS),
        (227, 2, LENGTH), // behind the end
    ] {
        assert_eq!(write(address, len), answer, "{len} bytes at {address}");
    }
}

#[test]
fn a_refused_write_changes_nothing() {
    let hand = LeapEmulator::new();
    hand.set(3, table::GOAL_POSITION, 0x0102_0304);
    hand.record_writes();
    assert!(bus(&hand).write(3, 116, &[9, 9]).is_err());
    assert_eq!(hand.get(3, table::GOAL_POSITION), Some(0x0102_0304));
    let writes = hand.take_writes();
    assert!(writes.len() == 1 && !writes[0].accepted, "{writes:?}");
}

/// A hand that pushes against a wall with 200 mA everywhere.
fn pressing(hand: &LeapEmulator) -> (LeapHand<EmulatorPort>, HandState) {
    (0..16).for_each(|id| hand.set_wall(id, f64::NEG_INFINITY, 2100.0));
    let options = LeapOptions::right().with_timing(Timing::for_latency(Duration::ZERO));
    let robot = Robot::bundled("leap_right").expect("bundled");
    let mut leap = LeapHand::connect(hand.port(), &robot, options).expect("connects");
    leap.turn_on().expect("on");
    let mut state = HandState::new(16);
    press(hand, &mut leap, &mut state, 500);
    (leap, state)
}

fn press(hand: &LeapEmulator, leap: &mut LeapHand<EmulatorPort>, state: &mut HandState, cycles: u32) {
    let command = HandCommand { position: vec![0.5; 16], effort_limit: vec![200.0; 16] };
    for _ in 0..cycles {
        leap.cycle(Some(&command), state).expect("exchange");
        hand.pass(Duration::from_millis(2));
    }
}

#[test]
fn a_weak_supply_sags_under_load() {
    let hand = LeapEmulator::new();
    hand.set_supply(5.0, 0.25);
    let (_leap, state) = pressing(&hand);
    // 16 motors at 0.2 A through 0.25 Ω.
    assert_eq!(state.voltage_v, vec![Some(4.2); 16]);
}

#[test]
fn a_brown_out_is_survived() {
    let hand = LeapEmulator::new();
    let (mut leap, mut state) = pressing(&hand);
    hand.set_supply(3.3, 0.0);
    assert_eq!(hand.get(0, table::HARDWARE_ERROR), Some(hardware_error::VOLTAGE));
    hand.set_supply(2.0, 0.0);
    assert_eq!(hand.under_torque(), 0, "without power");
    hand.set_supply(5.0, 0.0);
    let begun = hand.now();
    while state.status != [JointStatus::Driven; 16] || state.effort != [200.0; 16] {
        let command = HandCommand { position: vec![0.5; 16], effort_limit: vec![200.0; 16] };
        // While all boot nobody answers.
        let _ = leap.cycle(Some(&command), &mut state);
        hand.pass(Duration::from_millis(2));
        assert!(hand.now() - begun < Duration::from_secs(5), "{:?}", state.status);
    }
}

#[test]
fn a_stuck_encoder_reads_the_same_while_the_joint_moves() {
    let hand = LeapEmulator::new();
    let (mut leap, mut state) = pressing(&hand);
    hand.stick_encoder(5, true);
    hand.set_wall(5, f64::NEG_INFINITY, f64::INFINITY);
    let before = hand.get(5, table::PRESENT_POSITION);
    press(&hand, &mut leap, &mut state, 50);
    assert_eq!(hand.get(5, table::PRESENT_POSITION), before);
    assert!(hand.position(5).expect("there") > 2200.0, "the motor runs away from where it thinks it is");
    hand.stick_encoder(5, false);
    assert!(hand.get(5, table::PRESENT_POSITION) == before, "shown with the next step");
    hand.pass(Duration::from_millis(2));
    assert_ne!(hand.get(5, table::PRESENT_POSITION), before);
}

#[test]
fn a_current_sensor_that_is_off_lets_more_flow_than_it_says() {
    let hand = LeapEmulator::new();
    hand.set_supply(5.0, 0.25);
    hand.set_current_sensor(5, 0.5);
    let (_leap, state) = pressing(&hand);
    // All read what they were told, and one of them draws twice as much: 15 times 0.2 A and 0.4 A through 0.25 Ω leave 4.15 V.
    assert_eq!(state.effort, vec![200.0; 16]);
    let volts = hand.get(5, table::PRESENT_VOLTAGE).expect("there");
    assert!((41..=42).contains(&volts), "{volts}");
}

#[test]
fn a_fault_can_be_put_off() {
    let hand = LeapEmulator::new();
    assert_eq!(hand.port().name(), "emulated LEAP hand");
    let mut bus = bus(&hand);
    hand.inject_later(Fault::Mute(3), 2);
    let answers: Vec<bool> = (0..5).map(|_| bus.get(3, table::PRESENT_TEMPERATURE).is_ok()).collect();
    assert_eq!(answers, [true, true, false, true, true]);
}

#[test]
fn a_motor_that_starts_again_forgets_its_turns_and_its_wall_stays_where_it_is() {
    let hand = LeapEmulator::new();
    // One turn and a bit; the wall is 200 ticks farther.
    hand.place(3, 4096.0 + 1000.0);
    hand.set_wall(3, 4096.0 + 900.0, 4096.0 + 1200.0);
    hand.power_cycle(3);
    hand.pass(Duration::from_secs(2));
    assert_eq!(hand.position(3), Some(1000.0));
    hand.set(3, table::TORQUE_ENABLE, 1);
    hand.set(3, table::GOAL_CURRENT, 100);
    hand.set(3, table::GOAL_PWM, 885);
    hand.set(3, table::GOAL_POSITION, 2000);
    hand.pass(Duration::from_secs(2));
    let stopped = hand.position(3).expect("there");
    assert!((1195.0..1230.0).contains(&stopped), "{stopped}");
    hand.set(3, table::GOAL_POSITION, 100);
    hand.pass(Duration::from_secs(2));
    let stopped = hand.position(3).expect("there");
    assert!((870.0..905.0).contains(&stopped), "{stopped}");
}
