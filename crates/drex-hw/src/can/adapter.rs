//! The adapter's end of slcan: any bus as what programs find behind a serial port.

use std::time::Duration;

use super::CanBus;
use super::slcan_line::{SlcanEvent, SlcanParser, write_slcan};
use crate::Result;

/// No line of a program is longer.
const LONGEST: usize = 40;
/// Most frames that one look at the bus takes from it.
const MOST_FRAMES: usize = 256;

/// An slcan adapter made of a bus: text in, text out. Behind a pseudo-terminal,
/// `PtyServer::serve(SlcanAdapter::new(hand.bus()), None)`, programs open an emulated hand as a serial port.
#[derive(Debug)]
pub struct SlcanAdapter<B> {
    bus: B,
    line: Vec<u8>,
    speed: Option<u8>,
    open: bool,
}

impl<B: CanBus> SlcanAdapter<B> {
    /// An adapter, closed as after power-up, at `bus`, which runs at 1 Mbit/s.
    pub fn new(bus: B) -> Self {
        Self { bus, line: Vec::with_capacity(LONGEST), speed: None, open: false }
    }

    /// The bus.
    pub fn bus(&self) -> &B {
        &self.bus
    }

    /// Takes text from the program and appends what the adapter answers and what it heard on the bus.
    ///
    /// # Errors
    /// [`Error::Port`](crate::Error::Port) if nothing can be heard of the bus any more; what it does not send is refused.
    pub fn take(&mut self, bytes: &[u8], reply: &mut Vec<u8>) -> Result<()> {
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
        for _ in 0..MOST_FRAMES {
            let Some(frame) = self.bus.receive(Duration::ZERO)? else { break };
            // A closed adapter, or one at another speed, hears nothing that makes sense.
            if self.open && self.speed == Some(b'8') {
                let mut line = [0; 32];
                let n = write_slcan(&frame, &mut line);
                reply.extend_from_slice(&line[..n]);
            }
        }
        Ok(())
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
                self.speed != Some(b'8') || self.bus.send(&frame).is_ok()
            }
            _ => false,
        }
    }
}
