//! A bus as a serial port: what relays bytes, such as a guard, relays frames with it.

use std::io;
use std::time::Duration;

use super::{CanBus, SlcanAdapter};
use crate::dynamixel::Port;
use crate::{Clock, Error, Result, SystemClock};

/// A bus that is silent is looked at this often.
const LOOK: Duration = Duration::from_micros(200);

/// A bus as a port behind which an slcan adapter is: a guard that relays bytes relays frames with it.
#[derive(Debug)]
pub(crate) struct SlcanPort<B> {
    adapter: SlcanAdapter<B>,
    /// Opens the bus again.
    open: fn(&str) -> Result<B>,
    name: String,
    clock: SystemClock,
    /// What the adapter said and nobody has read, from `at` on.
    said: Vec<u8>,
    at: usize,
}

impl<B: CanBus> SlcanPort<B> {
    /// The bus of a name, opened by `open`.
    ///
    /// # Errors
    /// As `open`.
    pub fn open(name: &str, open: fn(&str) -> Result<B>) -> Result<Self> {
        let (adapter, clock) = (SlcanAdapter::new(open(name)?), SystemClock::default());
        Ok(Self { adapter, open, name: name.into(), clock, said: Vec::new(), at: 0 })
    }

    /// The bus.
    #[cfg(all(feature = "socketcan", target_os = "linux"))]
    pub fn bus(&self) -> &B {
        self.adapter.bus()
    }

    /// Whether something waits to be read that is not on the bus any more.
    pub fn waits(&self) -> bool {
        self.at < self.said.len()
    }

    fn exchange(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.said.drain(..std::mem::take(&mut self.at));
        self.adapter.take(bytes, &mut self.said).map_err(source)
    }
}

impl<B: CanBus> Clock for SlcanPort<B> {
    fn now(&self) -> Duration {
        self.clock.now()
    }
}

impl<B: CanBus> Port for SlcanPort<B> {
    fn name(&self) -> &str {
        &self.name
    }

    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize> {
        let end = self.now() + wait;
        loop {
            if !self.waits() {
                self.exchange(&[])?;
            }
            let n = buffer.len().min(self.said.len() - self.at);
            let left = end.saturating_sub(self.now());
            if n > 0 || left.is_zero() {
                buffer[..n].copy_from_slice(&self.said[self.at..self.at + n]);
                self.at += n;
                return Ok(n);
            }
            std::thread::sleep(left.min(LOOK));
        }
    }

    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.exchange(bytes)
    }

    fn clear_input(&mut self) -> io::Result<()> {
        self.exchange(&[])?;
        self.at = self.said.len();
        Ok(())
    }

    fn set_baud(&mut self, _: u32) -> io::Result<()> {
        Ok(())
    }

    fn reopen(&mut self) -> io::Result<()> {
        self.adapter = SlcanAdapter::new((self.open)(&self.name).map_err(source)?);
        (self.said, self.at) = (Vec::new(), 0);
        Ok(())
    }
}

fn source(error: Error) -> io::Error {
    match error {
        Error::Port { source, .. } => source,
        other => io::Error::other(other.to_string()),
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::Hand;
    use crate::allegro::{AllegroHand, AllegroOptions, AllegroVersion};
    use crate::can::Slcan;
    use crate::emulator::allegro::AllegroEmulator;
    use crate::guard::{SwitchOff, switch_off};

    thread_local! {
        static HAND: AllegroEmulator = AllegroEmulator::new(AllegroVersion::V5).in_real_time();
    }

    #[test]
    fn a_hand_at_a_bus_is_driven_and_switched_off_through_text() {
        let hand = HAND.with(Clone::clone);
        let open = || SlcanPort::open("can7", |_| Ok(HAND.with(|hand| hand.bus()))).unwrap();
        let robot = drex_robot::Robot::bundled("allegro_right").unwrap();
        let bus = Slcan::over(open()).unwrap();
        let mut driver = AllegroHand::connect(bus, &robot, AllegroOptions::new(AllegroVersion::V5)).unwrap();
        driver.turn_on().unwrap();
        assert!(hand.is_on());
        // As after a program that was killed: the channel is open, nobody says that the torque goes off.
        std::mem::forget(driver);
        let mut port = open();
        port.write_all(b"S8\rO\r").unwrap();
        let off = SwitchOff::Allegro { version: AllegroVersion::V5 };
        let off = switch_off(port, &off, Duration::from_secs(2), &mut |_| {});
        assert!(off.confirmed && !hand.is_on(), "{}", off.text);
    }

    #[test]
    fn a_bus_that_is_gone_is_opened_again() {
        let hand = HAND.with(Clone::clone);
        let open = |name: &str| match name {
            "can7" => Ok(HAND.with(|hand| hand.bus())),
            _ => Err(Error::value("no such bus", "name another")),
        };
        assert!(SlcanPort::open("can8", open).is_err());
        let (mut port, mut buffer) = (SlcanPort::open("can7", open).unwrap(), [0; 3]);
        port.write_all(b"S8\rO\rx\r").unwrap();
        // More than fits is kept.
        assert_eq!((port.read(&mut buffer, Duration::ZERO).unwrap(), &buffer), (3, b"\r\r\x07"));
        port.write_all(b"\r\r\r\r").unwrap();
        assert_eq!((port.read(&mut buffer, Duration::ZERO).unwrap(), port.waits()), (3, true));
        port.clear_input().unwrap();
        assert_eq!((port.read(&mut buffer, Duration::from_millis(1)).unwrap(), port.waits()), (0, false));
        hand.unplug();
        assert!(port.write_all(b"t1000\r").is_err());
        // What it refused is said before the error.
        assert_eq!((port.read(&mut buffer, Duration::ZERO).unwrap(), buffer[0]), (1, 7));
        assert!(port.read(&mut buffer, Duration::ZERO).is_err());
        hand.plug();
        port.reopen().unwrap();
        port.write_all(b"t1000\r").unwrap();
        // Closed, as after power-up.
        assert_eq!((port.read(&mut buffer, Duration::ZERO).unwrap(), buffer[0]), (1, 7));
    }
}
