//! A CAN adapter that speaks slcan over a serial port.

use std::io;
use std::path::Path;
use std::time::Duration;

use super::slcan_line::{SlcanEvent, SlcanParser, write_slcan};
use super::{CanBus, CanFrame};
use crate::dynamixel::{Port, SerialPort, Torque};
use crate::{Error, Result};

/// How long an adapter may take to answer a command; many never answer.
const ANSWER: Duration = Duration::from_millis(50);
/// An adapter that was silent for so long has no answer left from before.
const QUIET: Duration = Duration::from_millis(10);
/// USB adapters ignore the speed of their serial port; those with a UART use this one.
pub(crate) const SLCAN_BAUD: u32 = 115_200;

/// A bus behind an slcan adapter: opened at 1 Mbit/s, closed when dropped. An adapter that was unplugged is opened again with the next frame
/// that is sent or asked for.
#[derive(Debug)]
pub struct Slcan<P: Port> {
    port: P,
    parser: SlcanParser,
    chunk: [u8; 256],
    at: usize,
    filled: usize,
    /// Whether the port failed and was not opened again.
    lost: bool,
    refused: u64,
    /// Frames sent, and answers to them, or to what the adapter took for a line.
    sent: u64,
    answered: u64,
}

impl Slcan<SerialPort> {
    /// Opens the adapter at a serial port.
    ///
    /// # Errors
    /// [`Error::Port`] if the port cannot be opened, somebody else has it (the message says who), or the adapter refuses to open the bus.
    pub fn open(path: &Path) -> Result<Self> {
        Self::over(SerialPort::open(path, SLCAN_BAUD)?)
    }
}

impl<P: Port> Slcan<P> {
    /// Opens the adapter behind a port that is open.
    ///
    /// # Errors
    /// [`Error::Port`] if the port fails or the adapter refuses to open the bus.
    pub fn over(port: P) -> Result<Self> {
        let mut bus = Self::resumed(port);
        bus.open_channel()?;
        Ok(bus)
    }

    /// An adapter whose channel is open already.
    pub(crate) fn resumed(port: P) -> Self {
        Self {
            port,
            parser: SlcanParser::default(),
            chunk: [0; 256],
            at: 0,
            filled: 0,
            lost: false,
            refused: 0,
            sent: 0,
            answered: 0,
        }
    }

    /// Closes the channel and opens it at 1 Mbit/s.
    pub(crate) fn open_channel(&mut self) -> Result<()> {
        // A closed channel refuses to be closed; it may also have been left open, with frames in flight.
        self.command(b"\rC\r")?;
        self.settle()?;
        let speed = self.command(b"S8\r")?;
        let opened = self.command(b"O\r")?;
        if speed == Some(SlcanEvent::Refused) || opened == Some(SlcanEvent::Refused) {
            return Err(self.failed(io::Error::other("the adapter refused to open the bus at 1 Mbit/s")));
        }
        (self.refused, self.sent, self.answered) = (0, 0, 0);
        Ok(())
    }

    /// Opens a port again that failed.
    fn restore(&mut self) -> Result<()> {
        if self.lost {
            self.port.reopen().map_err(|e| self.failed(e))?;
            (self.parser, self.at, self.filled) = (SlcanParser::default(), 0, 0);
            self.open_channel().inspect_err(|_| self.lost = true)?;
            self.lost = false;
        }
        Ok(())
    }

    /// The port, to look at.
    pub(crate) fn port(&self) -> &P {
        &self.port
    }

    /// Lines from the adapter that meant nothing.
    pub fn ignored(&self) -> u64 {
        self.parser.ignored()
    }

    /// Drops what an adapter whose channel is closed still has to say, to another program perhaps, for [`ANSWER`] at most.
    fn settle(&mut self) -> Result<()> {
        let end = self.port.now() + ANSWER;
        while self.port.now() < end {
            let quiet = self.port.now() + QUIET;
            if self.event(quiet.min(end))?.is_none() {
                break;
            }
        }
        Ok(())
    }

    /// Sends a command and waits a little for the last of its answers, dropping frames.
    fn command(&mut self, text: &[u8]) -> Result<Option<SlcanEvent>> {
        self.write(text)?;
        let deadline = self.port.now() + ANSWER;
        let mut wanted = text.iter().filter(|b| **b == b'\r').count();
        let mut last = None;
        while let Some(event) = self.event(deadline)? {
            if !matches!(event, SlcanEvent::Frame(_)) {
                last = Some(event);
                wanted -= 1;
                if wanted == 0 {
                    break;
                }
            }
        }
        Ok(last)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.port.write_all(bytes).map_err(|e| {
            self.lost = true;
            self.failed(e)
        })
    }

    /// The next event; `None` if there is none before the deadline. What has already arrived is always looked at.
    fn event(&mut self, deadline: Duration) -> Result<Option<SlcanEvent>> {
        loop {
            while self.at < self.filled {
                let byte = self.chunk[self.at];
                self.at += 1;
                if let Some(event) = self.parser.push(byte) {
                    self.refused += u64::from(event == SlcanEvent::Refused);
                    self.answered += u64::from(!matches!(event, SlcanEvent::Frame(_)));
                    return Ok(Some(event));
                }
            }
            let left = deadline.saturating_sub(self.port.now());
            (self.at, self.filled) = (0, self.read(left)?);
            if self.filled == 0 && left.is_zero() {
                return Ok(None);
            }
        }
    }

    /// Bytes that arrive within a time, none if there are none.
    fn read(&mut self, wait: Duration) -> Result<usize> {
        self.port.read(&mut self.chunk, wait).map_err(|e| {
            self.lost = true;
            self.failed(e)
        })
    }

    fn failed(&self, source: io::Error) -> Error {
        let remedy = "check the adapter's plug; it is tried again with every frame".into();
        Error::Port { port: self.port.name().to_owned(), source, remedy }
    }
}

impl<P: Port> CanBus for Slcan<P> {
    fn name(&self) -> &str {
        self.port.name()
    }

    fn send(&mut self, frame: &CanFrame) -> Result<()> {
        self.restore()?;
        let mut line = [0; 32];
        let n = write_slcan(frame, &mut line);
        self.sent += 1;
        self.write(&line[..n])
    }

    fn refused(&self) -> u64 {
        self.refused
    }

    fn settle(&mut self, wait: Duration) -> Result<()> {
        let deadline = self.port.now() + wait;
        // What has come already shows whether the adapter answers frames at all.
        while self.event(self.port.now())?.is_some() && self.port.now() < deadline {}
        while self.answered > 0 && self.answered < self.sent {
            if self.event(deadline)?.is_none() {
                break;
            }
        }
        Ok(())
    }

    fn torque(&mut self, torque: Torque) -> Result<()> {
        self.port.torque(torque).map_err(|e| self.failed(e))
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<CanFrame>> {
        self.restore()?;
        let deadline = self.port.now() + timeout;
        loop {
            match self.event(deadline)? {
                Some(SlcanEvent::Frame(frame)) => return Ok(Some(frame)),
                Some(_) => {}
                None => return Ok(None),
            }
        }
    }
}

impl<P: Port> Drop for Slcan<P> {
    fn drop(&mut self) {
        // Nobody is left to be told that it failed.
        let _ = self.port.write_all(b"C\r");
    }
}
