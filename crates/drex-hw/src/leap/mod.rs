//! The LEAP hand: 16 Dynamixel motors in current-based position mode.

pub mod table;
