//! A look at a hand that is not whole.

use std::time::Duration;

use drex_hw::Error;
use drex_hw::dynamixel::Timing;
use drex_hw::emulator::leap::{Fault, LeapEmulator};
use drex_hw::leap::table::{self, hardware_error};
use drex_hw::leap::{LeapHand, LeapOptions, inspect_hand};
use drex_robot::Robot;

fn robot() -> Robot {
    Robot::bundled("leap_right").expect("bundled")
}

fn options() -> LeapOptions {
    LeapOptions::right().with_timing(Timing::for_latency(Duration::ZERO))
}

#[test]
fn one_dead_motor_does_not_hide_the_others() {
    let hand = LeapEmulator::new();
    hand.inject(Fault::Mute(11), 100_000);
    hand.place(6, 2048.0 + 100.0);
    assert!(LeapHand::connect(hand.port(), &robot(), options()).is_err());
    hand.fail(4, hardware_error::OVERLOAD);
    hand.set(3, table::TORQUE_ENABLE, 1);

    hand.record_writes();
    let seen = inspect_hand(hand.port(), &robot(), &options()).expect("15 answer");
    assert_eq!(hand.take_writes(), [], "nothing is changed");
    assert_eq!(hand.get(3, table::TORQUE_ENABLE), Some(1));
    assert_eq!(seen.motors.len(), 16);
    for m in &seen.motors {
        let fault = m.fault.as_deref();
        match m.id {
            11 => {
                assert!(m.reading.is_none() && fault.is_some_and(|t| t.contains("does not answer")), "{m:?}");
                continue;
            }
            4 => assert_eq!(fault, Some("overload")),
            _ => assert_eq!(fault, None),
        }
        let reading = m.reading.as_ref().expect("it answers");
        assert_eq!((reading.model, reading.torque), (1240, m.id == 3));
        assert_eq!((reading.health.temperature_c, reading.health.voltage_v), (31.0, 5.0));
        let angle = if m.id == 6 { 100.0 * table::RAD_PER_TICK } else { 0.0 };
        assert!((reading.position - angle).abs() < 0.01, "{m:?}");
    }
    assert!(seen.findings.iter().any(|f| f.motor == Some(11)), "{:?}", seen.findings);
}

#[test]
fn a_hand_without_any_answer_is_an_error_with_its_reason() {
    let hand = LeapEmulator::new();
    (0..16).for_each(|id| hand.set(id, table::BAUD, 1));
    let error = inspect_hand(hand.port(), &robot(), &options()).expect_err("another speed");
    assert!(matches!(error, Error::NoMotors { .. }) && error.to_string().contains("57600"), "{error}");
}
