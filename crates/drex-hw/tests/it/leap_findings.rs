//! What speaks against motion, what a low supply takes from the limits, and what is told of errors on the way.

use std::time::Duration;

use drex_hw::control::{
    ControlOptions, Derating, HoldPosition, JointFault, Recorder, Sample, StopReason, Telemetry, run, telemetry,
};
use drex_hw::dynamixel::Timing;
use drex_hw::emulator::leap::{EmulatorPort, LeapEmulator};
use drex_hw::leap::table::{self, MotorModel, hardware_error};
use drex_hw::leap::{FindingKind, LeapHand, LeapOptions, refuse_motion};
use drex_hw::torque_current::Nominal;
use drex_hw::{Hand, HandState};
use drex_robot::Robot;
use proptest::prelude::*;

fn connect(hand: &LeapEmulator, options: LeapOptions) -> LeapHand<EmulatorPort> {
    let options = options.with_timing(Timing::for_latency(Duration::ZERO));
    LeapHand::connect(hand.port(), &Robot::bundled("leap_right").expect("bundled"), options).expect("connects")
}

#[test]
fn findings_that_stop_motion_are_named_and_allowed_by_name() {
    let hand = LeapEmulator::new();
    assert!(refuse_motion(connect(&hand, LeapOptions::right()).findings(), &[]).is_ok(), "slow is not unsafe");
    hand.set(6, table::HOMING_OFFSET, 1000);
    hand.set(7, table::PRESENT_VOLTAGE, 40);
    hand.fail(8, hardware_error::OVERLOAD);
    hand.set(9, table::PRESENT_TEMPERATURE, 61);
    hand.set(10, table::SHADOW_ID, 3);
    let leap = connect(&hand, LeapOptions::right());
    let kinds: Vec<FindingKind> = leap.findings().iter().filter(|f| f.kind.stops_motion()).map(|f| f.kind).collect();
    use FindingKind::{HardwareError, HomingOffset, Hot, LowVoltage, SecondId};
    assert_eq!(kinds, [HomingOffset, LowVoltage, HardwareError, Hot, SecondId]);
    let text = refuse_motion(leap.findings(), &[LowVoltage]).expect_err("four are left").to_string();
    for words in
        ["motor 6", "1000 ticks", "88 degrees", "overload", "61 °C", "homing-offset,hardware-error,hot,second-id"]
    {
        assert!(text.contains(words), "{words}: {text}");
    }
    assert!(!text.contains("4.0 V"), "{text}");
    assert!(refuse_motion(leap.findings(), &kinds).is_ok());
    for kind in FindingKind::ALL {
        assert_eq!(FindingKind::ALL.iter().filter(|k| k.name() == kind.name()).count(), 1);
    }
}

#[test]
fn an_offset_that_the_zero_knows_is_no_finding() {
    let hand = LeapEmulator::new();
    hand.set(6, table::HOMING_OFFSET, 300);
    let mut options = LeapOptions::right();
    options.joints[6].homing_offset_ticks = 300;
    assert!(refuse_motion(connect(&hand, options).findings(), &[]).is_ok());
}

/// A hand that presses on something with all it may, from a supply that sags under load.
fn press(hand: &LeapEmulator, derating: Option<Derating>) -> (Vec<Sample>, Vec<(usize, JointFault)>) {
    (0..16).for_each(|id| hand.set_wall(id, f64::NEG_INFINITY, 2100.0));
    let mut leap = connect(hand, LeapOptions::right());
    let goal = drex_hw::control::Waypoint { time_s: 0.2, position: vec![0.5; 16] };
    let end = drex_hw::control::Waypoint { time_s: 8.0, position: vec![0.5; 16] };
    let caps = leap.effort_caps().to_vec();
    let mut way = drex_hw::control::Trajectory::new(vec![goal, end], caps).expect("a way");
    let (recorder, mut cycles): (Recorder, Telemetry) = telemetry(16, 10_000);
    let mut options = ControlOptions::default().with_recorder(recorder);
    options.derating = derating;
    let report = run(&mut leap, &mut way, hand, options);
    assert!(matches!(report.stop_reason, StopReason::Done) && report.torque_off.is_ok(), "{:?}", report.stop_reason);
    let mut samples = Vec::new();
    while let Ok(Some(sample)) = cycles.next(Duration::ZERO, Sample::clone) {
        samples.push(sample);
    }
    (samples, report.faults)
}

#[test]
fn a_sagging_supply_lowers_the_limits_without_swinging() {
    let hand = LeapEmulator::new();
    // 16 motors at 0.2 A would leave 3.56 V.
    hand.set_supply(5.0, 0.45);
    let (samples, faults) = press(&hand, Some(Derating::default()));
    assert!(faults.len() == 16 && faults.iter().all(|(_, t)| matches!(t, JointFault::LowVoltage { .. })), "{faults:?}");
    let late: Vec<f64> = samples[samples.len() / 2..].iter().map(|s| s.command.effort_limit[3]).collect();
    let (low, high) = (late.iter().copied().fold(f64::INFINITY, f64::min), late.iter().copied().fold(0.0, f64::max));
    // In balance 5 V − 0.45 Ω · 16 · I is the supply at which I is allowed; without the slow way back it swings between floor and cap.
    assert!(low > 60.0 && high < 180.0 && high - low < 40.0, "{low} to {high} mA");
    let volts = samples.last().and_then(|s| s.state.voltage_v[3]).expect("measured");
    assert!(volts > 3.7, "{volts} V");

    let strong = LeapEmulator::new();
    let (samples, faults) = press(&strong, Some(Derating::default()));
    assert!(faults.is_empty() && samples.last().is_some_and(|s| s.command.effort_limit[3] == 200.0), "{faults:?}");
}

proptest! {
    #[test]
    fn less_supply_never_gives_more(a in 0.0..7.0_f64, b in 0.0..7.0_f64) {
        let d = Derating::default();
        let (low, high) = (a.min(b), a.max(b));
        prop_assert!(d.share_at_supply(low) <= d.share_at_supply(high));
        prop_assert!((d.floor_share..=1.0).contains(&d.share_at_supply(a)));
        prop_assert_eq!(d.share_at_supply(f64::NAN), d.floor_share);
    }
}

#[test]
fn an_error_with_which_a_motor_keeps_running_is_reported_too() {
    let hand = LeapEmulator::new();
    let mut leap = connect(&hand, LeapOptions::right());
    let j = leap.joints().iter().position(|n| n == "if_mcp").expect("there");
    let id = LeapOptions::right().joints.iter().find(|m| m.name == "if_mcp").expect("there").id;
    let breaks = hand.clone();
    let mut options = ControlOptions::default();
    let mut cycles = 0;
    options = options.with_limiter(move |_: &HandState, _: &mut [f64]| {
        cycles += 1;
        if cycles == 100 {
            breaks.fail(id, hardware_error::VOLTAGE);
        }
    });
    let report = run(&mut leap, &mut HoldPosition::new(1.0, vec![50.0; 16]), &hand, options);
    assert!(matches!(report.stop_reason, StopReason::Done));
    assert_eq!(report.faults, [(j, JointFault::HardwareError(hardware_error::VOLTAGE))]);
    assert_eq!(leap.error_text(hardware_error::VOLTAGE), "supply voltage out of range");
}

#[test]
fn published_models_disagree_as_documented() {
    let spread = |model: MotorModel, ma| Nominal::spread_nm(model.torque_current_models(), ma).expect("a current");
    let (low, high) = spread(MotorModel::Xc330M288, 350.0);
    assert!((low - 0.150).abs() < 1e-3 && (high - 0.410).abs() < 1e-3, "{low} to {high}");
    let first = |model: MotorModel| {
        drex_hw::torque_current::TorqueCurrentModel::nominal(model.torque_current_models()[0]).expect("nominal")
    };
    let (xc, xl) = (first(MotorModel::Xc330M288), first(MotorModel::Xl330M288));
    // What a law of the wrong motor costs.
    let share = xl.torque_nm(200.0).expect("finite") / xc.torque_nm(200.0).expect("finite");
    assert!((share - 0.685).abs() < 0.005, "{share}");
    assert!(Nominal::spread_nm(&[], 1.0).is_err());
}
