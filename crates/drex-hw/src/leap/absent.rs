//! Why nobody answers, as far as it can be found out.

use std::time::Duration;

use crate::dynamixel::{Bus, Port, Timing};
use crate::{Error, Result};

/// Patience with a hand that seems not to be there, at the speed that it should have and at others.
const LATE: Duration = Duration::from_millis(250);
const ELSEWHERE: Duration = Duration::from_millis(60);
/// Longest times that listening for all ids takes there: on a bus that babbles there is always more to read.
const LATE_SCAN: Duration = Duration::from_millis(600);
const ELSEWHERE_SCAN: Duration = Duration::from_millis(250);
/// How long nobody may answer before a look at a hand, or the first step of connecting, takes it for dead: in all, with the search
/// below, less than 5 s.
pub(super) const SILENCE: Duration = Duration::from_millis(1500);
/// Speeds at which motors may be, if not at the expected one.
const SPEEDS: [u32; 7] = [57_600, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 115_200, 9_600];

/// The error of a hand whose motors `ours`, expected at `expected` baud, do not answer.
pub(super) fn nobody<P: Port>(bus: &mut Bus<P>, ours: &[u8], expected: u32) -> Error {
    let expected = bus.port().baud().unwrap_or(expected);
    let patience = bus.timing().first_byte.as_millis();
    let heard = heard_at(bus, expected, LATE, LATE_SCAN);
    let remedy = if heard.iter().any(|id| ours.contains(id)) {
        format!(
            "motors {heard:?} answer later than {patience} ms: end programs that keep the computer busy, or set the latency timer of the adapter to 1 ms"
        )
    } else if !heard.is_empty() {
        format!("motors {heard:?} answer, but the hand has {ours:?}: set their ids")
    } else {
        let others = SPEEDS.into_iter().filter(|s| *s != expected);
        let found = others
            .map(|speed| (speed, heard_at(bus, speed, ELSEWHERE, ELSEWHERE_SCAN)))
            .find(|(_, heard)| !heard.is_empty());
        match found {
            Some((speed, heard)) => format!(
                "at a speed of {speed} baud motors {heard:?} do: connect at this speed, or set the speed of all motors to {expected} baud"
            ),
            None => "switch on its 5 V supply, check the cable, and that no other program changed the ids".into(),
        }
    };
    // Somebody may go on with the port.
    let _ = bus.port().set_baud(expected);
    Error::NoMotors { port: bus.port().name().to_owned(), remedy }
}

/// Who answers twice at `speed`: what comes late from a question before it is not taken for an answer.
fn heard_at<P: Port>(bus: &mut Bus<P>, speed: u32, patience: Duration, limit: Duration) -> Vec<u8> {
    let mut listen = || {
        bus.port().set_baud(speed).map_err(|_| Error::Silent { id: 0 })?;
        bus.set_timing(Timing::default().with_patience(patience));
        bus.pause(patience)?;
        let _ = bus.port().clear_input();
        let first = bus.scan_within(limit)?;
        if first.is_empty() { Ok(first) } else { bus.scan_within(limit) }
    };
    // A port that fails here, or does not know the speed, hears nobody.
    let pongs: Result<_> = listen();
    pongs.map_or_else(|_| Vec::new(), |pongs| pongs.iter().map(|p| p.id).collect())
}
