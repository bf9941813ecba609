//! The reply to a fast sync read: one packet, a block per motor, no stuffing, a CRC after each block that covers everything
//! before it.

use super::crc::crc16;
use super::packet::PROLOGUE;

/// Length of the whole reply of `motors` motors with `data` bytes each.
pub fn fast_reply_len(motors: usize, data: usize) -> usize {
    PROLOGUE + motors * (data + 4)
}

/// What one motor said.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FastBlock<'a> {
    /// Who.
    pub id: u8,
    /// Its error byte.
    pub error: u8,
    /// What was read.
    pub data: &'a [u8],
}

/// The blocks in `reply` (from the header on, perhaps cut off) in the order they came: `None` for one whose CRC is wrong.
///
/// A motor computes its CRC from what it heard, so that a block that was damaged on the way spoils the sums after it. They are
/// compared with a sum that goes on from the CRC before as well: then only the damaged block is lost.
pub fn fast_blocks(reply: &[u8], data: usize) -> impl Iterator<Item = Option<FastBlock<'_>>> {
    let (head, rest) = reply.split_at(PROLOGUE.min(reply.len()));
    let mut heard = crc16(0, head);
    let mut said = heard;
    rest.chunks_exact(data + 4).map(move |block| {
        let (body, crc) = block.split_at(data + 2);
        let sums = [crc16(heard, body), crc16(said, body)];
        let sent = u16::from_le_bytes([crc[0], crc[1]]);
        let good = sums.contains(&sent);
        // What the motor after this one has summed up, if the CRC came through; and if instead the block did.
        said = crc16(sent, crc);
        heard = if good { said } else { crc16(sums[0], &sums[0].to_le_bytes()) };
        good.then(|| FastBlock { id: body[1], error: body[0], data: &body[2..] })
    })
}
