//! The program's end: a port whose bytes go through the guard.

use std::collections::VecDeque;
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, SystemTime};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::device;
use super::message::{Inbox, MOST_BYTES, Message, Opening};
use super::{GuardOptions, SwitchOff, switch_off};
use crate::dynamixel::serial::latency_file_of;
use crate::dynamixel::{Port, Torque};
use crate::{Clock, Error, Result, SystemClock, TakenOver};

/// How long a guard may take to start and open the port, on a busy machine.
const START: Duration = Duration::from_secs(10);
/// How long a guard may take to do what it is asked for.
const ANSWER: Duration = Duration::from_secs(1);
/// How long a guard may take until it takes a message.
const TAKE: Duration = Duration::from_millis(200);
/// Time between two attempts to open the port of a guard that has died, or to see whether one has ended.
const RETRY: Duration = Duration::from_millis(2);
/// Time that a guard gets to end beyond its patience.
const LAST: Duration = Duration::from_secs(2);

/// A port that a guard owns; a CAN interface is seen as an slcan adapter.
#[derive(Debug)]
pub struct GuardedPort {
    path: PathBuf,
    name: String,
    baud: u32,
    off: SwitchOff,
    options: GuardOptions,
    clock: SystemClock,
    guard: Child,
    link: UnixStream,
    inbox: Inbox,
    scratch: Vec<u8>,
    /// Bytes that came and were not read.
    data: VecDeque<u8>,
    /// What the guard answered.
    answer: Option<io::Result<()>>,
    /// Why the port is gone.
    lost: Option<String>,
    torque: Torque,
    /// When the guard was last heard, and since when it owes a sign of life.
    heard_at: Duration,
    owes: Option<Duration>,
    /// Why the guard takes the torque off, and how that ended.
    takes_over: Option<String>,
    taken_over: Option<TakenOver>,
}

impl GuardedPort {
    /// Starts a guard that opens the serial port `path` at `baud`, or the CAN interface of that name, and switches the hand there off as `off` says.
    ///
    /// # Errors
    /// [`Error::Guard`] if it cannot be started, [`Error::Port`] if it cannot open the port.
    pub fn open(path: impl Into<PathBuf>, baud: u32, off: SwitchOff, options: &GuardOptions) -> Result<Self> {
        options.check()?;
        let path = path.into();
        let name = path.display().to_string();
        let cannot = |what: String| Error::Guard {
            what,
            remedy: "name a program that calls drex_hw::guard::serve, or drive the hand without a guard".into(),
        };
        let command = options.program.display();
        let (link, theirs) = UnixStream::pair().map_err(|e| cannot(e.to_string()))?;
        link.set_write_timeout(Some(TAKE)).map_err(|e| cannot(e.to_string()))?;
        let guard = Command::new(&options.program)
            .args(&options.arguments)
            .stdin(Stdio::from(OwnedFd::from(theirs)))
            .stdout(Stdio::null())
            // What a terminal sends to the program does not concern its guard.
            .process_group(0)
            .spawn()
            .map_err(|e| cannot(format!("{command} cannot be started: {e}")))?;
        let clock = SystemClock::default();
        let mut port = Self {
            path,
            name,
            baud,
            off,
            options: options.clone(),
            clock,
            guard,
            link,
            inbox: Inbox::default(),
            scratch: Vec::new(),
            data: VecDeque::new(),
            answer: None,
            lost: None,
            torque: Torque::Off,
            heard_at: clock.now(),
            owes: None,
            takes_over: None,
            taken_over: None,
        };
        let opening = Message::Open(Opening {
            path: &port.path,
            baud,
            heartbeat: options.heartbeat,
            patience: options.patience,
            off: port.off.clone(),
        });
        let opened = opening.send(&port.link, &mut port.scratch).and_then(|()| port.wait_for_answer(START));
        match opened {
            Ok(()) => Ok(port),
            Err(_) if port.taken_over.is_some() => {
                Err(cannot(format!("{command} ended before it had opened {}", port.name)))
            }
            Err(source) => Err(device::cannot_open(&port.path, &port.off, source)),
        }
    }

    /// Process of the guard.
    pub fn guard_id(&self) -> u32 {
        self.guard.id()
    }

    /// Gives no more than the error once the torque was taken off for the program.
    fn check(&self) -> io::Result<()> {
        match &self.taken_over {
            Some(over) => Err(io::Error::new(io::ErrorKind::ConnectionAborted, over.clone())),
            None => Ok(()),
        }
    }

    fn send(&mut self, message: &Message<'_>) -> io::Result<()> {
        match message.send(&self.link, &mut self.scratch) {
            Ok(()) => Ok(()),
            // What it last said may be why.
            Err(error) => self.listen().and_then(|()| match error.kind() {
                io::ErrorKind::WouldBlock => self.take_over("its guard does not answer"),
                _ => self.take_over("its guard has ended"),
            }),
        }
    }

    /// Asks the guard for something that it answers.
    fn ask(&mut self, message: &Message<'_>) -> io::Result<()> {
        self.check()?;
        self.answer = None;
        self.send(message)?;
        self.wait_for_answer(ANSWER)
    }

    fn wait_for_answer(&mut self, patience: Duration) -> io::Result<()> {
        let end = self.clock.now() + patience;
        loop {
            self.listen()?;
            if let Some(answer) = self.answer.take() {
                return answer;
            }
            let left = end.saturating_sub(self.clock.now());
            if left.is_zero() {
                return self.take_over("its guard does not answer");
            }
            readable(&self.link, left);
        }
    }

    /// Takes in what the guard has said, without waiting.
    fn listen(&mut self) -> io::Result<()> {
        self.check()?;
        while readable(&self.link, Duration::ZERO) {
            let open = self.inbox.fill(&self.link);
            if open.as_ref().is_ok_and(|open| *open) {
                (self.heard_at, self.owes) = (self.clock.now(), None);
            }
            self.understand()?;
            match open {
                Ok(true) => {}
                // Its last word is heard first.
                Ok(false) if self.answer.is_some() => return Ok(()),
                Ok(false) => return self.take_over("its guard has ended"),
                Err(error) => return self.take_over(&format!("its guard cannot be heard: {error}")),
            }
        }
        if self.takes_over.is_some() {
            return self.wait_until_taken_over();
        }
        Ok(())
    }

    fn understand(&mut self) -> io::Result<()> {
        loop {
            match self.inbox.next() {
                Ok(None) => return Ok(()),
                Ok(Some(Message::Data(bytes))) => self.data.extend(bytes),
                Ok(Some(Message::Done)) => self.answer = Some(Ok(())),
                Ok(Some(Message::Failed(kind, text))) => self.answer = Some(Err(io::Error::new(kind, text))),
                Ok(Some(Message::Lost(text))) => self.lost = Some(text.to_owned()),
                Ok(Some(Message::TakesOver(why))) => self.takes_over = Some(why.to_owned()),
                Ok(Some(Message::TookOver(confirmed, since_ms, how))) => {
                    let since = SystemTime::UNIX_EPOCH + Duration::from_millis(since_ms);
                    let why = format!("the guard took over: {}", self.takes_over.take().unwrap_or_default());
                    self.taken_over = Some(TakenOver::new(why, how.to_owned(), confirmed, since));
                    return self.check();
                }
                Ok(Some(_)) => {}
                Err(error) => return self.take_over(&format!("its guard says {error}")),
            }
        }
    }

    /// Waits for the guard to say how it went: until then nothing else can be done about the hand.
    fn wait_until_taken_over(&mut self) -> io::Result<()> {
        let end = self.clock.now() + self.options.patience + LAST;
        while self.taken_over.is_none() && self.clock.now() < end {
            if !readable(&self.link, end.saturating_sub(self.clock.now())) {
                continue;
            }
            if !self.inbox.fill(&self.link).unwrap_or(false) {
                break;
            }
            self.understand()?;
        }
        self.take_over("its guard did not say how the torque went off")
    }

    /// Takes the torque off without the guard, which is ended.
    fn take_over(&mut self, why: &str) -> io::Result<()> {
        self.check()?;
        // It may have ended already; if it hangs, it must not have the port any more.
        let _ = self.guard.kill();
        let _ = self.guard.wait();
        let since = SystemTime::now();
        let (how, confirmed) = match self.torque {
            Torque::Off => ("the torque was off".to_owned(), true),
            Torque::Ready | Torque::On => {
                let end = self.clock.now() + self.options.patience;
                loop {
                    match device::open(&self.path, self.baud, &self.off) {
                        Ok(port) => {
                            let left = end.saturating_sub(self.clock.now());
                            let off = switch_off(port, &self.off, left, &mut |_| {});
                            break (off.text, off.confirmed);
                        }
                        Err(error) if self.clock.now() >= end => break (format!("torque unknown: {error}"), false),
                        Err(_) => std::thread::sleep(RETRY),
                    }
                }
            }
        };
        let why = format!("this program took the hand over: {why}");
        self.taken_over = Some(TakenOver::new(why, how, confirmed, since));
        self.check()
    }

    /// Shows the guard that the program lives, and looks whether the guard does.
    fn beat(&mut self) -> io::Result<()> {
        let now = self.clock.now();
        // It had been silent for a slice before it was asked.
        let hung = self.options.heartbeat.saturating_sub(self.slice());
        if self.owes.is_some_and(|since| now.saturating_sub(since) >= hung) {
            return self.take_over("its guard does not answer");
        }
        self.owes.get_or_insert(now);
        self.send(&Message::Beat)
    }

    /// How long to wait at most before another sign of life.
    fn slice(&self) -> Duration {
        self.options.heartbeat / 4
    }

    fn gone(&self) -> io::Result<()> {
        match &self.lost {
            Some(text) => Err(io::Error::new(io::ErrorKind::NotConnected, text.clone())),
            None => Ok(()),
        }
    }
}

/// Whether something can be read from `link`, or it has ended, within `wait`.
fn readable(link: &UnixStream, wait: Duration) -> bool {
    let wait = Timespec { tv_sec: wait.as_secs() as _, tv_nsec: wait.subsec_nanos() as _ };
    matches!(poll(&mut [PollFd::new(link, PollFlags::IN)], Some(&wait)), Ok(1..))
}

impl Clock for GuardedPort {
    fn now(&self) -> Duration {
        self.clock.now()
    }
}

impl Port for GuardedPort {
    fn name(&self) -> &str {
        &self.name
    }

    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize> {
        let end = self.clock.now() + wait;
        loop {
            self.listen()?;
            if !self.data.is_empty() {
                let n = buffer.len().min(self.data.len());
                buffer.iter_mut().zip(self.data.drain(..n)).for_each(|(to, from)| *to = from);
                return Ok(n);
            }
            self.gone()?;
            let now = self.clock.now();
            if self.torque != Torque::Off && now.saturating_sub(self.heard_at) >= self.slice() {
                self.beat()?;
            }
            let left = end.saturating_sub(now);
            if left.is_zero() {
                return Ok(0);
            }
            readable(&self.link, left.min(self.slice()));
        }
    }

    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.listen()?;
        self.gone()?;
        bytes.chunks(MOST_BYTES).try_for_each(|chunk| self.send(&Message::Write(chunk)))
    }

    fn clear_input(&mut self) -> io::Result<()> {
        self.ask(&Message::Clear)?;
        self.data.clear();
        Ok(())
    }

    fn set_baud(&mut self, baud: u32) -> io::Result<()> {
        self.ask(&Message::Baud(baud))?;
        self.baud = baud;
        Ok(())
    }

    fn baud(&self) -> Option<u32> {
        Some(self.baud)
    }

    fn reopen(&mut self) -> io::Result<()> {
        self.ask(&Message::Reopen)?;
        self.lost = None;
        self.data.clear();
        Ok(())
    }

    fn torque(&mut self, torque: Torque) -> io::Result<()> {
        self.ask(&Message::Torque(torque))?;
        self.torque = torque;
        Ok(())
    }

    fn latency_file(&self) -> Option<PathBuf> {
        latency_file_of(&self.path)
    }
}

impl Drop for GuardedPort {
    fn drop(&mut self) {
        // The guard sees the end of the link. If the torque is not known to be off, it goes on trying for a while, and says so.
        let _ = self.link.shutdown(std::net::Shutdown::Write);
        let end = self.clock.now() + self.options.patience + LAST;
        while matches!(self.guard.try_wait(), Ok(None)) && self.clock.now() < end {
            std::thread::sleep(RETRY);
        }
        // One that has ended is not there to be killed.
        let _ = self.guard.kill();
        let _ = self.guard.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_word_of_a_guard_counts_though_it_has_ended() {
        // "In use" by another, the third of the kinds of errors, and nothing more.
        let guard = GuardOptions::new(
            "sh",
            ["-c", r"dd bs=4096 count=1 2>/dev/null >/dev/null; printf '\006\000N\003used' >&0"],
        );
        for _ in 0..60 {
            let off = SwitchOff::Leap { ids: vec![1] };
            let error = GuardedPort::open("/dev/no-such-port", 1_000_000, off, &guard).unwrap_err();
            let said = matches!(&error, Error::Port { source, .. } if source.kind() == io::ErrorKind::ResourceBusy);
            assert!(said && error.to_string().contains("used"), "{error}");
        }
    }
}
