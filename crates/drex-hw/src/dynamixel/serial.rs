//! A serial port of the system.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::Port;
use crate::{Clock, Error, Result, SystemClock};

/// Longest time that a write may take before the port counts as stuck.
const WRITE_TIMEOUT: Duration = Duration::from_millis(200);

/// A serial device that only this process uses.
#[derive(Debug)]
pub struct SerialPort {
    /// As the caller gave it: a link stays a link, so that a device that comes back under another number is found.
    path: PathBuf,
    name: String,
    baud: u32,
    clock: SystemClock,
    device: Option<Device>,
}

/// The open device, and the lock that goes with it.
#[derive(Debug)]
struct Device {
    port: serial2::SerialPort,
    #[cfg(unix)]
    _lock: std::fs::File,
}

impl Device {
    fn open(path: &Path, baud: u32) -> io::Result<Self> {
        #[cfg(unix)]
        let lock = super::lock::lock_device(path)?;
        let mut port = serial2::SerialPort::open(path, baud)?;
        port.set_write_timeout(WRITE_TIMEOUT)?;
        port.discard_buffers()?;
        Ok(Self {
            port,
            #[cfg(unix)]
            _lock: lock,
        })
    }
}

impl SerialPort {
    /// Opens `path` at `baud`, 8 data bits, no parity, 1 stop bit.
    ///
    /// # Errors
    /// If the device is not there, may not be opened, does not know the speed, or is in use; then by whom.
    pub fn open(path: impl Into<PathBuf>, baud: u32) -> Result<Self> {
        let path = path.into();
        let name = path.display().to_string();
        let device = Device::open(&path, baud).map_err(|source| cannot_open(&name, source))?;
        Ok(Self { path, name, baud, clock: SystemClock::default(), device: Some(device) })
    }

    fn device(&mut self) -> io::Result<&mut Device> {
        self.device.as_mut().ok_or_else(|| io::ErrorKind::NotConnected.into())
    }

    /// The open device, to wait for.
    #[cfg(unix)]
    pub(crate) fn descriptor(&self) -> Option<std::os::fd::BorrowedFd<'_>> {
        self.device.as_ref().map(|d| std::os::fd::AsFd::as_fd(&d.port))
    }
}

/// The error of a serial port that cannot be opened, and what to do about it.
pub(crate) fn cannot_open(name: &str, source: io::Error) -> Error {
    let remedy = match source.kind() {
        io::ErrorKind::NotFound => "plug the hand in and look under /dev/serial/by-id",
        io::ErrorKind::PermissionDenied => "add yourself to the group of the device, mostly dialout",
        io::ErrorKind::ResourceBusy => "end the other program",
        _ => "check that it is a serial port and knows this speed",
    };
    Error::Port { port: name.into(), source, remedy: remedy.into() }
}

impl Clock for SerialPort {
    fn now(&self) -> Duration {
        self.clock.now()
    }
}

impl Port for SerialPort {
    fn name(&self) -> &str {
        &self.name
    }

    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize> {
        let clock = self.clock;
        let port = &mut self.device()?.port;
        let read = uninterrupted(&clock, wait, |wait| {
            // The system counts in milliseconds; rounded up, so that a short wait is not none.
            let ms = u64::try_from(wait.as_micros().div_ceil(1000)).unwrap_or(u64::MAX).min(60_000);
            port.set_read_timeout(Duration::from_millis(ms))?;
            port.read(buffer)
        });
        match read {
            // A device that is readable and has nothing was hung up.
            Ok(0) if !buffer.is_empty() => Err(io::ErrorKind::BrokenPipe.into()),
            Err(e) if matches!(e.kind(), io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock) => Ok(0),
            other => other,
        }
    }

    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.device()?.port.write_all(bytes)
    }

    fn clear_input(&mut self) -> io::Result<()> {
        self.device()?.port.discard_input_buffer()
    }

    fn set_baud(&mut self, baud: u32) -> io::Result<()> {
        let port = &mut self.device()?.port;
        let mut settings = port.get_configuration()?;
        settings.set_baud_rate(baud)?;
        port.set_configuration(&settings)?;
        self.baud = baud;
        Ok(())
    }

    fn baud(&self) -> Option<u32> {
        Some(self.baud)
    }

    fn reopen(&mut self) -> io::Result<()> {
        // The lock of the old device goes first: it may be the same one.
        self.device = None;
        self.device = Some(Device::open(&self.path, self.baud)?);
        Ok(())
    }

    fn latency_file(&self) -> Option<PathBuf> {
        latency_file_of(&self.path)
    }
}

/// Does `read`, which is given how long to wait, again for the rest of `wait` when a signal interrupts it.
fn uninterrupted(
    clock: &impl Clock,
    wait: Duration,
    mut read: impl FnMut(Duration) -> io::Result<usize>,
) -> io::Result<usize> {
    let end = clock.now() + wait;
    let mut left = wait;
    loop {
        match read(left) {
            Err(e) if e.kind() == io::ErrorKind::Interrupted => left = end.saturating_sub(clock.now()),
            other => return other,
        }
    }
}

/// The latency timer of the device behind `path`, if the system keeps one.
pub(crate) fn latency_file_of(path: &Path) -> Option<PathBuf> {
    latency_file(Path::new("/sys/bus/usb-serial/devices"), path)
}

/// The latency timer of the device behind `path`, a link or not, among `devices` of the system.
fn latency_file(devices: &Path, path: &Path) -> Option<PathBuf> {
    let device = std::fs::canonicalize(path).ok()?;
    let file = devices.join(device.file_name()?).join("latency_timer");
    file.exists().then_some(file)
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn a_signal_is_no_broken_port() {
        let (clock, wait) = (SystemClock::default(), Duration::from_secs(5));
        let mut waits = Vec::new();
        let read = uninterrupted(&clock, wait, |left| {
            waits.push(left);
            std::thread::sleep(Duration::from_millis(1));
            if waits.len() < 3 { Err(io::ErrorKind::Interrupted.into()) } else { Ok(7) }
        });
        assert_eq!(read.expect("goes on"), 7);
        assert!(waits[0] == wait && waits.is_sorted_by(|a, b| a > b), "the wait does not begin anew: {waits:?}");
        let gone = uninterrupted(&clock, wait, |_| Err(io::ErrorKind::BrokenPipe.into()));
        assert_eq!(gone.expect_err("other errors stay").kind(), io::ErrorKind::BrokenPipe);
    }

    #[test]
    fn the_latency_timer_is_found_through_a_link() {
        let root = tempfile::tempdir().expect("folder");
        let at = |name: &str| root.path().join(name);
        std::fs::create_dir_all(at("devices/ttyUSB3")).expect("folder");
        std::fs::write(at("devices/ttyUSB3/latency_timer"), "16\n").expect("file");
        std::fs::write(at("ttyUSB3"), "").expect("file");
        std::os::unix::fs::symlink(at("ttyUSB3"), at("leap")).expect("link");
        let found = latency_file(&at("devices"), &at("leap"));
        assert_eq!(found, Some(at("devices/ttyUSB3/latency_timer")));
        std::fs::write(at("ttyACM0"), "").expect("file");
        assert_eq!(latency_file(&at("devices"), &at("ttyACM0")), None);
    }
}
