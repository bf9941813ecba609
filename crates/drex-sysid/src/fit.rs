//! How well a simulated motion agrees with what was observed, and how that changes with the parameters.
//!
//! Pose residuals are geodesic: translation in the world, rotation vector of q_sim⁻¹ q_obs in the body, each over its
//! standard deviation; encoder residuals are those of the tip along the push. A block is one pose or one reading: it is weighed as a whole
//! (Cauchy's loss), so that an outlier of the tracker counts little. Errors of the track (clock, bias, drift) are nuisances with
//! priors; they never need a new simulation.

use drex_core::Pose;
use drex_core::pose::pose_difference;
use drex_diffsim::{Dual, Scalar, tangents};
use nalgebra::{DMatrix, SMatrix, SVector, Vector6};

use crate::Result;
use crate::parameters::{NUISANCES, Parameter};
use crate::problem::{Action, Motion, Problem, Schedule, Values};

pub(crate) type Nuisance = SVector<f64, NUISANCES>;
type NuisanceMatrix = SMatrix<f64, NUISANCES, NUISANCES>;
type Columns = SMatrix<f64, 6, NUISANCES>;

/// Squared whitened residual of a block from which on it counts as suspicious.
pub(crate) const CAUCHY: f64 = 40.0;
/// Clock offset, either way, that a fit without a guess is tried from, seconds.
const OFFSET_S: f64 = 0.04;
/// Derivatives carried by one simulation, at most.
const LANES: usize = 8;
/// Poses show a motion if in their order they agree better with it than in any order, by this many standard deviations;
const SHOWN: f64 = 4.0;
/// or, where they are few, by this share of the √(n - 1) that n poses without noise can reach.
const SHOWN_SHARE: f64 = 0.75;
/// Poses that are looked at for that, at most.
const COMPARED: usize = 150;

/// Fit of the nuisances to a motion.
#[derive(Debug, Clone)]
pub(crate) struct Fit {
    pub cost: f64,
    pub nuisance: Nuisance,
    /// Whitened residuals: six per pose, then one per reading of the encoder.
    pub residuals: Vec<f64>,
    /// One weight per pose, then one per reading.
    pub weights: Vec<f64>,
}

impl Problem {
    /// Row at which the block starts, and its length.
    pub(crate) fn block(&self, k: usize) -> (usize, usize) {
        let n = self.times_s.len();
        if k < n { (6 * k, 6) } else { (5 * n + k, 1) }
    }

    /// Poses and readings.
    pub(crate) fn blocks(&self) -> usize {
        self.times_s.len() + self.readings()
    }

    /// Nuisances and weights that fit the track best to a motion, from `guess` or, without one, from several clock offsets: a brief
    /// motion that two clocks keep apart shows no way to it.
    pub(crate) fn fit(&self, motion: &Motion, guess: Option<&Nuisance>) -> Fit {
        let mean = self.nuisance_mean();
        let Some(guess) = guess else {
            let apart = |s: f64| {
                let mut from = mean;
                from[0] += s * OFFSET_S;
                self.fit_from(motion, &from)
            };
            let earlier_or_later = if self.nuisances[0].heavy { [-1.0, 1.0].as_slice() } else { &[] };
            let best = |a: Fit, b: Fit| if b.cost < a.cost { b } else { a };
            return earlier_or_later.iter().map(|s| apart(*s)).fold(self.fit_from(motion, &mean), best);
        };
        self.fit_from(motion, guess)
    }

    /// The same by iterated reweighting from `guess`.
    fn fit_from(&self, motion: &Motion, guess: &Nuisance) -> Fit {
        let mean = self.nuisance_mean();
        let mut last = self.evaluate(motion, guess);
        for _ in 0..8 {
            let columns = self.nuisance_columns(motion, &last.nuisance);
            let prior = self.nuisance_precision(&last.nuisance);
            let mut h = NuisanceMatrix::from_diagonal(&prior);
            let mut g = -(last.nuisance - mean).component_mul(&prior);
            for ((r, w), j) in last.residuals.chunks_exact(6).zip(&last.weights).zip(&columns) {
                h += j.transpose() * j * *w;
                g -= j.transpose() * Vector6::from_column_slice(r) * *w;
            }
            let Some(step) = h.cholesky().map(|c| c.solve(&g)) else { break };
            let mut next = self.evaluate(motion, &(last.nuisance + step));
            let mut shrink = 1.0;
            while next.cost > last.cost && shrink > 0.05 {
                shrink *= 0.4;
                next = self.evaluate(motion, &(last.nuisance + step * shrink));
            }
            let gain = last.cost - next.cost;
            if gain <= 0.0 {
                break;
            }
            last = next;
            if gain < 1e-6 * (1.0 + last.cost) {
                break;
            }
        }
        last
    }

    /// Residuals, weights and cost at given nuisances.
    pub(crate) fn evaluate(&self, motion: &Motion, nuisance: &Nuisance) -> Fit {
        let residuals = self.residuals(motion, nuisance);
        let mut cost: f64 = self.nuisances.iter().zip(nuisance.iter()).map(|(e, x)| e.cost(*x)).sum();
        let weights = (0..self.blocks())
            .map(|k| {
                let (start, length) = self.block(k);
                let size: f64 = residuals[start..start + length].iter().map(|r| r * r).sum();
                cost += 0.5 * CAUCHY * (size / CAUCHY).ln_1p();
                1.0 / (1.0 + size / CAUCHY)
            })
            .collect();
        Fit { cost, nuisance: *nuisance, residuals, weights }
    }

    /// How well the poses show the motion that `fit` belongs to, as a share of what it takes: poses of something at rest, or of another
    /// motion, agree with it as well in any other order. Mean and variance of the cost over all orders are those of Hoeffding (1951).
    pub(crate) fn shown(&self, motion: &Motion, fit: &Fit) -> f64 {
        let every = self.times_s.len().div_ceil(COMPARED);
        let frames: Vec<usize> = (0..self.times_s.len()).step_by(every.max(1)).collect();
        let n = frames.len();
        let bias = fit.nuisance.fixed_rows::<6>(1);
        let sds = self.sds();
        let cost = DMatrix::from_fn(n, n, |i, j| {
            let (t, observed) = (self.times_s[frames[i]], &self.observed[frames[j]]);
            let r = pose_difference(&motion.at(t - fit.nuisance[0]), observed) - bias;
            let size: f64 = r.iter().zip(sds).map(|(r, sd)| (r / sd).powi(2)).sum();
            0.5 * CAUCHY * (size / CAUCHY).ln_1p()
        });
        let (of_time, of_pose, mean) = (cost.column_mean(), cost.row_mean(), cost.mean());
        let spread = cost.map_with_location(|i, j, c| (c - of_time[i] - of_pose[j] + mean).powi(2)).sum();
        let most = (n as f64 - 1.0).max(1.0).sqrt();
        let sd = spread.sqrt() / most;
        // Less than one in cost is nothing, however sure.
        (n as f64 * mean - cost.trace()) / (SHOWN.min(SHOWN_SHARE * most) * sd.max(1.0))
    }

    /// Whitened residuals of a motion.
    pub(crate) fn residuals(&self, motion: &Motion, nuisance: &Nuisance) -> Vec<f64> {
        let mut out = Vec::with_capacity(6 * self.times_s.len() + self.readings());
        for (t, observed) in self.times_s.iter().zip(&self.observed) {
            let mut r = pose_difference(&motion.at(t - nuisance[0]), observed) - nuisance.fixed_rows::<6>(1);
            r[2] -= nuisance[7] * t;
            out.extend(r.iter().zip(self.sds()).map(|(r, sd)| r / sd));
        }
        if let Action::Finger(finger) = &self.action {
            for (k, q) in motion.tips.iter().enumerate() {
                out.push((finger.encoder[k] - q) / self.encoder_m);
            }
        }
        out
    }

    /// Standard deviation of each component of a pose.
    pub(crate) fn sds(&self) -> [f64; 6] {
        let (p, r) = (self.noise.position_m, self.noise.rotation_rad);
        std::array::from_fn(|i| self.excess[i] * if i < 3 { p } else { r })
    }

    /// Derivative of each pose's residual by the nuisances. A later clock shows the motion of an earlier time: the
    /// column of the offset is the velocity.
    pub(crate) fn nuisance_columns(&self, motion: &Motion, nuisance: &Nuisance) -> Vec<Columns> {
        let sd = self.sds();
        self.times_s
            .iter()
            .map(|t| {
                let mut j = Columns::zeros();
                let (v, w) = motion.velocity_at(t - nuisance[0]);
                for i in 0..3 {
                    j[(i, 0)] = v[i] / sd[i];
                    j[(i + 3, 0)] = w[i] / sd[i + 3];
                }
                for i in 0..6 {
                    j[(i, 1 + i)] = -1.0 / sd[i];
                }
                j[(2, 7)] = -t / sd[2];
                j
            })
            .collect()
    }

    pub(crate) fn nuisance_mean(&self) -> Nuisance {
        Nuisance::from_fn(|i, _| self.nuisances[i].mean)
    }

    /// One over the variance of each nuisance beforehand, as felt at a value.
    pub(crate) fn nuisance_precision(&self, at: &Nuisance) -> Nuisance {
        Nuisance::from_fn(|i, _| self.nuisances[i].precision(at[i]))
    }

    /// The residuals, and those of the nuisances' priors, as [`Problem::eliminate`] appends them.
    pub(crate) fn with_priors(&self, fit: &Fit) -> Vec<f64> {
        let precision = self.nuisance_precision(&fit.nuisance);
        let priors = (fit.nuisance - self.nuisance_mean()).component_mul(&precision.map(f64::sqrt));
        fit.residuals.iter().chain(priors.iter()).copied().collect()
    }

    /// Derivatives of the residuals by the parameters `of`, at the nuisances of `fit`, through dual numbers.
    pub(crate) fn slopes(&self, values: &Values<f64>, of: &[Parameter], fit: &Fit, dt_s: f64) -> Result<Vec<Vec<f64>>> {
        let mut out = Vec::with_capacity(of.len());
        for some in of.chunks(LANES) {
            out.extend(match some.len() {
                1 => self.slopes_of::<1>(values, some, fit, dt_s)?,
                2 => self.slopes_of::<2>(values, some, fit, dt_s)?,
                3 | 4 => self.slopes_of::<4>(values, some, fit, dt_s)?,
                _ => self.slopes_of::<LANES>(values, some, fit, dt_s)?,
            });
        }
        Ok(out)
    }

    fn slopes_of<const N: usize>(
        &self,
        values: &Values<f64>,
        of: &[Parameter],
        fit: &Fit,
        dt_s: f64,
    ) -> Result<Vec<Vec<f64>>> {
        let mut values = values.lift::<Dual<N>>();
        for (n, p) in of.iter().enumerate() {
            let x = &mut values.named[*p as usize];
            *x = drex_diffsim::parameter::<N>(x.re, n);
        }
        let begin = self.begin_s();
        let poses: Vec<f64> = self.times_s.iter().map(|t| (t - fit.nuisance[0]).max(begin)).collect();
        let schedule = Schedule::new(&poses, self.encoder_times_s());
        let record = self.run(&values, dt_s, &schedule.times_s)?;
        let mut out = vec![Vec::with_capacity(fit.residuals.len()); of.len()];
        let sd = self.sds();
        for &k in &schedule.first {
            let pose = &record.bodies[0].poses[k];
            let q = pose.rotation.quaternion();
            let back = value_of(pose).rotation.quaternion().conjugate();
            let dp = [0, 1, 2].map(|i| tangents(&pose.translation.vector[i]));
            let dq = [q.w, q.i, q.j, q.k].map(|x| tangents(&x));
            for (n, column) in out.iter_mut().enumerate() {
                // The body rotation vector of a small change: 2 Im(q⁻¹ dq). The residual turns by its opposite.
                let change = nalgebra::Quaternion::new(dq[0][n], dq[1][n], dq[2][n], dq[3][n]);
                let turn = (back * change).imag() * 2.0;
                column.extend((0..3).map(|i| -dp[i][n] / sd[i]));
                column.extend((0..3).map(|i| -turn[i] / sd[i + 3]));
            }
        }
        for &k in &schedule.second {
            let q = record.joints.first().and_then(|j| j.get(k)?.first());
            for (n, column) in out.iter_mut().enumerate() {
                column.push(q.map_or(0.0, |q| -q.tangent(n) / self.encoder_m));
            }
        }
        Ok(out)
    }

    /// Takes the part that nuisances can take over out of columns of derivatives, at the motion and weights of `fit`. What the
    /// nuisances' priors say to that is appended, one row per nuisance.
    pub(crate) fn eliminate(&self, motion: &Motion, fit: &Fit, columns: &mut [Vec<f64>]) {
        let by_nuisance = self.nuisance_columns(motion, &fit.nuisance);
        let precision = self.nuisance_precision(&fit.nuisance);
        let mut h = NuisanceMatrix::from_diagonal(&precision);
        for (j, w) in by_nuisance.iter().zip(&fit.weights) {
            h += j.transpose() * j * *w;
        }
        let Some(inverse) = h.cholesky() else { return };
        for column in columns {
            let mut cross = Nuisance::zeros();
            for ((j, p), w) in by_nuisance.iter().zip(column.chunks_exact(6)).zip(&fit.weights) {
                cross += j.transpose() * Vector6::from_column_slice(p) * *w;
            }
            let taken = inverse.solve(&cross);
            for (j, p) in by_nuisance.iter().zip(column.chunks_exact_mut(6)) {
                for (p, x) in p.iter_mut().zip((j * taken).iter()) {
                    *p -= x;
                }
            }
            column.extend(precision.iter().zip(taken.iter()).map(|(p, x)| -p.sqrt() * x));
        }
    }
}

fn value_of<const N: usize>(pose: &Pose<Dual<N>>) -> Pose {
    let q = pose.rotation.quaternion();
    let q = nalgebra::Quaternion::new(q.w.re, q.i.re, q.j.re, q.k.re);
    Pose::from_parts(pose.translation.vector.map(|x| x.re).into(), nalgebra::UnitQuaternion::new_unchecked(q))
}
