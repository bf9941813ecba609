//! What a guard can own: serial ports, and CAN interfaces as slcan adapters.

use std::io;
use std::os::fd::BorrowedFd;
use std::path::Path;

use super::SwitchOff;
use crate::can::is_interface;
#[cfg(all(feature = "socketcan", target_os = "linux"))]
use crate::can::{SlcanPort, SocketCan};
use crate::dynamixel::{Port, SerialPort, serial};
use crate::{Error, Result};

/// A port that a guard can wait for.
pub(super) trait Device: Port {
    /// What becomes readable when something comes; `None` while the port is gone.
    fn descriptor(&self) -> Option<BorrowedFd<'_>>;

    /// Whether something waits to be read that the descriptor does not show.
    fn waits(&self) -> bool {
        false
    }
}

impl Device for SerialPort {
    fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        self.descriptor()
    }
}

#[cfg(all(feature = "socketcan", target_os = "linux"))]
impl Device for SlcanPort<SocketCan> {
    fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        Some(self.bus().descriptor())
    }

    fn waits(&self) -> bool {
        self.waits()
    }
}

/// Whether `path` is a CAN interface at which a hand is that is switched off so.
fn is_can(path: &Path, off: &SwitchOff) -> bool {
    matches!(off, SwitchOff::Allegro { .. }) && is_interface(path)
}

/// Opens the serial port `path` at `baud`, or the CAN interface of that name with a hand that can be at one.
///
/// # Errors
/// [`Error::Port`] if it cannot be opened, or CAN interfaces are not built in.
pub(super) fn open(path: &Path, baud: u32, off: &SwitchOff) -> Result<Box<dyn Device>> {
    if !is_can(path, off) {
        return Ok(Box::new(SerialPort::open(path, baud)?));
    }
    #[cfg(all(feature = "socketcan", target_os = "linux"))]
    return Ok(Box::new(SlcanPort::open(&path.to_string_lossy(), SocketCan::open)?));
    #[cfg(not(all(feature = "socketcan", target_os = "linux")))]
    Err(cannot_open(path, off, io::ErrorKind::NotFound.into()))
}

/// The error of a port that cannot be opened, and what to do about it.
pub(super) fn cannot_open(path: &Path, off: &SwitchOff, source: io::Error) -> Error {
    let port = path.display().to_string();
    if !is_can(path, off) {
        return serial::cannot_open(&port, source);
    }
    let remedy = if cfg!(all(feature = "socketcan", target_os = "linux")) {
        format!("set it up: ip link set {port} up type can bitrate 1000000")
    } else {
        "name a serial port, or build with the feature socketcan for a CAN interface of that name".into()
    };
    Error::Port { port, source, remedy }
}
