//! Several pushes of one object as one least-squares problem over a list of coordinates, the first of them the logarithm of
//! the mass.

use std::sync::atomic::Ordering;

use nalgebra::{DMatrix, DVector};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::Result;
use crate::fit::{Fit, Nuisance};
use crate::parameters::{Knowledge, NUISANCES, Parameter};
use crate::problem::{Motion, Problem, Slot, Values};

/// Longest Gauss-Newton step in the logarithm of a mass or a friction.
const MAX_STEP: f64 = 0.5;
/// Iterations of one descent to the bottom.
const ITERATIONS: usize = 25;
/// A step that promises less than this much of the cost is not taken; nor is another after one that brought less.
const PROMISE: f64 = 0.01;

/// One estimated number.
#[derive(Debug, Clone)]
pub(crate) struct Coordinate {
    pub slot: Slot,
    /// Pushes that it belongs to.
    pub pushes: Vec<usize>,
    /// Expectation and standard deviation, if there are any.
    pub prior: Option<(f64, f64)>,
    pub start: f64,
    /// Change over which slopes are taken.
    pub span: f64,
    max_step: f64,
    bounds: (f64, f64),
}

/// Values of the coordinates.
pub(crate) type Point = Vec<f64>;

/// The pushes and what is estimated from them.
#[derive(Clone)]
pub(crate) struct Joint {
    pub problems: Vec<Problem>,
    pub coordinates: Vec<Coordinate>,
    /// What is fixed, per push.
    fixed: Vec<Values<f64>>,
}

/// A point with the motions and nuisance fits that belong to it.
pub(crate) struct Candidate {
    pub point: Point,
    pub cost: f64,
    pub motions: Vec<Motion>,
    pub fits: Vec<Fit>,
}

impl Joint {
    /// `frictions` are those that the recordings state.
    pub(crate) fn new(problems: Vec<Problem>, frictions: &[Option<f64>]) -> Self {
        let mut fixed: Vec<Values<f64>> = problems
            .iter()
            .zip(frictions)
            .map(|(p, f)| p.stated(Parameter::Mass.nominal(), f.unwrap_or(Parameter::Friction.nominal()).max(1e-6)))
            .collect();
        let mut coordinates = Vec::new();
        for (n, p) in Parameter::ALL.into_iter().enumerate().take(crate::parameters::SIMULATED) {
            let mut own = Vec::new();
            for (i, values) in fixed.iter_mut().enumerate() {
                // What the recording says; friction may not be said.
                let is_stated = p != Parameter::Friction || frictions[i].is_some();
                let stated = is_stated.then_some(p.of_coordinate(values.named[n]));
                let (start, prior) = match problems[i].parameters.of(p, stated) {
                    Knowledge::Fixed(value) if p != Parameter::Mass => {
                        values.named[n] = p.to_coordinate(value);
                        continue;
                    }
                    Knowledge::Fixed(value) => (p.to_coordinate(value), Some((p.to_coordinate(value), 1e-6))),
                    Knowledge::Free => (values.named[n], None),
                    Knowledge::Prior { mean, sd } => (p.to_coordinate(mean), Some((p.to_coordinate(mean), sd))),
                };
                if problems[i].depends_on(p) {
                    own.push((i, start, prior));
                }
            }
            let Some(&(_, start, prior)) = own.first() else { continue };
            let bounds = match p {
                Parameter::Mass => (1e-6_f64.ln(), 1e4_f64.ln()),
                Parameter::Friction | Parameter::FingerFriction => (0.02_f64.ln(), 3.0_f64.ln()),
                Parameter::JointFriction => (0.0, f64::INFINITY),
                _ => (f64::NEG_INFINITY, f64::INFINITY),
            };
            let max_step = if p.is_logarithmic() { MAX_STEP } else { 10.0 * p.scale() };
            let one = |pushes: Vec<usize>| Coordinate {
                slot: Slot::Named(p),
                pushes,
                prior,
                start,
                span: p.scale(),
                max_step,
                bounds,
            };
            if p.is_of_push() {
                coordinates.extend(own.iter().map(|(i, ..)| one(vec![*i])));
            } else {
                coordinates.push(one(own.iter().map(|(i, ..)| *i).collect()));
            }
        }
        for (i, problem) in problems.iter().enumerate() {
            coordinates.extend((0..problem.errors()).map(|k| Coordinate {
                slot: Slot::Error(k),
                pushes: vec![i],
                prior: Some((0.0, 1.0)),
                start: 0.0,
                span: 1.0,
                max_step: 2.0,
                bounds: (-6.0, 6.0),
            }));
        }
        Self { problems, coordinates, fixed }
    }

    /// How often a push has been simulated so far.
    pub(crate) fn simulations(&self) -> usize {
        self.problems.iter().map(|p| p.simulations.load(Ordering::Relaxed)).sum()
    }

    pub(crate) fn start(&self) -> Point {
        self.coordinates.iter().map(|c| c.start).collect()
    }

    /// Index of the coordinate that is the friction of the support, if it is estimated.
    pub(crate) fn friction(&self) -> Option<usize> {
        self.coordinates.iter().position(|c| c.slot == Slot::Named(Parameter::Friction))
    }

    /// What push `i` is simulated with at a point.
    pub(crate) fn values(&self, i: usize, point: &Point) -> Values<f64> {
        let mut out = self.fixed[i].clone();
        for (c, x) in self.coordinates.iter().zip(point).filter(|(c, _)| c.pushes.contains(&i)) {
            out.set(c.slot, *x);
        }
        out
    }

    /// Indices of the coordinates of push `i`, out of `of`.
    fn coordinates_of(&self, i: usize, of: &[usize]) -> Vec<usize> {
        of.iter().copied().filter(|&c| self.coordinates[c].pushes.contains(&i)).collect()
    }

    /// The coordinates that are not errors of the force.
    pub(crate) fn named(&self) -> Vec<usize> {
        (0..self.coordinates.len()).filter(|&c| matches!(self.coordinates[c].slot, Slot::Named(_))).collect()
    }

    /// Simulates all pushes and fits their nuisances. A simulation that fails counts as an infinite cost.
    pub(crate) fn evaluate(&self, point: Point, guess: Option<&[Fit]>, dt_s: f64) -> Candidate {
        let mut out = Candidate { cost: self.prior_cost(&point), point, motions: Vec::new(), fits: Vec::new() };
        for (i, problem) in self.problems.iter().enumerate() {
            let Ok(motion) = problem.simulate(&self.values(i, &out.point), dt_s) else {
                out.cost = f64::INFINITY;
                return out;
            };
            let fit = problem.fit(&motion, guess.and_then(|g| g.get(i)).map(|g| &g.nuisance));
            out.cost += fit.cost;
            out.fits.push(fit);
            out.motions.push(motion);
        }
        out
    }

    /// Simulates all pushes with the tracks' errors as given and, if `noise` is any, as much noise on what drives them as it has, of that
    /// sign; `None` if a simulation fails.
    pub(crate) fn evaluate_at(
        &self,
        point: &Point,
        nuisances: &[Nuisance],
        mut noise: Option<(f64, &mut ChaCha8Rng)>,
        dt_s: f64,
    ) -> Option<Candidate> {
        let mut out =
            Candidate { cost: self.prior_cost(point), point: point.clone(), motions: Vec::new(), fits: Vec::new() };
        for (i, (problem, nuisance)) in self.problems.iter().zip(nuisances).enumerate() {
            let mut values = self.values(i, point);
            if let Some((sign, random)) = &mut noise {
                values.noise = problem.drive_noise(*sign, random);
            }
            let motion = problem.simulate(&values, dt_s).ok()?;
            let fit = problem.evaluate(&motion, nuisance);
            out.cost += fit.cost;
            out.fits.push(fit);
            out.motions.push(motion);
        }
        out.cost.is_finite().then_some(out)
    }

    /// Costs over a grid of points, on all cores; the order of the result is that of the grid.
    pub(crate) fn costs(&self, grid: &[Point], dt_s: f64) -> Vec<f64> {
        grid.par_iter().map(|p| self.evaluate(p.clone(), None, dt_s).cost).collect()
    }

    fn prior_cost(&self, point: &Point) -> f64 {
        let of = |(c, x): (&Coordinate, &f64)| c.prior.map_or(0.0, |(mean, sd)| 0.5 * ((x - mean) / sd).powi(2));
        self.coordinates.iter().zip(point).map(of).sum()
    }

    /// Levenberg-Marquardt over the coordinates `active` from `now`.
    pub(crate) fn descend(&self, mut now: Candidate, active: &[usize], dt_s: f64) -> Result<Candidate> {
        let mut damping = 1e-3;
        for _ in 0..ITERATIONS {
            if !now.cost.is_finite() {
                break;
            }
            let columns = self.columns_of(&now, active, dt_s)?;
            let (h, g) = self.normal_equations(&now, active, &columns);
            let mut improved = false;
            for _ in 0..6 {
                let mut damped = h.clone();
                for k in 0..active.len() {
                    damped[(k, k)] += h[(k, k)] * damping + 1e-9;
                }
                let Some(step) = damped.cholesky().map(|c| -c.solve(&g)) else { break };
                if -0.5 * g.dot(&step) < PROMISE {
                    break;
                }
                let (point, size) = self.stepped(&now.point, active, &step);
                let next = self.evaluate(point, Some(&now.fits), dt_s);
                if next.cost < now.cost {
                    damping = (damping * 0.2).max(1e-6);
                    improved = size > 1e-3 && now.cost - next.cost > PROMISE;
                    now = next;
                    break;
                }
                damping = (damping * 8.0).max(0.05);
                if size < 1e-3 {
                    break;
                }
            }
            if !improved {
                break;
            }
        }
        Ok(now)
    }

    /// A point moved by `step` in the coordinates `active`, no farther than each may move at once; and the size of the
    /// move, in spans.
    fn stepped(&self, from: &Point, active: &[usize], step: &DVector<f64>) -> (Point, f64) {
        let over =
            active.iter().zip(step.iter()).map(|(&c, x)| x.abs() / self.coordinates[c].max_step).fold(1.0, f64::max);
        let (mut point, mut size) = (from.clone(), 0.0_f64);
        for (&c, x) in active.iter().zip(step.iter()) {
            let (lo, hi) = self.coordinates[c].bounds;
            point[c] = (point[c] + x / over).clamp(lo, hi);
            size = size.max((point[c] - from[c]).abs() / self.coordinates[c].span);
        }
        (point, size)
    }

    /// A point moved by `by`, within what its coordinates can be.
    pub(crate) fn moved(&self, from: &Point, by: &DVector<f64>) -> Point {
        let one = |(c, (x, d)): (&Coordinate, (&f64, &f64))| (x + d).clamp(c.bounds.0, c.bounds.1);
        self.coordinates.iter().zip(from.iter().zip(by.iter())).map(one).collect()
    }

    /// The same with a parameter that is not estimated moved by `by`.
    pub(crate) fn with_fixed(&self, parameter: Parameter, by: f64) -> Self {
        let mut out = self.clone();
        for values in &mut out.fixed {
            values.named[parameter as usize] += by;
        }
        out
    }

    /// Derivatives of each push's residuals by its coordinates among `active`, nuisances eliminated: by dual numbers, and over a standard
    /// deviation for errors of the force, of which a simulation has no duals.
    fn columns_of(&self, c: &Candidate, active: &[usize], dt_s: f64) -> Result<Vec<Vec<Vec<f64>>>> {
        self.problems
            .iter()
            .enumerate()
            .map(|(i, problem)| {
                let of = |k: usize| match self.coordinates[k].slot {
                    Slot::Named(p) => Some(p),
                    Slot::Error(_) => None,
                };
                let own: Vec<Parameter> = self.coordinates_of(i, active).into_iter().filter_map(of).collect();
                let values = self.values(i, &c.point);
                let mut columns = problem.slopes(&values, &own, &c.fits[i], dt_s)?;
                for k in self.coordinates_of(i, active).into_iter().filter(|&k| of(k).is_none()) {
                    let at = |by: f64| {
                        let mut values = values.clone();
                        values.set(self.coordinates[k].slot, c.point[k] + by);
                        problem.simulate(&values, dt_s).map(|m| problem.residuals(&m, &c.fits[i].nuisance))
                    };
                    columns.push(at(0.5)?.iter().zip(at(-0.5)?).map(|(b, a)| b - a).collect());
                }
                problem.eliminate(&c.motions[i], &c.fits[i], &mut columns);
                Ok(columns)
            })
            .collect()
    }

    /// Gauss-Newton matrix and gradient over `active`, priors included.
    fn normal_equations(
        &self,
        c: &Candidate,
        active: &[usize],
        columns: &[Vec<Vec<f64>>],
    ) -> (DMatrix<f64>, DVector<f64>) {
        let n = active.len();
        let (mut h, mut g) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for (k, &coordinate) in active.iter().enumerate() {
            if let Some((mean, sd)) = self.coordinates[coordinate].prior {
                h[(k, k)] += 1.0 / (sd * sd);
                g[k] += (c.point[coordinate] - mean) / (sd * sd);
            }
        }
        for (i, problem) in self.problems.iter().enumerate() {
            let fit = &c.fits[i];
            let (rows, residuals) = (problem.row_weights(fit), problem.with_priors(fit));
            let own: Vec<usize> = (0..n).filter(|&k| self.coordinates[active[k]].pushes.contains(&i)).collect();
            for (a, ka) in columns[i].iter().zip(&own) {
                for (b, kb) in columns[i].iter().zip(&own).filter(|(_, kb)| *kb <= ka) {
                    let x = weighted(&rows, a, b);
                    h[(*ka, *kb)] += x;
                    if ka != kb {
                        h[(*kb, *ka)] += x;
                    }
                }
                g[*ka] += weighted(&rows, a, &residuals);
            }
        }
        (h, g)
    }
}

impl Problem {
    /// Whether a simulated parameter plays a part in this push.
    pub(crate) fn depends_on(&self, p: Parameter) -> bool {
        use Parameter::*;
        match p {
            ForceGain => self.can_weigh() && !self.has_finger(),
            FingerFriction | ActuatorStiffness | ActuatorDamping | FingerInertia | JointFriction => self.has_finger(),
            ContactHeight => self.can_weigh(),
            _ => true,
        }
    }

    /// The weight of each row, those of the nuisances' priors at the end.
    fn row_weights(&self, fit: &Fit) -> Vec<f64> {
        let observed = (0..self.blocks()).flat_map(|k| std::iter::repeat_n(fit.weights[k], self.block(k).1));
        observed.chain(std::iter::repeat_n(1.0, NUISANCES)).collect()
    }
}

/// Σ w a b.
fn weighted(w: &[f64], a: &[f64], b: &[f64]) -> f64 {
    w.iter().zip(a).zip(b).map(|((w, a), b)| w * a * b).sum()
}
