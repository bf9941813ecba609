//! The guard's end: relays until there is a reason to take the torque off.

use std::io::{self, Write};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant, SystemTime};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::device::{self, Device};
use super::message::{Inbox, MOST_BYTES, Message, Opening};
use super::{SwitchOff, switch_off};
use crate::dynamixel::Torque;
use crate::{Error, Result};

/// How long a program may take to say what the guard is to do.
const OPENING: Duration = Duration::from_secs(10);
/// How long nothing has to happen until the guard looks around.
const IDLE: Duration = Duration::from_secs(1);
/// Bytes that wait for a program that does not read; more are lost, as on a wire.
const WAITING: usize = 1 << 16;

/// Is the guard of the program that started this process: opens the port that the program names, relays, and returns when the program
/// has ended and the torque is off. What it did about the torque is said on stderr.
///
/// # Errors
/// [`Error::Guard`] if no program that wants to be guarded is at the standard input.
pub fn serve() -> Result<()> {
    let failed = |source: io::Error| Error::Guard {
        what: source.to_string(),
        remedy: "a guard is started by the program that drives the hand, not by hand".into(),
    };
    let link = UnixStream::from(io::stdin().as_fd().try_clone_to_owned().map_err(failed)?);
    // Tells a socket from a terminal or a file.
    link.local_addr().map_err(failed)?;
    let signals = signals().map_err(failed)?;
    link.set_read_timeout(Some(OPENING)).map_err(failed)?;
    let mut inbox = Inbox::default();
    let (opened, off, heartbeat, patience) = loop {
        if let Some(message) = inbox.next().map_err(failed)? {
            let Message::Open(Opening { path, baud, heartbeat, patience, off }) = message else {
                return Err(failed(io::Error::other("the program did not say which port to open")));
            };
            break (device::open(path, baud, &off), off, heartbeat, patience);
        }
        if !inbox.fill(&link).map_err(failed)? {
            return Ok(());
        }
    };
    link.set_nonblocking(true).map_err(failed)?;
    let port = match opened {
        Ok(port) => port,
        Err(Error::Port { source, .. }) => {
            // The program says it; if it has ended, nobody wants to know.
            let _ = Message::Failed(source.kind(), &source.to_string()).send(&link, &mut Vec::new());
            return Ok(());
        }
        Err(error) => return Err(error),
    };
    let mut relay = Relay {
        link,
        signals,
        inbox,
        out: Vec::new(),
        port,
        lost: false,
        torque: Torque::Off,
        heard_at: Instant::now(),
        heartbeat,
    };
    Message::Done.put(&mut relay.out);
    if let Some(why) = relay.run() {
        relay.take_over(&why, &off, patience);
    }
    Ok(())
}

/// A stream that becomes readable when a signal comes that would end the guard.
fn signals() -> io::Result<UnixStream> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};
    let (read, write) = UnixStream::pair()?;
    for signal in [SIGINT, SIGTERM, SIGHUP, SIGQUIT] {
        signal_hook::low_level::pipe::register(signal, write.try_clone()?)?;
    }
    Ok(read)
}

struct Relay {
    link: UnixStream,
    signals: UnixStream,
    inbox: Inbox,
    /// Messages on their way to the program.
    out: Vec<u8>,
    port: Box<dyn Device>,
    /// Whether the port failed and was not opened again.
    lost: bool,
    torque: Torque,
    /// When the program was last heard.
    heard_at: Instant,
    heartbeat: Duration,
}

impl Relay {
    /// Relays until the program is done, or there is a reason to take the torque off.
    fn run(&mut self) -> Option<String> {
        loop {
            let [link, signal, port] = self.wait();
            if signal {
                return Some("the guard was told to end by a signal".into());
            }
            if link {
                let open = match self.inbox.fill(&self.link) {
                    Err(e) if e.kind() == io::ErrorKind::WouldBlock => true,
                    other => other.unwrap_or(false),
                };
                if let Err(error) = self.obey() {
                    return Some(format!("the program says {error}"));
                }
                if !open {
                    return (self.torque != Torque::Off).then(|| "the program has ended".into());
                }
                // Not from when it came: what took the guard itself long is not the program's fault.
                self.heard_at = Instant::now();
            } else if self.torque == Torque::On && self.heard_at.elapsed() >= self.heartbeat {
                let ms = self.heartbeat.as_millis();
                return Some(format!("no sign of life of the program for {ms} ms"));
            }
            if port {
                self.relay_back();
            }
            while self.port.waits() {
                self.relay_back();
            }
            self.flush();
        }
    }

    /// Waits until something happens: a message, a signal, bytes from the port.
    fn wait(&self) -> [bool; 3] {
        let wait = match self.torque {
            Torque::On => self.heartbeat.saturating_sub(self.heard_at.elapsed()),
            Torque::Off | Torque::Ready => IDLE,
        };
        let wait = Timespec { tv_sec: wait.as_secs() as _, tv_nsec: wait.subsec_nanos() as _ };
        let write = if self.out.is_empty() { PollFlags::empty() } else { PollFlags::OUT };
        let (link, signals) =
            (PollFd::new(&self.link, PollFlags::IN | write), PollFd::new(&self.signals, PollFlags::IN));
        let came = |fd: &PollFd<'_>| fd.revents().intersects(PollFlags::IN | PollFlags::HUP | PollFlags::ERR);
        match self.port.descriptor().filter(|_| !self.lost) {
            Some(port) => {
                let mut fds = [link, signals, PollFd::from_borrowed_fd(port, PollFlags::IN)];
                // A signal that interrupts it has been written to its stream.
                let _ = poll(&mut fds, Some(&wait));
                [came(&fds[0]), came(&fds[1]), came(&fds[2])]
            }
            None => {
                let mut fds = [link, signals];
                let _ = poll(&mut fds, Some(&wait));
                [came(&fds[0]), came(&fds[1]), false]
            }
        }
    }

    /// Does what the program has asked for.
    fn obey(&mut self) -> io::Result<()> {
        while let Some(message) = self.inbox.next()? {
            let done = match message {
                Message::Write(bytes) => {
                    if let Some(Err(error)) = (!self.lost).then(|| self.port.write_all(bytes)) {
                        self.lost = true;
                        Message::Lost(&error.to_string()).put(&mut self.out);
                    }
                    continue;
                }
                Message::Beat => {
                    Message::Beat.put(&mut self.out);
                    continue;
                }
                Message::Torque(torque) => {
                    self.torque = torque;
                    Ok(())
                }
                Message::Clear => self.port.clear_input(),
                Message::Baud(baud) => self.port.set_baud(baud),
                Message::Reopen => {
                    let opened = self.port.reopen();
                    self.lost = opened.is_err();
                    opened
                }
                _ => return Err(io::Error::new(io::ErrorKind::InvalidData, "what only a guard says")),
            };
            match done {
                Ok(()) => Message::Done.put(&mut self.out),
                Err(error) => Message::Failed(error.kind(), &error.to_string()).put(&mut self.out),
            }
        }
        Ok(())
    }

    /// Hands on what has come from the port.
    fn relay_back(&mut self) {
        let mut bytes = [0; MOST_BYTES];
        match self.port.read(&mut bytes, Duration::ZERO) {
            Ok(n) if self.out.len() < WAITING => Message::Data(&bytes[..n]).put(&mut self.out),
            Ok(_) => {}
            Err(error) => {
                self.lost = true;
                Message::Lost(&error.to_string()).put(&mut self.out);
            }
        }
    }

    /// Sends what the program takes without being waited for. That it has ended is seen elsewhere.
    fn flush(&mut self) {
        while !self.out.is_empty() {
            match (&self.link).write(&self.out) {
                Ok(n) if n > 0 => drop(self.out.drain(..n)),
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => return,
                _ => self.out.clear(),
            }
        }
    }

    /// Takes the torque off, and says so to the program, if it is there, and on stderr.
    fn take_over(mut self, why: &str, off: &SwitchOff, patience: Duration) {
        let name = self.port.name().to_owned();
        // A terminal that is gone takes no words, which must not end the guard.
        let say = |what: &str| drop(writeln!(io::stderr(), "guard of {name}: {why}; {what}"));
        Message::TakesOver(why).put(&mut self.out);
        self.flush();
        let done = switch_off(self.port, off, patience, &mut |news| say(news));
        let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let since_ms = u64::try_from(since.as_millis()).unwrap_or(u64::MAX);
        Message::TookOver(done.confirmed, since_ms, &done.text).put(&mut self.out);
        // A program that was stopped reads it when it goes on.
        let _ = (&self.link).write_all(&self.out);
        say(&done.text);
    }
}
