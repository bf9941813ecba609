//! A port in memory behind which an emulated hand sits.

use std::collections::VecDeque;
use std::io;
use std::time::Duration;

use super::LeapEmulator;
use crate::Clock;
use crate::dynamixel::Port;

/// Time of one byte on the bus at 4 Mbaud.
const BYTE: Duration = Duration::from_nanos(2500);
/// Time from a question to the answer.
const TURNAROUND: Duration = Duration::from_micros(50);

/// A port of an emulated hand. Nothing waits in earnest: time on its clock is the hand's.
#[derive(Debug)]
pub struct EmulatorPort {
    hand: LeapEmulator,
    coming: VecDeque<u8>,
    reply: Vec<u8>,
}

impl EmulatorPort {
    pub(super) fn new(hand: LeapEmulator) -> Self {
        Self { hand, coming: VecDeque::new(), reply: Vec::new() }
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
        if self.coming.is_empty() {
            self.hand.pass(wait);
            return Ok(0);
        }
        let n = buffer.len().min(self.coming.len());
        buffer.iter_mut().zip(self.coming.drain(..n)).for_each(|(to, from)| *to = from);
        self.hand.pass(BYTE * n as u32);
        Ok(n)
    }

    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.check()?;
        self.hand.pass(BYTE * bytes.len() as u32 + TURNAROUND);
        let hesitated = self.hand.exchange(bytes, &mut self.reply);
        self.hand.pass(hesitated);
        self.coming.extend(self.reply.drain(..));
        Ok(())
    }

    fn clear_input(&mut self) -> io::Result<()> {
        self.coming.clear();
        self.check()
    }

    fn set_baud(&mut self, _: u32) -> io::Result<()> {
        self.check()
    }

    fn reopen(&mut self) -> io::Result<()> {
        self.coming.clear();
        self.check()
    }

    fn latency(&self) -> Option<Duration> {
        Some(Duration::ZERO)
    }
}
