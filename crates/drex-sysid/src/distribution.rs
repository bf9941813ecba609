//! Distributions of a mass: densities over the logarithm of the mass, exact where their logarithm is linear between knots.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::{Result, SysidError};

/// Loss of log likelihood that excludes a mass: half the 95 % point of chi-square with one degree of freedom.
pub(crate) const EXCLUDES: f64 = 1.92;
/// Standard deviations on either side of the median for which a normal law has knots, and knots per standard deviation.
const REACH: i32 = 8;
const PER_SD: i32 = 20;
/// Largest cost that is taken: with it slopes, and what is continued with them, stay numbers.
const LARGEST_COST: f64 = 1e12;
/// Knots of two densities that are nearer than this in ln m are one.
const SAME: f64 = 1e-12;
/// Least extent of a distribution in ln m.
const LEAST_EXTENT: f64 = 1e-10;
/// Medians, kg, and standard deviations of ln m that a normal law may have: beyond them its ends are no numbers.
const MEDIANS_KG: [f64; 2] = [1e-9, 1e9];
const SDS_LOG: [f64; 2] = [1e-6, 10.0];

/// A distribution of a mass m > 0.
///
/// It is a density over ln m. Minus its logarithm, the cost, is linear between knots and least 0; outside of the knots there is no
/// probability. Integrals over such a density have closed forms, so that what is asked of it does not depend on a grid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Curve", into = "Curve")]
pub struct MassDistribution {
    log_mass: Vec<f64>,
    cost: Vec<f64>,
    /// Probability below each knot.
    below: Vec<f64>,
}

/// The file form of a distribution.
#[derive(Clone, Serialize, Deserialize)]
struct Curve {
    /// Masses, kg, increasing.
    mass_kg: Vec<f64>,
    /// Minus the logarithm of the density of ln m, up to a constant.
    cost: Vec<f64>,
}

impl MassDistribution {
    /// The distribution whose density over ln m has minus the logarithm `cost`, up to a constant, at `mass_kg`: pairs by increasing
    /// mass, linear in ln m between them and nothing outside.
    ///
    /// # Errors
    /// For fewer than two pairs, masses that do not increase, are not positive or all the same, and costs that are not
    /// between -1e12 and 1e12.
    pub fn from_costs(costs: &[(f64, f64)]) -> Result<Self> {
        let refuse = |what: String| SysidError::Parameter {
            name: "mass: the distribution".into(),
            what,
            remedy: "give at least two masses in kilograms, increasing, each with a cost between -1e12 and 1e12".into(),
        };
        if let Some((m, c)) = costs.iter().find(|(m, c)| !(*m > 0.0 && m.is_finite() && c.abs() <= LARGEST_COST)) {
            return Err(refuse(format!("has the cost {c} at {m} kg")));
        }
        let knots: Vec<(f64, f64)> = costs.iter().map(|(m, c)| (m.ln(), *c)).collect();
        if knots.len() < 2 || !knots.is_sorted_by(|a, b| a.0 < b.0) {
            return Err(refuse(format!("has {} masses that do not increase", knots.len())));
        }
        if knots[knots.len() - 1].0 - knots[0].0 < LEAST_EXTENT {
            return Err(refuse("has masses that are all the same".into()));
        }
        Ok(Self::of_knots(knots).0)
    }

    /// The normal law of ln m with the median `median_kg` and the standard deviation `sd_log` of ln m.
    ///
    /// # Errors
    /// If the median is not between 1e-9 and 1e9 kg, or the standard deviation not between 1e-6 and 10.
    pub fn log_normal(median_kg: f64, sd_log: f64) -> Result<Self> {
        let within = |x: f64, [low, high]: [f64; 2]| (low..=high).contains(&x);
        if !(within(median_kg, MEDIANS_KG) && within(sd_log, SDS_LOG)) {
            return Err(SysidError::Parameter {
                name: "mass: the distribution".into(),
                what: format!("has the median {median_kg} kg and the standard deviation {sd_log} of the logarithm"),
                remedy: "give a median of 1e-9 to 1e9 kg and a standard deviation of 1e-6 to 10".into(),
            });
        }
        let knot = |k: i32| {
            let z = f64::from(k) / f64::from(PER_SD);
            (median_kg.ln() + sd_log * z, 0.5 * z * z)
        };
        Ok(Self::of_knots((-REACH * PER_SD..=REACH * PER_SD).map(knot).collect()).0)
    }

    /// From at least two knots by increasing ln m; also the logarithm of the integral of exp(-cost). Knots that carry nothing stay: a
    /// further factor may leave nothing but them.
    fn of_knots(mut knots: Vec<(f64, f64)>) -> (Self, f64) {
        let least = knots.iter().map(|k| k.1).fold(f64::INFINITY, f64::min);
        knots.iter_mut().for_each(|k| k.1 -= least);
        let (log_mass, cost): (Vec<f64>, Vec<f64>) = knots.into_iter().unzip();
        let mut out = Self { log_mass, cost, below: vec![0.0] };
        let mut sum = 0.0;
        for k in 1..out.log_mass.len() {
            sum += out.segment(k, 0.0);
            out.below.push(sum);
        }
        out.below.iter_mut().for_each(|b| *b /= sum);
        (out, sum.ln() - least)
    }

    /// Integral of exp(power · ln m - cost) over the segment that ends at knot `k`.
    fn segment(&self, k: usize, power: f64) -> f64 {
        let at = |i: usize| self.cost[i] - power * self.log_mass[i];
        let (a, b) = (at(k - 1), at(k));
        (self.log_mass[k] - self.log_mass[k - 1]) * (-a.min(b)).exp() * falling((b - a).abs())
    }

    /// Integral of exp(power · ln m - cost) over all knots.
    fn moment(&self, power: f64) -> f64 {
        (1..self.log_mass.len()).map(|k| self.segment(k, power)).sum()
    }

    /// Cost at ln m, linear beyond the knots: a density that falls towards its last knot goes on falling as steeply, and one that does
    /// not stays as it is.
    fn cost_at(&self, log_mass: f64) -> f64 {
        let (x, c) = (&self.log_mass, &self.cost);
        let last = x.len() - 1;
        let k = x.partition_point(|x| *x < log_mass).clamp(1, last);
        let slope = (c[k] - c[k - 1]) / (x[k] - x[k - 1]);
        match log_mass {
            m if m < x[0] => c[0] + (slope * (m - x[0])).max(0.0),
            m if m > x[last] => c[last] + (slope * (m - x[last])).max(0.0),
            m => c[k - 1] + slope * (m - x[k - 1]),
        }
    }

    /// The product of the two densities, normalised, and the logarithm of its integral where both densities have the maximum 1.
    fn product(&self, other: &Self) -> (Self, f64) {
        let mut at: Vec<f64> = self.log_mass.iter().chain(&other.log_mass).copied().collect();
        at.sort_by(f64::total_cmp);
        at.dedup_by(|b, a| *b - *a < SAME);
        Self::of_knots(at.into_iter().map(|x| (x, self.cost_at(x) + other.cost_at(x))).collect())
    }

    /// The posterior of a prior and a likelihood, in either order: the product of the two densities over ln m.
    ///
    /// Beyond its knots a density that falls goes on falling as steeply, and one that does not (a bound from one side) stays as it is.
    #[must_use]
    pub fn times(&self, other: &Self) -> Self {
        self.product(other).0
    }

    /// How far a likelihood contradicts this prior, in standard deviations.
    ///
    /// With ρ the probability of the observation under this prior (its integral over prior times likelihood), relative to the largest
    /// one under a prior of the same shape with its median at any mass, this is √(−2 ln ρ). For two normal laws of ln m it is the distance
    /// of their medians over √(s₁² + s₂²), that is, the observation's place in its distribution under the prior; for a bound from one
    /// side, ρ is the share of the prior that the bound allows.
    pub fn contradiction_sd(&self, likelihood: &Self) -> f64 {
        let evidence = |shift: f64| {
            let mut moved = self.clone();
            moved.log_mass.iter_mut().for_each(|x| *x += shift);
            moved.product(likelihood).1
        };
        let here = evidence(0.0);
        let median = self.median_kg().ln();
        let best = likelihood.log_mass.iter().map(|x| evidence(x - median)).fold(here, f64::max);
        (2.0 * (best - here)).sqrt()
    }

    /// The mass below which the share `p` of the probability lies, kg; `p` is taken between 0 and 1.
    pub fn quantile_kg(&self, p: f64) -> f64 {
        let p = p.clamp(0.0, 1.0);
        let k = self.below.partition_point(|b| *b < p).clamp(1, self.below.len() - 1);
        let (x0, x1) = (self.log_mass[k - 1], self.log_mass[k]);
        let share = (p - self.below[k - 1]) / (self.below[k] - self.below[k - 1]).max(f64::MIN_POSITIVE);
        let fall = self.cost[k] - self.cost[k - 1];
        let way = if fall >= 0.0 { way_down(share, fall) } else { 1.0 - way_down(1.0 - share, -fall) };
        (x0 + way.clamp(0.0, 1.0) * (x1 - x0)).exp()
    }

    /// Median, kg.
    pub fn median_kg(&self) -> f64 {
        self.quantile_kg(0.5)
    }

    /// The interval between the 2.5 % and the 97.5 % quantile, kg.
    pub fn interval95_kg(&self) -> [f64; 2] {
        [self.quantile_kg(0.025), self.quantile_kg(0.975)]
    }

    /// Mean of the mass, kg.
    pub fn mean_kg(&self) -> f64 {
        self.moment(1.0) / self.moment(0.0)
    }

    /// Standard deviation of the mass, kg.
    pub fn sd_kg(&self) -> f64 {
        let square = self.moment(2.0) / self.moment(0.0);
        (square - self.mean_kg().powi(2)).max(0.0).sqrt()
    }

    /// Standard deviation of the logarithm of the mass.
    pub fn sd_log(&self) -> f64 {
        // Share, mean and variance of every segment.
        let parts: Vec<(f64, f64, f64)> = (1..self.log_mass.len())
            .map(|k| {
                let (step, fall) = (self.log_mass[k] - self.log_mass[k - 1], self.cost[k] - self.cost[k - 1]);
                let (mean, variance) = within(fall);
                (self.below[k] - self.below[k - 1], self.log_mass[k - 1] + step * mean, step * step * variance)
            })
            .collect();
        let mean: f64 = parts.iter().map(|(p, m, _)| p * m).sum();
        parts.iter().map(|(p, m, v)| p * (v + (m - mean).powi(2))).sum::<f64>().sqrt()
    }

    /// Ends of the 95 % interval, kg; absent on a side where the outermost knot is not excluded (less likely than the best mass by e^-1.92, as
    /// the ends of an interval are), so that the distribution is a bound from the other side at most.
    pub fn bounds_kg(&self) -> [Option<f64>; 2] {
        let last = self.cost.len() - 1;
        [(0, 0.025), (last, 0.975)].map(|(k, p)| (self.cost[k] > EXCLUDES).then(|| self.quantile_kg(p)))
    }

    /// Ends of the 95 % interval, kg; the outermost knot on a side that [`Self::bounds_kg`] leaves open.
    pub fn ends_kg(&self) -> [f64; 2] {
        let ends = [self.log_mass[0], self.log_mass[self.log_mass.len() - 1]];
        let [low, high] = self.bounds_kg();
        [low.unwrap_or(ends[0].exp()), high.unwrap_or(ends[1].exp())]
    }

    /// The same number of masses for the same seed, kg: independent draws, of which the first ones do not depend on `count`.
    pub fn sample_kg(&self, count: usize, seed: u64) -> Vec<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        (0..count).map(|_| self.quantile_kg(random.random())).collect()
    }

    /// Masses, kg, increasing, with minus the logarithm of the density of ln m, which is least 0.
    pub fn costs(&self) -> impl Iterator<Item = (f64, f64)> {
        self.log_mass.iter().zip(&self.cost).map(|(x, c)| (x.exp(), *c))
    }
}

impl From<MassDistribution> for Curve {
    fn from(d: MassDistribution) -> Self {
        let (mass_kg, cost) = d.costs().unzip();
        Self { mass_kg, cost }
    }
}

impl TryFrom<Curve> for MassDistribution {
    type Error = SysidError;

    fn try_from(curve: Curve) -> Result<Self> {
        if curve.mass_kg.len() != curve.cost.len() {
            return Err(SysidError::Parameter {
                name: "mass: the distribution".into(),
                what: format!("has {} masses and {} costs", curve.mass_kg.len(), curve.cost.len()),
                remedy: "give one cost per mass".into(),
            });
        }
        Self::from_costs(&curve.mass_kg.into_iter().zip(curve.cost).collect::<Vec<_>>())
    }
}

/// Integral of exp(-fall s) over s from 0 to 1.
fn falling(fall: f64) -> f64 {
    if fall < 1e-8 { 1.0 - 0.5 * fall } else { -(-fall).exp_m1() / fall }
}

/// Where on a unit segment whose density falls as exp(-fall s), `fall` at least 0, the share `p` lies below.
fn way_down(p: f64, fall: f64) -> f64 {
    if fall < 1e-8 { p } else { -(p * (-fall).exp_m1()).ln_1p() / fall }
}

/// Mean and variance of s between 0 and 1 with the density exp(-fall s).
fn within(fall: f64) -> (f64, f64) {
    let size = fall.abs();
    // The closed forms lose their digits where the density is even.
    let (mean, variance) = if size < 1e-2 {
        (0.5 - size / 12.0, 1.0 / 12.0 - size * size / 240.0)
    } else {
        (1.0 / size - 1.0 / size.exp_m1(), 1.0 / (size * size) + 1.0 / (size.exp_m1() * (-size).exp_m1()))
    };
    (if fall < 0.0 { 1.0 - mean } else { mean }, variance)
}
