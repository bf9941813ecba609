//! The bus against emulated motors, with and without faults.

use std::time::Duration;

use drex_hw::dynamixel::{Answers, Bus, Timing};
use drex_hw::emulator::leap::{EmulatorPort, Fault, LeapEmulator};
use drex_hw::leap::table;
use drex_hw::{Clock, Error};

const PRESENT: u16 = 126;

fn bus(hand: &LeapEmulator) -> Bus<EmulatorPort> {
    Bus::new(hand.port(), Timing::for_latency(Duration::ZERO))
}

fn all() -> Answers {
    Answers::new(&(0..16).collect::<Vec<u8>>(), 10).expect("16 motors")
}

fn fresh(answers: &Answers) -> Vec<u8> {
    (0..16).filter(|i| answers.get(*i).is_some()).map(|i| i as u8).collect()
}

fn all_but(id: u8) -> Vec<u8> {
    (0..16).filter(|i| *i != id).collect()
}

#[test]
fn single_and_common_reads_agree() {
    let hand = LeapEmulator::new();
    let mut bus = bus(&hand);
    assert_eq!(bus.ping(3).expect("there").model, 1240);
    assert_eq!(bus.scan().expect("port").len(), 16);
    for id in 0..16 {
        hand.place(id, 2048.0 - 100.0 * f64::from(id));
        // -1 mA next to a velocity that starts with fd: ff ff fd on the wire.
        hand.set(id, table::PRESENT_CURRENT, -1);
        hand.set(id, table::PRESENT_VELOCITY, 253);
    }
    let (mut fast, mut plain) = (all(), all());
    bus.sync_read(PRESENT, &mut fast).expect("port");
    bus.set_fast(false);
    for id in 0..16 {
        hand.set(id, table::PRESENT_CURRENT, -1);
        hand.set(id, table::PRESENT_VELOCITY, 253);
    }
    bus.sync_read(PRESENT, &mut plain).expect("port");
    for i in 0..16 {
        let (error, data) = plain.get(i).expect("answered");
        assert_eq!((error, table::PRESENT_CURRENT.in_block(PRESENT, data)), (0, -1));
        assert_eq!(table::PRESENT_VELOCITY.in_block(PRESENT, data), 253);
        assert_eq!(table::PRESENT_POSITION.in_block(PRESENT, data), 2048 - 100 * i as i32);
        assert_eq!(fast.get(i), plain.get(i), "motor {i}");
    }
}

#[test]
fn writes_of_all_kinds_arrive() {
    let hand = LeapEmulator::new();
    let mut bus = bus(&hand);
    bus.set(2, table::POSITION_P, 700).expect("done");
    assert_eq!(hand.get(2, table::POSITION_P), Some(700));
    let goals: Vec<[u8; 4]> = (0..16).map(|i: i32| (1000 + i).to_be_bytes().map(|b| b ^ 0xff)).collect();
    bus.sync_write(116, 4, (0u8..).zip(goals.iter().map(|g| &g[..]))).expect("sent");
    bus.bulk_write([(4, 84, &[1u8, 2][..]), (5, 98, &[9][..])].into_iter()).expect("sent");
    for id in 0..16 {
        assert_eq!(bus.get(id, table::GOAL_POSITION).expect("read"), i32::from_le_bytes(goals[usize::from(id)]));
    }
    let mut found = Vec::new();
    bus.bulk_read(&[(4, 84, 2), (5, 98, 1)], |i, error, data| found.push((i, error, data.to_vec()))).expect("port");
    assert_eq!(found, [(0, 0, vec![1, 2]), (1, 0, vec![9])]);
    let short = bus.sync_write(116, 4, [(1, &[0u8; 3][..])].into_iter());
    assert!(matches!(short, Err(Error::Value { .. })));
    bus.ping(1).expect("a refused packet leaves nothing behind");
}

#[test]
fn a_refusal_says_what_and_why() {
    let hand = LeapEmulator::new();
    let mut bus = bus(&hand);
    bus.set(0, table::TORQUE_ENABLE, 1).expect("on");
    let error = bus.set(0, table::MODE, 5).expect_err("locked");
    assert!(matches!(error, Error::Refused { id: 0, number: 7 }), "{error}");
    assert!(error.to_string().contains("torque off before a write"), "{error}");
    assert!(matches!(bus.ping(99), Err(Error::Silent { id: 99 })));
}

#[test]
fn addresses_that_mean_nothing_are_not_read_across() {
    let hand = LeapEmulator::new();
    let mut bus = bus(&hand);
    for (address, len) in [(0, 71), (64, 35), (13, 2), (147, 30), (60, 2), (98, 3)] {
        let error = bus.read(0, address, &mut vec![0; len]).expect_err("there is nothing in between");
        assert!(matches!(error, Error::Refused { number: 7, .. }) && error.to_string().contains("to read"), "{error}");
    }
    for (address, len) in [(0, 14), (31, 9), (62, 4), (68, 3), (100, 48), (168, 60)] {
        bus.read(0, address, &mut vec![0; len]).expect("defined");
    }
}

#[test]
fn a_silent_motor_costs_only_itself() {
    for fast in [true, false] {
        for mute in [0, 7, 15] {
            let hand = LeapEmulator::new();
            let mut bus = bus(&hand);
            bus.set_fast(fast);
            // Silent in every question of this cycle: at the head of a chain it is asked once more the plain way.
            hand.inject(Fault::Mute(mute), if fast && mute == 0 { 2 } else { 1 });
            let (mut answers, before) = (all(), bus.stats().follow_ups);
            bus.sync_read(PRESENT, &mut answers).expect("port");
            assert_eq!(fresh(&answers), all_but(mute), "fast {fast}");
            assert!(bus.stats().follow_ups - before <= 1, "one follow-up is enough");
            bus.sync_read(PRESENT, &mut answers).expect("port");
            assert_eq!(answers.answered(), 16);
            assert_eq!(bus.fast(), fast);
        }
    }
}

#[test]
fn damage_is_gone_in_the_next_cycle() {
    for fast in [true, false] {
        for fault in [Fault::Corrupt(7), Fault::Truncate(7), Fault::Duplicate(7), Fault::Noise] {
            let hand = LeapEmulator::new();
            let mut bus = bus(&hand);
            bus.set_fast(fast);
            hand.inject(fault, 1);
            let mut answers = all();
            bus.sync_read(PRESENT, &mut answers).expect("port");
            let heard = fresh(&answers);
            assert!(all_but(7).iter().all(|i| heard.contains(i)), "{fault:?}, fast {fast}: {heard:?}");
            bus.sync_read(PRESENT, &mut answers).expect("port");
            assert_eq!(answers.answered(), 16, "{fault:?}, fast {fast}");
            assert_eq!(bus.fast(), fast);
        }
    }
}

#[test]
fn old_firmware_is_asked_the_plain_way_and_that_is_remembered() {
    let hand = LeapEmulator::new();
    (0..16).for_each(|id| hand.set(id, table::FIRMWARE, 45));
    let mut bus = bus(&hand);
    let mut answers = all();
    for cycle in 0..4 {
        assert_eq!(bus.fast(), cycle < 3);
        bus.sync_read(PRESENT, &mut answers).expect("port");
        assert_eq!(answers.answered(), 16);
    }
    let asked = bus.stats().questions;
    bus.sync_read(PRESENT, &mut answers).expect("port");
    assert_eq!(bus.stats().questions, asked + 1);
}

#[test]
fn a_dead_hand_costs_bounded_time() {
    let hand = LeapEmulator::new();
    (0..16).for_each(|id| hand.inject(Fault::Mute(id), 1000));
    let mut bus = bus(&hand);
    let (mut answers, begun) = (all(), hand.now());
    bus.sync_read(PRESENT, &mut answers).expect("port");
    assert_eq!(answers.answered(), 0);
    assert!(hand.now() - begun < Duration::from_millis(100), "{:?}", hand.now() - begun);
}

#[test]
fn a_pulled_plug_is_an_error_of_the_port() {
    let hand = LeapEmulator::new();
    let mut bus = bus(&hand);
    hand.unplug();
    assert!(matches!(bus.ping(0), Err(Error::Port { .. })));
    hand.plug();
    bus.ping(0).expect("back");
}

#[cfg(unix)]
mod pty {
    use super::*;
    use drex_hw::dynamixel::{Port, SerialPort};
    use drex_hw::emulator::pty::PtyServer;

    #[test]
    fn a_slow_bus_is_given_the_time_that_its_bytes_need() {
        let hand = LeapEmulator::new();
        let server = PtyServer::serve(hand.paced(9600), None).expect("pty");
        (0..16).for_each(|id| hand.set(id, table::RETURN_DELAY, 0));
        let port = SerialPort::open(server.path(), 9600).expect("opens");
        // The common answer alone takes 240 ms.
        let mut bus = Bus::new(port, Timing::default().with_patience(Duration::from_millis(100)));
        let mut answers = all();
        bus.sync_read(PRESENT, &mut answers).expect("port");
        assert_eq!((answers.answered(), bus.stats().questions), (16, 1));
    }

    #[test]
    fn a_serial_port_works_and_has_one_user() {
        let folder = tempfile::tempdir().expect("folder");
        let link = folder.path().join("leap");
        let hand = LeapEmulator::new().in_real_time();
        let server = PtyServer::serve(hand.clone(), Some(&link)).expect("pty");
        let port = SerialPort::open(server.path(), 4_000_000).expect("opens");

        let error = SerialPort::open(&link, 4_000_000).expect_err("in use").to_string();
        assert!(error.contains(&format!("process {}", std::process::id())), "{error}");

        let mut bus = Bus::new(port, Timing::default().with_patience(Duration::from_millis(500)));
        let mut answers = all();
        for _ in 0..20 {
            bus.sync_read(PRESENT, &mut answers).expect("port");
            assert_eq!(answers.answered(), 16);
        }
        bus.port().set_baud(1_000_000).expect("a terminal takes any speed");

        hand.unplug();
        let waited = std::time::Instant::now();
        while bus.ping(1).is_ok() {
            assert!(waited.elapsed() < Duration::from_secs(5), "the hang-up is noticed");
        }
        assert!(bus.port().reopen().is_err());
        hand.plug();
        while bus.port().reopen().is_err() {
            assert!(waited.elapsed() < Duration::from_secs(5), "the port comes back");
            std::thread::sleep(Duration::from_millis(5));
        }
        bus.ping(1).expect("answers again");
        drop(server);
        assert!(!link.exists());
    }
}

#[test]
fn answers_that_come_late_behind_an_adapter_that_does_not_tell() {
    for ms in [10, 20, 35] {
        let hand = LeapEmulator::new();
        let port = hand.port().with_lateness(Duration::from_millis(ms));
        let mut bus = Bus::new(port, Timing::default());
        bus.ping(3).expect("ping");
        bus.set(3, table::GOAL_CURRENT, 50).expect("write");
        assert_eq!(bus.get(3, table::GOAL_CURRENT).expect("read"), 50);
        assert_eq!(bus.scan().expect("scan").len(), 16);
        assert_eq!((bus.slowest() + Duration::from_millis(1)).as_millis() as u64, ms, "without the bytes");
        assert_eq!(bus.stats().timeouts, 0, "{ms} ms");
    }
}

#[test]
fn a_loop_waits_twice_as_long_as_answers_took_within_bounds() {
    let ms = Duration::from_millis;
    for (worst, patience) in [(0, 10), (1, 10), (12, 29), (35, 50), (500, 50)] {
        let timing = Timing::for_loop(ms(worst));
        assert_eq!((timing.first_byte, timing.gap), (ms(patience), ms(patience)), "{worst} ms");
    }
}
