//! What can go wrong on a bus.

/// A fault on the way between motors and the host.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fault {
    /// The motor says nothing. Those that wait for it in a read of several say nothing either.
    Mute(u8),
    /// The motor does not hear the instruction.
    Deaf(u8),
    /// One byte of its answer is wrong.
    Corrupt(u8),
    /// The second half of its answer is missing.
    Truncate(u8),
    /// Its answer comes twice.
    Duplicate(u8),
    /// Bytes that nobody sent come before the answers.
    Noise,
}

/// Faults that are still to happen.
#[derive(Debug, Clone, Default)]
pub(super) struct Faults {
    /// What, how often it is let pass first, and how often it happens then.
    waiting: Vec<(Fault, u32, u32)>,
    dice: u32,
}

impl Faults {
    pub fn inject(&mut self, fault: Fault, skipped: u32, times: u32) {
        self.waiting.push((fault, skipped, times));
    }

    /// Whether `fault` happens now; then it happens one time less.
    pub fn happens(&mut self, fault: Fault) -> bool {
        let Some(i) = self.waiting.iter().position(|(f, ..)| *f == fault) else { return false };
        let (_, skipped, times) = &mut self.waiting[i];
        if *skipped > 0 {
            *skipped -= 1;
            return false;
        }
        *times = times.saturating_sub(1);
        if *times == 0 {
            self.waiting.swap_remove(i);
        }
        true
    }

    /// Some bytes of noise, among them the beginning of a header.
    pub fn noise(&mut self, reply: &mut Vec<u8>) {
        for _ in 0..9 {
            self.dice = self.dice.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            reply.push((self.dice >> 24) as u8);
        }
        reply.extend([0xff, 0xff, 0xfd]);
    }

    /// Damages the answer of motor `id`, which is the end of `reply` from `start` on, if that is due.
    pub fn damage(&mut self, id: u8, reply: &mut Vec<u8>, start: usize) {
        let length = reply.len() - start;
        if self.happens(Fault::Corrupt(id)) {
            reply[start + length / 2] ^= 0x41;
        }
        if self.happens(Fault::Truncate(id)) {
            reply.truncate(start + length / 2);
        }
        if self.happens(Fault::Duplicate(id)) {
            reply.extend_from_within(start..);
        }
    }
}
