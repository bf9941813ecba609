//! How well the loop kept its time.

use std::time::Duration;

/// Buckets per doubling of the time: a quantile is exact to a thirty-second part.
const FINE: u32 = 5;
/// Buckets: the first doublings of a nanosecond in full, then 32 per doubling up to the longest time there is.
const BUCKETS: usize = (64 - FINE as usize + 1) << FINE;

/// Times, s, that half, 99 % and all of the cycles stayed below.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Quantiles {
    /// Median.
    pub p50_s: f64,
    /// Ninety-nine of a hundred.
    pub p99_s: f64,
    /// Largest.
    pub max_s: f64,
}

/// What a loop measured of itself.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct LoopStats {
    /// Cycles done.
    pub cycles: u64,
    /// Cycles left out because the one before took too long.
    pub missed: u64,
    /// Cycles in which the hand could not be reached.
    pub failed: u64,
    /// Times that the hand was out of reach and came back; the controller's time stood still meanwhile.
    pub outages: u64,
    /// How long it was out of reach in these, s.
    pub outage_s: f64,
    /// Times that more than 50 ms were missing between two cycles, because the program was stopped or starved; the controller's time stood
    /// still meanwhile.
    pub stalls: u64,
    /// Cycles per second, from the first to the last.
    pub rate_hz: f64,
    /// How much later than planned cycles began: the jitter.
    pub late: Quantiles,
    /// How long cycles took: controller and exchange with the hand.
    pub busy: Quantiles,
}

/// Counts times without keeping them.
#[derive(Debug, Clone)]
struct Histogram {
    counts: Box<[u64]>,
    total: u64,
    max: u64,
}

impl Histogram {
    fn new() -> Self {
        Self { counts: vec![0; BUCKETS].into(), total: 0, max: 0 }
    }

    fn add(&mut self, time: Duration) {
        let ns = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        self.counts[bucket(ns)] += 1;
        self.total += 1;
        self.max = self.max.max(ns);
    }

    /// Upper end of the bucket below which a share of the times lies, ns.
    fn quantile(&self, share: f64) -> u64 {
        let wanted = ((share * self.total as f64).ceil() as u64).max(1);
        let mut seen = 0;
        for (k, n) in self.counts.iter().enumerate() {
            seen += n;
            if seen >= wanted {
                return upper_end(k).min(self.max);
            }
        }
        self.max
    }

    fn quantiles(&self) -> Quantiles {
        let s = |ns: u64| ns as f64 * 1e-9;
        Quantiles { p50_s: s(self.quantile(0.5)), p99_s: s(self.quantile(0.99)), max_s: s(self.max) }
    }
}

fn bucket(ns: u64) -> usize {
    let doublings = (64 - ns.leading_zeros()).saturating_sub(FINE + 1);
    ((doublings as usize) << FINE) + (ns >> doublings) as usize
}

fn upper_end(bucket: usize) -> u64 {
    let doublings = (bucket >> FINE).saturating_sub(1);
    let within = bucket - (doublings << FINE);
    let above = (within as u128 + 1) << doublings;
    u64::try_from(above - 1).unwrap_or(u64::MAX)
}

/// Measures a loop.
#[derive(Debug)]
pub(super) struct Meter {
    cycles: u64,
    missed: u64,
    failed: u64,
    stalls: u64,
    outages: u64,
    outage: Duration,
    first: Option<Duration>,
    last: Duration,
    late: Histogram,
    busy: Histogram,
}

impl Meter {
    pub fn new() -> Self {
        Self {
            cycles: 0,
            missed: 0,
            failed: 0,
            stalls: 0,
            outages: 0,
            outage: Duration::ZERO,
            first: None,
            last: Duration::ZERO,
            late: Histogram::new(),
            busy: Histogram::new(),
        }
    }

    /// Takes a cycle that was `due`, began, and ended.
    pub fn cycle(&mut self, due: Duration, began: Duration, ended: Duration) {
        self.cycles += 1;
        self.first.get_or_insert(began);
        self.last = began;
        self.late.add(began.saturating_sub(due));
        self.busy.add(ended.saturating_sub(began));
    }

    pub fn miss(&mut self, cycles: u64) {
        self.missed += cycles;
    }

    pub fn fail(&mut self) {
        self.failed += 1;
    }

    pub fn stall(&mut self) {
        self.stalls += 1;
    }

    /// Takes a time for which the hand was out of reach, when it is back.
    pub fn outage(&mut self, time: Duration) {
        self.outages += 1;
        self.outage += time;
    }

    /// Whether the number of cycles done is a multiple of `n`.
    pub fn is_nth(&self, n: u64) -> bool {
        self.cycles.is_multiple_of(n)
    }

    pub fn stats(&self) -> LoopStats {
        let span_s = self.last.saturating_sub(self.first.unwrap_or_default()).as_secs_f64();
        let rate_hz = if span_s > 0.0 { (self.cycles - 1) as f64 / span_s } else { 0.0 };
        let (late, busy) = (self.late.quantiles(), self.busy.quantiles());
        let Self { cycles, missed, failed, stalls, outages, outage, .. } = *self;
        LoopStats { cycles, missed, failed, outages, outage_s: outage.as_secs_f64(), stalls, rate_hz, late, busy }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buckets_are_in_order_and_hold_what_belongs_to_them() {
        let mut last = None;
        for k in 0..BUCKETS {
            let end = upper_end(k);
            assert_eq!(bucket(end), k);
            assert!(last.is_none_or(|l| l < end));
            last = Some(end);
        }
        assert_eq!((bucket(0), bucket(u64::MAX)), (0, BUCKETS - 1));
    }

    #[test]
    fn quantiles_are_close_to_those_of_the_sorted_times() {
        let mut histogram = Histogram::new();
        let times: Vec<u64> = (1..=10_000_u64).map(|k| k * k).collect();
        times.iter().for_each(|t| histogram.add(Duration::from_nanos(*t)));
        for share in [0.01, 0.5, 0.99] {
            let exact = times[(share * 10_000.0) as usize - 1] as f64;
            let found = histogram.quantile(share) as f64;
            assert!((0.0..=exact / 32.0 + 1.0).contains(&(found - exact)), "{found} instead of {exact}");
        }
        assert_eq!(histogram.quantile(1.0), 100_000_000);
        assert_eq!(Meter::new().stats(), LoopStats::default());
    }
}
