//! The estimator: scan of the logarithm of the mass, Gauss-Newton with dual-number derivatives from the best cells,
//! likelihood profile, sandwich, and what the noise of the force and the choice of contact do to the estimate.

use drex_diffsim::ForcePoint;
use nalgebra::{Matrix2, SMatrix, Vector2, Vector6};
use rayon::prelude::*;

use crate::answer::ErrorBudget;
use crate::problem::{Action, Fit, Linear, Motion, NUISANCES, Parameters, Problem};
use crate::random::Normal;
use crate::{IdentifyOptions, Result};

/// Two correct simulators of rigid contact disagree about a mass by this much (relative).
const MODEL_FLOOR: f64 = 0.005;
/// The same for a push by a fingertip that slides and chatters on the object, against MuJoCo.
const FINGER_FLOOR: f64 = 0.03;
/// Draws that carry the force noise into the estimate.
const DRAWS: usize = 24;
/// Friction coefficients of the scan when friction is free.
const FRICTIONS: [f64; 6] = [0.12, 0.2, 0.3, 0.45, 0.65, 0.9];
/// Spans in the logarithms over which slopes are averaged.
const SPANS: [f64; 3] = [0.03, 0.01, 0.003];
/// Nobody is surer beforehand than this about the logarithm of a mass or a friction of something on a table.
const PRIOR_SD: f64 = 1.0;
/// Longest Gauss-Newton step in the logarithms.
const MAX_STEP: f64 = 0.5;

/// Several pushes of one object with one mass and, if it is free, one friction.
pub(crate) struct Joint<'a> {
    pub problems: &'a [Problem],
    /// Known friction per push; `None` where it is free.
    pub friction: Vec<Option<f64>>,
    pub options: &'a IdentifyOptions,
}

/// A point in parameter space with the motions and nuisance fits that belong to it.
pub(crate) struct Candidate {
    pub parameters: Parameters,
    pub cost: f64,
    pub motions: Vec<Motion>,
    pub fits: Vec<Fit>,
}

/// What the estimator found.
pub(crate) struct Estimate {
    pub best: Candidate,
    pub profile: Vec<(f64, f64)>,
    pub budget: ErrorBudget,
    /// Standard deviation of log mass, everything together.
    pub sd: f64,
    /// Standard deviation of log(friction · mass), if friction is free.
    pub sd_mu_m: Option<f64>,
    /// Cost at the worst mass of the scan minus cost at the best.
    pub relief: f64,
}

impl Joint<'_> {
    fn friction_free(&self) -> bool {
        self.friction.iter().any(Option::is_none)
    }

    fn at(&self, p: &Parameters, i: usize) -> Parameters {
        Parameters { log_friction: self.friction[i].map_or(p.log_friction, f64::ln), ..*p }
    }

    /// Simulates all pushes and fits their nuisances. A simulation that fails counts as an infinite cost.
    fn evaluate(&self, parameters: Parameters, guess: Option<&[Fit]>) -> Candidate {
        let mut out = Candidate { parameters, cost: 0.0, motions: Vec::new(), fits: Vec::new() };
        for (i, problem) in self.problems.iter().enumerate() {
            let Ok(motion) = problem.simulate(&self.at(&parameters, i)) else {
                out.cost = f64::INFINITY;
                return out;
            };
            let fit = problem.fit(&motion, guess.and_then(|g| g.get(i)));
            out.cost += fit.cost;
            out.fits.push(fit);
            out.motions.push(motion);
        }
        out
    }

    /// Costs over a grid of parameters, on all cores; the order of the result is that of the grid.
    fn costs(&self, grid: &[Parameters]) -> Vec<f64> {
        grid.par_iter().map(|p| self.evaluate(*p, None).cost).collect()
    }

    /// The whole estimate.
    pub(crate) fn solve(&self) -> Result<Estimate> {
        let scan = self.refined(self.scan());
        if scan.iter().all(|s| !s.1.is_finite()) {
            // No mass can be simulated: say why.
            for (i, problem) in self.problems.iter().enumerate() {
                problem.simulate(&self.at(&scan[scan.len() / 2].0, i))?;
            }
        }
        let worst = scan.iter().map(|s| s.1).filter(|c| c.is_finite()).fold(f64::NEG_INFINITY, f64::max);
        let mut profile: Vec<(f64, f64)> = scan.iter().map(|(p, c)| (p.log_mass.exp(), *c)).collect();
        let mut best: Option<Candidate> = None;
        let starts = minima(&scan);
        let found: Vec<Result<Candidate>> = starts.par_iter().map(|p| self.descend(*p)).collect();
        for candidate in found {
            let candidate = candidate?;
            if best.as_ref().is_none_or(|b| candidate.cost < b.cost) {
                best = Some(candidate);
            }
        }
        let mut best = best
            .unwrap_or_else(|| self.evaluate(Parameters { log_mass: 0.2_f64.ln(), log_friction: 0.5_f64.ln() }, None));
        let mut information = Information::of(self, &best)?;
        let mut fine = Vec::new();
        for _ in 0..4 {
            fine = self.around(&best, &information);
            let lowest = fine.iter().min_by(|a, b| a.1.total_cmp(&b.1)).copied();
            match lowest {
                Some((p, c)) if c < best.cost - 0.02 => {
                    let refined = self.descend(p)?;
                    best = refined;
                    information = Information::of(self, &best)?;
                }
                _ => break,
            }
        }
        profile.extend(fine.iter().map(|(p, c)| (p.log_mass.exp(), *c)));
        profile.push((best.parameters.log_mass.exp(), best.cost));
        profile.retain(|(_, c)| c.is_finite());
        profile.sort_by(|a, b| a.0.total_cmp(&b.0));
        let scale = information.scale;
        let budget = ErrorBudget {
            poses: information.sd(scale),
            sandwich: information.sandwich,
            profile: profile_sd(&fine, &best, scale),
            force: self.force_sd(&best, &information),
            contact: self.contact_sd(&best, &information),
        };
        let random = budget.poses.max(budget.sandwich).max(budget.profile);
        let floor = if self.problems.iter().any(Problem::is_pushed_by_finger) { FINGER_FLOOR } else { MODEL_FLOOR };
        let sd = (random.powi(2) + budget.force.powi(2) + budget.contact.powi(2) + floor.powi(2)).sqrt();
        let sd_mu_m = self.friction_free().then(|| information.sd_product(scale));
        Ok(Estimate { relief: worst - best.cost, best, profile, budget, sd, sd_mu_m })
    }

    /// Cost over the grid of masses (and, if it is free, of frictions: the best of each mass is kept).
    fn scan(&self) -> Vec<(Parameters, f64)> {
        let n = self.options.scan_points.max(5);
        let (lo, hi) = (self.options.scan_kg[0].ln(), self.options.scan_kg[1].ln());
        let step = (hi - lo) / (n - 1) as f64;
        let frictions: Vec<f64> = if self.friction_free() { FRICTIONS.to_vec() } else { vec![0.5] };
        let column = |masses: &[f64]| -> Vec<(Parameters, f64)> {
            let grid: Vec<Parameters> = masses
                .iter()
                .flat_map(|&log_mass| frictions.iter().map(move |f| Parameters { log_mass, log_friction: f.ln() }))
                .collect();
            let costs = self.costs(&grid);
            grid.chunks(frictions.len())
                .zip(costs.chunks(frictions.len()))
                .map(|(p, c)| {
                    let k = (0..c.len()).min_by(|&a, &b| c[a].total_cmp(&c[b])).unwrap_or(0);
                    (p[k], c[k])
                })
                .collect()
        };
        let mut scan = column(&(0..n).map(|k| lo + k as f64 * step).collect::<Vec<_>>());
        for _ in 0..4 {
            let best = (0..scan.len()).min_by(|&a, &b| scan[a].1.total_cmp(&scan[b].1)).unwrap_or(0);
            let flat = scan.iter().all(|s| (s.1 - scan[best].1).abs() < 1e-3 || !s.1.is_finite());
            if flat {
                break;
            } else if best == 0 {
                let first = scan[0].0.log_mass;
                let mut more = column(&(1..=4).rev().map(|k| first - f64::from(k) * step).collect::<Vec<_>>());
                more.append(&mut scan);
                scan = more;
            } else if best + 1 == scan.len() {
                let last = scan[best].0.log_mass;
                scan.extend(column(&(1..=4).map(|k| last + f64::from(k) * step).collect::<Vec<_>>()));
            } else {
                break;
            }
        }
        scan
    }

    /// The scan with the cells around its two best minima divided: where an object rocks, the cost has narrow valleys.
    fn refined(&self, mut scan: Vec<(Parameters, f64)>) -> Vec<(Parameters, f64)> {
        const PARTS: usize = 8;
        let mut more = Vec::new();
        for center in minima(&scan).into_iter().take(2) {
            let Some(k) = scan.iter().position(|s| s.0 == center) else { continue };
            for neighbour in [k.checked_sub(1), Some(k + 1)].into_iter().flatten().filter_map(|i| scan.get(i)) {
                let (a, b) = (center.log_mass, neighbour.0.log_mass);
                more.extend(
                    (1..PARTS).map(|i| Parameters { log_mass: a + (b - a) * i as f64 / PARTS as f64, ..center }),
                );
            }
        }
        let costs = self.costs(&more);
        scan.extend(more.into_iter().zip(costs));
        scan.sort_by(|a, b| a.0.log_mass.total_cmp(&b.0.log_mass));
        scan.dedup_by(|a, b| a.0.log_mass == b.0.log_mass);
        scan
    }

    /// Levenberg-Marquardt from `start`.
    fn descend(&self, start: Parameters) -> Result<Candidate> {
        let mut now = self.evaluate(start, None);
        let mut damping = 1e-3;
        for _ in 0..25 {
            if !now.cost.is_finite() {
                break;
            }
            let (h, g) = self.normal_equations(&now)?;
            let mut improved = false;
            for _ in 0..6 {
                let damped = h + Matrix2::from_diagonal(&(h.diagonal() * damping).add_scalar(1e-9));
                let Some(mut step) = damped.try_inverse().map(|i| -(i * g)) else { break };
                if !self.friction_free() {
                    step.y = 0.0;
                }
                let size = step.amax();
                if size > MAX_STEP {
                    step *= MAX_STEP / size;
                }
                let p = now.parameters;
                let next = self.evaluate(
                    Parameters {
                        log_mass: p.log_mass + step.x,
                        log_friction: (p.log_friction + step.y).clamp(-4.0, 1.0),
                    },
                    Some(&now.fits),
                );
                if next.cost < now.cost {
                    damping = (damping * 0.2).max(1e-6);
                    improved = size > 2e-5;
                    now = next;
                    break;
                }
                damping = (damping * 8.0).max(0.05);
                if size < 2e-5 {
                    break;
                }
            }
            if !improved {
                break;
            }
        }
        Ok(now)
    }

    /// Gauss-Newton matrix and gradient by (log mass, log friction), nuisances eliminated.
    fn normal_equations(&self, c: &Candidate) -> Result<(Matrix2<f64>, Vector2<f64>)> {
        let mut h = Matrix2::zeros();
        let mut g = Vector2::zeros();
        for (i, problem) in self.problems.iter().enumerate() {
            let linear = problem.linearize(&self.at(&c.parameters, i), &c.fits[i], self.friction[i].is_none())?;
            let (columns, _) = eliminated(problem, &linear, &c.fits[i]);
            for ((j, r), w) in columns.iter().zip(&linear.residuals).zip(&c.fits[i].weights) {
                h += j.transpose() * j * *w;
                g += j.transpose() * r * *w;
            }
        }
        Ok((h, g))
    }

    /// Costs around an estimate, along the valley that friction follows if it is free.
    fn around(&self, best: &Candidate, information: &Information) -> Vec<(Parameters, f64)> {
        let mut unit = information.sd(information.scale).clamp(0.002, 0.15);
        let slope = information.friction_slope();
        let mut out: Vec<(Parameters, f64)> = Vec::new();
        for round in 0..3 {
            let grid: Vec<Parameters> = [-4.0, -3.0, -2.0, -1.5, -1.0, -0.5, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0]
                .iter()
                .filter(|k: &&f64| round == 0 || k.abs() > 1.2)
                .map(|k| Parameters {
                    log_mass: best.parameters.log_mass + k * unit,
                    log_friction: best.parameters.log_friction + k * unit * slope,
                })
                .collect();
            let costs: Vec<f64> = grid.par_iter().map(|p| self.evaluate(*p, Some(&best.fits)).cost).collect();
            out.extend(grid.into_iter().zip(costs));
            out.sort_by(|a, b| a.0.log_mass.total_cmp(&b.0.log_mass));
            let open = |s: Option<&(Parameters, f64)>| s.is_some_and(|s| s.1 < best.cost + 2.0 * information.scale);
            if !(open(out.first()) || open(out.last())) {
                break;
            }
            unit *= 3.0;
        }
        out
    }

    /// Mean slopes of the residuals over a few percent of mass (and friction), one set per span. Where objects rock and
    /// chatter the exact derivative is that of one brief branch; what a track can tell follows the mean slope.
    fn secants(&self, c: &Candidate, i: usize) -> Result<Vec<Vec<SMatrix<f64, 6, 2>>>> {
        let (problem, fit) = (&self.problems[i], &c.fits[i]);
        let at = self.at(&c.parameters, i);
        let columns = if self.friction[i].is_none() { 2 } else { 1 };
        let runs: Vec<(usize, f64)> =
            (0..columns).flat_map(|n| SPANS.iter().flat_map(move |x| [(n, -x), (n, *x)])).collect();
        let motions = runs
            .par_iter()
            .map(|&(n, x)| {
                let mut p = at;
                *(if n == 0 { &mut p.log_mass } else { &mut p.log_friction }) += x;
                problem.simulate(&p)
            })
            .collect::<Result<Vec<Motion>>>()?;
        let mut out = vec![vec![SMatrix::<f64, 6, 2>::zeros(); problem.times_s.len()]; SPANS.len()];
        for (pair, run) in motions.chunks(2).zip(runs.chunks(2)) {
            let (n, span) = (run[0].0, run[1].1);
            let Some(set) = SPANS.iter().position(|s| *s == span).and_then(|k| out.get_mut(k)) else { continue };
            for (k, j) in set.iter_mut().enumerate() {
                let at = |motion: &Motion| {
                    problem.residual(&motion.at(problem.times_s[k] - fit.nuisance[0]), k, &fit.nuisance)
                };
                j.set_column(n, &((at(&pair[1]) - at(&pair[0])) / (2.0 * span)));
            }
        }
        Ok(out)
    }

    /// Shift of log mass when the simulated motion changes as given, by one Gauss-Newton step.
    fn shift(&self, information: &Information, i: usize, best: &Candidate, changed: &Problem) -> f64 {
        let Ok(motion) = changed.simulate(&self.at(&best.parameters, i)) else { return 0.0 };
        let fit = &best.fits[i];
        let mut g = Vector2::zeros();
        for (k, (j, w)) in information.columns[i].iter().zip(&fit.weights).enumerate() {
            let r = changed.residual(&motion.at(changed.times_s[k] - fit.nuisance[0]), k, &fit.nuisance);
            g += j.transpose() * (r - fit.residuals[k]) * *w;
        }
        -(information.inverse * g).x
    }

    /// Standard deviation of log mass from white noise on the recorded force.
    fn force_sd(&self, best: &Candidate, information: &Information) -> f64 {
        let mut variance = 0.0;
        for (i, problem) in self.problems.iter().enumerate() {
            let Action::Force { times_s, forces_n, noise_n, point } = &problem.action else { continue };
            if *noise_n == 0.0 {
                continue;
            }
            let shifts: Vec<f64> = (0..DRAWS)
                .into_par_iter()
                .map(|draw| {
                    let mut normal = Normal::new(self.options.seed, (i * DRAWS + draw) as u64);
                    // Idle stretches carry no noise any more.
                    let forces_n = forces_n
                        .iter()
                        .map(|f| f.map(|x| if x == 0.0 { 0.0 } else { x + noise_n * normal.next() }))
                        .collect();
                    let point: ForcePoint = point.clone();
                    let mut changed = problem.clone();
                    changed.action = Action::Force { times_s: times_s.clone(), forces_n, noise_n: *noise_n, point };
                    self.shift(information, i, best, &changed)
                })
                .collect();
            variance += robust_square(&shifts);
        }
        variance.sqrt()
    }

    /// Shift of log mass when contact is softer or stiffer or the step shorter.
    fn contact_sd(&self, best: &Candidate, information: &Information) -> f64 {
        let shifts: Vec<f64> = [(0.5, 1.0, 1.0), (1.0, 0.6, 1.0), (1.0, 1.0, 0.5)]
            .par_iter()
            .map(|(frequency, damping, step)| {
                self.problems
                    .iter()
                    .enumerate()
                    .map(|(i, problem)| {
                        let mut changed = problem.clone();
                        changed.contact.frequency_rad_s *= frequency;
                        changed.contact.relaxation_s *= damping;
                        changed.dt_s *= step;
                        self.shift(information, i, best, &changed)
                    })
                    .sum::<f64>()
            })
            .collect();
        (shifts.iter().map(|s| s * s).sum::<f64>() / shifts.len() as f64).sqrt().min(10.0)
    }
}

/// Mean square of values of which a few may be wild (a draw that topples the object): from the median.
fn robust_square(values: &[f64]) -> f64 {
    let mut squares: Vec<f64> = values.iter().map(|v| v * v).collect();
    squares.sort_by(f64::total_cmp);
    let mean = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
    let median = squares.get(squares.len() / 2).copied().unwrap_or(0.0) / 0.4549;
    mean.min(4.0 * median)
}

/// Information about the parameters at an estimate.
struct Information {
    /// Whitened derivative of each frame by (log mass, log friction), nuisances eliminated; per push.
    columns: Vec<Vec<SMatrix<f64, 6, 2>>>,
    inverse: Matrix2<f64>,
    /// The same with a weak prior, for what is known although mass and friction are not.
    bounded: Matrix2<f64>,
    /// Reduced chi-square, at least one.
    scale: f64,
    sandwich: f64,
}

impl Information {
    fn of(joint: &Joint<'_>, c: &Candidate) -> Result<Self> {
        let mut columns = Vec::new();
        let mut h = Matrix2::zeros();
        let (mut chi, mut count) = (0.0, 0.0);
        let mut scatter = Matrix2::zeros();
        for (i, problem) in joint.problems.iter().enumerate() {
            let (Some(fit), Some(motion)) = (c.fits.get(i), c.motions.get(i)) else { continue };
            // Of several spans the one that claims least: a nearby cliff (an object that topples) is no knowledge.
            let mut least: Option<(f64, Vec<SMatrix<f64, 6, 2>>)> = None;
            for by_parameters in joint.secants(c, i)? {
                let linear = Linear {
                    residuals: fit.residuals.clone(),
                    by_parameters,
                    by_nuisances: problem.nuisance_columns(motion, &fit.nuisance),
                };
                let (j, _) = eliminated(problem, &linear, fit);
                let claim = j.iter().zip(&fit.weights).map(|(j, w)| j.column(0).norm_squared() * w).sum::<f64>();
                if least.as_ref().is_none_or(|l| claim < l.0) {
                    least = Some((claim, j));
                }
            }
            let Some((_, j)) = least else { continue };
            let mut scores: Vec<Vector2<f64>> = Vec::new();
            for ((j, r), w) in j.iter().zip(&fit.residuals).zip(&fit.weights) {
                h += j.transpose() * j * *w;
                chi += w * r.norm_squared();
                count += w * 6.0;
                scores.push(j.transpose() * r * *w);
            }
            scatter += correlated(&scores);
            columns.push(j);
        }
        if !joint.friction_free() {
            h[(1, 1)] = 1e12;
        }
        let inverse = (h + Matrix2::identity() * 1e-9).try_inverse().unwrap_or_else(Matrix2::zeros);
        let prior = Matrix2::identity() / (PRIOR_SD * PRIOR_SD);
        let bounded = (h + prior).try_inverse().unwrap_or_else(Matrix2::identity);
        let sandwich = (inverse * scatter * inverse)[(0, 0)].max(0.0).sqrt();
        Ok(Self { columns, inverse, bounded, scale: (chi / f64::max(count - 9.0, 1.0)).max(1.0), sandwich })
    }

    fn sd(&self, scale: f64) -> f64 {
        (self.inverse[(0, 0)] * scale).sqrt()
    }

    fn sd_product(&self, scale: f64) -> f64 {
        (self.bounded.sum() * scale).max(0.0).sqrt()
    }

    /// How log friction follows log mass in the valley.
    fn friction_slope(&self) -> f64 {
        if self.inverse[(0, 0)] > 0.0 { self.inverse[(1, 0)] / self.inverse[(0, 0)] } else { 0.0 }
    }
}

/// Sum of outer products of scores with those of their neighbours in time (Newey and West, 1987, Bartlett window).
fn correlated(scores: &[Vector2<f64>]) -> Matrix2<f64> {
    const LAGS: usize = 4;
    let mut b: Matrix2<f64> = scores.iter().map(|s| s * s.transpose()).sum();
    for lag in 1..=LAGS {
        let w = 1.0 - lag as f64 / (LAGS + 1) as f64;
        let c: Matrix2<f64> = scores.windows(lag + 1).map(|s| s[0] * s[lag].transpose()).sum();
        b += (c + c.transpose()) * w;
    }
    b
}

/// Derivatives by the parameters with the part that nuisances can take over removed.
fn eliminated(problem: &Problem, linear: &Linear, fit: &Fit) -> (Vec<SMatrix<f64, 6, 2>>, Vec<Vector6<f64>>) {
    let mut h = SMatrix::<f64, NUISANCES, NUISANCES>::from_diagonal(&problem.prior_precision());
    let mut cross = SMatrix::<f64, NUISANCES, 2>::zeros();
    for ((n, p), w) in linear.by_nuisances.iter().zip(&linear.by_parameters).zip(&fit.weights) {
        h += n.transpose() * n * *w;
        cross += n.transpose() * p * *w;
    }
    let taken = h.cholesky().map(|c| c.solve(&cross)).unwrap_or_else(SMatrix::zeros);
    let columns = linear.by_nuisances.iter().zip(&linear.by_parameters).map(|(n, p)| p - n * taken).collect();
    (columns, linear.residuals.clone())
}

/// The local minima of a scan, best three.
fn minima(scan: &[(Parameters, f64)]) -> Vec<Parameters> {
    let cost = |k: Option<usize>| k.and_then(|k| scan.get(k)).map_or(f64::INFINITY, |s| s.1);
    let mut found: Vec<(Parameters, f64)> = (0..scan.len())
        .filter(|&k| scan[k].1.is_finite() && scan[k].1 <= cost(k.checked_sub(1)) && scan[k].1 <= cost(Some(k + 1)))
        .map(|k| scan[k])
        .collect();
    found.sort_by(|a, b| a.1.total_cmp(&b.1));
    found.truncate(3);
    found.into_iter().map(|f| f.0).collect()
}

/// Standard deviation from the outermost masses whose cost is within the 95 % bound of the best.
fn profile_sd(fine: &[(Parameters, f64)], best: &Candidate, scale: f64) -> f64 {
    let bound = best.cost + 1.92 * scale;
    let x0 = best.parameters.log_mass;
    let reach = |side: f64| {
        let mut points: Vec<(f64, f64)> =
            fine.iter().map(|(p, c)| ((p.log_mass - x0) * side, *c)).filter(|(d, _)| *d > 0.0).collect();
        points.push((0.0, best.cost));
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let last = points.iter().rposition(|(_, c)| *c <= bound).unwrap_or(0);
        match points.get(last + 1) {
            Some((d, c)) if c.is_finite() => {
                let (d0, c0) = points[last];
                // Between two points the excess grows like a parabola.
                let a = ((bound - best.cost).max(0.0) / (c - best.cost).max(1e-300)).sqrt();
                (d * a).clamp(d0, *d).max(if c0 > bound { 0.0 } else { d0 })
            }
            _ => points[last].0 * 1.5,
        }
    };
    0.5 * (reach(1.0) + reach(-1.0)) / 1.96
}
