//! How many exchanges with 16 motors a second are possible: current and goal of each written, current, velocity and position of each
//! read, with an emulated hand behind a pseudo-terminal that answers at once; the crate dynamixel2 beside it in the same run.
//!
//!     cargo run --release -p drex-hw --example bus_rate -- [SECONDS [BAUD]]
//!
//! With BAUD the emulator is as slow as a bus of that speed, without return delay, and the time that the formula of the
//! wire gives is printed too.
#![allow(clippy::print_stdout)] // the output is the point of an example

#[cfg(unix)]
use unix::main;

#[cfg(not(unix))]
fn main() {
    eprintln!("there are no pseudo-terminals on this system");
}

#[cfg(unix)]
mod unix {
    use std::error::Error;
    use std::time::{Duration, Instant};

    use drex_hw::dynamixel::{Answers, Bus, SerialPort, Timing};
    use drex_hw::emulator::leap::LeapEmulator;
    use drex_hw::emulator::pty::PtyServer;
    use drex_hw::leap::{LeapHand, LeapOptions, table};
    use drex_hw::{Hand, HandCommand, HandState};
    use drex_robot::Robot;
    use dynamixel2::instructions::SyncWriteData;

    const BAUD: u32 = 4_000_000;
    /// Turns of each, one after the other, so that what else the machine does meets all.
    const TURNS: u32 = 3;

    /// Times of exchanges, and how many were incomplete.
    #[derive(Default)]
    struct Tally {
        times: Vec<Duration>,
        incomplete: u32,
    }

    impl Tally {
        fn run(&mut self, time: Duration, mut exchange: impl FnMut() -> bool) {
            let begun = Instant::now();
            while begun.elapsed() < time {
                let start = Instant::now();
                self.incomplete += u32::from(!exchange());
                self.times.push(start.elapsed());
            }
        }

        fn print(&mut self, name: &str) {
            self.times.sort_unstable();
            let all: Duration = self.times.iter().sum();
            let at = |part: f64| self.times[((self.times.len() - 1) as f64 * part) as usize].as_secs_f64() * 1e6;
            println!(
                "{name:<42} {:>6.0}/s   p50 {:>5.0} µs   p99 {:>6.0} µs   incomplete {}",
                self.times.len() as f64 / all.as_secs_f64(),
                at(0.5),
                at(0.99),
                self.incomplete
            );
        }
    }

    pub fn main() -> Result<(), Box<dyn Error>> {
        let mut arguments = std::env::args().skip(1);
        let seconds: f64 = arguments.next().map_or(Ok(6.0), |s| s.parse())?;
        let paced: Option<u32> = arguments.next().map(|s| s.parse()).transpose()?;
        let turn = Duration::from_secs_f64(seconds / f64::from(4 * TURNS));
        let hand = LeapEmulator::new().in_real_time();
        (0..16).for_each(|id| hand.set(id, table::RETURN_DELAY, 0));
        let server = match paced {
            Some(baud) => PtyServer::serve(hand.paced(baud), None)?,
            None => PtyServer::serve(hand.clone(), None)?,
        };
        let ids: Vec<u8> = (0..16).collect();
        let order = [100, 0, 0, 8, 0, 0];
        let mut answers = Answers::new(&ids, 10)?;
        let robot = Robot::bundled("leap_right")?;
        let (mut driver, mut fast, mut plain, mut other) =
            (Tally::default(), Tally::default(), Tally::default(), Tally::default());
        for _ in 0..TURNS {
            {
                let options = LeapOptions::right().with_watchdog(Duration::from_secs(1));
                let mut leap = LeapHand::open(server.path(), &robot, options)?;
                leap.turn_on()?;
                let command = HandCommand { position: vec![0.1; 16], effort_limit: vec![100.0; 16] };
                let mut state = HandState::new(16);
                driver
                    .run(turn, || leap.cycle(Some(&command), &mut state).is_ok() && state.age.iter().all(|a| *a == 0));
            }
            for (tally, is_fast) in [(&mut fast, true), (&mut plain, false)] {
                let mut bus =
                    Bus::new(SerialPort::open(server.path(), BAUD)?, Timing::for_latency(Duration::from_millis(4)));
                bus.set_fast(is_fast);
                tally.run(turn, || {
                    let sent = bus.queue_sync_write(208, 6, ids.iter().map(|id| (*id, &order[..])));
                    sent.and_then(|()| bus.sync_read(126, &mut answers)).is_ok() && answers.answered() == 16
                });
            }
            let mut bus = dynamixel2::Bus::open_with_buffers(server.path(), BAUD, vec![0; 1024], vec![0; 1024])?;
            other.run(turn, || {
                let orders = ids.iter().map(|id| SyncWriteData { motor_id: *id, data: order });
                let mut answered = 0;
                bus.sync_write(208, 6, orders).is_ok()
                    && bus.sync_read_cb(&ids, 126, 10, |a| answered += u32::from(a.is_ok())).is_ok()
                    && answered == 16
            });
        }
        driver.print("LeapHand::cycle (fast sync read, health)");
        fast.print("our bus, fast sync read");
        plain.print("our bus, plain sync read");
        other.print("dynamixel2, plain sync read");
        if let Some(baud) = paced {
            let (written, asked) = (14 + 16 * 7, 14 + 16);
            let wire = |answer: u32| f64::from(10 * (written + asked + answer)) / f64::from(baud);
            println!("the wire alone: fast {:.0}/s, plain {:.0}/s", 1.0 / wire(8 + 16 * 14), 1.0 / wire(16 * 21));
        }
        Ok(())
    }
}
