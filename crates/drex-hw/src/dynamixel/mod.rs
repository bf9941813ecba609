//! Dynamixel protocol 2.0: a codec without allocation, ports, and a bus on which a silent motor costs only itself.

mod answers;
mod bus;
mod crc;
mod fast;
#[cfg(unix)]
pub(crate) mod lock;
mod packet;
mod parser;
mod port;
pub(crate) mod serial;
mod sync;

pub use answers::Answers;
pub use bus::{Bus, BusStats, Pong, Timing};
pub use crc::crc16;
pub use fast::{FastBlock, fast_blocks, fast_reply_len};
pub use packet::{BROADCAST, HEADER, PacketWriter, encode, instruction};
pub use parser::{Packet, Parser};
pub use port::{MemoryPort, Port, Torque, memory_pair};
pub use serial::SerialPort;

#[cfg(test)]
mod tests;
