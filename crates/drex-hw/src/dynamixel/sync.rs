//! Questions to several motors at once. Who does not answer costs only itself: the motors after it are asked again.

use super::bus::Bus;
use super::fast::{fast_blocks, fast_reply_len};
use super::packet::{BROADCAST, instruction};
use super::{Answers, Port};
use crate::{Error, Result};

/// Times in a row that motors may answer a plain read and not a fast one before fast reads are given up.
const FAST_DOUBTS: u32 = 3;

impl<P: Port> Bus<P> {
    /// Writes to the same address of several motors: `len` bytes to each. Nobody answers.
    ///
    /// # Errors
    /// If data has another length, the packet is too long or the port fails.
    pub fn sync_write<'a>(
        &mut self,
        address: u16,
        len: usize,
        items: impl Iterator<Item = (u8, &'a [u8])>,
    ) -> Result<()> {
        self.queue_sync_write(address, len, items)?;
        self.send_only()
    }

    /// As [`Bus::sync_write`], sent together with the next question: one transfer instead of two.
    ///
    /// # Errors
    /// As [`Bus::sync_write`].
    pub fn queue_sync_write<'a>(
        &mut self,
        address: u16,
        len: usize,
        items: impl Iterator<Item = (u8, &'a [u8])>,
    ) -> Result<()> {
        let (mut right, length) = (true, len as u16);
        self.queue(BROADCAST, instruction::SYNC_WRITE, |packet| {
            packet.push(&address.to_le_bytes());
            packet.push(&length.to_le_bytes());
            for (id, data) in items {
                right &= data.len() == len;
                packet.push(&[id]);
                packet.push(data);
            }
        })?;
        if !right {
            self.unqueue();
            return Err(Error::value(format!("sync write data that is not {len} bytes long"), "give as many to each"));
        }
        Ok(())
    }

    /// Writes to a motor, an address and a number of bytes of its own each. Nobody answers.
    ///
    /// # Errors
    /// If the packet is too long or the port fails.
    pub fn bulk_write<'a>(&mut self, items: impl Iterator<Item = (u8, u16, &'a [u8])>) -> Result<()> {
        self.queue(BROADCAST, instruction::BULK_WRITE, |packet| {
            for (id, address, data) in items {
                packet.push(&[id]);
                packet.push(&address.to_le_bytes());
                packet.push(&(data.len() as u16).to_le_bytes());
                packet.push(data);
            }
        })?;
        self.send_only()
    }

    /// Reads the same address of all motors of `answers`, by fast sync read where they know it. What good motors said is kept.
    ///
    /// # Errors
    /// If the port fails; motors that do not answer have no answer.
    pub fn sync_read(&mut self, address: u16, answers: &mut Answers) -> Result<()> {
        answers.clear();
        let mut first = 0;
        for round in 0..=self.timing.follow_ups {
            if round > 0 {
                self.stats.follow_ups += 1;
            }
            let before = answers.answered();
            if self.fast {
                self.fast_round(address, answers, first)?;
            }
            if answers.answered() > before {
                self.fast_doubts = 0;
            } else if round == 0 || !self.fast {
                // Perhaps they do not know the fast way; asked once, so that a hand without power costs little time.
                self.plain_round(address, answers, first)?;
                if self.fast && answers.answered() > before {
                    self.fast_doubts += 1;
                    self.fast = self.fast_doubts < FAST_DOUBTS;
                }
            }
            // Each motor waits for the one before it, so that a silent one ends the round: all after it are asked again.
            let silent = answers.last().map_or(0, |i| i + 1).max(first);
            first = silent + 1;
            if first >= answers.ids().len() {
                break;
            }
        }
        Ok(())
    }

    /// Asks the motors from number `first` on; each answers by a packet of its own.
    fn plain_round(&mut self, address: u16, answers: &mut Answers, first: usize) -> Result<()> {
        let count = answers.ids().len() - first;
        let length = answers.data_len() + 11;
        self.queue_read(instruction::SYNC_READ, address, answers, first)?;
        self.send(length + length / 3)?;
        let mut wait = self.first_wait();
        let end = self.port.now() + wait + self.gap_wait() * (count as u32 + 4);
        loop {
            while let Some(p) = self.parser.next_packet() {
                if let (instruction::STATUS, Some((&error, data))) = (p.instruction, p.params.split_first()) {
                    answers.keep(first, p.id, error, data);
                }
            }
            if answers.last() == Some(answers.ids().len() - 1) {
                return Ok(());
            }
            if self.port.now() >= end || !self.receive(wait)? {
                if self.parser.give_up() {
                    continue;
                }
                self.stats.timeouts += 1;
                return Ok(());
            }
            wait = self.gap_wait();
        }
    }

    /// Asks the motors from number `first` on; they answer by one packet together.
    fn fast_round(&mut self, address: u16, answers: &mut Answers, first: usize) -> Result<()> {
        let len = answers.data_len();
        let total = fast_reply_len(answers.ids().len() - first, len);
        self.queue_read(instruction::FAST_SYNC_READ, address, answers, first)?;
        self.send(total)?;
        let mut wait = self.first_wait();
        let end = self.port.now() + wait + self.gap_wait() * 8;
        loop {
            if self.parser.fast_reply(total).is_some_and(|reply| reply.len() == total) {
                break;
            }
            if self.port.now() >= end || !self.receive(wait)? {
                self.stats.timeouts += 1;
                break;
            }
            wait = self.gap_wait();
        }
        if let Some(reply) = self.parser.fast_reply(total) {
            for block in fast_blocks(reply, len).flatten() {
                answers.keep(first, block.id, block.error, block.data);
            }
        }
        Ok(())
    }

    fn queue_read(&mut self, how: u8, address: u16, answers: &Answers, first: usize) -> Result<()> {
        self.queue(BROADCAST, how, |packet| {
            packet.push(&address.to_le_bytes());
            packet.push(&(answers.data_len() as u16).to_le_bytes());
            packet.push(&answers.ids()[first..]);
        })
    }

    /// Reads from a motor, an address and a number of bytes of its own each (`id`, address, length); `found` is handed the number
    /// of the item, the error byte and the data of each answer.
    ///
    /// # Errors
    /// If the port fails; motors that do not answer are left out.
    pub fn bulk_read(&mut self, items: &[(u8, u16, u16)], mut found: impl FnMut(usize, u8, &[u8])) -> Result<()> {
        let mut first = 0;
        for round in 0..=self.timing.follow_ups {
            if first >= items.len() {
                break;
            }
            self.stats.follow_ups += u64::from(round > 0);
            let last = self.bulk_round(&items[first..], |i, error, data| found(first + i, error, data))?;
            first += last.map_or(0, |i| i + 1) + 1;
        }
        Ok(())
    }

    /// One question; the number of the last item that was answered.
    fn bulk_round(
        &mut self,
        items: &[(u8, u16, u16)],
        mut found: impl FnMut(usize, u8, &[u8]),
    ) -> Result<Option<usize>> {
        self.queue(BROADCAST, instruction::BULK_READ, |packet| {
            for (id, address, len) in items {
                packet.push(&[*id]);
                packet.push(&address.to_le_bytes());
                packet.push(&len.to_le_bytes());
            }
        })?;
        let length = items.iter().map(|(_, _, len)| usize::from(*len)).max().unwrap_or(0) + 11;
        self.send(length + length / 3)?;
        let (mut wait, mut last) = (self.first_wait(), None);
        let end = self.port.now() + wait + self.gap_wait() * (items.len() as u32 + 4);
        loop {
            while let Some(p) = self.parser.next_packet() {
                let (instruction::STATUS, Some((&error, data))) = (p.instruction, p.params.split_first()) else {
                    continue;
                };
                let open = last.map_or(0, |i| i + 1);
                let item = items[open..].iter().position(|(id, _, len)| *id == p.id && usize::from(*len) == data.len());
                if let Some(i) = item {
                    found(open + i, error, data);
                    last = Some(open + i);
                }
            }
            if last == items.len().checked_sub(1) {
                return Ok(last);
            }
            if self.port.now() >= end || !self.receive(wait)? {
                if self.parser.give_up() {
                    continue;
                }
                self.stats.timeouts += 1;
                return Ok(last);
            }
            wait = self.gap_wait();
        }
    }
}
