//! Intervals for success rates.

use serde::{Deserialize, Serialize};

/// 97.5 % point of the normal distribution: two-sided intervals of 95 %.
const Z: f64 = 1.959_963_984_540_054;

/// A share with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// The estimate.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// 95 % interval of a success rate (Wilson 1927): `successes` of `n` trials. Without trials the whole of 0 to 1.
pub fn wilson(successes: usize, n: usize) -> Interval {
    if n == 0 {
        return Interval { value: 0.0, low: 0.0, high: 1.0 };
    }
    let (n, p) = (n as f64, successes.min(n) as f64 / n as f64);
    let scale = 1.0 / (1.0 + Z * Z / n);
    let centre = scale * (p + Z * Z / (2.0 * n));
    let half = scale * Z * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
    Interval { value: p, low: (centre - half).max(0.0), high: (centre + half).min(1.0) }
}

/// 95 % interval of the success rate of clusters, (successes, trials) of each: trials of one object are more alike than those of several. From the spread of
/// the clusters about the common rate (Cochran 1977, equation 2.39, of a ratio), at least as wide as [`wilson`]'s.
pub fn clustered(groups: &[(usize, usize)]) -> Interval {
    let sum = |of: fn(&(usize, usize)) -> usize| groups.iter().map(of).sum::<usize>();
    let (successes, n) = (sum(|g| g.0), sum(|g| g.1));
    let alone = wilson(successes, n);
    if groups.len() < 2 || n == 0 {
        return alone;
    }
    let count = groups.len() as f64;
    let squares: f64 = groups.iter().map(|g| (g.0 as f64 - alone.value * g.1 as f64).powi(2)).sum();
    let half = Z * (count / (count - 1.0) * squares).sqrt() / n as f64;
    Interval {
        value: alone.value,
        low: (alone.value - half).min(alone.low).max(0.0),
        high: (alone.value + half).max(alone.high).min(1.0),
    }
}

/// Difference of two success rates of the same clusters, (successes of a, successes of b, trials) of each, `a` minus `b`, with its 95 % interval from the
/// spread of the clusters' differences (as [`clustered`]). Of fewer than two clusters the interval is everything.
pub fn clustered_difference(groups: &[(usize, usize, usize)]) -> Interval {
    let n = groups.iter().map(|g| g.2).sum::<usize>() as f64;
    let gained = |g: &(usize, usize, usize)| g.0 as f64 - g.1 as f64;
    let value = groups.iter().map(gained).sum::<f64>() / n.max(1.0);
    let count = groups.len() as f64;
    if groups.len() < 2 || n == 0.0 {
        return Interval { value, low: -1.0, high: 1.0 };
    }
    let squares: f64 = groups.iter().map(|g| (gained(g) - value * g.2 as f64).powi(2)).sum();
    let half = Z * (count / (count - 1.0) * squares).sqrt() / n;
    Interval { value, low: (value - half).max(-1.0), high: (value + half).min(1.0) }
}

/// Difference of two success rates on the same trials, `a` minus `b`, with its 95 % interval from the trials that differ.
///
/// The interval is that of Agresti and Min (2005): Wald's with half a trial added to each cell of the table.
/// Only as many trials as the shorter list has are compared.
pub fn paired_difference(a: &[bool], b: &[bool]) -> Interval {
    let pairs = || a.iter().zip(b);
    let n = pairs().count();
    if n == 0 {
        return Interval { value: 0.0, low: -1.0, high: 1.0 };
    }
    let only = |want: (bool, bool)| pairs().filter(|&(&x, &y)| (x, y) == want).count() as f64;
    let (gained, lost) = (only((true, false)), only((false, true)));
    let (more, less, total) = (gained + 0.5, lost + 0.5, n as f64 + 2.0);
    let centre = (more - less) / total;
    let half = Z * ((more + less) - (more - less).powi(2) / total).sqrt() / total;
    Interval { value: (gained - lost) / n as f64, low: (centre - half).max(-1.0), high: (centre + half).min(1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_of_known_counts() {
        // Rounded to a percent, as tables of twenty trials have them.
        for (k, n, low, high) in
            [(15, 20, 53, 89), (16, 20, 58, 92), (19, 20, 76, 99), (6, 20, 15, 52), (3, 20, 5, 36), (4, 10, 17, 69)]
        {
            let i = wilson(k, n);
            assert_eq!(((100.0 * i.low).round() as i32, (100.0 * i.high).round() as i32), (low, high), "{k}/{n}");
        }
        assert_eq!(wilson(0, 10).low, 0.0);
        assert!(wilson(10, 10).high <= 1.0 && wilson(10, 10).low > 0.69);
        assert_eq!((wilson(0, 0).low, wilson(0, 0).high), (0.0, 1.0));
    }

    #[test]
    fn differences_of_clusters_are_as_certain_as_clusters_agree() {
        // Each object loses one of ten: no doubt. One object of ten loses all ten: the same mean, and next to no certainty.
        let even = clustered_difference(&[(8, 9, 10); 10]);
        assert!((even.value + 0.1).abs() < 1e-12 && (even.high - even.low) < 1e-12, "{even:?}");
        let mut groups = [(9, 9, 10); 10];
        groups[3] = (0, 10, 10);
        let one = clustered_difference(&groups);
        assert!((one.value + 0.1).abs() < 1e-12 && (one.high - 0.096).abs() < 1e-3, "{one:?}");
        assert_eq!(clustered_difference(&[(3, 1, 10)]), Interval { value: 0.2, low: -1.0, high: 1.0 });
    }

    #[test]
    fn clusters_that_agree_say_no_more_than_their_number() {
        // Ten objects, five of which always hold: the rate of ten tosses of a coin, not of a thousand.
        let groups: Vec<(usize, usize)> = (0..10).map(|i| if i % 2 == 0 { (100, 100) } else { (0, 100) }).collect();
        let i = clustered(&groups);
        assert!((i.value - 0.5).abs() < 1e-12 && (i.low - 0.5 + 1.96 * 0.5 / 9.0_f64.sqrt()).abs() < 1e-3, "{i:?}");
        let even = clustered(&[(50, 100); 10]);
        assert_eq!((even.low, even.high), (wilson(500, 1000).low, wilson(500, 1000).high));
        assert_eq!(clustered(&[(3, 4)]), wilson(3, 4));
    }

    #[test]
    fn paired_differences() {
        let a: Vec<bool> = (0..200).map(|i| i % 10 != 0).collect();
        let same = paired_difference(&a, &a);
        assert!(same.value == 0.0 && same.low < 0.0 && same.high > 0.0 && same.high < 0.02);
        let b: Vec<bool> = (0..200).map(|i| i % 2 == 0).collect();
        let d = paired_difference(&a, &b);
        assert!((d.value - 0.4).abs() < 1e-12 && d.low > 0.3 && d.high < 0.5, "{d:?}");
        let swapped = paired_difference(&b, &a);
        assert!((swapped.low + d.high).abs() < 1e-12);
    }
}
