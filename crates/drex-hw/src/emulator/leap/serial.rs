//! An emulated hand behind a pseudo-terminal.

use std::collections::VecDeque;
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

/// A hand that is as slow as its bus, its motors' return delays and its USB adapter.
#[derive(Debug)]
pub struct PacedLeap {
    hand: LeapEmulator,
    /// Speed of the bus; `None` takes no time.
    baud: Option<u32>,
    latency: Duration,
    /// Answers in the adapter, and when it hands them on.
    held: VecDeque<(Instant, Vec<u8>)>,
}

impl LeapEmulator {
    /// This hand at a bus of `baud`, for a pseudo-terminal.
    pub fn paced(&self, baud: u32) -> PacedLeap {
        PacedLeap { baud: Some(baud.max(1)), ..self.behind_adapter(Duration::ZERO) }
    }

    /// This hand behind an adapter that keeps every answer back for `latency`, for a pseudo-terminal.
    pub fn behind_adapter(&self, latency: Duration) -> PacedLeap {
        PacedLeap { hand: self.clone(), baud: None, latency, held: VecDeque::new() }
    }
}

impl PacedLeap {
    /// The same behind an adapter that keeps every answer back for `latency`: 16 ms is what FTDI adapters do unless told otherwise.
    pub fn with_latency(mut self, latency: Duration) -> Self {
        self.latency = latency;
        self
    }
}

impl SerialDevice for PacedLeap {
    fn exchange(&mut self, bytes: &[u8], reply: &mut Vec<u8>) {
        let came = Instant::now();
        let mut said = Vec::new();
        let hesitated = self.hand.exchange(bytes, &mut said);
        if let Some(baud) = self.baud {
            // Ten bits a byte, there and back.
            let wire = Duration::from_secs_f64(10.0 * (bytes.len() + said.len()) as f64 / f64::from(baud));
            std::thread::sleep((wire + hesitated).saturating_sub(came.elapsed()));
        }
        let now = Instant::now();
        if !said.is_empty() {
            self.held.push_back((now + self.latency, said));
        }
        while let Some((_, mut said)) = self.held.pop_front_if(|(due, _)| *due <= now) {
            reply.append(&mut said);
        }
    }

    fn patience(&self) -> Duration {
        self.held.front().map_or(Duration::MAX, |(due, _)| due.saturating_duration_since(Instant::now()))
    }

    fn plugged(&self) -> bool {
        self.hand.plugged()
    }
}
