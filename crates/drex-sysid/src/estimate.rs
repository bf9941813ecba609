//! The estimator: scan of the logarithm of the mass, Levenberg-Marquardt with dual-number derivatives from the best cells,
//! then what the answer is worth.

use nalgebra::DVector;
use rayon::prelude::*;

use crate::answer::{ErrorBudget, ParameterEstimate};
use crate::finger::PULL;
use crate::information::Information;
use crate::joint::{Candidate, Coordinate, ITERATIONS, Joint, Point, Slopes};
use crate::problem::{Action, Problem, Slot};
use crate::profile::{BOUND, Profile, minima};
use crate::rivals::widened;
use crate::{IdentifyOptions, Result};

/// Two correct simulators of rigid contact disagree about a mass by this much (relative).
const MODEL_FLOOR: f64 = 0.005;
/// The same for a push by a fingertip whose encoder shows how far the two motions differ.
const FINGER_FLOOR: f64 = 0.0035;
/// The same without an encoder, which alone tells the force across the push.
const BLIND_FINGER_FLOOR: f64 = 0.04;
/// Models that are as right as the chosen one: factors on frequency and damping of contact, on the pull on a fingertip
/// across the push, and on the time step.
const VARIANTS: [[f64; 4]; 3] = [[0.5, 1.0, 1.0, 1.0], [1.0, 0.6, 1.0, 1.0], [1.0, 1.0, 3.0, 0.5]];
/// Friction coefficients of the scan when friction is free.
pub(crate) const FRICTIONS: [f64; 6] = [0.12, 0.2, 0.3, 0.45, 0.65, 0.9];
/// Standard deviations taken for an encoder in the scan and in the first descent, metres: far from the best mass no reading
/// agrees to a tenth of a millimetre, and all would count as outliers.
const LOOSE_ENCODER_M: f64 = 2e-3;
/// The most that is taken for it in the end.
const WORST_ENCODER_M: f64 = 2e-3;

/// Standard deviation of log mass beyond which nothing that could be added makes a measurement of it.
const HOPELESS: f64 = 3.0;
/// Standard deviation of log mass below which a closed form is a start.
const GOOD_HINT: f64 = 0.1;
/// Iterations of one descent by mean slopes.
pub(crate) const MEAN_ITERATIONS: usize = 8;

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
    /// Per push and pose: what it tells about the mass, as a share of the whole.
    pub shares: Vec<Vec<f64>>,
    /// What else was estimated.
    pub others: Vec<ParameterEstimate>,
    /// Change of log mass per change of what was taken for granted.
    pub sensitivities: Vec<(crate::Parameter, f64)>,
}

impl Joint {
    /// The whole estimate.
    pub(crate) fn solve(&mut self, options: &IdentifyOptions, progress: &(dyn Fn(f64) + Sync)) -> Result<Estimate> {
        let finest = options.encoder_m;
        for problem in &mut self.problems {
            problem.encoder_m = LOOSE_ENCODER_M.max(finest);
        }
        let middle_dt = (options.dt_s * options.scan_dt_s).sqrt();
        let mut scan = self.scan(options);
        // Where all masses do equally well, a minimum between two of them is an accident of contact.
        let told = relief(&scan) > BOUND;
        if told {
            scan = self.refined(scan, options.scan_dt_s);
        }
        if scan.iter().all(|s| !s.1.is_finite()) {
            // No mass can be simulated: say why.
            for (i, problem) in self.problems.iter().enumerate() {
                problem.simulate(&self.values(i, &scan[scan.len() / 2].0), options.dt_s)?;
            }
        }
        // The shares are those that the parts usually take.
        progress(0.15);
        let (named, all) = (self.active(false), self.active(true));
        // With errors of the force, many motions agree with the track: the exact slopes of one are of little use.
        let by = if named.len() < all.len() { Slopes::Mean } else { Slopes::Exact };
        let starts = if told { 3 } else { 0 };
        let mut begin = promising(&scan, starts);
        begin.extend(self.hints(&begin));
        let mut found: Vec<Candidate> = begin
            .par_iter()
            .map(|p| {
                let start = self.evaluate(p.clone(), None, middle_dt);
                self.descend(start, &named, Slopes::Exact, ITERATIONS, middle_dt)
            })
            .collect::<Result<_>>()?;
        found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        if self.knows_a_force()
            && let Some(first) = found.first()
        {
            found = self
                .valleys(first, options.dt_s)
                .into_par_iter()
                .map(|c| self.descend(c, &all, by, MEAN_ITERATIONS, options.dt_s))
                .collect::<Result<_>>()?;
        }
        found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let start = found.first().map_or_else(|| self.start(), |c| c.point.clone());

        progress(0.4);
        let mut best = self.evaluate(start, None, options.dt_s);
        let passes = if told && self.problems.iter().any(Problem::has_finger) { 4 } else { 0 };
        for _ in 0..passes {
            let changed = self.rescale_encoders(&best, (finest, WORST_ENCODER_M.max(finest)));
            if changed {
                best = self.evaluate(best.point, Some(&best.fits), options.dt_s);
            }
            best = self.descend(best, &all, by, MEAN_ITERATIONS, options.dt_s)?;
            if !changed {
                break;
            }
        }
        for _ in 0..if told { 2 } else { 0 } {
            if !self.rescale_poses(&best) {
                break;
            }
            best = self.evaluate(best.point, Some(&best.fits), options.dt_s);
            best = self.descend(best, &all, by, MEAN_ITERATIONS, options.dt_s)?;
        }
        let mut across = self.across_frictions(&best, &all, options.dt_s)?;
        if let Some(k) = (0..across.len()).min_by(|&a, &b| across[a].cost.total_cmp(&across[b].cost))
            && across[k].cost < best.cost - 0.3
        {
            across.push(best);
            best = self.descend(across.swap_remove(k), &all, by, MEAN_ITERATIONS, options.dt_s)?;
        }
        progress(0.6);
        let mut information = Information::of(self, &best, options)?;
        let mut profile = Profile::default();
        let rounds = if told && information.sd() <= HOPELESS { 3 } else { 0 };
        for round in 0..rounds {
            progress(0.65 + 0.1 * f64::from(round));
            best = self.polish(best, &all, &information, options.dt_s);
            profile = Profile::around(self, &best, &information, options.dt_s)?;
            match profile.lowest() {
                Some((point, cost)) if cost < best.cost - 0.3 => {
                    best = self.evaluate(point, Some(&best.fits), options.dt_s);
                    information = Information::of(self, &best, options)?;
                }
                _ => break,
            }
        }
        let rivals = if rounds > 0 { self.rivals(found, &best, &information, options.dt_s)? } else { 0.0 };
        let width = profile.sd(&best, information.scale) + rivals;
        let budget = ErrorBudget {
            poses: information.sd_of_poses(),
            sandwich: information.sandwich,
            profile: widened(width, &best, &across, information.scale),
            force: information.sd_of_force().hypot(information.factor),
            force_factor: information.factor,
            contact: if rounds > 0 {
                self.contact_sd(&best, &information, options).hypot(information.unmodelled)
            } else {
                0.0
            },
        };
        let random = information.sd().max(budget.sandwich).max(budget.profile);
        let floor = self.problems.iter().map(floor).fold(0.0, f64::max);
        let sd = (random.powi(2) + information.factor.powi(2) + budget.contact.powi(2) + floor.powi(2)).sqrt();
        // The scan was weighed differently if there is an encoder; its own best is what its worst compares with.
        let lowest = scan.iter().map(|s| s.1).fold(f64::INFINITY, f64::min);
        let sd_mu_m = self.friction().map(|_| information.sd_product());
        let sensitivities = if rounds > 0 { self.sensitivities(&best, &information, options) } else { Vec::new() };
        let shares = (0..self.problems.len()).map(|i| information.shares(self, i)).collect();
        let others = self.others(&best, &information);
        let mut points = profile.masses();
        points.push((best.point[0].exp(), best.cost));
        points.retain(|(_, c)| c.is_finite());
        // Where masses were fitted, the coarser scan only bounds from above what they say.
        let least = points.iter().map(|p| p.0).fold(f64::INFINITY, f64::min);
        let most = points.iter().map(|p| p.0).fold(0.0, f64::max);
        let scanned = scan.iter().map(|(p, c)| (p[0].exp(), *c - lowest + best.cost));
        points.extend(scanned.filter(|(mass, cost)| cost.is_finite() && !(least..=most).contains(mass)));
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(Estimate {
            relief: relief(&scan),
            best,
            profile: points,
            budget,
            sd,
            sd_mu_m,
            shares,
            others,
            sensitivities,
        })
    }

    /// The masses of closed forms, where they are good ones, with everything else as in the best of the points that there are.
    fn hints(&self, others: &[Point]) -> Vec<Point> {
        let Some(best) = others.first() else { return Vec::new() };
        let hints = self.problems.iter().filter_map(|p| p.hint).filter(|h| h.sd_log_mass < GOOD_HINT);
        let at = |h: crate::ClosedForm| {
            let mut point = best.clone();
            point[0] = h.mass_kg.ln();
            point
        };
        hints.map(at).collect()
    }

    /// The estimated parameters besides the mass.
    fn others(&self, best: &Candidate, information: &Information) -> Vec<ParameterEstimate> {
        let of = |(k, c): (usize, &Coordinate)| {
            let Slot::Named(parameter) = c.slot else { return None };
            let value = parameter.of_coordinate(best.point[k]);
            let sd = information.sd_of(k) * if parameter.is_logarithmic() { value } else { 1.0 };
            let push = parameter.is_of_push().then(|| self.problems[c.pushes[0]].name.clone());
            Some(ParameterEstimate { parameter, push, value, sd })
        };
        self.coordinates.iter().enumerate().skip(1).filter_map(of).collect()
    }

    fn knows_a_force(&self) -> bool {
        self.problems.iter().any(|p| matches!(p.action, Action::Force(_)))
    }

    /// Cost over the grid of masses (and, if it is free, of frictions: the best of each mass is kept).
    fn scan(&self, options: &IdentifyOptions) -> Vec<(Point, f64)> {
        let n = options.scan_points.max(5);
        let (lo, hi) = (options.scan_kg[0].ln(), options.scan_kg[1].ln());
        let step = (hi - lo) / (n - 1) as f64;
        let friction = self.friction().filter(|&c| self.coordinates[c].prior.is_none());
        let column = |masses: &[f64]| -> Vec<(Point, f64)> {
            let grid: Vec<Point> = masses
                .iter()
                .flat_map(|&log_mass| {
                    let count = if friction.is_some() { FRICTIONS.len() } else { 1 };
                    (0..count).map(move |k| (log_mass, FRICTIONS[k]))
                })
                .map(|(log_mass, mu)| {
                    let mut point = self.start();
                    point[0] = log_mass;
                    if let Some(c) = friction {
                        point[c] = mu.ln();
                    }
                    point
                })
                .collect();
            let costs = self.costs(&grid, None, options.scan_dt_s);
            let per = grid.len() / masses.len().max(1);
            grid.chunks(per.max(1))
                .zip(costs.chunks(per.max(1)))
                .map(|(p, c)| {
                    let k = (0..c.len()).min_by(|&a, &b| c[a].total_cmp(&c[b])).unwrap_or(0);
                    (p[k].clone(), c[k])
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
                let first = scan[0].0[0];
                let mut more = column(&(1..=4).rev().map(|k| first - f64::from(k) * step).collect::<Vec<_>>());
                more.append(&mut scan);
                scan = more;
            } else if best + 1 == scan.len() {
                let last = scan[best].0[0];
                scan.extend(column(&(1..=4).map(|k| last + f64::from(k) * step).collect::<Vec<_>>()));
            } else {
                break;
            }
        }
        scan
    }

    /// The scan with the cells around its two best minima divided: where an object rocks, the cost has narrow valleys.
    fn refined(&self, mut scan: Vec<(Point, f64)>, dt_s: f64) -> Vec<(Point, f64)> {
        const PARTS: usize = 8;
        let mut more: Vec<Point> = Vec::new();
        for center in promising(&scan, 2) {
            let Some(k) = scan.iter().position(|s| s.0 == center) else { continue };
            for neighbour in [k.checked_sub(1), Some(k + 1)].into_iter().flatten().filter_map(|i| scan.get(i)) {
                let (a, b) = (center[0], neighbour.0[0]);
                more.extend((1..PARTS).map(|i| {
                    let mut point = center.clone();
                    point[0] = a + (b - a) * i as f64 / PARTS as f64;
                    point
                }));
            }
        }
        let costs = self.costs(&more, None, dt_s);
        scan.extend(more.into_iter().zip(costs));
        scan.sort_by(|a, b| a.0[0].total_cmp(&b.0[0]));
        scan.dedup_by(|a, b| a.0[0] == b.0[0]);
        scan
    }

    /// Shift of log mass when contact is softer, or less damped, or a fingertip slides less across
    /// the push and the step is shorter.
    pub(crate) fn contact_sd(&self, best: &Candidate, information: &Information, options: &IdentifyOptions) -> f64 {
        let shifts: Vec<f64> =
            VARIANTS.par_iter().map(|variant| self.shift_by(variant, best, information, options.dt_s)).collect();
        (shifts.iter().map(|s| s * s).sum::<f64>() / shifts.len() as f64).sqrt().min(10.0)
    }

    /// Shift of log mass with another contact.
    pub(crate) fn shift_by(&self, variant: &[f64; 4], best: &Candidate, information: &Information, dt_s: f64) -> f64 {
        let [frequency, damping, pull, step] = variant;
        let mut differences = Vec::new();
        for (i, problem) in self.problems.iter().enumerate() {
            let mut changed = problem.clone();
            changed.contact.frequency_rad_s *= frequency;
            changed.contact.relaxation_s *= damping;
            if let Action::Finger(finger) = &mut changed.action
                && finger.pull_across(PULL * pull).is_err()
            {
                return 0.0;
            }
            let fit = &best.fits[i];
            let Ok(motion) = changed.simulate(&self.values(i, &best.point), dt_s * step) else { return 0.0 };
            let mut r = changed.residuals(&motion, &fit.nuisance);
            r.iter_mut().zip(&fit.residuals).for_each(|(r, old)| *r -= old);
            differences.push(r);
        }
        information.shift(&differences)
    }
}

/// Cost at the worst mass of a scan minus cost at the best.
fn relief(scan: &[(Point, f64)]) -> f64 {
    let costs = || scan.iter().map(|s| s.1).filter(|c| c.is_finite());
    costs().fold(f64::NEG_INFINITY, f64::max) - costs().fold(f64::INFINITY, f64::min)
}

/// The local minima of a scan, best first, without those that no refinement makes the best.
fn promising(scan: &[(Point, f64)], most: usize) -> Vec<Point> {
    let lowest = scan.iter().map(|s| s.1).fold(f64::INFINITY, f64::min);
    let cost = |p: &Point| scan.iter().find(|s| s.0 == *p).map_or(f64::INFINITY, |s| s.1);
    minima(scan, most).into_iter().filter(|p| cost(p) <= 3.0 * lowest + 20.0).collect()
}

/// How far two correct simulators may differ about the mass from a push.
pub(crate) fn floor(problem: &Problem) -> f64 {
    match (problem.has_finger(), problem.readings()) {
        (false, _) => MODEL_FLOOR,
        (true, 0) => BLIND_FINGER_FLOOR,
        (true, _) => FINGER_FLOOR,
    }
}

/// The unit vector of coordinate `k` among `n`.
pub(crate) fn unit(n: usize, k: usize) -> DVector<f64> {
    DVector::from_fn(n, |i, _| if i == k { 1.0 } else { 0.0 })
}
