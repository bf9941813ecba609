//! How a loop runs.

use std::time::Duration;

use super::{EStop, Recorder};
use crate::{Error, HandState, Result};

/// What heat and a low supply take from a joint's largest effort.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Derating {
    /// Up to this temperature a joint may use its whole cap, °C.
    pub from_c: f64,
    /// From this temperature on only [`Derating::floor_share`] of it, °C; in between it falls in a line.
    pub to_c: f64,
    /// Share of the cap that a hot joint keeps, 0 to 1: enough to hold its place.
    pub floor_share: f64,
    /// Down to this supply a joint may use its whole cap, V.
    pub from_v: f64,
    /// From this supply down only [`Derating::floor_share`] of it, V; in between it falls in a line.
    pub to_v: f64,
    /// How fast a limit that a low supply took comes back, share of the cap per second: at once it would pull the supply down again.
    pub recovery_per_s: f64,
}

impl Default for Derating {
    /// From 55 to 68 °C and from 4.5 to 3.7 V down to a tenth: LEAP's motors switch off at 70 °C, and have the input-voltage error at
    /// 3.5 V. A quarter of the cap comes back each second.
    fn default() -> Self {
        Self { from_c: 55.0, to_c: 68.0, floor_share: 0.1, from_v: 4.5, to_v: 3.7, recovery_per_s: 0.25 }
    }
}

impl Derating {
    /// Share of the cap that is left at a temperature, °C; the floor for what is no temperature.
    pub fn share(&self, celsius: f64) -> f64 {
        self.between((self.to_c - celsius) / (self.to_c - self.from_c))
    }

    /// Share of the cap that is left at a supply, V; the floor for what is no voltage.
    pub fn share_at_supply(&self, volts: f64) -> f64 {
        self.between((volts - self.to_v) / (self.from_v - self.to_v))
    }

    /// Share of the cap from the floor, at 0 and below, to all of it, at 1 and above.
    fn between(&self, well: f64) -> f64 {
        let share = self.floor_share + well.clamp(0.0, 1.0) * (1.0 - self.floor_share);
        if share.is_nan() { self.floor_share } else { share }
    }
}

/// Looks at the state and lowers effort limits.
pub(super) type Limiter = Box<dyn FnMut(&HandState, &mut [f64]) + Send>;

/// How a loop runs.
#[non_exhaustive]
pub struct ControlOptions {
    /// Cycles per second.
    pub rate_hz: f64,
    /// How long joints may take until all have told where they are.
    pub first_state: Duration,
    /// How long the hand may be out of reach, its plug pulled for instance, before the loop gives up. Meanwhile the controller's time
    /// stands still and its last command is tried again every cycle; zero gives up at the first failure.
    pub outage: Duration,
    /// How long a hand that does not confirm that its torque is off is told again after the loop, three times at least.
    pub off_patience: Duration,
    /// What heat and a low supply take from the limits, where the hand measures it; `None` leaves that to the motors.
    pub derating: Option<Derating>,
    /// Whether the hand only is watched: no torque, no commands.
    pub torque_off: bool,
    /// Stops the loop.
    pub estop: EStop,
    /// Stops this loop only: when its handle is dropped.
    pub(super) cancel: EStop,
    pub(super) limiter: Option<Limiter>,
    pub(super) recorder: Option<Recorder>,
}

impl Default for ControlOptions {
    /// 400 cycles per second, two seconds until all joints have answered, no outage, derating.
    fn default() -> Self {
        Self {
            rate_hz: 400.0,
            first_state: Duration::from_secs(2),
            outage: Duration::ZERO,
            off_patience: Duration::ZERO,
            derating: Some(Derating::default()),
            torque_off: false,
            estop: EStop::new(),
            cancel: EStop::new(),
            limiter: None,
            recorder: None,
        }
    }
}

impl ControlOptions {
    /// The same with this many cycles per second.
    pub fn with_rate_hz(mut self, rate_hz: f64) -> Self {
        self.rate_hz = rate_hz;
        self
    }

    /// The same with a hand that is only watched: its joints can be moved by hand.
    pub fn with_torque_off(mut self) -> Self {
        self.torque_off = true;
        self
    }

    /// The same with this emergency stop.
    pub fn with_estop(mut self, estop: &EStop) -> Self {
        self.estop = estop.clone();
        self
    }

    /// The same with a hand that may be out of reach for this long.
    pub fn with_outage(mut self, outage: Duration) -> Self {
        self.outage = outage;
        self
    }

    /// The same with a hand that is told for this long that its torque goes off, until it confirms it.
    pub fn with_off_patience(mut self, patience: Duration) -> Self {
        self.off_patience = patience;
        self
    }

    /// The same with other derating, or none.
    pub fn with_derating(mut self, derating: Option<Derating>) -> Self {
        self.derating = derating;
        self
    }

    /// The same with `limiter`, which sees the state and the effort limits of every cycle before they are sent. It can lower limits;
    /// what it raises is put back.
    pub fn with_limiter(mut self, limiter: impl FnMut(&HandState, &mut [f64]) + Send + 'static) -> Self {
        self.limiter = Some(Box::new(limiter));
        self
    }

    /// The same with telemetry; see [`telemetry`](super::telemetry).
    pub fn with_recorder(mut self, recorder: Recorder) -> Self {
        self.recorder = Some(recorder);
        self
    }

    /// Whether somebody stopped the loop.
    pub(super) fn is_stopped(&self) -> bool {
        self.estop.is_stopped() || self.cancel.is_stopped()
    }

    /// Time of a cycle.
    pub(super) fn period(&self) -> Result<Duration> {
        if !(self.rate_hz >= 1.0 && self.rate_hz <= 10_000.0) {
            return Err(Error::value(format!("{} cycles per second", self.rate_hz), "give 1 to 10000"));
        }
        let means_something = |d: &Derating| {
            let ranges = d.to_c > d.from_c && d.to_v < d.from_v && d.recovery_per_s > 0.0;
            ranges && (0.0..=1.0).contains(&d.floor_share)
        };
        if let Some(d) = self.derating.filter(|d| !means_something(d)) {
            return Err(Error::value(
                format!(
                    "derating from {} to {} °C and from {} to {} V down to {} of the cap, {} of it back each second",
                    d.from_c, d.to_c, d.from_v, d.to_v, d.floor_share, d.recovery_per_s
                ),
                "let it end hotter and at less supply than it begins, at a share of 0 to 1, and come back",
            ));
        }
        Ok(Duration::from_secs_f64(1.0 / self.rate_hz))
    }
}
