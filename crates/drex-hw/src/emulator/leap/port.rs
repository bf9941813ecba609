//! A port in memory behind which an emulated hand sits.

use std::collections::VecDeque;
use std::io;
use std::time::Duration;

use super::LeapEmulator;
use crate::Clock;
use crate::dynamixel::Port;

/// Time from a question to the answer.
const TURNAROUND: Duration = Duration::from_micros(50);

/// A port of an emulated hand. Nothing waits in earnest: time on its clock is the hand's.
#[derive(Debug)]
pub struct EmulatorPort {
    hand: LeapEmulator,
    coming: VecDeque<u8>,
    reply: Vec<u8>,
    baud: u32,
    /// How long answers are kept back, and when the last one is handed on.
    late: Duration,
    ready: Duration,
}

impl EmulatorPort {
    pub(super) fn new(hand: LeapEmulator) -> Self {
        Self {
            hand,
            coming: VecDeque::new(),
            reply: Vec::new(),
            baud: 4_000_000,
            late: Duration::ZERO,
            ready: Duration::ZERO,
        }
    }

    /// The same port behind something that keeps every answer back for `late` and does not tell.
    pub fn with_lateness(mut self, late: Duration) -> Self {
        self.late = late;
        self
    }

    /// Time of `bytes` on the bus.
    fn wire(&self, bytes: usize) -> Duration {
        Duration::from_nanos(bytes as u64 * 10_000_000_000 / u64::from(self.baud))
    }

    fn check(&self) -> io::Result<()> {
        if self.hand.plugged() { Ok(()) } else { Err(io::ErrorKind::NotConnected.into()) }
    }
}

impl Clock for EmulatorPort {
    fn now(&self) -> Duration {
        self.hand.now()
    }

    fn wait_until(&self, then: Duration) {
        self.hand.wait_until(then);
    }
}

impl Port for EmulatorPort {
    fn name(&self) -> &str {
        "emulated LEAP hand"
    }

    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize> {
        self.check()?;
        let early = self.ready.saturating_sub(self.now());
        if self.coming.is_empty() || wait < early {
            self.hand.pass(wait);
            return Ok(0);
        }
        self.hand.pass(early);
        let n = buffer.len().min(self.coming.len());
        buffer.iter_mut().zip(self.coming.drain(..n)).for_each(|(to, from)| *to = from);
        self.hand.pass(self.wire(n));
        Ok(n)
    }

    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.check()?;
        self.hand.pass(self.wire(bytes.len()) + TURNAROUND);
        // What is sent at another speed than theirs is noise to motors.
        let heard = if self.baud == self.hand.baud() { bytes } else { &[] };
        let hesitated = self.hand.exchange(heard, &mut self.reply);
        self.hand.pass(hesitated);
        if !self.reply.is_empty() {
            self.ready = self.now() + self.late;
        }
        self.coming.extend(self.reply.drain(..));
        Ok(())
    }

    fn clear_input(&mut self) -> io::Result<()> {
        self.coming.clear();
        self.check()
    }

    fn set_baud(&mut self, baud: u32) -> io::Result<()> {
        self.baud = baud.max(1);
        self.check()
    }

    fn baud(&self) -> Option<u32> {
        Some(self.baud)
    }

    fn reopen(&mut self) -> io::Result<()> {
        self.coming.clear();
        self.check()
    }

    fn latency(&self) -> Option<Duration> {
        self.late.is_zero().then_some(Duration::ZERO)
    }
}
