//! A CAN adapter that speaks slcan over a serial port.

use std::io::{self, Read, Write};
use std::path::Path;
use std::time::{Duration, Instant};

use super::slcan_line::{SlcanEvent, SlcanParser, write_slcan};
use super::{CanBus, CanFrame};
use crate::{Error, Result};

/// How long an adapter may take to answer a command; many never answer.
const ANSWER: Duration = Duration::from_millis(50);
/// How long a line may take to be written.
const WRITE: Duration = Duration::from_millis(100);

/// Bytes in and out, with a limit on how long reading waits.
pub trait BytePort: Read + Write + Send {
    /// Reads that follow give up after this long; zero means at once.
    ///
    /// # Errors
    /// As the system says.
    fn set_wait(&mut self, wait: Duration) -> io::Result<()>;
}

/// A serial port of the system that only this process uses.
#[derive(Debug)]
pub struct SerialBytes {
    port: serial2::SerialPort,
    #[cfg(unix)]
    _lock: std::fs::File,
}

impl SerialBytes {
    fn open(path: &Path) -> io::Result<Self> {
        #[cfg(unix)]
        let lock = crate::dynamixel::lock::lock_device(path)?;
        // USB adapters ignore the rate; those with a UART use this one.
        let mut port = serial2::SerialPort::open(path, 115_200)?;
        port.set_write_timeout(WRITE)?;
        port.discard_buffers()?;
        Ok(Self {
            port,
            #[cfg(unix)]
            _lock: lock,
        })
    }
}

impl Read for SerialBytes {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.port.read(buffer)
    }
}

impl Write for SerialBytes {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        self.port.write(buffer)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.port.flush()
    }
}

impl BytePort for SerialBytes {
    fn set_wait(&mut self, wait: Duration) -> io::Result<()> {
        // The system counts in milliseconds; rounded up, so that a short wait is not none.
        let ms = u64::try_from(wait.as_micros().div_ceil(1000)).unwrap_or(u64::MAX).min(60_000);
        self.port.set_read_timeout(Duration::from_millis(ms))
    }
}

#[cfg(unix)]
impl BytePort for std::os::unix::net::UnixStream {
    fn set_wait(&mut self, wait: Duration) -> io::Result<()> {
        // A socket takes zero for ever.
        self.set_read_timeout(Some(wait.max(Duration::from_micros(1))))
    }
}

/// A bus behind an slcan adapter: opened at 1 Mbit/s, closed when dropped.
#[derive(Debug)]
pub struct Slcan<P: BytePort> {
    port: P,
    name: String,
    parser: SlcanParser,
    chunk: [u8; 256],
    at: usize,
    filled: usize,
    wait: Option<Duration>,
    refused: u64,
    /// Frames sent, and answers to them, or to what the adapter took for a line.
    sent: u64,
    answered: u64,
}

impl Slcan<SerialBytes> {
    /// Opens the adapter at a serial port.
    ///
    /// # Errors
    /// [`Error::Port`] if the port cannot be opened, somebody else has it (the message says who), or the adapter refuses to open the bus.
    pub fn open(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let port = SerialBytes::open(path).map_err(|source| Error::Port {
            port: name.clone(),
            source,
            remedy: "check the path, end other programs that use it, and join its group, mostly dialout".into(),
        })?;
        Self::over(port, name)
    }
}

impl<P: BytePort> Slcan<P> {
    /// Opens the adapter behind a port that is open.
    ///
    /// # Errors
    /// [`Error::Port`] if the port fails or the adapter refuses to open the bus.
    pub fn over(port: P, name: impl Into<String>) -> Result<Self> {
        let parser = SlcanParser::default();
        let mut bus = Self {
            port,
            name: name.into(),
            parser,
            chunk: [0; 256],
            at: 0,
            filled: 0,
            wait: None,
            refused: 0,
            sent: 0,
            answered: 0,
        };
        // A closed channel refuses to be closed; it may also have been left open, with frames in flight.
        bus.command(b"\rC\r")?;
        let speed = bus.command(b"S8\r")?;
        let opened = bus.command(b"O\r")?;
        if speed == Some(SlcanEvent::Refused) || opened == Some(SlcanEvent::Refused) {
            return Err(bus.failed(io::Error::other("the adapter refused to open the bus at 1 Mbit/s")));
        }
        (bus.refused, bus.answered) = (0, 0);
        Ok(bus)
    }

    /// Lines from the adapter that meant nothing.
    pub fn ignored(&self) -> u64 {
        self.parser.ignored()
    }

    /// Sends a command and waits a little for the last of its answers, dropping frames.
    fn command(&mut self, text: &[u8]) -> Result<Option<SlcanEvent>> {
        self.write(text)?;
        let deadline = Instant::now() + ANSWER;
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
        self.port.write_all(bytes).map_err(|e| self.failed(e))
    }

    /// The next event; `None` if there is none before the deadline. What has already arrived is always looked at.
    fn event(&mut self, deadline: Instant) -> Result<Option<SlcanEvent>> {
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
            let left = deadline.saturating_duration_since(Instant::now());
            (self.at, self.filled) = (0, self.read(left)?);
            if self.filled == 0 && left.is_zero() {
                return Ok(None);
            }
        }
    }

    /// Bytes that arrive within a time, none if there are none.
    fn read(&mut self, wait: Duration) -> Result<usize> {
        if self.wait != Some(wait) {
            self.port.set_wait(wait).map_err(|e| self.failed(e))?;
            self.wait = Some(wait);
        }
        match self.port.read(&mut self.chunk) {
            // The end of a stream: the adapter was unplugged.
            Ok(0) => Err(self.failed(io::ErrorKind::UnexpectedEof.into())),
            Ok(n) => Ok(n),
            Err(e) => match e.kind() {
                io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted => Ok(0),
                _ => Err(self.failed(e)),
            },
        }
    }

    fn failed(&self, source: io::Error) -> Error {
        Error::Port { port: self.name.clone(), source, remedy: "check the adapter's plug, then connect again".into() }
    }
}

impl<P: BytePort> CanBus for Slcan<P> {
    fn name(&self) -> &str {
        &self.name
    }

    fn send(&mut self, frame: &CanFrame) -> Result<()> {
        let mut line = [0; 32];
        let n = write_slcan(frame, &mut line);
        self.sent += 1;
        self.write(&line[..n])
    }

    fn refused(&self) -> u64 {
        self.refused
    }

    fn settle(&mut self, wait: Duration) -> Result<()> {
        let deadline = Instant::now() + wait;
        // What has come already shows whether the adapter answers frames at all.
        while self.event(Instant::now())?.is_some() && Instant::now() < deadline {}
        while self.answered > 0 && self.answered < self.sent {
            if self.event(deadline)?.is_none() {
                break;
            }
        }
        Ok(())
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<CanFrame>> {
        let deadline = Instant::now() + timeout;
        loop {
            match self.event(deadline)? {
                Some(SlcanEvent::Frame(frame)) => return Ok(Some(frame)),
                Some(_) => {}
                None => return Ok(None),
            }
        }
    }
}

impl<P: BytePort> Drop for Slcan<P> {
    fn drop(&mut self) {
        // Nobody is left to be told that it failed.
        let _ = self.port.write_all(b"C\r");
        let _ = self.port.flush();
    }
}
