//! Pseudo-terminals, for programs that open a serial port and shall meet an emulator there.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use crate::{Error, Result};

/// How long a server whose plug was pulled waits before it looks again.
const UNPLUGGED: Duration = Duration::from_millis(5);
/// The server looks at least this often whether it is to stop.
const LOOK: Duration = Duration::from_millis(10);

/// What sits behind a serial port.
pub trait SerialDevice: Send + 'static {
    /// Takes bytes from the program, perhaps none, and appends what the device has to say.
    fn exchange(&mut self, bytes: &[u8], reply: &mut Vec<u8>);

    /// How long it may be left alone if the program is silent.
    fn patience(&self) -> Duration {
        LOOK
    }

    /// Whether its plug is in; while it is not, the port is gone.
    fn plugged(&self) -> bool {
        true
    }
}

/// A server that lets programs open an emulated device as a serial port. It stops when it is dropped.
#[derive(Debug)]
pub struct PtyServer {
    path: PathBuf,
    stop: Arc<AtomicBool>,
    server: Option<JoinHandle<()>>,
}

impl PtyServer {
    /// Serves `device`, which should be in real time, at a new pseudo-terminal, and at `link` if one is given. A link is needed when
    /// the plug is to be pulled and put back: the terminal has another name afterwards.
    ///
    /// # Errors
    /// [`Error::Port`] if the system gives no terminal, or something that is no link stands in the place of `link`.
    pub fn serve(device: impl SerialDevice, link: Option<&Path>) -> Result<Self> {
        let failed = |source| Error::Port {
            port: link.unwrap_or(Path::new("/dev/ptmx")).display().to_string(),
            source,
            remedy: "check that pseudo-terminals are allowed and the link can be written".into(),
        };
        let link = link.map(Path::to_owned);
        let terminal = Terminal::open(link.as_deref()).map_err(failed)?;
        let path = link.clone().unwrap_or_else(|| terminal.path.clone());
        let stop = Arc::new(AtomicBool::new(false));
        let told = stop.clone();
        let server = std::thread::spawn(move || serve(device, terminal, link.as_deref(), &told));
        Ok(Self { path, stop, server: Some(server) })
    }

    /// What programs open: the link, or the terminal itself.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for PtyServer {
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
        // A program that this one starts would keep the terminal alive when the plug is pulled.
        rustix::io::fcntl_setfd(&master, rustix::io::FdFlags::CLOEXEC)?;
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

fn serve(mut device: impl SerialDevice, terminal: Terminal, link: Option<&Path>, stop: &AtomicBool) {
    let mut terminal = Some(terminal);
    let (mut bytes, mut reply) = ([0; 1024], Vec::new());
    while !stop.load(Ordering::Relaxed) {
        if !device.plugged() {
            // Closing our end hangs up on the program at the other.
            terminal = None;
            std::thread::sleep(UNPLUGGED);
            continue;
        }
        let Some(open) = &mut terminal else {
            terminal = Terminal::open(link).ok();
            if terminal.is_none() {
                std::thread::sleep(UNPLUGGED);
            }
            continue;
        };
        let wait = device.patience().min(LOOK);
        let wait = Timespec { tv_sec: 0, tv_nsec: i64::from(wait.subsec_nanos()) as _ };
        let mut fds = [PollFd::new(&open.master, PollFlags::IN)];
        let n = match poll(&mut fds, Some(&wait)) {
            Ok(1..) => open.master.read(&mut bytes).unwrap_or(0),
            _ => 0,
        };
        device.exchange(&bytes[..n], &mut reply);
        // What a program does not read is lost, as on a wire.
        let _ = open.master.write(&reply);
        reply.clear();
    }
}
