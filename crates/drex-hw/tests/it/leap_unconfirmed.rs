//! Torque off, and what is said of motors that do not confirm it.

use std::cell::Cell;
use std::time::Duration;

use drex_hw::control::{ControlOptions, HoldPosition, StopReason, run};
use drex_hw::dynamixel::Timing;
use drex_hw::emulator::leap::{EmulatorPort, LeapEmulator};
use drex_hw::leap::{LeapHand, LeapOptions};
use drex_hw::{Clock, Error, Hand, HandState};
use drex_robot::Robot;

const MUTE: u8 = 5;

fn hand() -> (LeapEmulator, LeapHand<EmulatorPort>) {
    let emulator = LeapEmulator::new();
    let options = LeapOptions::right().with_timing(Timing::for_latency(Duration::ZERO));
    let hand = LeapHand::connect(emulator.port(), &Robot::bundled("leap_right").unwrap(), options).unwrap();
    (emulator, hand)
}

fn is_unknown(told: &drex_hw::Result<()>) -> bool {
    matches!(told, Err(error @ Error::TorqueUnknown { .. }) if error.to_string().contains("(motor 5)"))
}

#[test]
fn a_motor_that_does_not_answer_is_torque_unknown_and_the_others_are_off() {
    let (emulator, mut leap) = hand();
    leap.turn_on().unwrap();
    emulator.detach(MUTE, true);
    let told = leap.turn_off();
    assert!(is_unknown(&told) && emulator.under_torque() == 1, "{told:?}");
    emulator.detach(MUTE, false);
    leap.turn_off().unwrap();
    assert_eq!(emulator.under_torque(), 0);

    // Also one that has been away for so long that it is no longer asked with the others.
    leap.turn_on().unwrap();
    emulator.detach(MUTE, true);
    let mut state = HandState::new(16);
    for _ in 0..100 {
        leap.cycle(None, &mut state).unwrap();
    }
    assert!(is_unknown(&leap.turn_off()));
    // And one that says nothing although it obeys.
    emulator.detach(MUTE, false);
    emulator.inject(drex_hw::emulator::leap::Fault::Mute(MUTE), 20);
    assert!(is_unknown(&leap.turn_off()) && emulator.under_torque() == 0);
}

/// The emulator's time; the mute motor's cable is mended at some time, and it is noted when no torque is left.
struct Mender {
    emulator: LeapEmulator,
    at: Duration,
    off: Cell<Option<Duration>>,
}

impl Clock for Mender {
    fn now(&self) -> Duration {
        let now = self.emulator.now();
        if now >= self.at {
            self.emulator.detach(MUTE, false);
        }
        if self.emulator.under_torque() == 0 {
            self.off.set(self.off.get().or(Some(now)));
        }
        now
    }

    fn wait_until(&self, then: Duration) {
        self.emulator.wait_until(then);
    }
}

#[test]
fn a_loop_goes_on_telling_a_motor_that_it_cannot_reach() {
    for (mended_s, patience_s) in [(1.3, 5.0), (9.0, 1.0)] {
        let (emulator, mut leap) = hand();
        let clock = Mender { emulator: emulator.clone(), at: Duration::from_secs_f64(mended_s), off: Cell::new(None) };
        let caps = leap.effort_caps().to_vec();
        let mut lost = false;
        let cut = emulator.clone();
        let options = ControlOptions::default().with_off_patience(Duration::from_secs_f64(patience_s)).with_limiter(
            move |_, _| {
                if !std::mem::replace(&mut lost, true) {
                    cut.detach(MUTE, true);
                }
            },
        );
        let report = run(&mut leap, &mut HoldPosition::new(0.5, caps), &clock, options);
        assert!(matches!(report.stop_reason, StopReason::Done), "{:?}", report.stop_reason);
        if mended_s < patience_s {
            report.torque_off.unwrap();
            let off = clock.off.get().unwrap();
            let late = off.saturating_sub(clock.at);
            assert!(off >= clock.at && late < Duration::from_millis(60), "{late:?} after it answers again");
            assert!(report.off_took > Duration::from_millis(500), "{:?}", report.off_took);
        } else {
            assert!(is_unknown(&report.torque_off) && emulator.under_torque() == 1);
            assert!(report.off_took >= Duration::from_secs(1) && report.off_took < Duration::from_secs(2));
        }
    }
}
