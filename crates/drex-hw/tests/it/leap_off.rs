//! Torque off on hands in any state, and buses on which nobody answers.

use std::time::{Duration, Instant};

use drex_hw::dynamixel::{Timing, memory_pair};
use drex_hw::emulator::leap::{Fault, LeapEmulator};
use drex_hw::leap::table::{self, MotorModel, hardware_error};
use drex_hw::leap::{LeapHand, LeapOptions, MotorOff, TorqueState, inspect_hand, release, switch_off};
use drex_hw::{Clock, Error, Hand, HandCommand, HandState};
use drex_robot::Robot;
use proptest::prelude::*;

fn robot() -> Robot {
    Robot::bundled("leap_right").expect("bundled")
}

fn options() -> LeapOptions {
    LeapOptions::right().with_timing(Timing::for_latency(Duration::ZERO))
}

/// A hand whose driver was killed while it pressed on something with 150 mA everywhere.
fn left_alone() -> LeapEmulator {
    let hand = LeapEmulator::new();
    (0..16).for_each(|id| hand.set_wall(id, f64::NEG_INFINITY, 2100.0));
    let mut leap = LeapHand::connect(hand.port(), &robot(), options()).expect("connects");
    leap.turn_on().expect("on");
    let command = HandCommand { position: vec![0.5; 16], effort_limit: vec![150.0; 16] };
    let mut state = HandState::new(16);
    for _ in 0..500 {
        leap.cycle(Some(&command), &mut state).expect("exchange");
        hand.pass(Duration::from_millis(2));
    }
    assert_eq!(state.effort, vec![150.0; 16]);
    // Nothing of what a handle does when it is dropped.
    std::mem::forget(leap);
    hand
}

fn states(motors: &[MotorOff], state: TorqueState) -> Vec<u8> {
    motors.iter().filter(|m| m.torque == state).map(|m| m.id).collect()
}

#[test]
fn a_look_tells_what_a_killed_driver_left() {
    let hand = left_alone();
    hand.pass(Duration::from_millis(100));
    hand.set(6, table::HOMING_OFFSET, 1000);
    let seen = inspect_hand(hand.port(), &robot(), &options()).expect("answers");
    for motor in &seen.motors {
        let reading = motor.reading.as_ref().expect("answers");
        assert!(reading.torque && reading.is_frozen() && reading.watchdog == 255, "{motor:?}");
        assert_eq!(reading.homing_offset, if motor.id == 6 { 1000 } else { 0 });
    }
}

#[test]
fn one_motor_mute_and_one_with_an_error_keep_no_other_under_torque() {
    let hand = left_alone();
    hand.pass(Duration::from_millis(100));
    hand.inject(Fault::Mute(11), 100_000);
    hand.inject(Fault::Deaf(11), 100_000);
    hand.fail(4, hardware_error::VOLTAGE);
    let motors = switch_off(hand.port(), &robot(), &options()).expect("15 answer");
    assert_eq!(states(&motors, TorqueState::Unknown), [11]);
    assert_eq!(states(&motors, TorqueState::Off).len(), 15);
    let mute = motors.iter().find(|m| m.id == 11).expect("listed");
    assert_eq!(mute.fault.as_deref(), Some("did not answer"));
    assert_eq!(hand.under_torque(), 1, "the deaf one");
    assert!((0..16).filter(|id| *id != 11).all(|id| hand.get(id, table::BUS_WATCHDOG) == Some(0)));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Whatever motors are in: torque off where they hear, and never "off" where torque is on.
    #[test]
    fn any_state_ends_in_torque_off_or_is_said(
        torque in prop::collection::vec(any::<bool>(), 16),
        watchdog in prop::collection::vec(prop::sample::select(vec![0_u8, 2, 255]), 16),
        errors in prop::collection::vec(prop::sample::select(vec![0_u8, 1, 4, 32]), 16),
        mode in prop::collection::vec(prop::sample::select(vec![0_u8, 3, 4, 5, 16]), 16),
        quiet in prop::collection::vec(0_u8..3, 16),
        mute in prop::collection::vec(prop::bool::weighted(0.2), 16),
        deaf in prop::collection::vec(prop::bool::weighted(0.2), 16),
        gently in any::<bool>(),
    ) {
        let hand = LeapEmulator::new();
        for id in 0..16_u8 {
            let i = usize::from(id);
            hand.set(id, table::MODE, mode[i]);
            hand.set(id, table::TORQUE_ENABLE, torque[i].into());
            hand.set(id, table::BUS_WATCHDOG, watchdog[i]);
            hand.set(id, table::STATUS_LEVEL, quiet[i]);
            hand.fail(id, errors[i]);
            if mute[i] { hand.inject(Fault::Mute(id), 100_000); }
            if deaf[i] { hand.inject(Fault::Deaf(id), 100_000); }
        }
        let time = Duration::from_millis(200);
        let done = match gently {
            true => release(hand.port(), &robot(), &options(), time),
            false => switch_off(hand.port(), &robot(), &options()),
        };
        match done {
            Ok(motors) => for motor in motors {
                let i = usize::from(motor.id);
                let is_on = hand.get(motor.id, table::TORQUE_ENABLE) != Some(0);
                prop_assert!(!(is_on && motor.torque == TorqueState::Off), "{:?}", motor);
                let silent = mute[i] || deaf[i];
                prop_assert_eq!(motor.torque == TorqueState::Unknown, silent, "{:?}", motor);
                prop_assert!(deaf[i] || !is_on);
            },
            Err(error) => prop_assert!((0..16).all(|i| mute[i] || deaf[i]), "{}", error),
        }
    }
}

#[test]
fn a_release_lets_the_force_fall_slowly() {
    let hand = left_alone();
    hand.pass(Duration::from_millis(100));
    let until = hand.now();
    let watched = hand.clone();
    // Pauses of the release are time of the hand: what it presses with is noted at each write.
    hand.record_writes();
    let motors = release(hand.port(), &robot(), &options(), Duration::from_secs(1)).expect("answers");
    assert_eq!(states(&motors, TorqueState::Off).len(), 16);
    assert!(
        (Duration::from_secs(1)..Duration::from_secs(2)).contains(&(hand.now() - until)),
        "{:?}",
        hand.now() - until
    );
    let writes = watched.take_writes();
    let falling: Vec<i16> = writes
        .iter()
        .filter(|w| w.id == 3 && w.address == 100 && w.accepted)
        .map(|w| i16::from_le_bytes([w.data[2], w.data[3]]))
        .collect();
    assert!(falling.len() >= 50 && falling.is_sorted_by(|a, b| a >= b), "{falling:?}");
    assert!((147..150).contains(&falling[0]) && falling.ends_with(&[0]), "{falling:?}");
    assert!(falling.windows(2).all(|w| w[0] - w[1] <= 4), "{falling:?}");
    let off = writes.iter().position(|w| w.address == 64 && w.data == [0]).expect("torque off");
    assert!(writes[..off].iter().filter(|w| w.address == 100 && w.id == 3).count() >= 50, "force first, torque last");
}

#[test]
fn a_port_that_goes_away_meanwhile_is_opened_again() {
    let hand = LeapEmulator::new().in_real_time();
    (0..16).for_each(|id| hand.set(id, table::TORQUE_ENABLE, 1));
    let plug = hand.clone();
    hand.unplug();
    // Somebody puts the plug back after half a second.
    let helper = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(500));
        plug.plug();
    });
    let motors = switch_off(hand.port(), &robot(), &options()).expect("it is back");
    assert_eq!(states(&motors, TorqueState::Off).len(), 16);
    assert_eq!(hand.under_torque(), 0);
    helper.join().expect("ends");
    let gone = LeapEmulator::new();
    gone.unplug();
    assert!(matches!(switch_off(gone.port(), &robot(), &options()), Err(Error::Port { .. })));
}

/// Nobody answers, few answer, or somebody babbles: nothing takes longer than 5 s, by the clock of the bus.
#[test]
fn a_dead_bus_is_given_up_in_time() {
    let limit = Duration::from_secs(5);
    let slow = || LeapOptions::right();
    for alive in [0, 1, 8] {
        let hand = LeapEmulator::new();
        (alive..16).for_each(|id| hand.inject(Fault::Mute(id), 1_000_000));
        let timed = |what: &str, run: &dyn Fn()| {
            let begun = hand.now();
            run();
            assert!(hand.now() - begun < limit, "{what} with {alive} motors took {:?}", hand.now() - begun);
        };
        // The port says nothing of its latency: as patient as with any adapter.
        let port = || hand.port().with_lateness(Duration::from_millis(16));
        timed("connect", &|| drop(LeapHand::connect(port(), &robot(), slow()).expect_err("dead")));
        timed("look", &|| assert_eq!(inspect_hand(port(), &robot(), &slow()).is_ok(), alive > 0));
        timed("off", &|| assert_eq!(switch_off(port(), &robot(), &slow()).is_ok(), alive > 0));
        timed("release", &|| drop(release(port(), &robot(), &slow(), Duration::from_millis(100))));
    }
    // In real time: a port from which noise comes without an end.
    for what in ["connect", "look", "off"] {
        let (ours, mut theirs) = memory_pair();
        let babble = std::thread::spawn(move || {
            use drex_hw::dynamixel::Port;
            let mut n = 1_u32;
            while theirs.write_all(&[(n >> 16) as u8; 7]).is_ok() {
                n = n.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                std::thread::sleep(Duration::from_micros(500));
            }
        });
        let begun = Instant::now();
        let done = match what {
            "connect" => LeapHand::connect(ours, &robot(), slow()).map(|_| ()),
            "look" => inspect_hand(ours, &robot(), &slow()).map(|_| ()),
            _ => switch_off(ours, &robot(), &slow()).map(|_| ()),
        };
        assert!(matches!(done, Err(Error::NoMotors { .. })), "{done:?}");
        // The limit is 5 s on a machine with nothing else to do.
        assert!(begun.elapsed() < 2 * limit, "{what} took {:?}", begun.elapsed());
        babble.join().expect("ends");
    }
}

#[test]
fn caps_know_the_motor() {
    for (model, gentle, refused) in [(MotorModel::Xc330M288, 200, 1801.0), (MotorModel::Xl330M288, 150, 1740.0)] {
        let hand = LeapEmulator::with_model(model);
        let leap = LeapHand::connect(hand.port(), &robot(), options()).expect("connects");
        assert_eq!(leap.effort_caps(), [f64::from(gentle); 16]);
        assert_eq!(hand.get(0, table::CURRENT_LIMIT), Some(gentle));
        drop(leap);
        let most = model.peak_ma();
        drop(LeapHand::connect(hand.port(), &robot(), options().with_cap_ma(most)).expect("at its peak"));
        let error = LeapHand::connect(hand.port(), &robot(), options().with_cap_ma(refused)).expect_err("too much");
        let text = error.to_string();
        let words = [model.name(), "stalls", &format!("{}", model.recommended_cap_ma())].map(str::to_owned);
        assert!(words.iter().all(|w| text.contains(w)), "{text}");
    }
}
