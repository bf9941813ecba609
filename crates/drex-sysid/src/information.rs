//! What observations tell about the coordinates at an estimate.
//!
//! Slopes are mean slopes over a few percent: where objects rock and chatter, the exact derivative is that of one brief
//! branch, and what a track can tell follows the mean slope.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::joint::{Candidate, Joint, weighted};
use crate::parameters::Parameter;
use crate::problem::{Problem, Slot};
use crate::{IdentifyOptions, Result};

/// Spans in the logarithm of the mass and of a free friction over which slopes are averaged.
const SPANS: [f64; 3] = [0.03, 0.01, 0.003];
/// The same for the height of a force, metres.
const HEIGHT_SPANS_M: [f64; 3] = [3e-3, 1e-3, 3e-4];
/// Nobody is surer beforehand than this about the logarithm of a mass or a friction of something on a table.
const PRIOR_SD: f64 = 1.0;

/// Information about all coordinates.
pub(crate) struct Information {
    /// Per push: its coordinates.
    own: Vec<Vec<usize>>,
    /// Per push and coordinate: the derivative of the rows, nuisances eliminated.
    pub slopes: Vec<Vec<Vec<f64>>>,
    /// Weight of each row, per push, over the excess of its kind's residuals.
    weights: Vec<Vec<f64>>,
    /// Covariance.
    inverse: DMatrix<f64>,
    /// Variance of log mass if the force had no errors.
    conditional: f64,
    /// Covariance with a weak prior, for what is known although mass and friction are not.
    bounded: DMatrix<f64>,
    friction: Option<usize>,
    /// Standard deviation of log mass from the scatter of the residuals, with their correlation in time.
    pub sandwich: f64,
    /// The same from what the noise of each force amounts to as a factor, weighed by what each push tells.
    pub factor: f64,
    /// What motions that the simulator does not follow may do to log mass, as told by a finger's encoder.
    pub unmodelled: f64,
    /// Mean square of the residuals of the kind that agrees worst; at least one.
    pub scale: f64,
}

impl Information {
    pub(crate) fn of(joint: &Joint, c: &Candidate, options: &IdentifyOptions) -> Result<Self> {
        let all = joint.active(true);
        let n = all.len();
        let mut h = DMatrix::zeros(n, n);
        for (k, coordinate) in joint.coordinates.iter().enumerate() {
            h[(k, k)] += coordinate.prior.map_or(0.0, |(_, sd)| 1.0 / (sd * sd));
        }
        let prior = h.clone();
        let (mut all_own, mut all_slopes, mut weights) = (Vec::new(), Vec::new(), Vec::new());
        let mut scale = 1.0_f64;
        for i in 0..joint.problems.len() {
            let own = joint.coordinates_of(i, &all);
            let slopes: Vec<Vec<f64>> =
                own.par_iter().map(|&k| joint.mean_slope(c, i, joint.coordinates[k].slot, options)).collect();
            let (rows, excess) = joint.whitened(c, i);
            scale = scale.max(excess);
            for (a, &ka) in slopes.iter().zip(&own) {
                for (b, &kb) in slopes.iter().zip(&own) {
                    h[(ka, kb)] += weighted(&rows, a, b);
                }
            }
            all_own.push(own);
            all_slopes.push(slopes);
            weights.push(rows);
        }
        let identity = DMatrix::<f64>::identity(n, n);
        let invert = |m: &DMatrix<f64>| m.clone().cholesky().map(|c| c.inverse());
        let inverse = invert(&(&h + &identity * 1e-9)).unwrap_or_else(|| &identity * 1e9);
        let mut weak = h.clone();
        let friction = joint.friction();
        for k in [Some(0), friction].into_iter().flatten() {
            weak[(k, k)] += 1.0 / (PRIOR_SD * PRIOR_SD);
        }
        let bounded = invert(&weak).unwrap_or(identity);
        let named = joint.active(false);
        let sub = DMatrix::from_fn(named.len(), named.len(), |a, b| {
            h[(named[a], named[b])] + if a == b { 1e-9 } else { 0.0 }
        });
        let conditional = invert(&sub).map_or(1e9, |m| m[(0, 0)]);
        let mut out = Self {
            own: all_own,
            slopes: all_slopes,
            weights,
            inverse,
            conditional,
            bounded,
            friction,
            sandwich: 0.0,
            factor: 0.0,
            unmodelled: 0.0,
            scale,
        };
        out.factor = out.factors(joint);
        out.unmodelled = out.unmodelled(joint, c);
        out.sandwich = out.scatter(joint, c, &prior);
        Ok(out)
    }

    /// The slopes by the coordinates `active` alone, per push.
    pub(crate) fn slopes_of(&self, active: &[usize]) -> Vec<Vec<Vec<f64>>> {
        let pick = |(own, slopes): (&Vec<usize>, &Vec<Vec<f64>>)| {
            own.iter().zip(slopes).filter(|(k, _)| active.contains(k)).map(|(_, s)| s.clone()).collect()
        };
        self.own.iter().zip(&self.slopes).map(pick).collect()
    }

    /// Standard deviation of log mass: noise of poses, encoder and force.
    pub(crate) fn sd(&self) -> f64 {
        self.inverse[(0, 0)].max(0.0).sqrt()
    }

    /// The same without the errors of the force.
    pub(crate) fn sd_of_poses(&self) -> f64 {
        self.conditional.max(0.0).sqrt()
    }

    /// What the errors of the force add.
    pub(crate) fn sd_of_force(&self) -> f64 {
        (self.inverse[(0, 0)] - self.conditional).max(0.0).sqrt()
    }

    /// Standard deviation of coordinate `k`.
    pub(crate) fn sd_of(&self, k: usize) -> f64 {
        self.inverse[(k, k)].max(0.0).sqrt()
    }

    /// What each pose of push `i` tells about log mass, as a share of all that is known of it (encoders and priors have the rest).
    pub(crate) fn shares(&self, joint: &Joint, i: usize) -> Vec<f64> {
        let (own, slopes, rows) = (&self.own[i], &self.slopes[i], &self.weights[i]);
        // The variance is the sum over rows of their weight times the square of how they move log mass.
        let influence = |r: usize| own.iter().zip(slopes).map(|(&k, s)| self.inverse[(0, k)] * s[r]).sum::<f64>();
        let share = |r: usize| rows[r] * influence(r).powi(2) / self.inverse[(0, 0)];
        (0..joint.problems[i].times_s.len()).map(|k| (6 * k..6 * k + 6).map(share).sum()).collect()
    }

    /// Standard deviation of log(friction · mass).
    pub(crate) fn sd_product(&self) -> f64 {
        let Some(f) = self.friction else { return f64::INFINITY };
        let b = &self.bounded;
        (b[(0, 0)] + 2.0 * b[(0, f)] + b[(f, f)]).max(0.0).sqrt()
    }

    /// How the other coordinates follow log mass in the valley.
    pub(crate) fn valley(&self) -> DVector<f64> {
        let v = self.inverse[(0, 0)];
        if v > 0.0 { self.inverse.column(0) / v } else { crate::estimate::unit(self.inverse.nrows(), 0) }
    }

    /// Shift of log mass when the residuals change as given per push, by one Gauss-Newton step.
    pub(crate) fn shift(&self, differences: &[Vec<f64>]) -> f64 {
        let mut g = DVector::zeros(self.inverse.nrows());
        for (((own, slopes), rows), r) in self.own.iter().zip(&self.slopes).zip(&self.weights).zip(differences) {
            for (&k, slope) in own.iter().zip(slopes) {
                g[k] += weighted(rows, slope, r);
            }
        }
        -(self.inverse.row(0) * g)[0]
    }

    /// What an encoder sees the simulator miss, slower than its noise, may go on unseen along the slope of the mass. At most as
    /// much as is seen there moves log mass by as many of its standard deviations; anything up to that is as likely.
    fn unmodelled(&self, joint: &Joint, c: &Candidate) -> f64 {
        let claims = self.claims(joint);
        let square = |(i, claim): (usize, &f64)| {
            let from = 6 * joint.problems[i].times_s.len();
            let rows = self.weights[i].iter().zip(&c.fits[i].residuals).skip(from);
            let whitened: Vec<f64> = rows.map(|(w, r)| w.sqrt() * r).collect();
            let slow: f64 = whitened.windows(2).map(|r| r[0] * r[1]).sum();
            slow.max(0.0) * claim
        };
        self.sd() * (claims.iter().enumerate().map(square).sum::<f64>() / 3.0).sqrt()
    }

    /// A factor on the force of one push moves log mass by the share of the information that comes from this push.
    fn factors(&self, joint: &Joint) -> f64 {
        let square = |(p, c): (&Problem, f64)| (p.factor_sd() * c).powi(2);
        joint.problems.iter().zip(self.claims(joint)).map(square).sum::<f64>().sqrt()
    }

    /// Share of each push in what all tell about the mass.
    fn claims(&self, joint: &Joint) -> Vec<f64> {
        let claim = |i: usize| {
            let mass = self.own[i].iter().position(|&k| k == 0).and_then(|k| self.slopes[i].get(k));
            mass.map_or(0.0, |s| weighted(&self.weights[i], s, s))
        };
        let claims: Vec<f64> = (0..joint.problems.len()).map(claim).collect();
        let all: f64 = claims.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        claims.iter().map(|c| c / all).collect()
    }

    /// Scatter of log mass: how each block's residual moves it, neighbours in time taken together as far as they agree
    /// (the initial positive sequence of Geyer, 1992), and the priors' share.
    fn scatter(&self, joint: &Joint, c: &Candidate, prior: &DMatrix<f64>) -> f64 {
        let row = self.inverse.row(0);
        let mut variance = (row * prior * row.transpose())[0];
        for (i, problem) in joint.problems.iter().enumerate() {
            let (own, slopes, rows, fit) = (&self.own[i], &self.slopes[i], &self.weights[i], &c.fits[i]);
            let influence: Vec<f64> = (0..problem.blocks())
                .map(|k| {
                    let (start, length) = problem.block(k);
                    let range = start..start + length;
                    let of = |slope: &Vec<f64>| {
                        weighted(&rows[range.clone()], &slope[range.clone()], &fit.residuals[range.clone()])
                    };
                    own.iter().zip(slopes).map(|(&n, slope)| row[n] * of(slope)).sum()
                })
                .collect();
            let (poses, readings) = influence.split_at(problem.times_s.len());
            variance += correlated_square(poses) + correlated_square(readings);
        }
        variance.max(0.0).sqrt()
    }
}

impl Joint {
    /// Mean slope of push `i`'s rows by an entry of its values, nuisances eliminated. Of several spans the one in the
    /// middle: a nearby cliff (an object that topples) or a brief chatter is no knowledge.
    fn mean_slope(&self, c: &Candidate, i: usize, slot: Slot, options: &IdentifyOptions) -> Vec<f64> {
        use Parameter::{ContactHeight, ForceGain, Friction, Mass};
        let one;
        let spans: &[f64] = match slot {
            Slot::Named(Mass | Friction | ForceGain) => &SPANS,
            Slot::Named(ContactHeight) => &HEIGHT_SPANS_M,
            Slot::Named(p) => {
                one = [p.scale()];
                &one
            }
            Slot::Error(_) => &[1.0],
        };
        let (problem, fit) = (&self.problems[i], &c.fits[i]);
        let rows = problem.row_weights(fit);
        let mut claims: Vec<(f64, Vec<f64>)> = Vec::new();
        for &span in spans {
            let Some(mut column) = self.secant(c, i, slot, span, options.dt_s) else { continue };
            problem.eliminate(&c.motions[i], fit, std::slice::from_mut(&mut column));
            claims.push((weighted(&rows, &column, &column), column));
        }
        claims.sort_by(|a, b| a.0.total_cmp(&b.0));
        let middle = claims.len().saturating_sub(1) / 2;
        claims.into_iter().nth(middle).map_or_else(|| vec![0.0; fit.residuals.len()], |l| l.1)
    }

    /// Difference quotient of push `i`'s rows by an entry of its values; `None` if one side cannot be simulated.
    pub(crate) fn secant(&self, c: &Candidate, i: usize, slot: Slot, span: f64, dt_s: f64) -> Option<Vec<f64>> {
        let (problem, fit) = (&self.problems[i], &c.fits[i]);
        let side = |x: f64| {
            let mut values = self.values(i, &c.point);
            *values.at_mut(slot)? += x;
            let motion = problem.simulate(&values, dt_s).ok()?;
            Some(problem.residuals(&motion, &fit.nuisance))
        };
        let (low, high) = (side(-span)?, side(span)?);
        Some(low.iter().zip(&high).map(|(a, b)| (b - a) / (2.0 * span)).collect())
    }

    /// Weights of the rows of push `i`, divided by the mean square of the residuals of their kind where that exceeds one;
    /// and the largest such excess.
    fn whitened(&self, c: &Candidate, i: usize) -> (Vec<f64>, f64) {
        let (problem, fit) = (&self.problems[i], &c.fits[i]);
        let mut rows = problem.row_weights(fit);
        let mut worst = 1.0_f64;
        let split = 6 * problem.times_s.len();
        let unknowns = crate::parameters::NUISANCES + 1;
        for (range, unknowns) in [(0..split, unknowns), (split..fit.residuals.len(), 1)] {
            let count: f64 = rows[range.clone()].iter().sum();
            let square: f64 = range.clone().map(|k| rows[k] * fit.residuals[k] * fit.residuals[k]).sum();
            let excess = (square / (count - unknowns as f64).max(1.0)).max(1.0);
            worst = worst.max(excess);
            rows[range].iter_mut().for_each(|w| *w /= excess);
        }
        (rows, worst)
    }

    /// Change of log mass per change of each parameter that was taken as stated. Slopes are taken as those by the mass are, so that a
    /// factor on the force gives the same factor on the mass.
    pub(crate) fn sensitivities(
        &self,
        c: &Candidate,
        information: &Information,
        options: &IdentifyOptions,
    ) -> Vec<(Parameter, f64)> {
        use Parameter::*;
        let all = [Friction, FingerFriction, ContactHeight, ForceGain, ActuatorStiffness, FingerInertia];
        let fixed = |p: &Parameter| !self.coordinates.iter().any(|k| k.slot == Slot::Named(*p));
        let candidates: Vec<Parameter> = all.into_iter().filter(fixed).collect();
        candidates
            .par_iter()
            .filter_map(|&p| {
                let changes: Vec<Vec<f64>> = (0..self.problems.len())
                    .map(|i| match self.problems[i].depends_on(p) {
                        true => self.mean_slope(c, i, Slot::Named(p), options),
                        false => vec![0.0; c.fits[i].residuals.len()],
                    })
                    .collect();
                changes.iter().flatten().any(|x| *x != 0.0).then(|| (p, information.shift(&changes)))
            })
            .collect()
    }
}

/// Square of a sum of numbers in order of time whose neighbours may agree.
fn correlated_square(x: &[f64]) -> f64 {
    let at = |lag: usize| x.iter().zip(&x[lag.min(x.len())..]).map(|(a, b)| a * b).sum::<f64>();
    let mut sum = at(0);
    for lag in (1..x.len() / 2).step_by(2) {
        let pair = at(lag) + at(lag + 1);
        if pair <= 0.0 {
            break;
        }
        sum += 2.0 * pair;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn correlation_in_time_counts() {
        let mut state = 5_u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let white: Vec<f64> = (0..4000).map(|_| next()).collect();
        let plain: f64 = white.iter().map(|x| x * x).sum();
        assert!((correlated_square(&white) / plain - 1.0).abs() < 0.3);
        // Every number five times in a row: five times the square.
        let held: Vec<f64> = white.iter().flat_map(|x| [*x; 5]).collect();
        let ratio = correlated_square(&held) / (5.0 * plain);
        assert!((3.5..6.5).contains(&ratio), "{ratio}");
        // Lags 1 to 4 of eight numbers that are all alike.
        assert_eq!(correlated_square(&[1.0; 8]), 8.0 + 2.0 * (7.0 + 6.0 + 5.0 + 4.0));
    }
}
