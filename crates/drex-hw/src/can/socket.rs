//! CAN interfaces of the Linux kernel.

use std::io;
use std::time::Duration;

use socketcan::{CanFrame as Raw, CanSocket, EmbeddedFrame, Id, Socket, StandardId};

use super::{CanBus, CanFrame};
use crate::{Error, Result};

/// Longest time that a frame waits for room on the bus.
const WRITE: Duration = Duration::from_millis(20);

/// A CAN interface such as `can0`; bit rate and state are set with `ip link` beforehand.
#[derive(Debug)]
pub struct SocketCan {
    socket: CanSocket,
    name: String,
}

impl SocketCan {
    /// Opens an interface that is up.
    ///
    /// # Errors
    /// [`Error::Port`] if there is no such interface.
    pub fn open(interface: &str) -> Result<Self> {
        let name = interface.to_string();
        match CanSocket::open(interface).and_then(|socket| socket.set_write_timeout(WRITE).map(|()| socket)) {
            Ok(socket) => Ok(Self { socket, name }),
            Err(source) => Err(Error::Port {
                remedy: format!("set it up: ip link set {name} up type can bitrate 1000000"),
                port: name,
                source,
            }),
        }
    }

    /// The open socket, to wait for.
    pub(crate) fn descriptor(&self) -> std::os::fd::BorrowedFd<'_> {
        std::os::fd::AsFd::as_fd(&self.socket)
    }

    fn failed(&self, source: io::Error) -> Error {
        Error::Port { port: self.name.clone(), source, remedy: "check the interface with ip -details link".into() }
    }
}

impl CanBus for SocketCan {
    fn name(&self) -> &str {
        &self.name
    }

    fn send(&mut self, frame: &CanFrame) -> Result<()> {
        let id = StandardId::new(frame.id());
        let raw = id.and_then(|id| match frame.is_remote() {
            true => Raw::new_remote(id, frame.len()),
            false => Raw::new(id, frame.data()),
        });
        let Some(raw) = raw else {
            return Err(self.failed(io::ErrorKind::InvalidInput.into()));
        };
        self.socket.write_frame(&raw).map_err(|e| self.failed(e))
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<CanFrame>> {
        let raw = match self.socket.read_frame_timeout(timeout) {
            Ok(raw) => raw,
            Err(e) if matches!(e.kind(), io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock) => return Ok(None),
            Err(e) => return Err(self.failed(e)),
        };
        // Error frames and 29-bit identifiers are none of ours.
        let Id::Standard(id) = raw.id() else { return Ok(None) };
        match &raw {
            Raw::Data(data) => Ok(Some(CanFrame::masked(id.as_raw(), data.data()))),
            Raw::Remote(remote) => CanFrame::remote_frame(id.as_raw(), remote.dlc() as u8).map(Some),
            Raw::Error(_) => Ok(None),
        }
    }
}
