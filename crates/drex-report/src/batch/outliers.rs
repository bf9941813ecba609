//! Items that stand out from the others of their batch.

use std::collections::BTreeMap;

use drex_core::stats::median;
use drex_trial::wilson;

use super::measures::{Measured, digits, duration, pooled, trials_text};

/// Fewer values than these say nothing about what is usual.
pub const FEWEST: usize = 8;
/// A spread of logarithms that is smaller counts as this: what differs by a few per cent does not stand out.
pub const LEAST_SPREAD: f64 = 0.05;
/// Makes the median distance from the median the standard deviation of a normal distribution.
const MAD_TO_SD: f64 = 1.4826;
/// Share of batches of like items in which a success rate may stand out by chance.
const FALSE_ALARMS: f64 = 0.01;

/// What an item can stand out in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quantity {
    /// Width of the 95 % interval of the mass, as a share of the mass.
    MassInterval,
    /// Grip force as a multiple of the weight.
    Grip,
    /// Share of the trials that held.
    SuccessRate,
    /// Wall time; only upwards, since an item that goes on where it was takes less.
    Seconds,
}

impl Quantity {
    const ALL: [Self; 4] = [Self::MassInterval, Self::Grip, Self::SuccessRate, Self::Seconds];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::MassInterval => "width of the mass interval",
            Self::Grip => "grip force per weight",
            Self::SuccessRate => "success rate",
            Self::Seconds => "seconds",
        }
    }

    fn text(self, value: f64) -> String {
        match self {
            Self::MassInterval => format!("{} % of the mass", digits(100.0 * value)),
            Self::Grip => format!("{} times the weight", digits(value)),
            Self::SuccessRate => format!("{:.0} %", 100.0 * value),
            Self::Seconds => duration(value),
        }
    }
}

/// An item that stands out in a quantity.
#[derive(Debug, Clone, PartialEq)]
pub struct Outlier {
    /// Which row.
    pub row: usize,
    /// In what.
    pub quantity: Quantity,
    /// Its value.
    pub value: String,
    /// What is usual.
    pub usual: String,
    /// By how much they differ.
    pub distance: String,
}

/// What stands out, and where that could not be told.
#[derive(Debug, Default)]
pub struct Outliers {
    /// The outliers, by quantity, the farthest first.
    pub found: Vec<Outlier>,
    /// Quantities that enough items have.
    pub compared: Vec<Quantity>,
    /// Tasks and quantities that some items have, but too few to tell what is usual, with the number of items.
    pub too_few: Vec<(String, Quantity, usize)>,
}

/// How many spreads one of `n` values must lie away from their median to stand out. Where logarithms are normal, none does in 99 of 100
/// batches: the line lies above the 99 % points of simulated batches of 8 to 3,000 items (8.1 spreads of 8, 4.6 of 40, 4.5 of 1,000).
pub fn threshold(n: usize) -> f64 {
    5.0 + 30.0 / n as f64
}

/// The items that stand out among those of the same task.
pub fn find(items: &[Measured<'_>]) -> Outliers {
    let mut by_task: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (i, item) in items.iter().enumerate() {
        by_task.entry(item.row.task.as_str()).or_default().push(i);
    }
    let mut outliers = Outliers::default();
    for quantity in Quantity::ALL {
        let value = |i: usize| match quantity {
            Quantity::MassInterval => items[i].relative_width,
            Quantity::Grip => items[i].grip_per_weight,
            Quantity::SuccessRate => items[i].success_rate(),
            Quantity::Seconds => items[i].seconds,
        };
        for (task, rows) in &by_task {
            let values: Vec<(usize, f64)> = rows.iter().filter_map(|&i| Some((i, value(i)?))).collect();
            match values.len() {
                0 => {}
                n if n < FEWEST => outliers.too_few.push(((*task).to_owned(), quantity, n)),
                _ => {
                    outliers.compared.push(quantity);
                    outliers.found.extend(match quantity {
                        Quantity::SuccessRate => unlucky(items, &values),
                        _ => far(quantity, &values),
                    });
                }
            }
        }
    }
    outliers.compared.dedup();
    outliers
}

/// Values far from the median on a logarithmic scale.
fn far(quantity: Quantity, values: &[(usize, f64)]) -> Vec<Outlier> {
    let logs = || values.iter().map(|(_, v)| v.ln());
    let Some(middle) = median(logs()) else { return Vec::new() };
    let deviation = median(logs().map(|log| (log - middle).abs())).unwrap_or_default();
    let (spread, threshold) = ((MAD_TO_SD * deviation).max(LEAST_SPREAD), threshold(values.len()));
    let away = |value: f64| (value.ln() - middle) / spread;
    let mut far: Vec<(usize, f64)> = values.iter().copied().filter(|(_, v)| away(*v).abs() > threshold).collect();
    far.retain(|(_, v)| quantity != Quantity::Seconds || away(*v) > 0.0);
    far.sort_by(|a, b| away(b.1).abs().total_cmp(&away(a.1).abs()));
    let outlier = |(row, value): (usize, f64)| Outlier {
        row,
        quantity,
        value: quantity.text(value),
        usual: quantity.text(middle.exp()),
        distance: format!(
            "{} times the median, {:.1} spreads {}",
            digits((value.ln() - middle).exp()),
            away(value).abs(),
            if value.ln() > middle { "above" } else { "below" }
        ),
    };
    far.into_iter().map(outlier).collect()
}

/// Success rates whose interval lies below the rate of all, by more than chance makes of as many like items.
fn unlucky(items: &[Measured<'_>], values: &[(usize, f64)]) -> Vec<Outlier> {
    let [held, all] = pooled(values.iter().map(|(i, _)| &items[*i]));
    let rate = held as f64 / all as f64;
    let mut found = Vec::new();
    for &(row, value) in values {
        let Some([h, n]) = items[row].trials else { continue };
        let high = wilson(h, n).high;
        if high >= rate {
            continue;
        }
        let chance = chance_of_so_few(h, n, held, all);
        if chance * (values.len() as f64) < FALSE_ALARMS {
            found.push((chance, row, value, [h, n], high));
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let outlier = |(_, row, value, trials, high)| Outlier {
        row,
        quantity: Quantity::SuccessRate,
        value: trials_text(trials),
        usual: Quantity::SuccessRate.text(rate),
        distance: format!(
            "{:.0} points below; its interval ends {:.1} points below",
            100.0 * (rate - value),
            100.0 * (rate - high)
        ),
    };
    found.into_iter().map(outlier).collect()
}

/// Probability that at most `held` of an item's `n` trials hold when `all_held` of `all` do and it is chance which (Fisher's exact test, one
/// side).
fn chance_of_so_few(held: usize, n: usize, all_held: usize, all: usize) -> f64 {
    let lost = all - all_held;
    let ln_all = ln_choose(all, n);
    (n.saturating_sub(lost)..=held)
        .map(|h| (ln_choose(all_held, h) + ln_choose(lost, n - h) - ln_all).exp())
        .sum::<f64>()
}

/// Logarithm of the number of ways to choose `k` of `n`.
fn ln_choose(n: usize, k: usize) -> f64 {
    ln_factorial(n) - ln_factorial(k) - ln_factorial(n - k)
}

/// Logarithm of n!, by Stirling's series where that is exact to a part in 10^12.
fn ln_factorial(n: usize) -> f64 {
    if n < 32 {
        return (2..=n).map(|k| (k as f64).ln()).sum();
    }
    let x = n as f64 + 1.0;
    let series = 1.0 / (12.0 * x) - 1.0 / (360.0 * x.powi(3)) + 1.0 / (1260.0 * x.powi(5));
    (x - 0.5) * x.ln() - x + 0.5 * std::f64::consts::TAU.ln() + series
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exact_test_has_the_known_probabilities() {
        // Fisher's lady: eight cups, four of them with the milk first, and four are chosen.
        for (held, ways) in [(0, 1.0), (1, 17.0), (2, 53.0), (3, 69.0), (4, 70.0)] {
            assert!((chance_of_so_few(held, 4, 4, 8) - ways / 70.0).abs() < 1e-12, "{held}");
        }
        // One failure of 960 trials is in an item of 24 by a chance of one in forty.
        assert!((chance_of_so_few(23, 24, 959, 960) - 0.025).abs() < 1e-9);
        // From a table of logarithms of factorials.
        assert!((ln_factorial(31) - 78.092_223_553_315_3).abs() < 1e-10);
        assert!((ln_factorial(170) - 706.573_062_245_787_4).abs() < 1e-9);
    }
}
