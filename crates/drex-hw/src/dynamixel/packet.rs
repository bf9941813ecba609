//! Packets of protocol 2.0, written into the caller's buffer.

use super::crc::crc16;
use crate::{Error, Result};

/// Every packet starts with these bytes.
pub const HEADER: [u8; 4] = [0xff, 0xff, 0xfd, 0x00];
/// Address of all motors at once.
pub const BROADCAST: u8 = 0xfe;
/// Bytes from the header to the instruction.
pub(super) const PROLOGUE: usize = 8;

/// What a packet says; the numbers of the protocol.
pub mod instruction {
    /// Is somebody there?
    pub const PING: u8 = 0x01;
    /// Read from the control table.
    pub const READ: u8 = 0x02;
    /// Write to the control table.
    pub const WRITE: u8 = 0x03;
    /// Write when told to act.
    pub const REG_WRITE: u8 = 0x04;
    /// Do the registered writes.
    pub const ACTION: u8 = 0x05;
    /// Start again.
    pub const REBOOT: u8 = 0x08;
    /// Forget something; motors that forget their turns count from within one turn again.
    pub const CLEAR: u8 = 0x10;
    /// A reply.
    pub const STATUS: u8 = 0x55;
    /// Read the same addresses of several motors.
    pub const SYNC_READ: u8 = 0x82;
    /// Write the same addresses of several motors.
    pub const SYNC_WRITE: u8 = 0x83;
    /// As `SYNC_READ`, answered by one packet.
    pub const FAST_SYNC_READ: u8 = 0x8a;
    /// Read different addresses of several motors.
    pub const BULK_READ: u8 = 0x92;
    /// Write different addresses of several motors.
    pub const BULK_WRITE: u8 = 0x93;
    /// As `BULK_READ`, answered by one packet.
    pub const FAST_BULK_READ: u8 = 0x9a;
}

/// Finds where a stuffing byte is due: after ff ff fd.
#[derive(Debug, Clone, Copy, Default)]
struct Stuffing(u8);

impl Stuffing {
    /// Takes the next byte of the data; whether an fd has to follow it.
    fn after(&mut self, byte: u8) -> bool {
        self.0 = match (self.0, byte) {
            (0, 0xff) => 1,
            (1 | 2, 0xff) => 2,
            (2, 0xfd) => {
                self.0 = 0;
                return true;
            }
            _ => 0,
        };
        false
    }
}

/// Writes one packet into a buffer, stuffing as it goes.
#[derive(Debug)]
pub struct PacketWriter<'a> {
    buffer: &'a mut [u8],
    len: usize,
    stuffing: Stuffing,
}

impl<'a> PacketWriter<'a> {
    /// Starts a packet for motor `id`.
    pub fn new(buffer: &'a mut [u8], id: u8, instruction: u8) -> Self {
        let mut writer = Self { buffer, len: 0, stuffing: Stuffing::default() };
        for byte in [HEADER[0], HEADER[1], HEADER[2], HEADER[3], id, 0, 0] {
            writer.raw(byte);
        }
        writer.push(&[instruction]);
        writer
    }

    /// Appends parameters.
    pub fn push(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.raw(byte);
            if self.stuffing.after(byte) {
                self.raw(0xfd);
            }
        }
    }

    fn raw(&mut self, byte: u8) {
        if let Some(place) = self.buffer.get_mut(self.len) {
            *place = byte;
        }
        self.len += 1;
    }

    /// Ends the packet; the number of bytes that were written.
    ///
    /// # Errors
    /// If the packet is longer than the buffer or than a packet can be.
    pub fn finish(mut self) -> Result<usize> {
        let (end, room) = (self.len + 2, self.buffer.len());
        let length = u16::try_from(end - PROLOGUE + 1).ok().filter(|_| end <= room).ok_or_else(|| {
            Error::value(
                format!("a packet of {end} bytes does not fit into a buffer of {room}"),
                "write to fewer motors at once or give a larger buffer",
            )
        })?;
        self.buffer[5..7].copy_from_slice(&length.to_le_bytes());
        let crc = crc16(0, &self.buffer[..self.len]).to_le_bytes();
        crc.into_iter().for_each(|byte| self.raw(byte));
        Ok(self.len)
    }
}

/// Writes a packet with these parameters; its length.
///
/// # Errors
/// As [`PacketWriter::finish`].
pub fn encode(buffer: &mut [u8], id: u8, instruction: u8, params: &[u8]) -> Result<usize> {
    let mut writer = PacketWriter::new(buffer, id, instruction);
    writer.push(params);
    writer.finish()
}

/// Takes stuffing bytes out of `body` (instruction and parameters) in place; the number of bytes that are left, or `None` if ff ff
/// fd is not followed by fd, which no sender writes.
pub(super) fn unstuff(body: &mut [u8]) -> Option<usize> {
    let (mut to, mut from, mut stuffing) = (0, 0, Stuffing::default());
    while from < body.len() {
        let byte = body[from];
        body[to] = byte;
        to += 1;
        from += 1;
        if stuffing.after(byte) {
            if body.get(from) != Some(&0xfd) {
                return None;
            }
            from += 1;
        }
    }
    Some(to)
}
