//! How values are distributed: bins with round edges, for the bars of a plot.

use super::plot::{Bar, step_of};

/// Values nearer to each other than this share of their size are equal: they come into one bin.
const EQUAL: f64 = 1e-9;
/// Width of a bin of equal values, as a share of their size.
const ALONE: f64 = 0.05;

/// Bins of equal width. Values that are not finite are left out.
pub fn bins(values: &[f64]) -> Vec<Bar> {
    let values: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let (lo, hi) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(*v), hi.max(*v)));
    let size = lo.abs().max(hi.abs());
    let alone = hi - lo <= EQUAL * size;
    let wanted = (2.0 * (values.len() as f64).sqrt()).clamp(12.0, 40.0);
    let step = step_of(if !alone {
        (hi - lo) / wanted
    } else if size > 0.0 {
        ALONE * size
    } else {
        1.0
    });
    // Of nothing, and of values whose difference is no number.
    if !step.is_finite() || step <= 0.0 {
        return Vec::new();
    }
    let first = (lo / step + EQUAL).floor();
    let count = (hi / step - EQUAL).ceil() - first;
    // Empty bins beside a lone one show that it is one.
    let (first, count) = if alone { (first - 1.0, 3.0) } else { (first, count) };
    binned(&values, first * step, step, count as usize)
}

/// Bins whose right ends are the same multiple of the left ones, of values over zero.
pub fn log_bins(values: &[f64]) -> Vec<Bar> {
    let exponents: Vec<f64> = values.iter().map(|v| v.log10()).collect();
    let power = |x: f64| 10f64.powf(x);
    bins(&exponents).into_iter().map(|b| Bar { from: power(b.from), to: power(b.to), ..b }).collect()
}

/// `count` bins from `first` on. A value on an edge belongs to the right one, the last edge to the last bin; what lies outside is left out.
pub fn binned(values: &[f64], first: f64, step: f64, count: usize) -> Vec<Bar> {
    let edge = |i: usize| first + step * i as f64;
    let mut bars: Vec<Bar> = (0..count).map(|i| Bar { from: edge(i), to: edge(i + 1), count: 0 }).collect();
    for value in values {
        let place = (value - first) / step + EQUAL;
        let inside = place >= 0.0 && place <= count as f64 + 2.0 * EQUAL;
        if let Some(bar) = bars.get_mut((place as usize).min(count.saturating_sub(1))).filter(|_| inside) {
            bar.count += 1;
        }
    }
    bars
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(bars: &[Bar]) -> Vec<usize> {
        bars.iter().map(|b| b.count).collect()
    }

    #[test]
    fn every_value_lies_in_its_bin_and_edges_are_round() {
        let values: Vec<f64> = (0..41).map(|i| 20.0 + 0.1 * f64::from(i)).collect();
        let bars = bins(&values);
        assert_eq!(counts(&bars), [5, 5, 5, 5, 5, 5, 5, 6], "{bars:?}");
        assert_eq!((bars[0].from, bars[1].from, bars[7].to), (20.0, 20.5, 24.0));
        let bars = binned(&[0.0, 4.9, 5.0, 100.0, 100.1, -0.1, f64::NAN], 0.0, 5.0, 20);
        assert_eq!(counts(&bars)[..2], [2, 1]);
        assert_eq!((bars[19].count, bars.iter().map(|b| b.count).sum::<usize>()), (1, 4));
    }

    #[test]
    fn equal_values_are_one_bar_between_empty_ones_and_odd_ones_are_none() {
        for value in [7.3, -2.0, 0.0, 1e-12, 1e12] {
            let bars = bins(&[value; 5]);
            assert_eq!(counts(&bars), [0, 5, 0], "{value}: {bars:?}");
            assert!(bars[1].from <= value && value <= bars[1].to && bars[1].to > bars[1].from);
        }
        assert!(bins(&[]).is_empty() && bins(&[f64::NAN, f64::INFINITY]).is_empty());
        assert!(bins(&[-f64::MAX, f64::MAX]).is_empty());
        assert!(log_bins(&[0.0, -1.0]).is_empty());
    }

    #[test]
    fn bins_of_a_logarithmic_axis_are_equal_multiples() {
        let bars = log_bins(&[0.01, 0.1, 0.1, 1.0, 10.0]);
        assert_eq!(bars.iter().map(|b| b.count).sum::<usize>(), 5);
        let ratio = bars[0].to / bars[0].from;
        assert!(bars.iter().all(|b| (b.to / b.from - ratio).abs() < 1e-9 * ratio), "{bars:?}");
    }
}
