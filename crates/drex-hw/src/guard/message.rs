//! What a program and its guard tell each other: whole messages with their length in front, so that one that is broken off is never acted on.

use std::ffi::OsStr;
use std::io::{self, Read, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

use super::SwitchOff;
use crate::allegro::AllegroVersion;
use crate::dynamixel::Torque;

/// Number of this set of messages.
const PROTOCOL: u8 = 1;
/// Most bytes of a message after its length.
const LONGEST: usize = 1 << 15;
/// Most bytes that one message carries to or from the port.
pub(super) const MOST_BYTES: usize = 4096;

/// What the guard has to know before it can begin.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Opening<'a> {
    pub path: &'a Path,
    pub baud: u32,
    pub heartbeat: Duration,
    pub patience: Duration,
    pub off: SwitchOff,
}

/// A message, either way.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Message<'a> {
    /// To the guard: open the port; answered by `Done` or `Failed`, as all that ask for something.
    Open(Opening<'a>),
    /// To the guard: bytes for the port.
    Write(&'a [u8]),
    /// To the guard: how much there is to watch; answered.
    Torque(Torque),
    /// To the guard: throw away what has arrived; answered.
    Clear,
    /// To the guard: another speed; answered.
    Baud(u32),
    /// To the guard: open the port again; answered.
    Reopen,
    /// A sign of life, which the guard answers by the same.
    Beat,
    /// To the program: bytes from the port.
    Data(&'a [u8]),
    /// To the program: what it asked for is done.
    Done,
    /// To the program: what it asked for cannot be done.
    Failed(io::ErrorKind, &'a str),
    /// To the program: the port is gone.
    Lost(&'a str),
    /// To the program: the guard takes the torque off; why.
    TakesOver(&'a str),
    /// To the program: the guard is done; whether the hand confirmed it, since when (ms since 1970), and how it went.
    TookOver(bool, u64, &'a str),
}

/// Kinds of errors that mean something to those who open a port, and their numbers.
const KINDS: [(u8, io::ErrorKind); 4] = [
    (1, io::ErrorKind::NotFound),
    (2, io::ErrorKind::PermissionDenied),
    (3, io::ErrorKind::ResourceBusy),
    (4, io::ErrorKind::TimedOut),
];

impl Message<'_> {
    /// Appends the message to `out`, length first.
    pub fn put(&self, out: &mut Vec<u8>) {
        let begin = out.len();
        out.extend([0, 0]);
        match self {
            Self::Open(o) => {
                out.extend([b'O', PROTOCOL]);
                for number in [o.baud, millis(o.heartbeat), millis(o.patience)] {
                    out.extend(number.to_le_bytes());
                }
                match &o.off {
                    SwitchOff::Leap { ids } => {
                        // A bus has at most 253 motors.
                        out.extend([b'L', ids.len() as u8]);
                        out.extend(ids);
                    }
                    SwitchOff::Allegro { version } => {
                        let version = match version {
                            AllegroVersion::V3 => 3,
                            AllegroVersion::V4 => 4,
                            AllegroVersion::V5 => 5,
                        };
                        out.extend([b'A', 1, version]);
                    }
                }
                out.extend(o.path.as_os_str().as_bytes());
            }
            Self::Write(bytes) => put_bytes(out, b'W', bytes),
            Self::Torque(torque) => out.extend([b'T', *torque as u8]),
            Self::Clear => out.push(b'C'),
            Self::Baud(baud) => put_bytes(out, b'S', &baud.to_le_bytes()),
            Self::Reopen => out.push(b'R'),
            Self::Beat => out.push(b'B'),
            Self::Data(bytes) => put_bytes(out, b'D', bytes),
            Self::Done => out.push(b'Y'),
            Self::Failed(kind, text) => {
                let number = KINDS.iter().find(|(_, k)| k == kind).map_or(0, |(n, _)| *n);
                out.extend([b'N', number]);
                out.extend(text.as_bytes());
            }
            Self::Lost(text) => put_bytes(out, b'G', text.as_bytes()),
            Self::TakesOver(text) => put_bytes(out, b'X', text.as_bytes()),
            Self::TookOver(confirmed, since_ms, text) => {
                out.extend([b'Z', u8::from(*confirmed)]);
                out.extend(since_ms.to_le_bytes());
                out.extend(text.as_bytes());
            }
        }
        out.truncate(begin + 2 + LONGEST);
        let length = (out.len() - begin - 2) as u16;
        out[begin..begin + 2].copy_from_slice(&length.to_le_bytes());
    }

    /// Sends the message at once.
    ///
    /// # Errors
    /// If the other end is gone or takes nothing.
    pub fn send(&self, mut link: &UnixStream, scratch: &mut Vec<u8>) -> io::Result<()> {
        scratch.clear();
        self.put(scratch);
        link.write_all(scratch)
    }
}

fn put_bytes(out: &mut Vec<u8>, kind: u8, bytes: &[u8]) {
    out.push(kind);
    out.extend(bytes);
}

fn millis(time: Duration) -> u32 {
    u32::try_from(time.as_millis()).unwrap_or(u32::MAX)
}

/// Messages as they come in.
#[derive(Debug, Default)]
pub(super) struct Inbox {
    bytes: Vec<u8>,
    at: usize,
}

impl Inbox {
    /// Takes what has come over `link`; false at its end.
    ///
    /// # Errors
    /// As the system says; `WouldBlock` if the link does not block and nothing has come.
    pub fn fill(&mut self, mut link: &UnixStream) -> io::Result<bool> {
        self.bytes.drain(..self.at);
        self.at = 0;
        let mut chunk = [0; 8192];
        match link.read(&mut chunk) {
            Ok(0) => Ok(false),
            // The other end was closed with something unread in it.
            Err(e) if e.kind() == io::ErrorKind::ConnectionReset => Ok(false),
            Err(e) if e.kind() == io::ErrorKind::Interrupted => Ok(true),
            Err(e) => Err(e),
            Ok(n) => {
                self.bytes.extend(&chunk[..n]);
                Ok(true)
            }
        }
    }

    /// The next whole message, if there is one.
    ///
    /// # Errors
    /// [`io::ErrorKind::InvalidData`] for what is none: the other end is another program.
    pub fn next(&mut self) -> io::Result<Option<Message<'_>>> {
        let Some((length, rest)) = self.bytes[self.at..].split_first_chunk::<2>() else { return Ok(None) };
        let length = usize::from(u16::from_le_bytes(*length));
        let Some(body) = rest.get(..length) else { return Ok(None) };
        self.at += 2 + length;
        match read(body) {
            Some(message) => Ok(Some(message)),
            None => Err(io::Error::new(io::ErrorKind::InvalidData, "a message that means nothing")),
        }
    }
}

fn read(body: &[u8]) -> Option<Message<'_>> {
    let (kind, rest) = body.split_first()?;
    let text = |bytes| std::str::from_utf8(bytes).ok();
    Some(match kind {
        b'O' => Message::Open(read_opening(rest)?),
        b'W' => Message::Write(rest),
        b'T' => Message::Torque([Torque::Off, Torque::Ready, Torque::On].into_iter().find(|t| rest == [*t as u8])?),
        b'C' => Message::Clear,
        b'S' => Message::Baud(u32::from_le_bytes(rest.try_into().ok()?)),
        b'R' => Message::Reopen,
        b'B' => Message::Beat,
        b'D' => Message::Data(rest),
        b'Y' => Message::Done,
        b'N' => {
            let (number, rest) = rest.split_first()?;
            let kind = KINDS.iter().find(|(n, _)| n == number).map_or(io::ErrorKind::Other, |(_, k)| *k);
            Message::Failed(kind, text(rest)?)
        }
        b'G' => Message::Lost(text(rest)?),
        b'X' => Message::TakesOver(text(rest)?),
        b'Z' => {
            let (confirmed, rest) = rest.split_first()?;
            let (since_ms, rest) = rest.split_first_chunk()?;
            Message::TookOver(*confirmed == 1, u64::from_le_bytes(*since_ms), text(rest)?)
        }
        _ => return None,
    })
}

fn read_opening(bytes: &[u8]) -> Option<Opening<'_>> {
    let (protocol, rest) = bytes.split_first()?;
    let (numbers, rest) = rest.split_at_checked(12)?;
    let number = |k: usize| numbers[4 * k..4 * k + 4].try_into().map(u32::from_le_bytes).ok();
    let (head, rest) = rest.split_first_chunk::<2>()?;
    let (list, path) = rest.split_at_checked(usize::from(head[1]))?;
    let off = match (head[0], list) {
        (b'L', ids) => SwitchOff::Leap { ids: ids.to_vec() },
        (b'A', [3]) => SwitchOff::Allegro { version: AllegroVersion::V3 },
        (b'A', [4]) => SwitchOff::Allegro { version: AllegroVersion::V4 },
        (b'A', [5]) => SwitchOff::Allegro { version: AllegroVersion::V5 },
        _ => return None,
    };
    (*protocol == PROTOCOL).then_some(Opening {
        path: Path::new(OsStr::from_bytes(path)),
        baud: number(0)?,
        heartbeat: Duration::from_millis(number(1)?.into()),
        patience: Duration::from_millis(number(2)?.into()),
        off,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_come_back_whole_or_not_at_all() {
        let opening = |off| {
            Message::Open(Opening {
                path: Path::new("/dev/tty é"),
                baud: 4_000_000,
                heartbeat: Duration::from_millis(40),
                patience: Duration::from_secs(10),
                off,
            })
        };
        let messages = [
            opening(SwitchOff::Leap { ids: (0..16).collect() }),
            opening(SwitchOff::Allegro { version: AllegroVersion::V5 }),
            Message::Write(&[0xff, 0xff, 0xfd, 0]),
            Message::Torque(Torque::Ready),
            Message::Clear,
            Message::Baud(57_600),
            Message::Reopen,
            Message::Beat,
            Message::Data(&[]),
            Message::Done,
            Message::Failed(io::ErrorKind::ResourceBusy, "in use"),
            Message::Failed(io::ErrorKind::Other, ""),
            Message::Lost("gone"),
            Message::TakesOver("hung"),
            Message::TookOver(true, 1_795_000_000_000, "off"),
        ];
        let (a, b) = UnixStream::pair().expect("pair");
        b.set_nonblocking(true).expect("set");
        let (mut inbox, mut all) = (Inbox::default(), Vec::new());
        messages.iter().for_each(|m| m.put(&mut all));
        let mut found = 0;
        for byte in &all {
            (&a).write_all(&[*byte]).expect("written");
            assert!(inbox.fill(&b).expect("read"));
            if let Some(message) = inbox.next().expect("sense") {
                assert_eq!(message, messages[found]);
                found += 1;
            }
        }
        assert_eq!(found, messages.len());
        // Half a message before the end is nothing.
        (&a).write_all(&all[..20]).expect("written");
        drop(a);
        assert!(inbox.fill(&b).expect("read") && inbox.next().expect("sense").is_none());
        assert!(!inbox.fill(&b).expect("the end"));
    }

    #[test]
    fn what_means_nothing_is_refused() {
        for bad in [&b"?"[..], b"", b"T\x07", b"O\x02", b"N", b"G\xff", b"S\x01"] {
            let mut inbox = Inbox { bytes: [&(bad.len() as u16).to_le_bytes()[..], bad].concat(), at: 0 };
            assert!(inbox.next().is_err(), "{bad:?}");
        }
    }
}
