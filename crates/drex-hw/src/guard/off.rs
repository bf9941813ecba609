//! Taking the torque off a hand through its port, whatever state it is in, until the hand confirms it.

use std::time::Duration;

use crate::allegro::{AllegroCommand, AllegroReport, AllegroVersion};
use crate::can::{CanBus, Slcan};
use crate::dynamixel::{Bus, Port, Timing};
use crate::leap::{LeapOptions, off_round};
use crate::{Error, Result};

/// How a hand is switched off.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum SwitchOff {
    /// Torque off in motors with these ids.
    Leap {
        /// Ids of the motors.
        ids: Vec<u8>,
    },
    /// Zero torque, off and silence over an slcan adapter whose channel is open.
    Allegro {
        /// Generation of the hand.
        version: AllegroVersion,
    },
}

impl SwitchOff {
    /// The motors of a LEAP hand.
    pub fn leap(options: &LeapOptions) -> Self {
        Self::Leap { ids: options.joints.iter().map(|j| j.id).collect() }
    }
}

/// How it went.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct SwitchedOff {
    /// Whether the hand confirmed that its torque is off.
    pub confirmed: bool,
    /// How it went, in words: "torque off, …" or "torque unknown: …".
    pub text: String,
}

/// Time between two attempts.
const RETRY: Duration = Duration::from_millis(5);
/// Patience with a motor when it is first asked, and at most: an order must go out at least every 60 ms.
const FIRST: Duration = Duration::from_millis(10);
const MOST: Duration = Duration::from_millis(40);
/// A hand that is not off after this time is told of.
const NEWS: Duration = Duration::from_millis(500);
/// An Allegro hand that was silent for so long no longer sends poses, which come every few milliseconds.
const QUIET: Duration = Duration::from_millis(25);
/// How long poses may go on after it was told to be silent.
const BABBLE: Duration = Duration::from_millis(60);

/// Takes the torque off the hand behind `port`, and tries again until the hand confirms it or `patience` is over; a port that is gone is
/// opened again when it is back. `news` is told once if it takes long, and why.
pub fn switch_off<P: Port>(port: P, off: &SwitchOff, patience: Duration, news: &mut dyn FnMut(&str)) -> SwitchedOff {
    match off {
        SwitchOff::Leap { ids } => leap(port, ids, patience, news),
        SwitchOff::Allegro { version } => allegro(port, *version, patience, news),
    }
}

/// What is not off yet, and since when it is tried.
struct Attempt<'a> {
    begun: Duration,
    patience: Duration,
    news: Option<&'a mut dyn FnMut(&str)>,
    was_gone: bool,
}

impl<'a> Attempt<'a> {
    fn new(now: Duration, patience: Duration, news: &'a mut dyn FnMut(&str)) -> Self {
        Self { begun: now, patience, news: Some(news), was_gone: false }
    }

    /// Whether to try again, after what was found at `now`.
    fn goes_on(&mut self, now: Duration, found: impl FnOnce() -> String) -> bool {
        let took = now.saturating_sub(self.begun);
        let left = self.patience.saturating_sub(took);
        if let Some(news) = self.news.take_if(|_| took >= NEWS && !left.is_zero()) {
            news(&format!("torque unknown: {}; trying for {:.0} s more", found(), left.as_secs_f64()));
        }
        !left.is_zero()
    }

    fn done(&self, now: Duration, how: &str) -> SwitchedOff {
        let seconds = now.saturating_sub(self.begun).as_secs_f64();
        let back = if self.was_gone { "after the port came back, " } else { "" };
        SwitchedOff { confirmed: true, text: format!("torque off, {back}{how} within {seconds:.3} s") }
    }

    fn failed(&self, found: &str) -> SwitchedOff {
        let seconds = self.patience.as_secs_f64();
        let text = format!("torque unknown: {found} for {seconds:.1} s; switch the hand's power off");
        SwitchedOff { confirmed: false, text }
    }
}

fn leap<P: Port>(port: P, ids: &[u8], patience: Duration, news: &mut dyn FnMut(&str)) -> SwitchedOff {
    let latency = port.latency().unwrap_or_default();
    let mut bus = Bus::new(port, Timing::default());
    let mut attempt = Attempt::new(bus.port().now(), patience, news);
    let (mut left, mut lost, mut wait) = (ids.to_vec(), None, FIRST);
    loop {
        bus.set_timing(Timing::for_latency(latency).with_patience((wait + latency).min(MOST)));
        if lost.is_some() {
            lost = bus.port().reopen().err();
        }
        if lost.is_none() {
            match off_round(&mut bus, &mut left) {
                Err(Error::Port { source, .. }) => {
                    (lost, attempt.was_gone) = (Some(source), true);
                }
                // What cannot be sent today cannot be sent tomorrow.
                Err(error) => return attempt.failed(&error.to_string()),
                Ok(_) => {}
            }
        }
        let now = bus.port().now();
        if left.is_empty() {
            return attempt.done(now, &format!("confirmed by {} motors", ids.len()));
        }
        let found = || match &lost {
            Some(error) => format!("the port is gone ({error})"),
            None => format!("no confirmation of motors {left:?}, the other {} are off", ids.len() - left.len()),
        };
        if !attempt.goes_on(now, found) {
            return attempt.failed(&found());
        }
        bus.port().wait_until(now + RETRY);
        wait = (wait + RETRY).min(MOST);
    }
}

fn allegro<P: Port>(port: P, version: AllegroVersion, patience: Duration, news: &mut dyn FnMut(&str)) -> SwitchedOff {
    let mut bus = Slcan::resumed(port);
    let mut attempt = Attempt::new(bus.port().now(), patience, news);
    // Poses that were on their way show that the hand was there before it fell silent.
    let mut heard = false;
    loop {
        let told = allegro_round(&mut bus, version, &mut heard);
        let now = bus.port().now();
        let found = match &told {
            Err(error) => error.to_string(),
            Ok(Received::Nothing) if heard => return attempt.done(now, "the hand has fallen silent"),
            Ok(Received::Nothing) => "nothing was heard of the hand".to_owned(),
            Ok(Received::Refusals) => "the adapter refuses frames".to_owned(),
            Ok(Received::Poses) => "the hand goes on reporting".to_owned(),
        };
        attempt.was_gone |= told.is_err();
        if matches!(told, Ok(Received::Refusals)) {
            // Its channel may be closed, after the adapter was without power. What fails here fails again in the next round.
            let _ = bus.open_channel();
        }
        if !attempt.goes_on(now, || found.clone()) {
            return attempt.failed(&found);
        }
        bus.port().wait_until(now + RETRY);
    }
}

/// What an Allegro hand and its adapter said after they were told to be silent.
enum Received {
    Nothing,
    Refusals,
    Poses,
}

/// Says all of it once; what came after that. An answer to the question who it is counts as heard.
fn allegro_round<P: Port>(bus: &mut Slcan<P>, version: AllegroVersion, heard: &mut bool) -> Result<Received> {
    let refused = bus.refused();
    let zero = (0..4).map(|finger| AllegroCommand::Torque { finger, wire: [0; 4] });
    let silence = AllegroCommand::Period { pose_ms: 0, imu_ms: 0, temperature_ms: 0 };
    for command in zero.chain([AllegroCommand::Off, silence, AllegroCommand::AskInfo]) {
        if let Some(frame) = command.encode(version) {
            bus.send(&frame)?;
        }
    }
    let begun = bus.port().now();
    while let Some(frame) = bus.receive(QUIET)? {
        *heard |= AllegroReport::decode(version, &frame).is_some();
        if bus.port().now().saturating_sub(begun) > BABBLE {
            return Ok(Received::Poses);
        }
    }
    Ok(if bus.refused() == refused { Received::Nothing } else { Received::Refusals })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Clock;
    use crate::emulator::leap::LeapEmulator;
    use crate::leap::table;

    #[test]
    fn motors_in_any_state_lose_their_torque() {
        let hand = LeapEmulator::new();
        (0..16).for_each(|id| hand.set(id, table::TORQUE_ENABLE, 1));
        hand.set(3, table::BUS_WATCHDOG, 255);
        let ids: Vec<u8> = (0..16).collect();
        let off = switch_off(hand.port(), &SwitchOff::Leap { ids }, Duration::from_secs(1), &mut |_| {});
        assert!(off.confirmed && off.text.starts_with("torque off"), "{off:?}");
        assert_eq!((hand.under_torque(), hand.get(3, table::BUS_WATCHDOG)), (0, Some(0)));
    }

    #[test]
    fn a_motor_that_does_not_answer_is_unknown_and_never_said_to_be_off() {
        let hand = LeapEmulator::new();
        (0..16).for_each(|id| hand.set(id, table::TORQUE_ENABLE, 1));
        hand.detach(5, true);
        let (off, mut told) = (SwitchOff::Leap { ids: (0..16).collect() }, Vec::new());
        let result = switch_off(hand.port(), &off, Duration::from_secs(2), &mut |news| told.push(news.to_owned()));
        assert!(
            !result.confirmed && result.text.contains("torque unknown") && result.text.contains("[5]"),
            "{result:?}"
        );
        assert!(told.len() == 1 && told[0].contains("[5]"), "{told:?}");
        assert_eq!(hand.under_torque(), 1, "the others are off");
        hand.detach(5, false);
        assert!(switch_off(hand.port(), &off, Duration::from_secs(1), &mut |_| {}).confirmed);
        assert_eq!(hand.under_torque(), 0);
    }

    #[test]
    fn a_port_that_is_gone_is_waited_for() {
        let hand = LeapEmulator::new();
        (0..16).for_each(|id| hand.set(id, table::TORQUE_ENABLE, 1));
        hand.unplug();
        let (off, begun) = (SwitchOff::Leap { ids: (0..16).collect() }, hand.now());
        let result = switch_off(hand.port(), &off, Duration::from_secs(2), &mut |_| hand.plug());
        assert!(result.confirmed && result.text.contains("came back"), "{result:?}");
        assert!(hand.under_torque() == 0 && hand.now() - begun < Duration::from_secs(1));
        hand.unplug();
        let result = switch_off(hand.port(), &off, Duration::from_secs(1), &mut |_| {});
        assert!(!result.confirmed && result.text.contains("the port is gone"), "{result:?}");
    }
}
