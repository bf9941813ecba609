//! The registers of a motor: where each begins, how many bytes it has, and whether it may be written.

/// Error numbers of status packets.
pub(super) mod refusal {
    pub const FAILED: u8 = 1;
    pub const INSTRUCTION: u8 = 2;
    pub const RANGE: u8 = 4;
    pub const LENGTH: u8 = 5;
    pub const LIMIT: u8 = 6;
    pub const ACCESS: u8 = 7;
}

/// One entry of the control table.
struct Entry {
    start: u16,
    len: u16,
    writable: bool,
}

const fn rw(start: u16, len: u16) -> Entry {
    Entry { start, len, writable: true }
}

const fn ro(start: u16, len: u16) -> Entry {
    Entry { start, len, writable: false }
}

/// The table up to the indirect addresses, as the maker's manual of the XC330-M288 and XL330-M288 has it.
const TABLE: [Entry; 55] = [
    ro(0, 2),   // model number
    ro(2, 4),   // model information
    ro(6, 1),   // firmware
    rw(7, 1),   // id
    rw(8, 1),   // baud rate
    rw(9, 1),   // return delay
    rw(10, 1),  // drive mode
    rw(11, 1),  // operating mode
    rw(12, 1),  // secondary id
    rw(13, 1),  // protocol type
    rw(20, 4),  // homing offset
    rw(24, 4),  // moving threshold
    rw(31, 1),  // temperature limit
    rw(32, 2),  // largest voltage
    rw(34, 2),  // smallest voltage
    rw(36, 2),  // PWM limit
    rw(38, 2),  // current limit
    rw(44, 4),  // velocity limit
    rw(48, 4),  // largest position
    rw(52, 4),  // smallest position
    rw(60, 1),  // startup configuration
    rw(62, 1),  // PWM slope
    rw(63, 1),  // shutdown
    rw(64, 1),  // torque enable
    rw(65, 1),  // LED
    rw(68, 1),  // status return level
    ro(69, 1),  // registered instruction
    ro(70, 1),  // hardware error
    rw(76, 2),  // velocity I
    rw(78, 2),  // velocity P
    rw(80, 2),  // position D
    rw(82, 2),  // position I
    rw(84, 2),  // position P
    rw(88, 2),  // feed-forward of the acceleration
    rw(90, 2),  // feed-forward of the velocity
    rw(98, 1),  // bus watchdog
    rw(100, 2), // goal PWM
    rw(102, 2), // goal current
    rw(104, 4), // goal velocity
    rw(108, 4), // profile acceleration
    rw(112, 4), // profile velocity
    rw(116, 4), // goal position
    ro(120, 2), // realtime tick
    ro(122, 1), // moving
    ro(123, 1), // moving status
    ro(124, 2), // present PWM
    ro(126, 2), // present current
    ro(128, 4), // present velocity
    ro(132, 4), // present position
    ro(136, 4), // velocity trajectory
    ro(140, 4), // position trajectory
    ro(144, 2), // input voltage
    ro(146, 1), // temperature
    ro(147, 1), // backup ready
    // Twenty addresses of two bytes each; the data bytes that follow stand alone.
    rw(168, 40),
];
/// The indirect addresses, each two bytes long, and the indirect data, single bytes.
const INDIRECT_ADDRESSES: std::ops::Range<u16> = 168..208;
const INDIRECT_DATA: std::ops::Range<u16> = 208..228;
/// First address behind the table.
pub(super) const END: usize = INDIRECT_DATA.end as usize;

/// Begin, length and whether it may be written, of the register that holds `address`.
fn register_at(address: u16) -> Option<(u16, u16, bool)> {
    if INDIRECT_ADDRESSES.contains(&address) {
        return Some((address & !1, 2, true));
    }
    if INDIRECT_DATA.contains(&address) {
        return Some((address, 1, true));
    }
    let entry = TABLE.iter().find(|e| (e.start..e.start + e.len).contains(&address))?;
    Some((entry.start, entry.len, entry.writable))
}

/// Whether there is something to read at `address`.
pub(super) fn is_defined(address: usize) -> bool {
    u16::try_from(address).is_ok_and(|a| register_at(a).is_some())
}

/// Whether `address` may be written.
pub(super) fn is_writable(address: usize) -> bool {
    u16::try_from(address).ok().and_then(register_at).is_some_and(|(_, _, writable)| writable)
}

/// Refuses a write of `len` bytes at `start` that does not consist of whole registers that may be written.
pub(super) fn check_write(start: usize, len: usize) -> Result<(), u8> {
    if len == 0 || start + len > END {
        return Err(refusal::LENGTH);
    }
    let mut at = start;
    while at < start + len {
        // Below `END`, so that it fits.
        let Some((begin, width, writable)) = register_at(at as u16) else { return Err(refusal::ACCESS) };
        if !writable {
            return Err(refusal::ACCESS);
        }
        let end = usize::from(begin + width);
        if usize::from(begin) != at || end > start + len {
            return Err(refusal::LENGTH);
        }
        at = end;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_follow_one_another_without_overlap() {
        assert!(TABLE.windows(2).all(|w| w[0].start + w[0].len <= w[1].start));
        // The gaps of the manual's table.
        let gaps = [14..20, 28..31, 40..44, 56..60, 61..62, 66..68, 71..76, 86..88, 92..98, 99..100, 148..168];
        let undefined: Vec<usize> = (0..END).filter(|a| !is_defined(*a)).collect();
        assert_eq!(undefined, gaps.into_iter().flatten().collect::<Vec<_>>());
    }
}
