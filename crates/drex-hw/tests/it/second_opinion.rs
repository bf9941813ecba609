//! The emulated LEAP hand as another implementation of the protocol sees it, over a pseudo-terminal.
#![cfg(unix)]

use std::time::Duration;

use drex_hw::dynamixel::{Answers, Bus, SerialPort, Timing};
use drex_hw::emulator::leap::LeapEmulator;
use drex_hw::emulator::pty::PtyServer;
use drex_hw::leap::table;
use dynamixel2::instructions::SyncWriteData;

#[test]
fn dynamixel2_and_we_read_and_write_the_same() {
    // Its time stands still, so that nothing moves between two reads.
    let hand = LeapEmulator::new();
    for id in 0..16 {
        hand.place(id, 2048.0 - 300.0 * f64::from(id));
        hand.set(id, table::PRESENT_CURRENT, -1);
        hand.set(id, table::PRESENT_VELOCITY, 253);
    }
    let server = PtyServer::serve(hand.clone(), None).expect("pty");
    let ids: Vec<u8> = (0..16).collect();

    let mut theirs = Vec::new();
    {
        let mut bus =
            dynamixel2::Bus::open_with_buffers(server.path(), 4_000_000, vec![0; 1024], vec![0; 1024]).expect("opens");
        let pong = bus.ping(5).expect("answers");
        assert_eq!((pong.data.model, pong.data.firmware), (1240, 52));
        // ff ff fd on its way out, which has to be stuffed, and back.
        let stuffed = [0xff, 0xff, 0xfd, 0xff];
        let goals = ids.iter().map(|id| SyncWriteData { motor_id: *id, data: stuffed });
        bus.sync_write(116, 4, goals.collect::<Vec<_>>()).expect("sent");
        assert_eq!(bus.read(3, 116, 4).expect("answers").data, stuffed);
        bus.write_u16(3, 84, 700).expect("answers");
        assert!(bus.write_u8(3, 126, 1).is_err(), "a register that is only read");
        bus.sync_read_cb(&ids, 126, 10, |answer| theirs.push(answer.expect("answers").data.to_vec())).expect("sent");
        // Its bulk read is left out: 0.9.1 lays the items of the question over one another.
    }

    let port = SerialPort::open(server.path(), 4_000_000).expect("it was let go");
    let mut bus = Bus::new(port, Timing::default().with_patience(Duration::from_millis(500)));
    let mut ours = Answers::new(&ids, 10).expect("16 motors");
    for fast in [true, false] {
        bus.set_fast(fast);
        bus.sync_read(126, &mut ours).expect("port");
        for (i, data) in theirs.iter().enumerate() {
            assert_eq!(ours.get(i), Some((0, &data[..])), "motor {i}, fast {fast}");
        }
    }
    assert_eq!(bus.get(3, table::GOAL_POSITION).expect("answers"), i32::from_le_bytes([0xff, 0xff, 0xfd, 0xff]));
}
