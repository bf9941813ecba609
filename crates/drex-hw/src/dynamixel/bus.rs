//! Questions to single motors, and what all questions share: sending, waiting, giving up.

use std::time::Duration;

use super::packet::{BROADCAST, PacketWriter, instruction};
use super::{Parser, Port};
use crate::{Error, Result};

/// Bytes that a batch of packets may take.
const OUT: usize = 1024;
/// Patience with an adapter that does not tell its latency, or with a program on a busy machine.
const UNKNOWN: Duration = Duration::from_millis(50);
/// Least patience in a loop behind such an adapter.
const LEAST: Duration = Duration::from_millis(10);
/// Longest time that a scan of all ids takes.
const SCAN: Duration = Duration::from_secs(3);
/// Reads that are thrown away before a question; more is not left-over but noise without an end.
const DRAINS: usize = 16;

/// How long motors may take, besides the time that the bytes themselves need at the speed of the port.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Timing {
    /// From the end of a question to the first byte of the answer.
    pub first_byte: Duration,
    /// From one byte of an answer to the next, and from one motor to the next.
    pub gap: Duration,
    /// How often the motors after a silent one are asked again in one read.
    pub follow_ups: u32,
}

impl Default for Timing {
    fn default() -> Self {
        Self::for_latency(Duration::ZERO).with_patience(UNKNOWN)
    }
}

impl Timing {
    /// For an adapter that keeps received bytes back for `latency`.
    pub fn for_latency(latency: Duration) -> Self {
        Self { first_byte: latency + Duration::from_millis(6), gap: latency + Duration::from_millis(4), follow_ups: 3 }
    }

    /// For a loop, where a silent motor holds the others up, after answers took `worst` to come: twice as long and a bit, from 10
    /// to 50 ms.
    pub fn for_loop(worst: Duration) -> Self {
        let patience = (worst * 2 + Duration::from_millis(5)).clamp(LEAST, UNKNOWN);
        Self::for_latency(Duration::ZERO).with_patience(patience)
    }

    /// The same with other times, for both the first byte and the next.
    pub fn with_patience(mut self, patience: Duration) -> Self {
        (self.first_byte, self.gap) = (patience, patience);
        self
    }
}

/// What a bus has seen since it was made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct BusStats {
    /// Questions sent.
    pub questions: u64,
    /// Questions that were not, or not wholly, answered in time.
    pub timeouts: u64,
    /// Headers that no good packet followed.
    pub rejected: u64,
    /// Reads of several motors that had to be asked again.
    pub follow_ups: u64,
}

/// What a motor says to a ping.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pong {
    /// Who.
    pub id: u8,
    /// Model number.
    pub model: u16,
    /// Version of its firmware.
    pub firmware: u8,
    /// Whether its hardware error register is not 0.
    pub alert: bool,
}

/// The motors on one port.
#[derive(Debug)]
pub struct Bus<P> {
    pub(super) port: P,
    pub(super) parser: Parser,
    out: [u8; OUT],
    queued: usize,
    pub(super) timing: Timing,
    /// Time that the last question and its answer need on the wire.
    wire: Duration,
    /// Longest time beyond that which a single motor took to answer.
    slowest: Duration,
    pub(super) stats: BusStats,
    /// Whether several motors are asked for one common answer.
    pub(super) fast: bool,
    /// Times in a row that a plain read was answered and a fast one was not.
    pub(super) fast_doubts: u32,
    /// How long nobody may answer before single questions are no longer asked, and since when nobody has.
    silence: Option<Duration>,
    silent_since: Duration,
}

impl<P: Port> Bus<P> {
    /// The motors behind `port`.
    pub fn new(port: P, timing: Timing) -> Self {
        Self {
            port,
            parser: Parser::new(),
            out: [0; OUT],
            queued: 0,
            timing,
            wire: Duration::ZERO,
            slowest: Duration::ZERO,
            stats: BusStats::default(),
            fast: true,
            fast_doubts: 0,
            silence: None,
            silent_since: Duration::ZERO,
        }
    }

    /// From now on single questions are refused as [`Error::Silent`] without being asked once nobody has answered one for `silence`;
    /// `None` asks for ever. A bus that is dead, or on which somebody babbles, is given up in time by this.
    pub(crate) fn limit_silence(&mut self, silence: Option<Duration>) {
        (self.silence, self.silent_since) = (silence, self.port.now());
    }

    /// The port.
    pub fn port(&mut self) -> &mut P {
        &mut self.port
    }

    /// What was seen so far.
    pub fn stats(&self) -> BusStats {
        BusStats { rejected: self.parser.rejected(), ..self.stats }
    }

    /// How long motors may take.
    pub fn timing(&self) -> Timing {
        self.timing
    }

    /// Says how long motors may take from now on.
    pub fn set_timing(&mut self, timing: Timing) {
        self.timing = timing;
    }

    /// Longest time that a single motor took to answer so far, besides the time of the bytes.
    pub fn slowest(&self) -> Duration {
        self.slowest
    }

    /// Whether several motors are asked by fast sync read; turned off for good after motors did not know it.
    pub fn fast(&self) -> bool {
        self.fast
    }

    /// Says whether to ask by fast sync read.
    pub fn set_fast(&mut self, fast: bool) {
        (self.fast, self.fast_doubts) = (fast, 0);
    }

    /// Asks motor `id` who it is.
    ///
    /// # Errors
    /// If it does not answer or the port fails.
    pub fn ping(&mut self, id: u8) -> Result<Pong> {
        let mut data = [0; 3];
        let error = self.ask(id, instruction::PING, &[], &mut data)?;
        Ok(pong(id, error, &data))
    }

    /// Asks who is there at all. Motors answer one after the other, in the order of their ids.
    ///
    /// # Errors
    /// If the port fails; nobody there is an empty list.
    pub fn scan(&mut self) -> Result<Vec<Pong>> {
        self.scan_within(SCAN)
    }

    /// The same within `limit`, where a bus that babbles would take all the time there is.
    pub(crate) fn scan_within(&mut self, limit: Duration) -> Result<Vec<Pong>> {
        self.queue(BROADCAST, instruction::PING, |_| {})?;
        self.send(14)?;
        let mut found: Vec<Pong> = Vec::new();
        // A motor with a high id waits for its turn, so the first one may be late.
        let mut wait = self.first_wait() + Duration::from_millis(40);
        let end = self.port.now() + limit;
        while self.port.now() < end {
            while let Some(p) = self.parser.next_packet() {
                if let (instruction::STATUS, &[error, a, b, c]) = (p.instruction, p.params) {
                    let pong = pong(p.id, error, &[a, b, c]);
                    if !found.iter().any(|f| f.id == pong.id) {
                        found.push(pong);
                    }
                }
            }
            if !self.receive(wait)? {
                break;
            }
            wait = self.gap_wait() + Duration::from_millis(40);
        }
        found.sort_by_key(|p| p.id);
        Ok(found)
    }

    /// Reads `data.len()` bytes at `address`; whether the motor's alert bit is set.
    ///
    /// # Errors
    /// If the motor does not answer or refuses, or the port fails.
    pub fn read(&mut self, id: u8, address: u16, data: &mut [u8]) -> Result<bool> {
        let [a, b] = address.to_le_bytes();
        let [c, d] = (data.len() as u16).to_le_bytes();
        let error = self.ask(id, instruction::READ, &[&[a, b, c, d]], data)?;
        refused(id, error)
    }

    /// Writes `data` at `address`; whether the motor's alert bit is set.
    ///
    /// # Errors
    /// As [`Bus::read`].
    pub fn write(&mut self, id: u8, address: u16, data: &[u8]) -> Result<bool> {
        let error = self.ask(id, instruction::WRITE, &[&address.to_le_bytes(), data], &mut [])?;
        refused(id, error)
    }

    /// Starts motor `id` again: torque off, errors and everything in RAM forgotten. It is deaf for a moment.
    ///
    /// # Errors
    /// As [`Bus::read`].
    pub fn reboot(&mut self, id: u8) -> Result<()> {
        let error = self.ask(id, instruction::REBOOT, &[], &mut [])?;
        refused(id, error).map(|_| ())
    }

    /// One question to one motor; its error byte.
    fn ask(&mut self, id: u8, instruction: u8, params: &[&[u8]], data: &mut [u8]) -> Result<u8> {
        let given_up = self.silence.map(|s| self.silent_since + s);
        if given_up.is_some_and(|then| self.port.now() >= then) {
            return Err(Error::Silent { id });
        }
        self.queue(id, instruction, |packet| params.iter().for_each(|p| packet.push(p)))?;
        let length = 11 + data.len();
        self.send(length + length / 3)?;
        let mut wait = self.first_wait();
        let sent = self.port.now();
        let end = sent + wait + self.gap_wait() * 8;
        let end = given_up.map_or(end, |then| then.min(end));
        loop {
            while let Some(p) = self.parser.next_packet() {
                let (self::instruction::STATUS, Some((error, reply))) = (p.instruction, p.params.split_first()) else {
                    continue;
                };
                if p.id == id && reply.len() == data.len() {
                    self.silent_since = self.port.now();
                    let took = self.silent_since.saturating_sub(sent + self.wire);
                    self.slowest = self.slowest.max(took);
                    data.copy_from_slice(reply);
                    return Ok(*error);
                }
                // Who refuses sends no data.
                if p.id == id && reply.is_empty() && error & 0x7f != 0 {
                    self.silent_since = self.port.now();
                    return Ok(*error);
                }
            }
            if self.port.now() >= end || !self.receive(wait)? {
                if self.parser.give_up() {
                    continue;
                }
                self.stats.timeouts += 1;
                return Err(Error::Silent { id });
            }
            wait = self.gap_wait();
        }
    }

    /// Lets `time` pass on the port's clock; what arrives is thrown away.
    ///
    /// # Errors
    /// If the port fails.
    pub fn pause(&mut self, time: Duration) -> Result<()> {
        let end = self.port.now() + time;
        loop {
            let left = end.saturating_sub(self.port.now());
            if left.is_zero() {
                return Ok(());
            }
            self.parser.reset(0);
            self.receive(left)?;
        }
    }

    /// Adds a packet to those that go out next.
    pub(super) fn queue(&mut self, id: u8, instruction: u8, fill: impl FnOnce(&mut PacketWriter<'_>)) -> Result<()> {
        let mut packet = PacketWriter::new(&mut self.out[self.queued..], id, instruction);
        fill(&mut packet);
        match packet.finish() {
            Ok(length) => self.queued += length,
            Err(e) => {
                self.queued = 0;
                return Err(e);
            }
        }
        Ok(())
    }

    /// Sends what is queued, after throwing away what an earlier question left behind. Answers are at most `longest` bytes.
    pub(super) fn send(&mut self, longest: usize) -> Result<()> {
        self.stats.questions += 1;
        let queued = std::mem::take(&mut self.queued);
        for _ in 0..DRAINS {
            self.parser.reset(longest);
            let left = self.port.read(self.parser.room(), Duration::ZERO).map_err(|e| lost(&self.port, e))?;
            if left == 0 {
                break;
            }
        }
        self.parser.reset(longest);
        let bits = 10 * (queued + longest) as u64;
        // A port without a speed has no wire.
        self.wire = self.port.baud().map_or(Duration::ZERO, |baud| {
            Duration::from_nanos((bits * 1_000_000_000).div_ceil(u64::from(baud.max(1))))
        });
        self.port.write_all(&self.out[..queued]).map_err(|e| lost(&self.port, e))
    }

    /// How long to wait for the first byte of an answer: a write returns before its bytes are on the wire.
    pub(super) fn first_wait(&self) -> Duration {
        self.timing.first_byte + self.wire
    }

    /// How long to wait for more bytes: an adapter may keep all of an answer until it is complete.
    pub(super) fn gap_wait(&self) -> Duration {
        self.timing.gap + self.wire
    }

    /// Sends what is queued and waits for no answer.
    pub(super) fn send_only(&mut self) -> Result<()> {
        let queued = std::mem::take(&mut self.queued);
        self.port.write_all(&self.out[..queued]).map_err(|e| lost(&self.port, e))
    }

    /// Forgets what is queued.
    pub(super) fn unqueue(&mut self) {
        self.queued = 0;
    }

    /// Waits for bytes; whether some came.
    pub(super) fn receive(&mut self, wait: Duration) -> Result<bool> {
        let read = self.port.read(self.parser.room(), wait).map_err(|e| lost(&self.port, e))?;
        self.parser.filled(read);
        Ok(read > 0)
    }
}

fn pong(id: u8, error: u8, data: &[u8; 3]) -> Pong {
    Pong { id, model: u16::from_le_bytes([data[0], data[1]]), firmware: data[2], alert: error & 0x80 != 0 }
}

/// The alert bit of an error byte that is otherwise clean.
pub(super) fn refused(id: u8, error: u8) -> Result<bool> {
    match error & 0x7f {
        0 => Ok(error & 0x80 != 0),
        number => Err(Error::Refused { id, number }),
    }
}

fn lost<P: Port>(port: &P, source: std::io::Error) -> Error {
    Error::Port {
        port: port.name().to_owned(),
        source,
        remedy: "check cable and power; the driver tries to open it again".into(),
    }
}
