//! The bus of an emulated hand: instructions in, status packets out.

use std::time::Duration;

use super::fault::{Fault, Faults};
use super::motor::Motor;
use super::registers::refusal;
use crate::dynamixel::{BROADCAST, HEADER, Parser, crc16, encode, instruction};
use crate::leap::table::{self, MotorModel};

/// Step of the physics.
const STEP: Duration = Duration::from_millis(1);
/// Longest reply of several motors in one packet.
const LONGEST: u16 = 4096;
/// Most steps that are made up for after a pause.
const MOST_STEPS: u32 = 2000;

/// A write that a motor was asked for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WriteRecord {
    /// Who.
    pub id: u8,
    /// Where, as it stood in the packet.
    pub address: u16,
    /// What.
    pub data: Vec<u8>,
    /// Whether the motor did it.
    pub accepted: bool,
}

/// A supply and what its cables take from it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Supply {
    /// Without load, V.
    pub volts: f64,
    /// Resistance on the way to the motors, Ω.
    pub ohms: f64,
}

#[derive(Debug)]
pub(super) struct Wire {
    pub motors: Vec<Motor>,
    /// What they are supplied with; `None` is 5 V under any load.
    pub supply: Option<Supply>,
    pub plugged: bool,
    pub record: Option<Vec<WriteRecord>>,
    parser: Parser,
    faults: Faults,
    now: Duration,
    stepped: Duration,
    /// Sum of the return delays of the answers so far.
    delay: Duration,
}

impl Wire {
    pub fn new(model: MotorModel) -> Self {
        Self {
            motors: (0..16).map(|id| Motor::new(id, model)).collect(),
            supply: None,
            plugged: true,
            record: None,
            parser: Parser::new(),
            faults: Faults::default(),
            now: Duration::ZERO,
            stepped: Duration::ZERO,
            delay: Duration::ZERO,
        }
    }

    pub fn now(&self) -> Duration {
        self.now
    }

    pub fn pass(&mut self, time: Duration) {
        self.advance_to(self.now + time);
    }

    pub fn advance_to(&mut self, now: Duration) {
        self.now = self.now.max(now);
        self.stepped = self.stepped.max(self.now.saturating_sub(STEP * MOST_STEPS));
        while self.stepped + STEP <= self.now {
            self.stepped += STEP;
            self.motors.iter_mut().for_each(|m| m.step(self.stepped, STEP.as_secs_f64()));
            self.feed();
        }
    }

    /// Gives the motors the voltage that their currents leave of the supply.
    pub fn feed(&mut self) {
        let Some(Supply { volts, ohms }) = self.supply else { return };
        let load_a: f64 = self.motors.iter().map(|m| m.body.flowing().abs() * 1e-3).sum();
        let (volts, now) = ((volts - ohms * load_a).max(0.0), self.stepped);
        self.motors.iter_mut().for_each(|m| m.supply(volts, now));
    }

    pub fn inject(&mut self, fault: Fault, times: u32) {
        self.faults.inject(fault, 0, times);
    }

    pub fn inject_later(&mut self, fault: Fault, skipped: u32) {
        self.faults.inject(fault, skipped, 1);
    }

    /// Takes bytes from the host; appends what the motors answer. For how long they hesitated.
    pub fn receive(&mut self, mut bytes: &[u8], reply: &mut Vec<u8>) -> Duration {
        self.delay = Duration::ZERO;
        loop {
            while let Some(p) = self.parser.next_packet() {
                let (id, number, params) = (p.id, p.instruction, p.params.to_vec());
                self.instruction(id, number, &params, reply);
            }
            if bytes.is_empty() {
                return self.delay;
            }
            let taken = self.parser.push(bytes);
            bytes = &bytes[taken..];
        }
    }

    fn instruction(&mut self, id: u8, number: u8, params: &[u8], reply: &mut Vec<u8>) {
        if number == instruction::STATUS {
            return;
        }
        if self.faults.happens(Fault::Noise) {
            self.faults.noise(reply);
        }
        match number {
            instruction::SYNC_WRITE => self.sync_write(params),
            instruction::BULK_WRITE => self.bulk_write(params),
            instruction::SYNC_READ => self.chain(&of_sync(params), reply),
            instruction::BULK_READ => self.chain(&of_bulk(params), reply),
            instruction::FAST_SYNC_READ => self.fast_chain(&of_sync(params), reply),
            instruction::FAST_BULK_READ => self.fast_chain(&of_bulk(params), reply),
            _ => {
                for i in 0..self.motors.len() {
                    if id == BROADCAST || self.motors[i].id == id {
                        self.single(i, id == BROADCAST, number, params, reply);
                    }
                }
            }
        }
    }

    /// Motor with this id, if it hears.
    fn hearing(&mut self, id: u8) -> Option<usize> {
        let i = self.motors.iter().position(|m| m.id == id)?;
        if self.motors[i].deaf(self.now) || self.faults.happens(Fault::Deaf(id)) {
            return None;
        }
        self.motors[i].note_instruction(self.now);
        Some(i)
    }

    /// An instruction to one motor, or to it among all.
    fn single(&mut self, i: usize, to_all: bool, number: u8, params: &[u8], reply: &mut Vec<u8>) {
        let id = self.motors[i].id;
        let Some(i) = self.hearing(id) else { return };
        let mut data = Vec::new();
        let told = self.motors[i].get(table::STATUS_LEVEL);
        let done = match number {
            instruction::PING => {
                let pong = self.motors[i].pong();
                data = [&pong.model.to_le_bytes()[..], &[pong.firmware]].concat();
                Ok(())
            }
            instruction::READ => match range(params) {
                Some((address, len, _)) if usize::from(len) <= 256 => {
                    data = vec![0; usize::from(len)];
                    self.motors[i].read(address, &mut data)
                }
                _ => Err(refusal::LENGTH),
            },
            instruction::WRITE => match params.split_at_checked(2) {
                Some((a, bytes)) => self.write(i, u16::from_le_bytes([a[0], a[1]]), bytes),
                None => Err(refusal::LENGTH),
            },
            instruction::REG_WRITE => match params.split_at_checked(2) {
                Some((a, bytes)) => self.motors[i].register(u16::from_le_bytes([a[0], a[1]]), bytes),
                None => Err(refusal::LENGTH),
            },
            instruction::ACTION => match self.motors[i].registered.take() {
                Some((address, bytes)) => self.write(i, address, &bytes),
                None => Err(refusal::FAILED),
            },
            instruction::CLEAR => self.motors[i].clear(params),
            instruction::REBOOT => Ok(()),
            _ => Err(refusal::INSTRUCTION),
        };
        let level = match number {
            instruction::PING => 0,
            instruction::READ => 1,
            _ => 2,
        };
        // What it is told to answer to holds from the next instruction on; pings are always answered.
        if (!to_all && told >= level) || number == instruction::PING {
            if done.is_err() {
                data.clear();
            }
            self.status(i, done.err().unwrap_or(0), &data, reply);
        }
        if number == instruction::REBOOT {
            let now = self.now;
            self.motors[i].reboot(now);
        }
    }

    fn write(&mut self, i: usize, address: u16, data: &[u8]) -> Result<(), u8> {
        let done = self.motors[i].write(address, data);
        if let Some(record) = &mut self.record {
            let id = self.motors[i].id;
            record.push(WriteRecord { id, address, data: data.to_vec(), accepted: done.is_ok() });
        }
        done
    }

    fn sync_write(&mut self, params: &[u8]) {
        let Some((address, len, items)) = range(params) else { return };
        for item in items.chunks_exact(usize::from(len) + 1) {
            if let Some(i) = self.hearing(item[0]) {
                // Nobody hears of a refusal: that is how this instruction is.
                let _ = self.write(i, address, &item[1..]);
            }
        }
    }

    fn bulk_write(&mut self, mut params: &[u8]) {
        while let Some((&id, rest)) = params.split_first() {
            let Some((address, len, rest)) = range(rest) else { return };
            let Some((data, rest)) = rest.split_at_checked(usize::from(len)) else { return };
            if let Some(i) = self.hearing(id) {
                let _ = self.write(i, address, data);
            }
            params = rest;
        }
    }

    /// Answers one after the other; each waits for the one before it.
    fn chain(&mut self, items: &[(u8, u16, u16)], reply: &mut Vec<u8>) {
        // All hear the question, also those that will not get to answer.
        let hearing: Vec<_> = items.iter().map(|(id, _, _)| self.hearing(*id)).collect();
        for (i, (_, address, len)) in hearing.into_iter().zip(items) {
            let Some(i) = i else { return };
            let mut data = vec![0; usize::from(*len).min(256)];
            let done = self.motors[i].read(*address, &mut data);
            if done.is_err() {
                data.clear();
            }
            if !self.status(i, done.err().unwrap_or(0), &data, reply) {
                return;
            }
        }
    }

    /// Answers in one packet; each adds its block when it has heard the one before it.
    fn fast_chain(&mut self, items: &[(u8, u16, u16)], reply: &mut Vec<u8>) {
        let hearing: Vec<_> = items.iter().map(|(id, _, _)| self.hearing(*id)).collect();
        let length = 1 + items.iter().map(|(_, _, len)| usize::from(*len) + 4).sum::<usize>();
        let Some(length) = u16::try_from(length).ok().filter(|l| *l <= LONGEST) else { return };
        let mut head = [&HEADER[..], &[BROADCAST], &length.to_le_bytes(), &[instruction::STATUS]].concat();
        let mut sum = crc16(0, &head);
        let (begin, mut twice) = (reply.len(), false);
        for (i, (_, address, len)) in hearing.into_iter().zip(items) {
            let Some(i) = i.filter(|i| self.motors[*i].knows_fast_reads()) else { return };
            let motor = &self.motors[i];
            let id = motor.id;
            let mut block = vec![0; usize::from(*len) + 2];
            let error = motor.read(*address, &mut block[2..]).err().unwrap_or(0) | motor.alert();
            (block[0], block[1]) = (error, id);
            if self.faults.happens(Fault::Mute(id)) {
                return;
            }
            // Only the first has to hesitate.
            if !head.is_empty() {
                self.delay += motor.return_delay();
            }
            // Each goes on with the sum of all that was said before, sums included.
            let crc = crc16(sum, &block).to_le_bytes();
            block.extend(crc);
            sum = crc16(sum, &block);
            reply.append(&mut head);
            let sent = reply.len();
            reply.append(&mut block);
            // The answers are one packet: what comes twice is all of it.
            twice |= self.faults.happens(Fault::Duplicate(id));
            self.faults.damage(id, reply, sent);
        }
        if twice {
            reply.extend_from_within(begin..);
        }
    }

    /// The status packet of a motor; whether it was sent.
    fn status(&mut self, i: usize, error: u8, data: &[u8], reply: &mut Vec<u8>) -> bool {
        let motor = &self.motors[i];
        let id = motor.id;
        if self.faults.happens(Fault::Mute(id)) {
            return false;
        }
        let mut buffer = [0; 400];
        let params = [&[error | motor.alert()][..], data].concat();
        let Ok(length) = encode(&mut buffer, id, instruction::STATUS, &params) else { return false };
        let start = reply.len();
        self.delay += motor.return_delay();
        reply.extend_from_slice(&buffer[..length]);
        self.faults.damage(id, reply, start);
        true
    }
}

/// Who is asked for what by a read of the same addresses of several: id, address, length.
fn of_sync(params: &[u8]) -> Vec<(u8, u16, u16)> {
    range(params).map_or_else(Vec::new, |(address, len, ids)| ids.iter().map(|id| (*id, address, len)).collect())
}

/// The same of a read of different addresses.
fn of_bulk(params: &[u8]) -> Vec<(u8, u16, u16)> {
    let items = params.chunks_exact(5).filter_map(|c| Some((c[0], range(&c[1..])?)));
    items.map(|(id, (address, len, _))| (id, address, len)).collect()
}

/// Address, length and what follows.
fn range(params: &[u8]) -> Option<(u16, u16, &[u8])> {
    let (head, rest) = params.split_at_checked(4)?;
    Some((u16::from_le_bytes([head[0], head[1]]), u16::from_le_bytes([head[2], head[3]]), rest))
}
