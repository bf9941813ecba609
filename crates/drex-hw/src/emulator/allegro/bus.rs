//! A bus in memory with an emulated hand at it, and the hand's clock.

use std::io;
use std::time::Duration;

use super::AllegroEmulator;
use crate::can::{CanBus, CanFrame, SlcanAdapter};
use crate::{Clock, Error, Result};

/// Time of a frame with eight bytes at 1 Mbit/s.
const FRAME: Duration = Duration::from_micros(125);

/// The computer's end of a bus with an emulated hand at the other. With a hand that is not in real time nothing waits in
/// earnest: waiting lets the hand's time pass.
#[derive(Debug)]
pub struct EmulatorBus(pub(super) AllegroEmulator);

impl EmulatorBus {
    fn check(&self) -> Result<()> {
        match self.0.device().plugged {
            true => Ok(()),
            false => Err(Error::Port {
                port: self.name().into(),
                source: io::ErrorKind::NotConnected.into(),
                remedy: "put the plug back".into(),
            }),
        }
    }
}

impl CanBus for EmulatorBus {
    fn name(&self) -> &str {
        "emulated Allegro hand"
    }

    fn send(&mut self, frame: &CanFrame) -> Result<()> {
        self.check()?;
        self.0.pass(FRAME);
        self.0.hear(frame);
        Ok(())
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<CanFrame>> {
        let begin = self.0.now();
        loop {
            self.check()?;
            if let Some(frame) = self.0.say() {
                return Ok(Some(frame));
            }
            let left = begin.saturating_add(timeout).saturating_sub(self.0.now());
            if left.is_zero() {
                return Ok(None);
            }
            let due = self.0.until_next_report().map_or(left, |t| t.min(left));
            EmulatorClock(self.0.clone()).wait(due);
        }
    }
}

/// The clock of an emulated hand.
#[derive(Debug, Clone)]
pub struct EmulatorClock(pub(super) AllegroEmulator);

impl EmulatorClock {
    fn wait(&self, time: Duration) {
        if self.0.in_real_time {
            std::thread::sleep(time);
        } else {
            self.0.pass(time);
        }
    }
}

impl Clock for EmulatorClock {
    fn now(&self) -> Duration {
        self.0.now()
    }

    fn wait_until(&self, then: Duration) {
        self.wait(then.saturating_sub(self.0.now()));
    }
}

#[cfg(unix)]
impl crate::emulator::pty::SerialDevice for SlcanAdapter<EmulatorBus> {
    fn exchange(&mut self, bytes: &[u8], reply: &mut Vec<u8>) {
        // A plug that was pulled is seen below.
        let _ = self.take(bytes, reply);
    }

    fn patience(&self) -> Duration {
        let due = self.bus().0.until_next_report();
        due.unwrap_or(Duration::from_millis(10)).max(Duration::from_micros(100))
    }

    fn plugged(&self) -> bool {
        self.bus().0.device().plugged
    }
}
