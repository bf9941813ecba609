//! Finds packets in a stream of bytes, whatever else is in it.

use super::crc::crc16;
use super::packet::{BROADCAST, HEADER, PROLOGUE, instruction, unstuff};

/// Bytes a parser holds; the reply of 16 motors to a read of 10 bytes takes 336.
const CAPACITY: usize = 1024;
/// Longest packet that is waited for.
const LONGEST: usize = CAPACITY - 64;

/// A packet with a right CRC, without its stuffing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Packet<'a> {
    /// Who is meant, or who answers.
    pub id: u8,
    /// One of [`instruction`].
    pub instruction: u8,
    /// What follows the instruction. In a status packet the first byte is the error.
    pub params: &'a [u8],
}

/// Incremental parser over a fixed buffer. After noise, truncation or a wrong CRC it goes on at the next header.
#[derive(Debug, Clone)]
pub struct Parser {
    buffer: [u8; CAPACITY],
    start: usize,
    end: usize,
    longest: usize,
    rejected: u64,
}

impl Default for Parser {
    fn default() -> Self {
        Self { buffer: [0; CAPACITY], start: 0, end: 0, longest: LONGEST, rejected: 0 }
    }
}

/// What stands at the front of the buffer.
enum Front {
    Incomplete,
    Whole(usize),
}

impl Parser {
    /// An empty parser.
    pub fn new() -> Self {
        Self::default()
    }

    /// Forgets what has not been parsed; packets that say they are longer than `longest` bytes in all are not waited for.
    pub fn reset(&mut self, longest: usize) {
        (self.start, self.end) = (0, 0);
        self.longest = longest.min(LONGEST);
    }

    /// How many headers were found that no good packet followed.
    pub fn rejected(&self) -> u64 {
        self.rejected
    }

    /// Room for bytes from a port; call [`Parser::filled`] afterwards. Never empty once [`Parser::next_packet`] has returned `None`.
    pub fn room(&mut self) -> &mut [u8] {
        if self.start > 0 {
            self.buffer.copy_within(self.start..self.end, 0);
            (self.start, self.end) = (0, self.end - self.start);
        }
        &mut self.buffer[self.end..]
    }

    /// Says how many bytes were put into [`Parser::room`].
    pub fn filled(&mut self, bytes: usize) {
        self.end = (self.end + bytes).min(CAPACITY);
    }

    /// Takes over as many of `bytes` as there is room for; how many that was.
    pub fn push(&mut self, bytes: &[u8]) -> usize {
        let room = self.room();
        let n = room.len().min(bytes.len());
        room[..n].copy_from_slice(&bytes[..n]);
        self.filled(n);
        n
    }

    /// The next packet with a right CRC. Fast replies are not packets of this kind, see [`Parser::fast_reply`].
    pub fn next_packet(&mut self) -> Option<Packet<'_>> {
        loop {
            let Front::Whole(total) = self.front() else { return None };
            let packet = self.start..self.start + total;
            let (head, tail) = self.buffer[packet.clone()].split_at(total - 2);
            if crc16(0, head).to_le_bytes() != *tail {
                self.skip();
                continue;
            }
            let body = packet.start + PROLOGUE - 1..packet.end - 2;
            let Some(length) = unstuff(&mut self.buffer[body.clone()]) else {
                self.skip();
                continue;
            };
            self.start += total;
            let body = &self.buffer[body.start..body.start + length];
            return Some(Packet { id: self.buffer[packet.start + 4], instruction: body[0], params: &body[1..] });
        }
    }

    /// The bytes of a fast reply of `total` bytes as far as they have come, from the header on; `None` before there is one. Its
    /// blocks carry their own CRCs.
    pub fn fast_reply(&mut self, total: usize) -> Option<&[u8]> {
        loop {
            self.front();
            let bytes = &self.buffer[self.start..self.end];
            if bytes.len() < PROLOGUE {
                return None;
            }
            let length = usize::from(u16::from_le_bytes([bytes[5], bytes[6]]));
            if bytes[4] == BROADCAST && bytes[7] == instruction::STATUS && length + 7 == total {
                return Some(&self.buffer[self.start..self.end.min(self.start + total)]);
            }
            self.skip();
        }
    }

    /// Gives up on a packet that did not arrive in full; what follows its header may hold whole ones. Whether anything follows.
    pub fn give_up(&mut self) -> bool {
        if self.end > self.start {
            self.skip();
        }
        self.end > self.start
    }

    /// Leaves the header at the front and looks for the next.
    fn skip(&mut self) {
        self.start += 1;
        self.rejected += 1;
    }

    /// Moves to the first possible header and says whether its packet is complete.
    fn front(&mut self) -> Front {
        loop {
            let bytes = &self.buffer[self.start..self.end];
            let known = bytes.len().min(HEADER.len());
            if bytes[..known] != HEADER[..known] {
                self.start += 1;
                continue;
            }
            if bytes.len() < PROLOGUE - 1 {
                return Front::Incomplete;
            }
            let total = 7 + usize::from(u16::from_le_bytes([bytes[5], bytes[6]]));
            if !(10..=self.longest).contains(&total) || bytes[4] == 0xff {
                self.skip();
                continue;
            }
            return if bytes.len() < total { Front::Incomplete } else { Front::Whole(total) };
        }
    }
}
