//! The text of slcan: one line per frame, `\r` at its end, `\a` for an error.

use super::CanFrame;

/// Longest line that means something: `t`, identifier, length, eight bytes, time stamp.
const LONGEST: usize = 1 + 3 + 1 + 16 + 4;

/// What an adapter says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SlcanEvent {
    /// A frame from the bus.
    Frame(CanFrame),
    /// The last command was taken.
    Acknowledged,
    /// The last command was refused.
    Refused,
}

/// Finds events in a stream of bytes, byte by byte. Noise costs the lines that it hits, and nothing more.
#[derive(Debug, Clone, Default)]
pub struct SlcanParser {
    line: [u8; LONGEST],
    len: usize,
    ignored: u64,
}

impl SlcanParser {
    /// Takes one byte.
    pub fn push(&mut self, byte: u8) -> Option<SlcanEvent> {
        match byte {
            b'\r' => {
                let line = self.line;
                let line = &line[..std::mem::take(&mut self.len)];
                let event = read_line(line);
                if event.is_none() {
                    self.ignored += 1;
                }
                event
            }
            0x07 => {
                self.len = 0;
                Some(SlcanEvent::Refused)
            }
            b'\n' => None,
            _ => {
                // A full line without an end is noise in front of a frame: the last bytes are kept.
                if self.len == LONGEST {
                    self.line.copy_within(1.., 0);
                    self.len -= 1;
                }
                self.line[self.len] = byte;
                self.len += 1;
                None
            }
        }
    }

    /// Lines that meant nothing so far: noise, 29-bit identifiers, answers to questions nobody asked.
    pub fn ignored(&self) -> u64 {
        self.ignored
    }
}

fn read_line(line: &[u8]) -> Option<SlcanEvent> {
    if let [] | [b'z' | b'Z'] = line {
        return Some(SlcanEvent::Acknowledged);
    }
    // `t` and `r` are no hexadecimal digits, so that the last one begins the frame and what is before it is noise.
    let start = line.iter().rposition(|b| matches!(b, b't' | b'r'))?;
    read_frame(&line[start..]).map(SlcanEvent::Frame)
}

/// A whole frame, with or without the time stamp that some adapters append.
fn read_frame(text: &[u8]) -> Option<CanFrame> {
    let (kind, rest) = text.split_first()?;
    let (id, rest) = rest.split_at_checked(3)?;
    let id = id.iter().try_fold(0_u16, |id, b| Some(id << 4 | u16::from(digit(*b)?)))?;
    let (len, rest) = rest.split_first()?;
    let len = digit(*len).filter(|n| *n <= 8)?;
    let remote = *kind == b'r';
    let digits = if remote { 0 } else { 2 * usize::from(len) };
    let (hex, stamp) = rest.split_at_checked(digits)?;
    if !(matches!(stamp.len(), 0 | 4) && stamp.iter().all(u8::is_ascii_hexdigit)) {
        return None;
    }
    if remote {
        return CanFrame::remote_frame(id, len).ok();
    }
    let mut data = [0; 8];
    for (to, pair) in data.iter_mut().zip(hex.chunks_exact(2)) {
        *to = digit(pair[0])? << 4 | digit(pair[1])?;
    }
    CanFrame::data_frame(id, &data[..usize::from(len)]).ok()
}

fn digit(byte: u8) -> Option<u8> {
    // A hexadecimal digit is below sixteen.
    char::from(byte).to_digit(16).map(|d| d as u8)
}

/// Writes a frame as a line, `\r` included, and returns how many bytes it has.
pub fn write_slcan(frame: &CanFrame, line: &mut [u8; 32]) -> usize {
    const HEX: &[u8; 16] = b"0123456789ABCDEF";
    let mut at = 0;
    let mut put = |b: u8| {
        line[at] = b;
        at += 1;
    };
    put(if frame.is_remote() { b'r' } else { b't' });
    for shift in [8, 4, 0] {
        put(HEX[usize::from(frame.id() >> shift & 0xf)]);
    }
    put(b'0' + frame.len() as u8);
    for byte in frame.data() {
        put(HEX[usize::from(byte >> 4)]);
        put(HEX[usize::from(byte & 0xf)]);
    }
    put(b'\r');
    at
}
