//! Angles and velocities of a finger, from the poses that it reports.

use std::time::Duration;

/// Poses closer together than this came in one bunch and say nothing about velocity.
const BUNCH: Duration = Duration::from_micros(300);

/// What is known of a finger.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Finger {
    /// When the newest pose came.
    pub seen: Option<Duration>,
    /// rad.
    pub q: [f64; 4],
    /// rad/s, filtered.
    pub v: [f64; 4],
    /// Pose that velocities are measured from.
    from: Option<(Duration, [f64; 4])>,
}

impl Finger {
    /// Takes a pose; gaps longer than `stale` begin anew with no velocity.
    pub fn take(&mut self, q: [f64; 4], now: Duration, filter_s: f64, stale: Duration) {
        let gap = self.from.map(|(then, from)| (now.saturating_sub(then), from));
        match gap {
            Some((dt, from)) if dt <= stale => {
                if dt >= BUNCH {
                    let dt = dt.as_secs_f64();
                    // First order, exact for a constant velocity over the gap, with a gain of one.
                    let keep = (-dt / filter_s.max(1e-9)).exp();
                    for k in 0..4 {
                        self.v[k] = keep * self.v[k] + (1.0 - keep) * (q[k] - from[k]) / dt;
                    }
                    self.from = Some((now, q));
                }
            }
            _ => {
                self.v = [0.0; 4];
                self.from = Some((now, q));
            }
        }
        (self.q, self.seen) = (q, Some(now));
    }

    /// Forgets everything: the hand was switched off.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Whether the newest pose is younger than `stale`.
    pub fn is_fresh(&self, now: Duration, stale: Duration) -> bool {
        self.seen.is_some_and(|t| now.saturating_sub(t) <= stale)
    }
}
