//! Whatever is commanded and whatever goes wrong: no current above the cap, no goal outside of the limits, no panic.

use std::time::Duration;

use drex_hw::dynamixel::{Port, Timing, encode, instruction};
use drex_hw::emulator::leap::{Fault, LeapEmulator, WriteRecord};
use drex_hw::leap::table::{self, RAD_PER_TICK};
use drex_hw::leap::{LeapHand, LeapOptions};
use drex_hw::{Clock, Hand, HandCommand, HandState};
use drex_robot::Robot;
use proptest::prelude::*;

/// Numbers as programs send them, and as they should not.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -4.0..4.0,
        4 => 0.0..700.0,
        1 => any::<f64>(),
        1 => prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(f64::MIN), Just(1e300), Just(-0.0)],
    ]
}

/// What happens between two exchanges.
#[derive(Debug, Clone)]
enum Event {
    Nothing,
    Fault(u8, u8),
    Fail(u8, u8),
    Power(u8),
    Place(u8, f64),
    Plug,
    Pause(u16),
    Off,
    On,
}

fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        12 => Just(Event::Nothing),
        4 => (0..16_u8, 0..6_u8).prop_map(|(id, kind)| Event::Fault(id, kind)),
        1 => (0..16_u8, any::<u8>()).prop_map(|(id, bits)| Event::Fail(id, bits)),
        1 => (0..16_u8).prop_map(Event::Power),
        1 => (0..16_u8, prop_oneof![-4000.0..8000.0, any::<f64>()]).prop_map(|(id, at)| Event::Place(id, at)),
        1 => Just(Event::Plug),
        1 => any::<u16>().prop_map(|ms| Event::Pause(ms % 500)),
        1 => Just(Event::Off),
        2 => Just(Event::On),
    ]
}

fn happen(event: &Event, hand: &LeapEmulator, leap: &mut impl Hand) {
    match *event {
        Event::Nothing => {}
        Event::Fault(id, kind) => {
            let fault = [
                Fault::Mute(id),
                Fault::Corrupt(id),
                Fault::Truncate(id),
                Fault::Duplicate(id),
                Fault::Noise,
                Fault::Deaf(id),
            ];
            hand.inject(fault[usize::from(kind)], 1);
        }
        Event::Fail(id, bits) => hand.fail(id, bits),
        Event::Power(id) => hand.power_cycle(id),
        Event::Place(id, ticks) => hand.place(id, ticks),
        Event::Plug if hand.plugged() => hand.unplug(),
        Event::Plug => hand.plug(),
        Event::Pause(ms) => hand.pass(Duration::from_millis(u64::from(ms))),
        // Both may fail while things are broken; the writes are what counts.
        Event::Off => drop(leap.turn_off()),
        Event::On => drop(leap.turn_on()),
    }
}

/// A port on which somebody talks without end.
struct Babble {
    bytes: Vec<u8>,
    at: usize,
    time: std::cell::Cell<Duration>,
}

impl Clock for Babble {
    fn now(&self) -> Duration {
        self.time.set(self.time.get() + Duration::from_micros(20));
        self.time.get()
    }
}

impl Port for Babble {
    fn name(&self) -> &str {
        "babble"
    }
    fn read(&mut self, buffer: &mut [u8], _: Duration) -> std::io::Result<usize> {
        let n = buffer.len().min(37);
        for byte in &mut buffer[..n] {
            *byte = self.bytes[self.at % self.bytes.len()];
            self.at += 1;
        }
        Ok(n)
    }
    fn write_all(&mut self, _: &[u8]) -> std::io::Result<()> {
        Ok(())
    }
    fn clear_input(&mut self) -> std::io::Result<()> {
        Ok(())
    }
    fn set_baud(&mut self, _: u32) -> std::io::Result<()> {
        Ok(())
    }
    fn reopen(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn no_motor_is_told_more_than_it_may(
        cap in 20.0..900.0_f64,
        turns in prop::collection::vec(-2..3_i32, 16),
        script in prop::collection::vec((event(), prop::collection::vec((number(), number()), 16)), 1..40),
    ) {
        let hand = LeapEmulator::new();
        (0..16).for_each(|id| hand.place(id, 2048.0 + 4096.0 * f64::from(turns[usize::from(id)])));
        let robot = Robot::bundled("leap_right").expect("bundled");
        let options = LeapOptions::right()
            .with_cap_ma(cap)
            .with_soft_start(Duration::ZERO)
            .with_timing(Timing::for_latency(Duration::ZERO));
        let wiring = options.joints.clone();
        hand.record_writes();
        let mut leap = LeapHand::connect(hand.port(), &robot, options).expect("connects");
        let mut state = HandState::new(16);
        for (event, numbers) in &script {
            happen(event, &hand, &mut leap);
            let command = HandCommand {
                position: numbers.iter().map(|n| n.0).collect(),
                // Mostly limits that are not refused.
                effort_limit: numbers.iter().map(|n| if n.1 < 0.0 && n.1 > -4.0 { -n.1 } else { n.1 }).collect(),
            };
            let meaningless = numbers.iter().any(|(q, _)| !q.is_finite()) || command.effort_limit.iter().any(|l| !(*l >= 0.0 && l.is_finite()));
            let before = hand.take_writes();
            // As the motor tells it.
            let place = |id: u8| hand.position(id).expect("there").clamp(f64::from(i32::MIN), f64::from(i32::MAX));
            let here: Vec<f64> = (0..16).map(place).collect();
            let done = leap.cycle(Some(&command), &mut state);
            prop_assert!(!meaningless || done.is_err());
            let log = hand.take_writes();
            // Motors that froze are told to stay where they are, with the first current, before they follow commands again.
            let stays = |w: &WriteRecord| match w.data[..] {
                [a, b, c, d, e, f] => {
                    let (goal, then, now) = (f64::from(i32::from_le_bytes([c, d, e, f])), here[usize::from(w.id)], place(w.id));
                    i16::from_le_bytes([a, b]) == cap.min(30.0) as i16 && goal > then.min(now) - 30.0 && goal < then.max(now) + 30.0
                }
                _ => false,
            };
            for w in before.iter().chain(&log) {
                let joint = &robot.joints[robot.joint_index(&wiring[usize::from(w.id)].name).expect("there")];
                let (low, high) = joint.limits.expect("limited");
                let current = match (w.address, &w.data[..]) {
                    (102, &[a, b]) | (208, &[a, b, ..]) => i16::from_le_bytes([a, b]),
                    _ => 0,
                };
                prop_assert!(current >= 0 && f64::from(current) <= cap, "motor {} is told {current} mA", w.id);
                // Goals of the bring-up are where the joint is; those of commands are within the limits.
                if let (208, &[_, _, a, b, c, d]) = (w.address, &w.data[..]) {
                    let ticks = i64::from(i32::from_le_bytes([a, b, c, d])) - 2048;
                    let angle = ticks.rem_euclid(4096);
                    let angle = if angle > 2048 { angle - 4096 } else { angle } as f64 * RAD_PER_TICK;
                    let held = before.contains(w) || stays(w);
                    prop_assert!(held || (low..=high).contains(&angle), "{}: {angle}", joint.name);
                }
                // Whoever is given torque knows the cap as its own limit.
                if (w.address, &w.data[..]) == (64, &[1]) && w.accepted {
                    prop_assert_eq!(hand.get(w.id, table::CURRENT_LIMIT), Some(cap as u16));
                    prop_assert_eq!(hand.get(w.id, table::MODE), Some(5));
                }
            }
            if meaningless {
                let orders = log.iter().filter(|w| w.address == 208 && !stays(w)).count();
                prop_assert_eq!(orders, 0, "a refused command is not sent");
            }
            hand.pass(Duration::from_millis(2));
        }
        hand.plug();
        let _ = leap.turn_off();
        drop(leap);
        for id in 0..16 {
            // Injected faults may swallow every answer, but not what was said.
            prop_assert_eq!(hand.get(id, table::TORQUE_ENABLE), Some(0));
        }
    }

    #[test]
    fn a_port_that_babbles_is_given_up(
        noise in prop::collection::vec(any::<u8>(), 1..400),
        answers in prop::collection::vec((0..16_u8, prop::collection::vec(any::<u8>(), 1..12)), 0..20),
    ) {
        let mut bytes = noise;
        let mut packet = [0; 64];
        for (id, params) in &answers {
            let n = encode(&mut packet, *id, instruction::STATUS, params).expect("fits");
            bytes.extend_from_slice(&packet[..n]);
        }
        let port = Babble { bytes, at: 0, time: std::cell::Cell::default() };
        let robot = Robot::bundled("leap_right").expect("bundled");
        let options = LeapOptions::right().with_timing(Timing::for_latency(Duration::ZERO));
        prop_assert!(LeapHand::connect(port, &robot, options).is_err());
    }

    #[test]
    fn readings_without_sense_do_no_harm(ticks in prop::collection::vec(any::<i32>(), 16), currents in prop::collection::vec(any::<i16>(), 16)) {
        let hand = LeapEmulator::new();
        let robot = Robot::bundled("leap_right").expect("bundled");
        let timing = Timing::for_latency(Duration::ZERO);
        let mut leap = LeapHand::connect(hand.port(), &robot, LeapOptions::right().with_timing(timing)).expect("connects");
        let mut state = HandState::new(16);
        for _ in 0..3 {
            for id in 0..16 {
                hand.set(id, table::PRESENT_POSITION, ticks[usize::from(id)]);
                hand.set(id, table::PRESENT_CURRENT, currents[usize::from(id)]);
            }
            leap.cycle(Some(&HandCommand::new(16)), &mut state).expect("exchange");
            prop_assert!(state.position.iter().chain(&state.effort).all(|x| x.is_finite()));
        }
        // Refused, or on where it is.
        if leap.turn_on().is_ok() {
            prop_assert_eq!(hand.under_torque(), 16);
        } else {
            prop_assert_eq!(hand.under_torque(), 0);
        }
    }
}
