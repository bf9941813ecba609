//! An emulated hand behind a pseudo-terminal, for programs that open a serial port.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use super::LeapEmulator;
use crate::{Error, Result};

/// How often the server looks whether it is to stop or the plug was pulled.
const LOOK: Timespec = Timespec { tv_sec: 0, tv_nsec: 10_000_000 };

/// A server that lets programs open an emulated hand as a serial port. It stops when it is dropped.
#[derive(Debug)]
pub struct LeapPty {
    path: PathBuf,
    stop: Arc<AtomicBool>,
    server: Option<JoinHandle<()>>,
}

impl LeapPty {
    /// Serves `hand`, which should be in real time, at a new pseudo-terminal, and at `link` if one is given. A link is needed
    /// when the plug is to be pulled and put back: the terminal has another name afterwards.
    ///
    /// # Errors
    /// If the system gives no terminal, or something that is no link stands in the place of `link`.
    pub fn serve(hand: &LeapEmulator, link: Option<&Path>) -> Result<Self> {
        Self::start(hand, link, None)
    }

    /// As [`LeapPty::serve`], as slow as a bus of `baud`; otherwise answers come at once.
    ///
    /// # Errors
    /// As [`LeapPty::serve`].
    pub fn serve_paced(hand: &LeapEmulator, link: Option<&Path>, baud: u32) -> Result<Self> {
        Self::start(hand, link, Some(baud.max(1)))
    }

    fn start(hand: &LeapEmulator, link: Option<&Path>, baud: Option<u32>) -> Result<Self> {
        let failed = |source| Error::Port {
            port: link.unwrap_or(Path::new("/dev/ptmx")).display().to_string(),
            source,
            remedy: "check that pseudo-terminals are allowed and the link can be written".into(),
        };
        let link = link.map(Path::to_owned);
        let terminal = Terminal::open(link.as_deref()).map_err(failed)?;
        let path = link.clone().unwrap_or_else(|| terminal.path.clone());
        let stop = Arc::new(AtomicBool::new(false));
        let (hand, told) = (hand.clone(), stop.clone());
        let server = std::thread::spawn(move || serve(&hand, terminal, link.as_deref(), baud, &told));
        Ok(Self { path, stop, server: Some(server) })
    }

    /// What programs open: the link, or the terminal itself.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for LeapPty {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(server) = self.server.take() {
            // A server that panicked has told so on stderr.
            let _ = server.join();
        }
    }
}

/// A pseudo-terminal. The end of the programs is kept open, so that it outlives them.
struct Terminal {
    path: PathBuf,
    link: Option<PathBuf>,
    master: File,
    _slave: File,
}

impl Terminal {
    fn open(link: Option<&Path>) -> io::Result<Self> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let name = ptsname(&master, Vec::new())?;
        let path = PathBuf::from(name.to_string_lossy().into_owned());
        let slave = rustix::fs::open(&path, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())?;
        let mut settings = tcgetattr(&slave)?;
        settings.make_raw();
        tcsetattr(&slave, OptionalActions::Now, &settings)?;
        rustix::fs::fcntl_setfl(&master, OFlags::NONBLOCK)?;
        if let Some(link) = link {
            if std::fs::symlink_metadata(link).is_ok_and(|m| m.is_symlink()) {
                std::fs::remove_file(link)?;
            }
            std::os::unix::fs::symlink(&path, link)?;
        }
        let link = link.map(Path::to_owned);
        Ok(Self { path, link, master: File::from(master), _slave: File::from(slave) })
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        if let Some(link) = self.link.as_deref().filter(|l| std::fs::read_link(l).is_ok_and(|to| to == self.path)) {
            // Nothing depends on it: a link that leads nowhere says so itself.
            let _ = std::fs::remove_file(link);
        }
    }
}

fn serve(hand: &LeapEmulator, terminal: Terminal, link: Option<&Path>, baud: Option<u32>, stop: &AtomicBool) {
    let mut terminal = Some(terminal);
    let (mut bytes, mut reply) = ([0; 1024], Vec::new());
    while !stop.load(Ordering::Relaxed) {
        if !hand.plugged() {
            // Closing our end hangs up on the program at the other.
            terminal = None;
            std::thread::sleep(Duration::from_millis(5));
            continue;
        }
        let Some(open) = &mut terminal else {
            terminal = Terminal::open(link).ok();
            continue;
        };
        let mut fds = [PollFd::new(&open.master, PollFlags::IN)];
        if !matches!(poll(&mut fds, Some(&LOOK)), Ok(1..)) {
            hand.exchange(&[], &mut reply);
            continue;
        }
        let Ok(n) = open.master.read(&mut bytes) else { continue };
        let came = Instant::now();
        let hesitated = hand.exchange(&bytes[..n], &mut reply);
        if let Some(baud) = baud {
            // Ten bits a byte, there and back.
            let wire = Duration::from_secs_f64(10.0 * (n + reply.len()) as f64 / f64::from(baud));
            std::thread::sleep((wire + hesitated).saturating_sub(came.elapsed()));
        }
        // What a program does not read is lost, as on a wire.
        let _ = open.master.write(&reply);
        reply.clear();
    }
}
