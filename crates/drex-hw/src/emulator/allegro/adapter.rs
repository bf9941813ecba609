//! An slcan adapter with an emulated hand at its bus.

use std::time::Duration;

use super::AllegroEmulator;
use crate::can::{SlcanEvent, SlcanParser, write_slcan};

/// No line of a program is longer.
const LONGEST: usize = 40;

/// The adapter: text in, text out. Behind a pseudo-terminal, `PtyServer::serve(SlcanAdapter::new(hand), None)`, programs
/// open it as a serial port.
#[derive(Debug)]
pub struct SlcanAdapter {
    hand: AllegroEmulator,
    line: Vec<u8>,
    speed: Option<u8>,
    open: bool,
}

impl SlcanAdapter {
    /// An adapter, closed as after power-up, with `hand`, which should be in real time, at its bus.
    pub fn new(hand: AllegroEmulator) -> Self {
        Self { hand, line: Vec::with_capacity(LONGEST), speed: None, open: false }
    }

    /// Takes text from the program and appends what the adapter answers and what it heard on the bus.
    pub fn take(&mut self, bytes: &[u8], reply: &mut Vec<u8>) {
        for byte in bytes {
            match byte {
                b'\r' => {
                    let line = std::mem::take(&mut self.line);
                    reply.extend_from_slice(if self.command(&line) { b"\r" } else { b"\x07" });
                    self.line = line;
                    self.line.clear();
                }
                b'\n' => {}
                // The rest of an endless line is dropped, and the line refused at its end.
                _ if self.line.len() < LONGEST => self.line.push(*byte),
                _ => {}
            }
        }
        while let Some(frame) = self.hand.say() {
            // A closed adapter, or one at another speed, hears nothing that makes sense.
            if self.open && self.speed == Some(b'8') {
                let mut line = [0; 32];
                let n = write_slcan(&frame, &mut line);
                reply.extend_from_slice(&line[..n]);
            }
        }
    }

    /// Whether a command was taken.
    fn command(&mut self, line: &[u8]) -> bool {
        match line {
            [] | [b'V' | b'N'] => true,
            [b'S', speed @ b'0'..=b'8'] if !self.open => {
                self.speed = Some(*speed);
                true
            }
            b"O" if !self.open && self.speed.is_some() => {
                self.open = true;
                true
            }
            b"C" => std::mem::take(&mut self.open),
            [b't' | b'r', ..] if self.open => {
                let mut parser = SlcanParser::default();
                let event = line.iter().chain(b"\r").filter_map(|b| parser.push(*b)).last();
                let Some(SlcanEvent::Frame(frame)) = event else { return false };
                if self.speed == Some(b'8') {
                    self.hand.hear(&frame);
                }
                true
            }
            _ => false,
        }
    }
}

#[cfg(unix)]
impl crate::emulator::pty::SerialDevice for SlcanAdapter {
    fn exchange(&mut self, bytes: &[u8], reply: &mut Vec<u8>) {
        self.take(bytes, reply);
    }

    fn patience(&self) -> Duration {
        self.hand.until_next_report().unwrap_or(Duration::from_millis(10)).max(Duration::from_micros(100))
    }

    fn plugged(&self) -> bool {
        self.hand.device().plugged
    }
}
