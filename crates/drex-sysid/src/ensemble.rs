//! The posterior around a point by statistical linearisation: simulated draws of all unknowns, a line through their residuals, and
//! what the line misses as noise (iterated posterior linearisation; García-Fernández et al., *IEEE Trans. Signal Processing* 63, 2015).
//!
//! Where an object rocks and chatters, a residual is no smooth function of the mass: the derivative at a point is that of one brief
//! branch. The line through draws that are as far apart as the posterior is wide tells what the observations can tell, and what it
//! misses, residual by residual with all its correlation, is what a simulator cannot predict: one latent unknown per draw carries it.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::fit::{CAUCHY, Nuisance};
use crate::joint::{Candidate, Coordinate, Joint, Point};
use crate::noise::{self, normal};
use crate::parameters::NUISANCES;
use crate::problem::{Motion, Problem, Slot};
use crate::{IdentifyOptions, Parameter};

/// Pairs of draws more than there are unknowns; twice as many where the time step is extrapolated.
const SPARE_PAIRS: usize = 10;
/// Farthest that draws are spread, in [`crate::Parameter::scale`]s: a line holds no farther.
const WIDEST: f64 = 3.0;
/// Narrowest that the logarithm of the mass is spread, and how it is spread at first: a slope over less may be one brief branch of a
/// motion that chatters, and says more than two correct simulators agree about.
const NARROWEST: f64 = 0.02;
/// Longest step, in standard deviations of the draws.
const LONGEST: f64 = 3.0;
/// Standard deviation of a logarithm beyond which nothing is known of it.
pub(crate) const UNKNOWN: f64 = 3.0;
/// Share of the variance of chatter that is taken as independent from row to row (shrinkage; Ledoit and Wolf, *J. Multivariate Analysis*
/// 88, 2004): few draws tell its correlations only roughly.
const ALONE: f64 = 0.2;
/// Change, in [`Parameter::scale`]s, over which the mean of draws is differentiated: the slope of the line is that of their mean
/// (Stein, *Annals of Statistics* 9, 1981), as long as the change is small beside their spread.
const SPAN: f64 = 0.4;
/// A mean slope of the mass below this share of the line's tells nothing of other slopes.
const LEAST_SLOPE: f64 = 0.3;
/// Pairs of draws that such a change is made with.
const SLOPE_PAIRS: usize = 6;
/// Draws that are kept.
const BEST: usize = 6;
/// Rounds of weights within one conditioning.
const REWEIGHTED: usize = 8;
/// Tells the noise that is added to a force from the draws.
const NOISE_STREAM: u64 = 0x9e37_79b9_7f4a_7c15;

/// Time steps of a round, seconds.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Steps {
    One(f64),
    /// This step, with errors of the first order of the step and of the forces' noise taken out of the mean motion.
    Extrapolated(f64),
}

/// A normal law of all coordinates, and the errors of each track that go with its mean.
#[derive(Debug, Clone)]
pub(crate) struct Gaussian {
    pub mean: Point,
    pub covariance: DMatrix<f64>,
    pub nuisances: Vec<Nuisance>,
}

/// What one round finds.
pub(crate) struct Round {
    pub gaussian: Gaussian,
    /// Whether the round wanted to go farther than its draws reach.
    pub is_far: bool,
    /// Whether the mass alone did.
    pub mass_is_far: bool,
    /// Minus the logarithm of the evidence, up to a constant.
    pub cost: f64,
    /// Variance of log mass by its source.
    pub sources: Sources,
    /// Per push and pose: what it tells about the mass, as a share of what all observations tell.
    pub shares: Vec<Vec<f64>>,
    /// Per push: factor on the standard deviation of each component of a pose and of the encoder, for what is missed.
    pub excess: Vec<[f64; 7]>,
    /// Per push and row: how a residual moves log mass.
    pub influence: Vec<DVector<f64>>,
    /// The draws that agree best, the best one first.
    pub best: Vec<Candidate>,
}

/// Parts of the variance of log mass; they add up.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sources {
    pub poses: f64,
    pub encoder: f64,
    /// Noise of the force, the factor included.
    pub force: f64,
    pub factor: f64,
    /// What the line misses, and the time step.
    pub contact: f64,
    /// What was known beforehand of everything else.
    pub priors: f64,
}

/// The line through the draws, for one push.
struct Line {
    /// Residuals in the mean.
    mean: DVector<f64>,
    /// Their slopes by the draws' coordinates.
    slopes: DMatrix<f64>,
    /// What the draws have beyond, one column each.
    chatter: DMatrix<f64>,
    /// The part of the variance of that which counts row by row, so that a line that follows chatter by chance tells nothing.
    alone: DVector<f64>,
    /// What errors of the mean of unknown size, of one standard deviation each, look like.
    doubts: Vec<DVector<f64>>,
}

/// What becomes of a push when everything is conditioned.
struct Local {
    /// Columns of the unknowns of this push alone, after those of the draws.
    columns: DMatrix<f64>,
    kinds: Vec<Kind>,
    /// Factor on the standard deviation of each component of a pose and of the encoder.
    excess: [f64; 7],
    /// Per row.
    weights: DVector<f64>,
    precision: DVector<f64>,
    /// Gradient of their priors.
    pull: DVector<f64>,
    /// Values of the unknowns of this push.
    solution: DVector<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Nuisance,
    Factor,
    Contact,
}

impl Joint {
    /// A normal law to begin with around a candidate: what is known beforehand, and no wider than a line holds.
    pub(crate) fn first_guess(&self, from: &Candidate) -> Gaussian {
        let sd = |c: &Coordinate| {
            let widest = if c.slot == Slot::Named(Parameter::Mass) { NARROWEST } else { WIDEST * c.span };
            c.prior.map_or(f64::INFINITY, |(_, sd)| sd).min(widest)
        };
        let variances = self.coordinates.iter().map(|c| sd(c).powi(2));
        Gaussian {
            mean: from.point.clone(),
            covariance: DMatrix::from_diagonal(&DVector::from_iterator(self.coordinates.len(), variances)),
            nuisances: from.fits.iter().map(|f| f.nuisance).collect(),
        }
    }

    /// One round: draws from `gaussian`, the line through them, and the posterior. `None` if too few of them can be simulated.
    pub(crate) fn linearise(&self, gaussian: &Gaussian, steps: Steps, seed: u64) -> Option<Round> {
        let n = self.coordinates.len();
        let root = self.root(&gaussian.covariance)?;
        // What is extrapolated chatters more.
        let (spare, finest) = match steps {
            Steps::One(dt_s) => (SPARE_PAIRS, dt_s),
            Steps::Extrapolated(dt_s) => (2 * SPARE_PAIRS, dt_s),
        };
        let z = standard_draws(n + spare, n, seed);
        let center = self.evaluate_at(&gaussian.mean, &gaussian.nuisances, None, finest)?;
        let draws = self.draws(gaussian, &root, &z, finest, Some(seed));
        // What is taken out of the mean, as far as it is linear: the first order of the time step (Richardson), and what the noise that the
        // forces have and as much again that the draws add make of the motion (simulation extrapolation; Cook and Stefanski, *J. Amer.
        // Statistical Association* 89, 1994).
        let mut others = Vec::new();
        if let Steps::Extrapolated(dt_s) = steps {
            others.push((-1.0, self.draws(gaussian, &root, &z, 2.0 * dt_s, Some(seed))));
            if self.problems.iter().any(|p| p.is_driven_by_noise()) {
                others.push((2.0, self.draws(gaussian, &root, &z, dt_s, None)));
            }
        }
        let succeeds = |of: &[Option<Candidate>], k: usize| of[2 * k].is_some() && of[2 * k + 1].is_some();
        let kept: Vec<usize> =
            (0..z.nrows()).filter(|&k| succeeds(&draws, k) && others.iter().all(|o| succeeds(&o.1, k))).collect();
        if kept.len() < n + 2 {
            return None;
        }
        let mut lines = self.lines(&z.select_rows(&kept), &pairs(&draws, &kept));
        for (i, line) in lines.iter_mut().enumerate() {
            let mean = line.mean.clone();
            for (times, other) in &others {
                let change = mean_residuals(i, pairs(other, &kept).iter().flatten().copied()) - &mean;
                line.mean += &change * *times;
                // Either is as uncertain as one change is large.
                line.doubts.push(change);
            }
        }
        let mut out = self.condition(gaussian, &root, &lines, &center)?;
        out.best = draws.into_iter().flatten().chain([center]).collect();
        out.best.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        out.best.truncate(BEST);
        Some(out)
    }

    /// A square root of a covariance, no wider in any direction than a line holds.
    fn root(&self, covariance: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let widest = DVector::from_iterator(self.coordinates.len(), self.coordinates.iter().map(|c| WIDEST * c.span));
        let mut covariance = covariance.clone();
        if self.coordinates[0].prior.is_none() {
            covariance[(0, 0)] = covariance[(0, 0)].max(NARROWEST * NARROWEST);
        }
        let scaled = covariance.map_with_location(|i, j, x| x / (widest[i] * widest[j]));
        let eigen = scaled.symmetric_eigen();
        let clipped = eigen.eigenvalues.map(|l| l.clamp(1e-14, 1.0));
        let narrow = &eigen.eigenvectors * DMatrix::from_diagonal(&clipped) * eigen.eigenvectors.transpose();
        let lower = narrow.cholesky()?.unpack();
        Some(DMatrix::from_diagonal(&widest) * lower)
    }

    /// The draws `mean ± root z`, in pairs; `None` for one that cannot be simulated. What noise a force has beyond its error shapes is
    /// drawn too if there is a seed for it: to the line it is chatter.
    fn draws(
        &self,
        gaussian: &Gaussian,
        root: &DMatrix<f64>,
        z: &DMatrix<f64>,
        dt_s: f64,
        seed: Option<u64>,
    ) -> Vec<Option<Candidate>> {
        (0..2 * z.nrows())
            .into_par_iter()
            .map(|k| {
                let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
                let point = self.moved(&gaussian.mean, &(root * z.row(k / 2).transpose() * sign));
                let mut random = seed.map(|s| ChaCha8Rng::seed_from_u64(s ^ (NOISE_STREAM + (k / 2) as u64)));
                self.evaluate_at(&point, &gaussian.nuisances, random.as_mut().map(|r| (sign, r)), dt_s)
            })
            .collect()
    }

    /// The line through pairs of draws, per push.
    fn lines(&self, z: &DMatrix<f64>, pairs: &[[&Candidate; 2]]) -> Vec<Line> {
        let (count, n) = (pairs.len() as f64, z.ncols() as f64);
        let inverse = (z.transpose() * z).cholesky().map(|c| c.inverse());
        (0..self.problems.len())
            .map(|i| {
                let of = |sign: f64, [a, b]: &[&Candidate; 2]| {
                    let rows = a.fits[i].residuals.iter().zip(&b.fits[i].residuals);
                    DVector::from_iterator(a.fits[i].residuals.len(), rows.map(|(a, b)| 0.5 * (a + sign * b)))
                };
                let even: Vec<DVector<f64>> = pairs.iter().map(|p| of(1.0, p)).collect();
                let odd: Vec<DVector<f64>> = pairs.iter().map(|p| of(-1.0, p)).collect();
                let (even, odd) = (DMatrix::from_columns(&even), DMatrix::from_columns(&odd));
                let mean = even.column_mean();
                let slopes = match &inverse {
                    Some(inverse) => &odd * z * inverse,
                    None => DMatrix::zeros(mean.len(), z.ncols()),
                };
                let beside = (&odd - &slopes * z.transpose()) / (count - n).max(1.0).sqrt();
                let mut around = even / (count - 1.0).max(1.0).sqrt();
                around.column_iter_mut().for_each(|mut c| c -= &mean / (count - 1.0).max(1.0).sqrt());
                let chatter = DMatrix::from_fn(mean.len(), 2 * pairs.len(), |r, c| {
                    if c < pairs.len() { beside[(r, c)] } else { around[(r, c - pairs.len())] }
                });
                let alone = DVector::from_iterator(mean.len(), chatter.row_iter().map(|r| ALONE * r.norm_squared()));
                Line { mean, slopes, chatter: chatter * (1.0 - ALONE).sqrt(), alone, doubts: Vec::new() }
            })
            .collect()
    }

    /// Change of log mass per change of each parameter that was taken as stated, and how well they can be trusted: the slope of the mass
    /// itself, taken as theirs are, over that of the line. Slopes are differences of means over draws of the posterior; each is compared with
    /// that of the mass. A factor on all forces does what the same factor on the mass undoes, chatter included.
    pub(crate) fn sensitivities(
        &self,
        of: &Round,
        dt_s: f64,
        options: &IdentifyOptions,
    ) -> Option<(Vec<(Parameter, f64)>, f64)> {
        use Parameter::{ActuatorStiffness, ContactHeight, FingerFriction, FingerInertia, ForceGain, Friction, Mass};
        let n = self.coordinates.len();
        let root = self.root(&of.gaussian.covariance)?;
        let z = standard_draws(n + SPARE_PAIRS, n, options.seed).rows(0, SLOPE_PAIRS).into_owned();
        // How log mass follows the change of the mean residuals.
        let moves = |p: Parameter| {
            let side = |by: f64| {
                let shifted = self.with_fixed(p, by);
                let mut gaussian = of.gaussian.clone();
                gaussian.mean[0] += if p == Mass { by } else { 0.0 };
                let draws = shifted.draws(&gaussian, &root, &z, dt_s, Some(options.seed));
                let all: Vec<&Candidate> = draws.iter().map(Option::as_ref).collect::<Option<_>>()?;
                Some((0..self.problems.len()).map(|i| mean_residuals(i, all.iter().copied())).collect::<Vec<_>>())
            };
            let span = SPAN * p.scale();
            let (low, high) = (side(-span)?, side(span)?);
            let by_push = of.influence.iter().zip(low.iter().zip(&high));
            Some(by_push.map(|(x, (a, b))| x.dot(&(b - a))).sum::<f64>() / (2.0 * span))
        };
        let mass = -moves(Mass)?;
        if mass < LEAST_SLOPE {
            return None;
        }
        // Beside a push by a finger it moves only a part of what is observed.
        let known = self.problems.iter().all(|q| q.depends_on(ForceGain));
        let fixed = |p: &Parameter| !self.coordinates.iter().any(|k| k.slot == Slot::Named(*p));
        let out = [Friction, FingerFriction, ContactHeight, ForceGain, ActuatorStiffness, FingerInertia]
            .into_iter()
            .filter(fixed)
            .filter(|p| self.problems.iter().any(|q| q.depends_on(*p)))
            .filter_map(|p| match p {
                ForceGain if known => Some((p, 1.0)),
                _ => moves(p).filter(|x| *x != 0.0).map(|x| (p, x / mass)),
            })
            .collect();
        Some((out, mass))
    }

    /// The posterior of the draws' coordinates, of the errors of the tracks and of what the line misses.
    fn condition(&self, gaussian: &Gaussian, root: &DMatrix<f64>, lines: &[Line], center: &Candidate) -> Option<Round> {
        let n = self.coordinates.len();
        let mut locals: Vec<Local> = (0..lines.len())
            .map(|i| self.problems[i].local(&lines[i], root, &center.motions[i], &gaussian.nuisances[i]))
            .collect();
        let (mut prior, mut pull) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for (k, c) in self.coordinates.iter().enumerate() {
            // Of what nobody knows anything, a prior so wide that it says nothing keeps the covariance finite.
            let (mean, sd) = c.prior.unwrap_or((gaussian.mean[k], UNKNOWN));
            let row = root.row(k).transpose();
            prior += &row * row.transpose() / (sd * sd);
            pull += row * ((gaussian.mean[k] - mean) / (sd * sd));
        }
        let mut step = DVector::zeros(n);
        let mut reduced = Vec::new();
        for round in 1..=REWEIGHTED {
            reduced = lines.iter().zip(&locals).map(|(line, local)| local.reduced(line)).collect::<Option<Vec<_>>>()?;
            let (mut h, mut g) = (prior.clone(), pull.clone());
            for r in &reduced {
                h += &r.matrix;
                g += &r.gradient;
            }
            step = -h.clone().cholesky()?.solve(&g);
            for ((local, line), (r, problem)) in locals.iter_mut().zip(lines).zip(reduced.iter().zip(&self.problems)) {
                local.solution = -(&r.offset + &r.cross * &step);
                // What follows is of the last weights that were solved with: only so do the sources add up.
                if round < REWEIGHTED {
                    local.reweigh(line, &step, problem);
                }
            }
        }
        let mut h = prior.clone();
        reduced.iter().for_each(|r| h += &r.matrix);
        let factor = h.cholesky()?;
        let inverse = factor.inverse();
        let length = step.amax();
        if !length.is_finite() {
            return None;
        }
        // Cost at the minimum, and the width of the law that is integrated over.
        let mut cost = 0.5 * (&prior * &step).dot(&step) + pull.dot(&step);
        cost += factor.l().diagonal().iter().map(|d| d.ln()).sum::<f64>()
            - root.diagonal().iter().map(|d| d.ln()).sum::<f64>();
        for ((line, local), problem) in lines.iter().zip(&locals).zip(&self.problems) {
            cost += local.cost(line, &step, problem)?;
        }
        let row = root.row(0) * &inverse;
        let mut sources = Sources { priors: (&row * &prior).dot(&row), ..Sources::default() };
        // The coordinates that are errors of the force.
        for (k, c) in self.coordinates.iter().enumerate().filter(|(_, c)| matches!(c.slot, Slot::Error(_))) {
            let of = (&row * root.row(k).transpose())[0];
            let variance = c.prior.map_or(0.0, |(_, sd)| (of / sd).powi(2));
            sources.force += variance;
            sources.priors -= variance;
        }
        let mut influence = Vec::new();
        for (i, (line, local)) in lines.iter().zip(&locals).enumerate() {
            let own = -(&reduced[i].cross * row.transpose());
            let by_row = (&line.slopes * row.transpose() + &local.columns * &own).component_mul(&local.weights);
            let poses = 6 * self.problems[i].times_s.len();
            for (r, x) in by_row.iter().enumerate().filter(|(r, _)| local.weights[*r] > 0.0) {
                let variance = x * x / local.weights[r];
                *(if r < poses { &mut sources.poses } else { &mut sources.encoder }) += variance;
            }
            for ((kind, p), x) in local.kinds.iter().zip(local.precision.iter()).zip(own.iter()) {
                let variance = p * x * x;
                match kind {
                    Kind::Nuisance => sources.priors += variance,
                    Kind::Contact => sources.contact += variance,
                    Kind::Factor => {
                        sources.force += variance;
                        sources.factor += variance;
                    }
                }
            }
            influence.push(-by_row);
        }
        // For a line through points it is the share of the information: w a² over the sum of it.
        let observed = (sources.poses + sources.encoder).max(f64::MIN_POSITIVE);
        let shares = influence
            .iter()
            .zip(&locals)
            .enumerate()
            .map(|(i, (x, local))| {
                let share = |r: usize| x[r] * x[r] / local.weights[r].max(f64::MIN_POSITIVE) / observed;
                (0..self.problems[i].times_s.len()).map(|k| (6 * k..6 * k + 6).map(share).sum()).collect()
            })
            .collect();
        let limited = &step * (LONGEST / length).min(1.0);
        Some(Round {
            is_far: length > LONGEST,
            // A root is lower triangular: the first of its coordinates is the mass.
            mass_is_far: step[0].abs() > LONGEST,
            gaussian: Gaussian {
                mean: self.moved(&gaussian.mean, &(root * limited)),
                covariance: if length > LONGEST {
                    gaussian.covariance.clone()
                } else {
                    root * inverse * root.transpose()
                },
                nuisances: gaussian
                    .nuisances
                    .iter()
                    .zip(&locals)
                    .map(|(old, local)| old + local.solution.fixed_rows::<NUISANCES>(0))
                    .collect(),
            },
            cost,
            sources,
            shares,
            excess: locals.iter().map(|l| l.excess).collect(),
            influence,
            best: Vec::new(),
        })
    }
}

impl Sources {
    /// The whole variance.
    pub(crate) fn all(&self) -> f64 {
        self.poses + self.encoder + self.force + self.contact + self.priors
    }
}

/// A push's part of the normal equations, its own unknowns eliminated: those are -(offset + cross z).
struct Reduced {
    matrix: DMatrix<f64>,
    gradient: DVector<f64>,
    offset: DVector<f64>,
    cross: DMatrix<f64>,
}

impl Problem {
    fn local(&self, line: &Line, root: &DMatrix<f64>, motion: &Motion, nuisance: &Nuisance) -> Local {
        let rows = line.mean.len();
        let by_nuisance = self.nuisance_columns(motion, nuisance);
        let mut columns: Vec<DVector<f64>> = (0..NUISANCES)
            .map(|n| DVector::from_fn(rows, |r, _| by_nuisance.get(r / 6).map_or(0.0, |j| j[(r % 6, n)])))
            .collect();
        let mut kinds = vec![Kind::Nuisance; NUISANCES];
        // A factor on the whole force is the same factor on the mass.
        let factor_sd = self.factor_sd();
        let by_mass = root.clone().lu().solve(&DVector::from_fn(root.nrows(), |k, _| f64::from(u8::from(k == 0))));
        if let Some(by_mass) = by_mass.filter(|_| factor_sd > 0.0) {
            columns.push(&line.slopes * by_mass * -factor_sd);
            kinds.push(Kind::Factor);
        }
        columns.extend(line.doubts.iter().cloned());
        columns.extend(line.chatter.column_iter().map(|c| c.into_owned()));
        kinds.resize(columns.len(), Kind::Contact);
        let mut precision = DVector::from_element(columns.len(), 1.0);
        precision.fixed_rows_mut::<NUISANCES>(0).copy_from(&self.nuisance_precision(nuisance));
        let mut pull = DVector::zeros(columns.len());
        let away = (nuisance - self.nuisance_mean()).component_mul(&self.nuisance_precision(nuisance));
        pull.fixed_rows_mut::<NUISANCES>(0).copy_from(&away);
        Local {
            solution: DVector::zeros(columns.len()),
            columns: DMatrix::from_columns(&columns),
            kinds,
            excess: [1.0; 7],
            weights: line.alone.map(|a| 1.0 / (1.0 + a)),
            precision,
            pull,
        }
    }
}

impl Local {
    fn reduced(&self, line: &Line) -> Option<Reduced> {
        let scaled = |m: &DMatrix<f64>| {
            let mut m = m.clone();
            m.column_iter_mut().for_each(|mut c| c.component_mul_assign(&self.weights));
            m
        };
        let (a, b) = (&line.slopes, &self.columns);
        let (wa, wb) = (scaled(a), scaled(b));
        let inner = (b.transpose() * &wb + DMatrix::from_diagonal(&self.precision)).cholesky()?;
        let between = wb.transpose() * a;
        let cross = inner.solve(&between);
        let offset = inner.solve(&(wb.transpose() * &line.mean + &self.pull));
        let matrix = a.transpose() * &wa - between.transpose() * &cross;
        let gradient = wa.transpose() * &line.mean - between.transpose() * &offset;
        Some(Reduced { matrix, gradient, offset, cross })
    }

    fn residuals(&self, line: &Line, step: &DVector<f64>) -> DVector<f64> {
        &line.mean + &line.slopes * step + &self.columns * &self.solution
    }

    /// Weights of the rows for what is left of the residuals: blocks that stand out count little, and a kind of observation that misses
    /// by more than its noise counts as noisy as that, with the correlation in time of what it misses.
    fn reweigh(&mut self, line: &Line, step: &DVector<f64>, problem: &Problem) {
        let left = self.residuals(line, step);
        let poses = problem.times_s.len();
        let old = self.weights.clone();
        let rows_of =
            |kind: usize| if kind < 6 { (kind..6 * poses).step_by(6) } else { (6 * poses..left.len()).step_by(1) };
        for kind in 0..7 {
            let usual: Vec<f64> = rows_of(kind).map(|r| left[r]).collect();
            let misfit = noise::spread(&usual).unwrap_or(0.0);
            // Outliers take no part in how long what is missed lasts.
            let clipped: Vec<f64> = usual.iter().map(|x| x.clamp(-3.0 * misfit, 3.0 * misfit)).collect();
            let beyond = (misfit * misfit - 1.0).max(0.0);
            self.excess[kind] = (1.0 + beyond * correlation_time(&clipped)).sqrt();
        }
        for k in 0..problem.blocks() {
            let (start, length) = problem.block(k);
            let scale = |r: usize| self.excess[if k < poses { r - start } else { 6 }].powi(2) + line.alone[r];
            let size: f64 = (start..start + length).map(|r| left[r] * left[r] / scale(r)).sum();
            let weight = 1.0 / (1.0 + size / CAUCHY);
            let scaled: Vec<f64> = (start..start + length).map(|r| weight / scale(r)).collect();
            self.weights.rows_mut(start, length).copy_from_slice(&scaled);
        }
        // Half the way keeps weights and residuals from chasing each other.
        self.weights.iter_mut().zip(old.iter()).for_each(|(w, o)| *w = (*w * o).sqrt());
    }

    /// Minus the logarithm of the evidence of a push at `step`.
    fn cost(&self, line: &Line, step: &DVector<f64>, problem: &Problem) -> Option<f64> {
        let left = self.residuals(line, step);
        let of = |k: usize| {
            let (start, length) = problem.block(k);
            let rows = start..start + length;
            if k < problem.times_s.len() {
                // As if a track's noise were no more than stated: a mode that misses is no better for being allowed to.
                let size: f64 = rows.map(|r| left[r] * left[r]).sum();
                0.5 * CAUCHY * (size / CAUCHY).ln_1p()
            } else {
                rows.map(|r| 0.5 * (self.weights[r] * left[r] * left[r] - self.weights[r].ln())).sum()
            }
        };
        let data: f64 = (0..problem.blocks()).map(of).sum();
        let own =
            0.5 * self.solution.component_mul(&self.precision).dot(&self.solution) + self.pull.dot(&self.solution);
        let mut wb = self.columns.clone();
        wb.column_iter_mut().for_each(|mut c| c.component_mul_assign(&self.weights));
        let inner = (self.columns.transpose() * wb + DMatrix::from_diagonal(&self.precision)).cholesky()?;
        let width = inner.l().diagonal().iter().map(|d| d.ln()).sum::<f64>() - 0.5 * self.precision.map(f64::ln).sum();
        Some(data + own + width)
    }
}

/// The draws of the pairs `kept`.
fn pairs<'a>(draws: &'a [Option<Candidate>], kept: &[usize]) -> Vec<[&'a Candidate; 2]> {
    kept.iter().filter_map(|&k| Some([draws[2 * k].as_ref()?, draws[2 * k + 1].as_ref()?])).collect()
}

/// Mean residuals of push `i`.
fn mean_residuals<'a>(i: usize, draws: impl Iterator<Item = &'a Candidate>) -> DVector<f64> {
    let (mut sum, mut count) = (DVector::zeros(0), 0.0);
    for c in draws {
        let r = DVector::from_column_slice(&c.fits[i].residuals);
        sum = if count == 0.0 { r } else { sum + r };
        count += 1.0;
    }
    sum / f64::max(count, 1.0)
}

/// Rows of standard normal numbers whose columns are orthogonal and of mean square one, so that a line through `count` pairs of draws is
/// as well conditioned as can be.
fn standard_draws(count: usize, columns: usize, seed: u64) -> DMatrix<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let raw = DMatrix::from_fn(count, columns, |_, _| normal(&mut random));
    let qr = raw.qr();
    // The sign of a column is that of the draws, not of the factorisation.
    let signs = qr.r().diagonal().map(f64::signum);
    let mut q = qr.q() * (count as f64).sqrt();
    q.column_iter_mut().zip(signs.iter()).for_each(|(mut c, s)| c *= *s);
    q
}

/// How many neighbours in time go together: one and twice the sum of the correlations (the initial positive sequence of Geyer, 1992).
fn correlation_time(x: &[f64]) -> f64 {
    let at = |lag: usize| x.iter().zip(&x[lag.min(x.len())..]).map(|(a, b)| a * b).sum::<f64>();
    let all = at(0);
    let mut sum = all;
    for lag in (1..x.len() / 2).step_by(2) {
        let pair = at(lag) + at(lag + 1);
        if pair <= 0.0 {
            break;
        }
        sum += 2.0 * pair;
    }
    if all > 0.0 { (sum / all).max(1.0) } else { 1.0 }
}
