//! CAN frames, and the buses they travel on: in memory, slcan over a serial port, SocketCAN.

mod adapter;
mod memory;
mod slcan;
mod slcan_line;
#[cfg(any(test, all(feature = "socketcan", target_os = "linux")))]
mod slcan_port;
#[cfg(all(feature = "socketcan", target_os = "linux"))]
mod socket;

use std::path::Path;
use std::time::Duration;

pub use adapter::SlcanAdapter;
pub use memory::MemoryCan;
#[cfg(unix)]
pub(crate) use slcan::SLCAN_BAUD;
pub use slcan::Slcan;
pub use slcan_line::{SlcanEvent, SlcanParser, write_slcan};
#[cfg(all(feature = "socketcan", target_os = "linux"))]
pub(crate) use slcan_port::SlcanPort;
#[cfg(all(feature = "socketcan", target_os = "linux"))]
pub use socket::SocketCan;

use crate::dynamixel::Torque;
use crate::{Error, Result};

/// A classic CAN frame with an 11-bit identifier.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct CanFrame {
    id: u16,
    remote: bool,
    len: u8,
    data: [u8; 8],
}

impl CanFrame {
    /// A data frame.
    ///
    /// # Errors
    /// [`Error::Value`] for an identifier above 0x7ff or more than eight bytes.
    pub fn data_frame(id: u16, data: &[u8]) -> Result<Self> {
        check(id, data.len())?;
        Ok(Self::masked(id, data))
    }

    /// A frame that asks for `len` bytes.
    ///
    /// # Errors
    /// [`Error::Value`] for an identifier above 0x7ff or more than eight bytes.
    pub fn remote_frame(id: u16, len: u8) -> Result<Self> {
        check(id, usize::from(len))?;
        Ok(Self { id, remote: true, len, data: [0; 8] })
    }

    /// A data frame of what is known to fit: eleven bits, eight bytes.
    pub(crate) fn masked(id: u16, data: &[u8]) -> Self {
        let mut frame = Self { id: id & 0x7ff, remote: false, len: 0, data: [0; 8] };
        for (to, from) in frame.data.iter_mut().zip(data) {
            *to = *from;
            frame.len += 1;
        }
        frame
    }

    /// A remote frame without a length.
    pub(crate) fn masked_remote(id: u16) -> Self {
        Self { id: id & 0x7ff, remote: true, len: 0, data: [0; 8] }
    }

    /// The identifier.
    pub fn id(&self) -> u16 {
        self.id
    }

    /// Whether it asks for data instead of carrying them.
    pub fn is_remote(&self) -> bool {
        self.remote
    }

    /// How many bytes it carries or asks for.
    pub fn len(&self) -> usize {
        usize::from(self.len)
    }

    /// Whether it neither carries nor asks for bytes.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The bytes; none in a remote frame.
    pub fn data(&self) -> &[u8] {
        if self.remote { &[] } else { &self.data[..usize::from(self.len)] }
    }
}

/// Whether a port of this name is no file, and so perhaps a CAN interface of the kernel, such as `can0`.
pub fn is_interface(port: &Path) -> bool {
    port.components().count() == 1 && !port.exists()
}

fn check(id: u16, len: usize) -> Result<()> {
    if id > 0x7ff || len > 8 {
        return Err(Error::value(
            format!("a CAN frame with identifier {id:#x} and {len} bytes"),
            "identifiers have 11 bits, frames 0 to 8 bytes",
        ));
    }
    Ok(())
}

/// Where frames are sent and received.
pub trait CanBus: Send {
    /// Name for messages, such as the path of the port.
    fn name(&self) -> &str;

    /// Sends a frame.
    ///
    /// # Errors
    /// [`Error::Port`] if the bus is gone or does not take it.
    fn send(&mut self, frame: &CanFrame) -> Result<()>;

    /// The next frame, or `None` if none came within `timeout`; zero does not wait.
    ///
    /// # Errors
    /// [`Error::Port`] if the bus is gone.
    fn receive(&mut self, timeout: Duration) -> Result<Option<CanFrame>>;

    /// Frames that the bus refused after [`CanBus::send`] took them, as far as answers have been read; zero where nobody answers.
    fn refused(&self) -> u64 {
        0
    }

    /// Waits up to `wait` until all that was sent is answered, dropping frames; at once where nobody answers.
    ///
    /// # Errors
    /// [`Error::Port`] if the bus is gone.
    fn settle(&mut self, wait: Duration) -> Result<()> {
        let _ = wait;
        Ok(())
    }

    /// Is told how much of the hand is on, see [`Port::torque`](crate::dynamixel::Port::torque).
    ///
    /// # Errors
    /// [`Error::Port`] if the bus is gone.
    fn torque(&mut self, torque: Torque) -> Result<()> {
        let _ = torque;
        Ok(())
    }
}

impl<B: CanBus + ?Sized> CanBus for Box<B> {
    fn name(&self) -> &str {
        (**self).name()
    }

    fn send(&mut self, frame: &CanFrame) -> Result<()> {
        (**self).send(frame)
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<CanFrame>> {
        (**self).receive(timeout)
    }

    fn refused(&self) -> u64 {
        (**self).refused()
    }

    fn settle(&mut self, wait: Duration) -> Result<()> {
        (**self).settle(wait)
    }

    fn torque(&mut self, torque: Torque) -> Result<()> {
        (**self).torque(torque)
    }
}
