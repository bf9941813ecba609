//! Torque off on a hand in any state, without a driver.

use std::time::Duration;

use super::{AllegroCommand, AllegroOptions, AllegroReport};
use crate::can::CanBus;
use crate::{Clock, Error, Result};

/// How long the hand is listened to before and after it is told.
const LISTEN: Duration = Duration::from_millis(60);
/// Reports that are under way when the hand is switched off may come this long afterwards.
const UNDER_WAY: Duration = Duration::from_millis(20);
/// Most frames that one time of listening reads, so that a babbling bus cannot hold it up.
const MOST_FRAMES: usize = 2048;

/// What is known of a hand that was told to switch off. It says nothing of single motors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum AllegroOff {
    /// The hand answers, and reports no poses any more: its motors are off.
    Off,
    /// The hand goes on reporting poses: its motors are on.
    On,
    /// The hand said nothing before or after: nobody knows.
    Unknown,
}

/// A passing look at a bus: whether a hand that nobody of this program has switched on reports poses. Sends nothing.
///
/// # Errors
/// [`Error::Port`] if the bus fails.
pub fn reports_poses(bus: &mut dyn CanBus, options: &AllegroOptions, clock: &dyn Clock) -> Result<bool> {
    Ok(listen(bus, options, clock, LISTEN)?.poses > 0)
}

/// Sends zero torques and motors off to the hand on `bus`, in whatever state it is, and listens whether it obeys.
///
/// # Errors
/// [`Error::Port`] if the bus fails or refuses frames.
pub fn switch_off(bus: &mut dyn CanBus, options: &AllegroOptions, clock: &dyn Clock) -> Result<AllegroOff> {
    let before = listen(bus, options, clock, LISTEN)?;
    let refused = bus.refused();
    for finger in 0..4 {
        send(bus, options, AllegroCommand::Torque { finger, wire: [0; 4] })?;
    }
    send(bus, options, AllegroCommand::Off)?;
    listen(bus, options, clock, UNDER_WAY)?;
    send(bus, options, AllegroCommand::AskInfo)?;
    let after = listen(bus, options, clock, LISTEN)?;
    send(bus, options, AllegroCommand::Period { pose_ms: 0, imu_ms: 0, temperature_ms: 0 })?;
    bus.settle(UNDER_WAY)?;
    if bus.refused() > refused {
        return Err(Error::Port {
            port: bus.name().into(),
            source: std::io::Error::other(format!("the adapter refused {} frames", bus.refused() - refused)),
            remedy: "the hand may still be on: switch its power off".into(),
        });
    }
    Ok(match (before.all + after.all, after.poses) {
        (0, _) => AllegroOff::Unknown,
        (_, 0) => AllegroOff::Off,
        _ => AllegroOff::On,
    })
}

fn send(bus: &mut dyn CanBus, options: &AllegroOptions, command: AllegroCommand) -> Result<()> {
    command.encode(options.version).map_or(Ok(()), |frame| bus.send(&frame))
}

/// Reports of the hand in a span of time.
#[derive(Default)]
struct Overheard {
    all: u32,
    poses: u32,
}

fn listen(bus: &mut dyn CanBus, options: &AllegroOptions, clock: &dyn Clock, time: Duration) -> Result<Overheard> {
    let (end, mut overheard) = (clock.now() + time, Overheard::default());
    for _ in 0..MOST_FRAMES {
        let left = end.saturating_sub(clock.now());
        if left.is_zero() {
            break;
        }
        let Some(report) = bus.receive(left)?.and_then(|f| AllegroReport::decode(options.version, &f)) else {
            continue;
        };
        overheard.all += 1;
        overheard.poses += u32::from(matches!(report, AllegroReport::Pose { .. }));
    }
    Ok(overheard)
}
