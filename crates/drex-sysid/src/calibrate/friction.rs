//! Friction of alike joints from all their motions at once, touching ones included.
//!
//! In motion at velocity v (sign s) a drive's effort e moves the joint against
//!
//! e = s c + b v + κ (g + x) + I a
//!
//! with Coulomb friction c, viscous friction b, the gravity torque g of the links, what touches the links x, and the inertia I.
//! κ is the load factor: gears lose a share of what they carry, so that a load costs more effort than itself. It shows
//! where gravity changes along the motion, and it is what turns extra effort into contact torque.
//!
//! Contact resists a motion: s x ≥ 0. The residuals s e − … are therefore a mixture of noise and of noise plus something
//! positive (taken as exponential), which expectation maximisation takes apart without being told which finger touches.
//!
//! v is no good regressor while anything touches: the servo behind the effort ties e to v (a saturated one exactly), whatever
//! the load. So b is only looked for where nothing touches, and kept only if it is clearly there.

use nalgebra::{DMatrix, DVector};

use super::signals::STEP;

/// Effort that a contact adds, to begin with, N m.
const USUAL_CONTACT: f64 = 0.05;
/// More no contact of a hand adds, N m.
const MOST_CONTACT: f64 = 10.0;
/// Noise of an effort from which the search starts, N m.
const STARTS: [f64; 4] = [0.004, 0.01, 0.02, 0.04];
/// Share of samples that may lie anywhere.
const STRAY: f64 = 0.05;
/// Noise of an effort that is assumed at least, N m.
const LEAST_NOISE: f64 = 1e-3;
/// Share by which dry friction changes with position.
const ALONG_THE_WAY: f64 = 0.25;
/// Length of a stretch whose mean shows what repeats, s.
const BLOCK: f64 = 0.3;

/// One motion of one joint: consecutive grid points at which it moves.
#[derive(Debug, Clone)]
pub(super) struct Sequence {
    pub run: usize,
    pub joint: usize,
    pub times_s: Vec<f64>,
    /// s e, s g, s a, |v| per grid point.
    pub effort: Vec<f64>,
    pub gravity: Vec<f64>,
    pub acceleration: Vec<f64>,
    pub speed: Vec<f64>,
}

/// What is known of κ beforehand: mean and standard deviation.
#[derive(Debug, Clone, Copy)]
pub(super) struct LoadPrior(pub f64, pub f64);

/// The fit of one group of alike joints.
#[derive(Debug, Clone)]
pub(super) struct Fit {
    /// c, κ, I, b.
    pub values: [f64; 4],
    /// Their covariance.
    pub covariance: [[f64; 4]; 4],
    /// Standard deviation of the effort of a free joint about the fit, N m.
    pub noise: f64,
    /// Standard deviation of its mean over [`BLOCK`], N m: what differs from motion to motion.
    pub repeatability: f64,
    /// Share of I a that the fit misses while the joint accelerates hard.
    pub start_error: f64,
    /// Probability per sample that nothing touches, per sequence.
    pub free: Vec<Vec<f64>>,
    /// Range of the gravity torque over free samples, N m.
    pub gravity_range: f64,
}

/// Fits one group. `None` with fewer than 20 moving grid points.
pub(super) fn fit(sequences: &[Sequence], prior: LoadPrior) -> Option<Fit> {
    let count: usize = sequences.iter().map(|s| s.times_s.len()).sum();
    if count < 20 {
        return None;
    }
    let effort = DVector::from_iterator(count, sequences.iter().flat_map(|s| s.effort.iter().copied()));
    let rows = |viscous: bool| {
        let all = sequences.iter().flat_map(|s| (0..s.times_s.len()).map(move |k| (s, k)));
        let mut x = DMatrix::zeros(count, if viscous { 4 } else { 3 });
        for (i, (s, k)) in all.enumerate() {
            x[(i, 0)] = 1.0;
            x[(i, 1)] = s.gravity[k];
            x[(i, 2)] = s.acceleration[k];
            if viscous {
                x[(i, 3)] = s.speed[k];
            }
        }
        x
    };
    let x = rows(false);
    // Where most motions touch something, a wide start takes contact for noise and a narrow one finds it: the likelier stays.
    let ends = STARTS.iter().filter_map(|&noise| maximise(&x, &effort, noise, prior));
    let (c, state) = ends.max_by(|a, b| a.1.likelihood.total_cmp(&b.1.likelihood))?;
    let mut residual = &effort - &x * &c;
    // Neighbours err alike: count independent stretches, not samples.
    let independent = independence(sequences, residual.as_slice(), &state.weights);
    let thinned: Vec<f64> = state.weights.iter().map(|w| w * independent).collect();
    let (_, mut covariance) = solve(&x, &effort, &thinned, state.noise, prior)?;
    let mut values = [c[0], c[1], c[2], 0.0];
    let with_speed = rows(true);
    if let Some((d, cov)) = solve(&with_speed, &effort, &thinned, state.noise, prior) {
        let r = &effort - &with_speed * &d;
        let better =
            weighted_sd(r.as_slice(), &state.weights) < 0.95 * weighted_sd(residual.as_slice(), &state.weights);
        if d[3] > 3.0 * cov[(3, 3)].sqrt() && better && d[0] > 0.0 {
            (values, covariance, residual) = ([d[0], d[1], d[2], d[3]], cov, r);
        }
    }
    let n = covariance.nrows();
    let covariance =
        std::array::from_fn(|i| std::array::from_fn(|j| if i < n && j < n { covariance[(i, j)] } else { 0.0 }));
    let mut free = Vec::new();
    let mut at = 0;
    for s in sequences {
        free.push(state.weights[at..at + s.times_s.len()].to_vec());
        at += s.times_s.len();
    }
    let noise = weighted_sd(residual.as_slice(), &state.weights).max(LEAST_NOISE);
    Some(Fit {
        // Few motions cannot tell a touch that lasts from friction that changes along the way.
        repeatability: block_sd(sequences, residual.as_slice(), &state.weights)
            .unwrap_or(noise)
            .hypot(ALONG_THE_WAY * values[0].abs() / (sequences.len() as f64).sqrt()),
        start_error: start_error(sequences, residual.as_slice(), values[2], noise),
        gravity_range: gravity_range(sequences, &free),
        values,
        covariance,
        noise,
        free,
    })
}

/// Expectation maximisation from one start.
fn maximise(x: &DMatrix<f64>, y: &DVector<f64>, noise: f64, prior: LoadPrior) -> Option<(DVector<f64>, Mixture)> {
    // Starts and stops are no friction: a few samples may lie anywhere.
    let stray = 1.0 / (y.max() - y.min()).max(LEAST_NOISE);
    let mut state = Mixture {
        weights: vec![1.0; y.len()],
        touched: vec![0.0; y.len()],
        noise,
        contact: USUAL_CONTACT,
        share: 0.3,
        likelihood: 0.0,
        stray,
    };
    // The lower half is freer than the upper: start there.
    let flat = y.iter().sum::<f64>() / y.len() as f64;
    let mut c = solve(x, y, &y.iter().map(|e| if *e < flat { 1.0 } else { 0.1 }).collect::<Vec<_>>(), noise, prior)?.0;
    for _ in 0..80 {
        state.expect((y - x * &c).as_slice());
        c = solve(x, y, &state.weights, state.noise, prior)?.0;
        state.maximise((y - x * &c).as_slice());
    }
    Some((c, state))
}

/// What is noise and what is contact.
struct Mixture {
    /// Probability of each sample that nothing touches, and that something does; the rest are strays.
    weights: Vec<f64>,
    touched: Vec<f64>,
    noise: f64,
    contact: f64,
    share: f64,
    likelihood: f64,
    /// Density of strays, 1/(N m).
    stray: f64,
}

impl Mixture {
    /// The probability of each sample that nothing touches.
    fn expect(&mut self, residual: &[f64]) {
        let (s, rate) = (self.noise, 1.0 / self.contact);
        self.likelihood = 0.0;
        for ((w, held), r) in self.weights.iter_mut().zip(&mut self.touched).zip(residual) {
            let alone = (1.0 - self.share) * (-0.5 * (r / s).powi(2)).exp() / (s * (2.0 * std::f64::consts::PI).sqrt());
            // Normal noise plus an exponential: an exponentially modified normal density.
            let lift = rate * (rate * s * s / 2.0 - r);
            let touched = self.share * rate * lift.min(500.0).exp() * normal_cdf((r - rate * s * s) / s);
            let sum = (1.0 - STRAY) * (alone + touched) + STRAY * self.stray;
            let alone = (1.0 - STRAY) * alone;
            *w = alone / sum;
            *held = (1.0 - STRAY) * touched / sum;
            self.likelihood += sum.ln();
        }
    }

    /// Noise, and share and size of contact, from these.
    fn maximise(&mut self, residual: &[f64]) {
        self.noise = weighted_sd(residual, &self.weights).max(LEAST_NOISE);
        let (free, held): (f64, f64) = (self.weights.iter().sum(), self.touched.iter().sum());
        self.share = (held / (free + held)).clamp(0.01, 0.9);
        if held > 1.0 {
            let sum: f64 = residual.iter().zip(&self.touched).map(|(r, w)| w * r.max(0.0)).sum();
            self.contact = (sum / held).min(MOST_CONTACT).max(3.0 * self.noise);
        }
    }
}

/// Weighted least squares with a normal prior on κ, c ≥ 0 and I ≥ 0 not enforced. Values and covariance.
fn solve(
    x: &DMatrix<f64>,
    y: &DVector<f64>,
    w: &[f64],
    noise: f64,
    prior: LoadPrior,
) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let n = x.ncols();
    let (mut a, mut b) = (DMatrix::zeros(n, n), DVector::zeros(n));
    for i in 0..x.nrows() {
        let row = x.row(i).transpose();
        a += &row * row.transpose() * (w[i] / (noise * noise));
        b += row * (y[i] * w[i] / (noise * noise));
    }
    a[(1, 1)] += prior.1.powi(-2);
    b[1] += prior.0 * prior.1.powi(-2);
    // A joint that hardly accelerates must not make the inertia wild: 0 ± 0.05 kg m² holds for any finger.
    a[(2, 2)] += 0.05f64.powi(-2);
    let inverse = a.try_inverse()?;
    Some((&inverse * b, inverse))
}

fn weighted_sd(r: &[f64], w: &[f64]) -> f64 {
    let (sum, n) = r.iter().zip(w).fold((0.0, 0.0), |(s, n), (r, w)| (s + w * r * r, n + w));
    (sum / n.max(1e-9)).sqrt()
}

/// Independent samples per sample: one over the integrated autocorrelation time of free residuals, in grid points.
fn independence(sequences: &[Sequence], r: &[f64], w: &[f64]) -> f64 {
    let mut time = 1.0;
    for lag in 1..60 {
        let (mut cross, mut own, mut at) = (0.0, 0.0, 0);
        for s in sequences {
            let n = s.times_s.len();
            for k in at..(at + n).saturating_sub(lag) {
                let both = w[k] * w[k + lag];
                cross += both * r[k] * r[k + lag];
                own += both * 0.5 * (r[k] * r[k] + r[k + lag] * r[k + lag]);
            }
            at += n;
        }
        let correlation = if own > 0.0 { cross / own } else { 0.0 };
        if correlation < 0.05 {
            break;
        }
        time += 2.0 * correlation;
    }
    1.0 / time
}

/// Standard deviation of means of free residuals over [`BLOCK`]; `None` with fewer than three.
fn block_sd(sequences: &[Sequence], r: &[f64], w: &[f64]) -> Option<f64> {
    let (mut means, mut at) = (Vec::new(), 0);
    for s in sequences {
        let mut k = 0;
        while k < s.times_s.len() {
            let end = (k..s.times_s.len()).find(|&i| s.times_s[i] - s.times_s[k] > BLOCK).unwrap_or(s.times_s.len());
            let (sum, n) = (k..end).fold((0.0, 0.0), |(a, n), i| (a + w[at + i] * r[at + i], n + w[at + i]));
            if n * STEP > 0.5 * BLOCK {
                means.push(sum / n);
            }
            k = end;
        }
        at += s.times_s.len();
    }
    (means.len() >= 3).then(|| (means.iter().map(|m| m * m).sum::<f64>() / (means.len() - 1) as f64).sqrt())
}

/// Root mean square of residual over I a where |I a| is over three times the noise.
fn start_error(sequences: &[Sequence], r: &[f64], inertia: f64, noise: f64) -> f64 {
    let accelerations = sequences.iter().flat_map(|s| &s.acceleration);
    let hard = accelerations.zip(r).filter(|(a, _)| (inertia * **a).abs() > 3.0 * noise);
    let (sum, n) = hard.fold((0.0, 0.0), |(s, n), (a, r)| (s + (r / (inertia * a)).powi(2), n + 1.0));
    if n > 3.0 { (sum / n).sqrt().min(1.0) } else { 0.5 }
}

fn gravity_range(sequences: &[Sequence], free: &[Vec<f64>]) -> f64 {
    let values = sequences
        .iter()
        .zip(free)
        .flat_map(|(s, w)| s.gravity.iter().zip(w).filter(|(_, w)| **w > 0.5).map(|(g, _)| *g));
    let (lo, hi) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), g| (a.min(g), b.max(g)));
    (hi - lo).max(0.0)
}

/// Cumulative normal distribution; Abramowitz and Stegun 7.1.26, good to 1.5e-7.
fn normal_cdf(z: f64) -> f64 {
    let x = z.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let poly =
        t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let tail = 0.5 * poly * (-x * x).exp();
    if z > 0.0 { 1.0 - tail } else { tail }
}
