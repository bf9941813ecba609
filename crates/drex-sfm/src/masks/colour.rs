//! Colour models: smoothed histograms of RGB.

use super::table::{Fit, fit_density};

/// Bins along each channel.
const BINS: usize = 32;
const CELLS: usize = BINS * BINS * BINS;
/// Share of a model that belongs to colours never seen.
const UNSEEN: f32 = 0.05;
/// Bins with a smaller share of a model say nothing of what is common.
const LEAST_SHARE: f32 = 1e-4;

/// How often each colour occurs.
#[derive(Debug, Clone)]
pub(super) struct Histogram {
    weight: Vec<f32>,
    total: f64,
}

fn bin(colour: [u8; 3]) -> usize {
    let [r, g, b] = colour.map(|c| usize::from(c) * BINS / 256);
    (r * BINS + g) * BINS + b
}

impl Histogram {
    pub fn new() -> Self {
        Self { weight: vec![0.0; CELLS], total: 0.0 }
    }

    pub fn add(&mut self, colour: [u8; 3], weight: f32) {
        self.weight[bin(colour)] += weight;
        self.total += f64::from(weight);
    }

    /// Adds all of another histogram, times `weight`.
    pub fn merge(&mut self, other: &Self, weight: f32) {
        for (a, b) in self.weight.iter_mut().zip(&other.weight) {
            *a += weight * b;
        }
        self.total += other.total * f64::from(weight);
    }

    /// The share of `self` that `other` does not explain: bin by bin, what is left after `other`, brought to the same
    /// total and taken `times`, is removed.
    pub fn without(&self, other: &Self, times: f32) -> Self {
        let scale = (self.total / other.total.max(1e-9)) as f32 * times;
        let weight: Vec<f32> = self.weight.iter().zip(&other.weight).map(|(a, b)| (a - scale * b).max(0.0)).collect();
        let total = weight.iter().map(|w| f64::from(*w)).sum();
        Self { weight, total }
    }

    /// The same, each bin shared out over its neighbours by (1, 2, 1)/4 along each channel, `times` times over.
    pub fn smoothed(mut self, times: usize) -> Self {
        for _ in 0..times {
            for stride in [1, BINS, BINS * BINS] {
                for start in (0..CELLS).filter(|c| c / stride % BINS == 0) {
                    let mut before = self.weight[start];
                    for k in 0..BINS {
                        let at = start + k * stride;
                        let here = self.weight[at];
                        let after = if k + 1 < BINS { self.weight[at + stride] } else { here };
                        self.weight[at] = 0.25 * before + 0.5 * here + 0.25 * after;
                        before = here;
                    }
                }
            }
        }
        self.total = self.weight.iter().map(|w| f64::from(*w)).sum();
        self
    }

    /// Density of a colour, relative to the density if all colours were alike.
    pub fn density(&self, colour: [u8; 3]) -> f32 {
        if !(self.total > 0.0) {
            return 1.0;
        }
        let seen = (f64::from(self.weight[bin(colour)]) / self.total) as f32 * CELLS as f32;
        UNSEEN + (1.0 - UNSEEN) * seen
    }
}

/// How likely colours are where another one is expected: Bayes' rule, with what is common in a model as the prior.
///
/// A photo's noise says how far a colour may be from the expected one, not which colours there are: overexposed paper has one.
pub(super) struct Conditional<'a> {
    model: &'a Histogram,
    /// Spread of the difference to the expected colour, levels of 255.
    sigma: [f32; 3],
    /// Middle and share of the bins that matter.
    common: Vec<([u8; 3], f32)>,
    /// By bin of the expected colour, its density if the model's colours are seen with that spread; not a number before it is asked for.
    evidence: Vec<f32>,
}

impl<'a> Conditional<'a> {
    pub fn new(model: &'a Histogram, noise: &[f32; 3]) -> Self {
        let width = 256 / BINS;
        let share = |bin: usize| (f64::from(model.weight[bin]) / model.total) as f32;
        let middle =
            |bin: usize| [bin / BINS / BINS, bin / BINS % BINS, bin % BINS].map(|k| (k * width + width / 2) as u8);
        let common =
            (0..CELLS).map(|bin| (middle(bin), share(bin))).filter(|(_, share)| *share > LEAST_SHARE).collect();
        // Colours of a bin differ as well.
        let sigma = noise.map(|s| (s * s + (width * width) as f32 / 12.0).sqrt());
        Self { model, sigma, common, evidence: vec![f32::NAN; CELLS] }
    }

    /// Density of a colour with this fit.
    pub fn density(&mut self, seen: [u8; 3], fit: &Fit) -> f32 {
        if self.common.is_empty() {
            return fit.density;
        }
        let at = bin(fit.expected);
        if self.evidence[at].is_nan() {
            let expected = fit.expected.map(f32::from);
            let mean: f32 = self.common.iter().map(|(c, share)| share * fit_density(*c, expected, &self.sigma)).sum();
            self.evidence[at] = UNSEEN + (1.0 - UNSEEN) * mean;
        }
        fit.density * (self.model.density(seen) / self.evidence[at]).max(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn densities_average_to_one_and_smoothing_keeps_the_total() {
        let mut h = Histogram::new();
        for i in 0..200u8 {
            h.add([i, 255 - i, 40], 1.0);
        }
        let h = h.smoothed(2);
        assert!((h.total - 200.0).abs() < 1e-3);
        let mean = (0..CELLS)
            .map(|c| {
                let step = (256 / BINS) as u8;
                h.density([c / BINS / BINS, c / BINS % BINS, c % BINS].map(|k| k as u8 * step))
            })
            .sum::<f32>()
            / CELLS as f32;
        assert!((mean - 1.0).abs() < 1e-3, "{mean}");
        assert!(h.density([100, 155, 40]) > 100.0);
        assert!(h.density([200, 200, 200]) < 0.06);
    }

    #[test]
    fn what_the_background_explains_is_removed() {
        let (mut both, mut background) = (Histogram::new(), Histogram::new());
        both.add([10, 10, 10], 60.0);
        both.add([200, 10, 10], 40.0);
        background.add([10, 10, 10], 7.0);
        let rest = both.without(&background, 1.0);
        assert!((rest.total - 40.0).abs() < 1e-3);
    }

    #[test]
    fn overexposed_paper_is_likely_where_paper_is_expected_and_a_rare_colour_as_likely_as_its_noise_says() {
        let mut background = Histogram::new();
        background.add([255; 3], 30.0);
        (0..70u8).for_each(|k| background.add([3 * k, 200 - 2 * k, 40], 1.0));
        let background = background.smoothed(1);
        let sigma = [10.0; 3];
        let mut of = Conditional::new(&background, &sigma);
        let fit = |seen: [u8; 3], expected: [u8; 3]| {
            let expected = expected.map(f32::from);
            Fit::new(seen, expected, std::iter::once(expected), &sigma)
        };
        let paper = fit([255; 3], [250; 3]);
        // What the paper has of a bin's share of all colours, beside what its noise would have.
        assert!(
            of.density([255; 3], &paper) > 0.7 * background.density([255; 3]) / 0.3,
            "{}",
            of.density([255; 3], &paper)
        );
        assert!(paper.density < 1200.0);
        let rare = fit([20, 30, 200], [22, 33, 205]);
        assert!((of.density([20, 30, 200], &rare) / rare.density - 1.0).abs() < 0.01);
        // Dark where paper is expected is no background, however common.
        assert!(of.density([99, 134, 40], &fit([99, 134, 40], [250; 3])) < 0.01);
    }
}
