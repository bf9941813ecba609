//! CAN in memory and as slcan text: round trips, noise, pieces, refusals.

use std::time::Duration;

use drex_hw::can::{CanBus, CanFrame, MemoryCan, Slcan, SlcanEvent, SlcanParser, write_slcan};
use drex_hw::dynamixel::{MemoryPort, Port, memory_pair};
use proptest::prelude::*;

const SOON: Duration = Duration::from_millis(500);

fn any_frame() -> impl Strategy<Value = CanFrame> {
    let data = prop::collection::vec(any::<u8>(), 0..=8);
    prop_oneof![
        (0..0x800_u16, data).prop_map(|(id, data)| CanFrame::data_frame(id, &data).unwrap()),
        (0..0x800_u16, 0..=8_u8).prop_map(|(id, len)| CanFrame::remote_frame(id, len).unwrap()),
    ]
}

fn line(frame: &CanFrame) -> Vec<u8> {
    let mut buffer = [0; 32];
    let n = write_slcan(frame, &mut buffer);
    buffer[..n].to_vec()
}

fn frames(bytes: &[u8]) -> Vec<CanFrame> {
    let mut parser = SlcanParser::default();
    bytes
        .iter()
        .filter_map(|b| match parser.push(*b) {
            Some(SlcanEvent::Frame(f)) => Some(f),
            _ => None,
        })
        .collect()
}

#[test]
fn lines_are_as_adapters_write_them() {
    let torque = CanFrame::data_frame(0x180, &[0x02, 0x00, 0xcb, 0x00, 0x42, 0x00, 0x25, 0x00]).unwrap();
    assert_eq!(line(&torque), b"t18080200CB0042002500\r");
    assert_eq!(line(&CanFrame::remote_frame(0x200, 0).unwrap()), b"r2000\r");
    assert_eq!(line(&CanFrame::data_frame(0x7ff, &[]).unwrap()), b"t7FF0\r");
    assert!(CanFrame::data_frame(0x800, &[]).is_err() && CanFrame::data_frame(0, &[0; 9]).is_err());
    assert!(CanFrame::remote_frame(0, 9).is_err());
}

#[test]
fn time_stamps_and_small_letters_are_understood() {
    let frame = CanFrame::data_frame(0x123, &[0xab]).unwrap();
    assert_eq!(frames(b"t1231ab\rt1231ABF00D\r\nt1231aB\r"), [frame; 3]);
}

#[test]
fn what_is_no_frame_is_counted_and_dropped() {
    let mut parser = SlcanParser::default();
    let junk: &[u8] = b"t12\rt1239\rt123200\rtXYZ0\rT0000012310A\rV1013\rt8000\r\x00\xff\r";
    assert!(junk.iter().all(|b| parser.push(*b).is_none()));
    assert_eq!(parser.ignored(), 8);
    assert_eq!(parser.push(b'\r'), Some(SlcanEvent::Acknowledged));
    assert_eq!(parser.push(0x07), Some(SlcanEvent::Refused));
}

proptest! {
    #[test]
    fn frames_come_back(list in prop::collection::vec(any_frame(), 0..20)) {
        let text: Vec<u8> = list.iter().flat_map(line).collect();
        prop_assert_eq!(frames(&text), list);
    }

    #[test]
    fn noise_before_a_frame_costs_nothing(noise in prop::collection::vec(any::<u8>(), 0..60), frame in any_frame()) {
        let mut text = noise;
        text.extend(line(&frame));
        prop_assert_eq!(frames(&text).pop(), Some(frame));
    }

    #[test]
    fn noise_never_panics(noise in prop::collection::vec(any::<u8>(), 0..2000)) {
        frames(&noise);
    }
}

#[test]
fn both_ends_in_memory_hear_each_other() {
    let (mut a, mut b) = MemoryCan::pair();
    let frame = CanFrame::data_frame(0x81, &[1, 2]).unwrap();
    a.send(&frame).unwrap();
    assert_eq!(b.receive(SOON).unwrap(), Some(frame));
    assert_eq!(b.receive(Duration::ZERO).unwrap(), None);
    drop(a);
    assert!(b.receive(Duration::ZERO).is_err() && b.send(&frame).is_err());
}

/// An adapter that answers each of the opening commands with the given byte, and then hands its port over.
fn adapter(answers: &'static [u8; 4]) -> (MemoryPort, std::thread::JoinHandle<(MemoryPort, Vec<u8>)>) {
    let (host, mut device) = memory_pair();
    let thread = std::thread::spawn(move || {
        let (mut heard, mut answers) = (Vec::new(), answers.iter());
        let mut byte = [0];
        while answers.len() > 0 && device.read(&mut byte, SOON).unwrap_or(0) == 1 {
            heard.push(byte[0]);
            if byte[0] == b'\r' {
                device.write_all(&[*answers.next().unwrap()]).unwrap();
            }
        }
        (device, heard)
    });
    (host, thread)
}

/// All that has come.
fn rest(device: &mut MemoryPort) -> Vec<u8> {
    let (mut all, mut bytes) = (Vec::new(), [0; 64]);
    while let Ok(n @ 1..) = device.read(&mut bytes, Duration::ZERO) {
        all.extend(&bytes[..n]);
    }
    all
}

#[test]
fn slcan_opens_at_a_megabit_and_closes() {
    let (host, thread) = adapter(b"\r\x07\r\r");
    let mut bus = Slcan::over(host).unwrap();
    let (mut device, heard) = thread.join().unwrap();
    assert_eq!(heard, b"\rC\rS8\rO\r");
    assert_eq!((bus.refused(), bus.name()), (0, "memory"));

    let frame = CanFrame::data_frame(0x80, &[1, 2, 3, 4, 5, 6, 7, 8]).unwrap();
    bus.send(&frame).unwrap();
    device.write_all(b"z\r\x07\x00junk").unwrap();
    // In two pieces, with a pause between them that ends one call.
    let text = line(&frame);
    device.write_all(&text[..7]).unwrap();
    assert_eq!(bus.receive(Duration::from_millis(5)).unwrap(), None);
    device.write_all(&text[7..]).unwrap();
    assert_eq!(bus.receive(SOON).unwrap(), Some(frame));
    assert_eq!(bus.refused(), 1);

    drop(bus);
    assert_eq!(rest(&mut device), [line(&frame).as_slice(), b"C\r"].concat());
}

#[test]
fn settling_waits_for_the_last_answers_and_counts_what_was_refused() {
    let (host, thread) = adapter(b"\r\x07\r\r");
    let mut bus = Slcan::over(host).unwrap();
    let (mut device, _) = thread.join().unwrap();
    let frame = CanFrame::data_frame(0x80, &[1]).unwrap();
    bus.send(&frame).unwrap();
    bus.send(&frame).unwrap();
    device.write_all(b"z\rt0801FF\r").unwrap();
    let late = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(10));
        device.write_all(b"\x07").unwrap();
        device
    });
    bus.settle(Duration::from_secs(10)).unwrap();
    assert_eq!(bus.refused(), 1);
    let _device = late.join().unwrap();
    // Nobody waits for an adapter that never answers.
    let (host, _device) = memory_pair();
    let mut bus = Slcan::over(host).unwrap();
    bus.send(&frame).unwrap();
    bus.settle(Duration::from_secs(600)).unwrap();
}

#[test]
fn a_refused_bus_is_an_error_and_an_unplugged_adapter_too() {
    let (host, thread) = adapter(b"\r\r\r\x07");
    let error = Slcan::over(host).unwrap_err().to_string();
    assert!(error.contains("refused"), "{error}");
    thread.join().unwrap();

    let (host, thread) = adapter(b"\r\r\r\r");
    let mut bus = Slcan::over(host).unwrap();
    drop(thread.join().unwrap());
    assert!(bus.receive(SOON).is_err());
    assert!(bus.send(&CanFrame::remote_frame(1, 0).unwrap()).is_err());
}

#[test]
fn an_adapter_that_never_answers_is_opened_too() {
    let (host, mut device) = memory_pair();
    let mut bus = Slcan::over(host).unwrap();
    device.write_all(b"t0801FF\r").unwrap();
    assert_eq!(bus.receive(SOON).unwrap(), Some(CanFrame::data_frame(0x80, &[0xff]).unwrap()));
}
