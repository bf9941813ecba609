//! An emulated hand behind a pseudo-terminal.

use std::time::{Duration, Instant};

use super::LeapEmulator;
use crate::emulator::pty::SerialDevice;

/// Answers at once.
impl SerialDevice for LeapEmulator {
    fn exchange(&mut self, bytes: &[u8], reply: &mut Vec<u8>) {
        LeapEmulator::exchange(self, bytes, reply);
    }

    fn plugged(&self) -> bool {
        LeapEmulator::plugged(self)
    }
}

/// A hand that is as slow as its bus and its motors' return delays.
#[derive(Debug)]
pub struct PacedLeap {
    hand: LeapEmulator,
    baud: u32,
}

impl LeapEmulator {
    /// This hand at a bus of `baud`, for a pseudo-terminal.
    pub fn paced(&self, baud: u32) -> PacedLeap {
        PacedLeap { hand: self.clone(), baud: baud.max(1) }
    }
}

impl SerialDevice for PacedLeap {
    fn exchange(&mut self, bytes: &[u8], reply: &mut Vec<u8>) {
        let came = Instant::now();
        let hesitated = self.hand.exchange(bytes, reply);
        // Ten bits a byte, there and back.
        let wire = Duration::from_secs_f64(10.0 * (bytes.len() + reply.len()) as f64 / f64::from(self.baud));
        std::thread::sleep((wire + hesitated).saturating_sub(came.elapsed()));
    }

    fn plugged(&self) -> bool {
        self.hand.plugged()
    }
}
