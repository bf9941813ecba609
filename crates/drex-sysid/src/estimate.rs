//! The estimator: a scan of the logarithm of the mass, descents from its best cells, and around where these end the posterior by
//! draws; what is known of the mass is the mixture of what they find.

use nalgebra::{DMatrix, DVector, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::answer::{ErrorBudget, ParameterEstimate};
use crate::distribution::EXCLUDES;
use crate::ensemble::{Gaussian, Round, Steps};
use crate::joint::{Candidate, Coordinate, Joint, Point};
use crate::noise::normal;
use crate::problem::{Problem, Slot};
use crate::{IdentifyOptions, Knowledge, MassDistribution, Parameter, Result};

/// How far two correct simulators of rigid contact differ about a mass, relative, beside what friction makes of it.
const SIMULATORS: f64 = 0.001;
/// The same for a push by a fingertip: what half the step, or contacts twice and half as soft, make of MuJoCo's tilts by a finger.
const SIMULATORS_FINGER: f64 = 0.0027;
/// How far they differ in the friction that one coefficient makes, relative; nor does anyone know a coefficient better.
const SAME_FRICTION: f64 = 0.01;
/// How far they differ without an encoder, which alone tells the force across the push.
const SIMULATORS_BLIND: f64 = 0.04;
/// Friction coefficients of the scan when friction is all but unknown.
const FRICTIONS: [f64; 6] = [0.12, 0.2, 0.3, 0.45, 0.65, 0.9];
/// Standard deviation of log friction above which a scan looks for it.
const VAGUE: f64 = 0.3;
/// Standard deviation taken for an encoder until draws are made, metres: far from the best mass no reading agrees to a tenth of a
/// millimetre, and all would count as outliers.
const LOOSE_ENCODER_M: f64 = 2e-3;
/// Masses on each side of the best descent, and the logarithm between neighbours, that are looked at for other minima.
const NEAR: i32 = 14;
const NEAR_STEP: f64 = 0.007;
/// Starts that are followed, at most, and how much higher the cost of one may be than the best one's.
const FOLLOWED: usize = 3;
const FAR_WORSE: f64 = 15.0;
/// Cost per pose beyond which the noise of a track does not explain it: noise alone costs about 2.6.
const POOR: f64 = 4.0;
/// How often the cells of the scan around its best minima are divided.
const DIVISIONS: usize = 2;
/// Change of the cost of a scan below which two masses do equally well.
const PLATEAU: f64 = 0.5;
/// Rounds of starts that are tried then, each so many standard deviations of what is expected from the best one so far, with all masses.
const ELSEWHERE: [f64; 3] = [0.3, 0.3, 0.1];
const STARTS: usize = 8;
/// Rounds of points that are tried where the poses show no motion: standard deviations, and logarithms of the mass, from the best so far.
const BARELY: [(f64, [f64; 2]); 4] =
    [(0.5, [-0.4, 0.1]), (0.5, [-0.12, 0.12]), (0.3, [-0.08, 0.08]), (0.2, [-0.05, 0.05])];
const POINTS: usize = 64;
/// Share of what it takes for poses to show a motion below which draws around it will not either.
const HARDLY_SHOWN: f64 = 0.25;
/// Rounds of draws with the coarse step, at least and at most.
const ROUNDS: (usize, usize) = (2, 6);
/// Rounds at most as long as the mass goes far.
const MOST_ROUNDS: usize = 20;
/// A round that moves the mean by less than this many standard deviations is the last one, or the second of two that move it by less than
/// that many: what else goes far then does not matter to the mass.
const SETTLED: f64 = 0.5;
const STANDS: f64 = 0.1;
/// Logarithm of the odds below which another mode plays no part.
const ODDS: f64 = 8.0;
/// Knots of the law of the mass on each side of a mode, and their distance in standard deviations.
const KNOTS: i32 = 25;
const KNOT_SD: f64 = 0.2;

/// What the estimator found.
pub(crate) struct Estimate {
    /// Draws that agree best, the best one first.
    pub best: Vec<Candidate>,
    /// Weight, mean and standard deviation of log mass, per mode, the heaviest one first.
    pub modes: Vec<[f64; 3]>,
    pub scan: Vec<(f64, f64)>,
    pub budget: ErrorBudget,
    /// Standard deviation of log(friction · mass), if friction is free.
    pub sd_mu_m: Option<f64>,
    /// The friction of the support, if it was estimated.
    pub friction: Option<f64>,
    /// Cost at the worst mass of the scan minus cost at the best.
    pub relief: f64,
    /// Per push and pose: what it tells about the mass, as a share of what all observations tell.
    pub shares: Vec<Vec<f64>>,
    /// What else was estimated.
    pub others: Vec<ParameterEstimate>,
    /// Change of log mass per change of what was taken for granted, and the mean slope of the mass over that of the line; absent if
    /// nothing can be said of them.
    pub sensitivities: Option<(Vec<(Parameter, f64)>, f64)>,
}

/// How the estimate ends.
pub(crate) enum Outcome {
    Estimate(Box<Estimate>),
    /// Whatever the mass, the poses do not show the motion: the best candidate, and the scan as in [`Estimate`].
    Unseen(Candidate, Vec<(f64, f64)>),
    /// Draws around the best point cannot be simulated, or go ever farther.
    Lost,
}

impl Joint {
    /// The whole estimate.
    pub(crate) fn solve(&mut self, options: &IdentifyOptions, progress: &(dyn Fn(f64) + Sync)) -> Result<Outcome> {
        for problem in &mut self.problems {
            problem.encoder_m = LOOSE_ENCODER_M.max(options.encoder_m);
        }
        let middle_dt = (options.dt_s * options.scan_dt_s).sqrt();
        let mut scan = self.scan_from(&self.start(), options);
        // Where all masses do equally well, a minimum between two of them is an accident of contact.
        let told = relief(&scan) > EXCLUDES;
        if told {
            for _ in 0..DIVISIONS {
                scan = self.refined(scan, options.scan_dt_s);
            }
        }
        if scan.iter().all(|s| !s.1.is_finite()) {
            // No mass can be simulated: say why.
            for (i, problem) in self.problems.iter().enumerate() {
                problem.simulate(&self.values(i, &scan[scan.len() / 2].0), options.dt_s)?;
            }
        }
        // The shares are those that the parts usually take.
        progress(0.15);
        let named = self.named();
        let mut found = self.descents(promising(&scan, if told { 3 } else { 1 }), &named, middle_dt)?;
        let moving: Vec<Point> = found.iter().filter(|c| self.shown(c) > 1.0).map(|c| c.point.clone()).collect();
        let is_seen = self.fixed_mass().is_some() || !moving.is_empty();
        if told && found.first().is_some_and(|c| self.shown(c) <= 1.0) {
            // Rest agrees better than a motion that the poses show: the force goes elsewhere than its record, by as much as its noise.
            let all: Vec<usize> = (0..self.coordinates.len()).collect();
            found.extend(self.descents(moving, &all, middle_dt)?);
            found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        }
        if told && (!is_seen || found.first().is_some_and(|c| self.starts_elsewhere(c))) {
            found.extend(self.descents(self.probes(&scan, is_seen, options), &named, middle_dt)?);
            found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        }
        if let Some(first) = found.first().filter(|_| told) {
            found.extend(self.minima_near(first, middle_dt));
        }
        found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let bound = found.first().map_or(0.0, |c| c.cost + FAR_WORSE);
        found.dedup_by(|a, b| (a.point[0] - b.point[0]).abs() < 0.5 * NEAR_STEP);
        found.retain(|c| c.cost <= bound);
        found.truncate(FOLLOWED);
        for problem in &mut self.problems {
            problem.encoder_m = options.encoder_m;
        }
        progress(0.3);
        if self.problems.iter().any(|p| p.readings() > 0) {
            found = self.descents(found.into_iter().map(|c| c.point).collect(), &named, middle_dt)?;
        }
        if self.is_unseen(&found, HARDLY_SHOWN) {
            return Ok(found.into_iter().next().map_or(Outcome::Lost, |best| Outcome::Unseen(best, by_mass(&scan))));
        }
        let mut modes: Vec<Round> = Vec::new();
        for c in &found {
            // What lies this close to a mode that is not wide would end there.
            let within = |m: &Round| (SETTLED * m.gaussian.covariance[(0, 0)].sqrt()).min(2.0 * NEAR_STEP);
            if !modes.iter().any(|m| (c.point[0] - m.gaussian.mean[0]).abs() < within(m)) {
                modes.extend(self.settled(c, told, middle_dt, options));
            }
        }
        distinct(&mut modes);
        progress(0.6);
        let mut modes: Vec<Round> = modes.into_iter().filter_map(|g| self.refine(g, told, options)).collect();
        distinct(&mut modes);
        progress(0.9);
        let Some(first) = modes.first() else { return Ok(Outcome::Lost) };
        if self.is_unseen(&first.best, 1.0) && self.is_unseen(&found, 1.0) {
            let best = self.refit(modes.swap_remove(0));
            return Ok(best.into_iter().next().map_or(Outcome::Lost, |best| Outcome::Unseen(best, by_mass(&scan))));
        }
        let sensitivities = if told { self.sensitivities(first, middle_dt, options) } else { None };
        let follows = |(all, _): &(Vec<(Parameter, f64)>, f64)| {
            all.iter().find(|s| s.0 == Parameter::Friction).map_or(0.0, |s| s.1.abs())
        };
        // Where nothing can be said of it, the mass follows all of the friction.
        let simulators = self.simulators(sensitivities.as_ref().map_or(1.0, follows));
        let lowest = first.cost;
        let weights: Vec<f64> = modes.iter().map(|g| (lowest - g.cost).exp()).collect();
        let all: f64 = weights.iter().sum();
        let mode =
            |(g, w): (&Round, &f64)| [w / all, g.gaussian.mean[0], (g.sources.all() + simulators.powi(2)).sqrt()];
        let friction = self.friction();
        let sd_mu_m = friction.map(|f| {
            let c = &first.gaussian.covariance;
            (c[(0, 0)] + 2.0 * c[(0, f)] + c[(f, f)]).max(0.0).sqrt()
        });
        let s = &first.sources;
        Ok(Outcome::Estimate(Box::new(Estimate {
            relief: relief(&scan),
            modes: modes.iter().zip(&weights).map(mode).collect(),
            scan: by_mass(&scan),
            budget: ErrorBudget {
                poses: s.poses.sqrt(),
                encoder: s.encoder.sqrt(),
                force: s.force.sqrt(),
                force_factor: s.factor.sqrt(),
                contact: s.contact.sqrt(),
                stated: s.priors.max(0.0).sqrt(),
                simulator: simulators,
            },
            sd_mu_m,
            friction: friction.map(|f| first.gaussian.mean[f].exp()),
            shares: first.shares.clone(),
            others: self.others(&first.gaussian),
            sensitivities,
            best: self.refit(modes.swap_remove(0)),
        })))
    }

    /// The best minima of the cost near a candidate: where an object rocks they are narrow, and a coarse scan misses them.
    fn minima_near(&self, around: &Candidate, dt_s: f64) -> Vec<Candidate> {
        let near = |k: i32| {
            let mut point = around.point.clone();
            point[0] += NEAR_STEP * f64::from(k);
            self.evaluate(point, Some(&around.fits), dt_s)
        };
        let all: Vec<Candidate> = (-NEAR..=NEAR).into_par_iter().map(near).collect();
        let cost = |k: usize| all.get(k).map_or(f64::INFINITY, |c| c.cost);
        let is_minimum = |k: usize| cost(k) <= cost(k.wrapping_sub(1)) && cost(k) <= cost(k + 1);
        let minima: Vec<bool> = (0..all.len()).map(|k| cost(k).is_finite() && is_minimum(k)).collect();
        let mut found: Vec<Candidate> = all.into_iter().zip(minima).filter_map(|(c, is)| is.then_some(c)).collect();
        found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        found.truncate(FOLLOWED);
        found
    }

    /// Where descents from points end, best first.
    fn descents(&self, from: Vec<Point>, active: &[usize], dt_s: f64) -> Result<Vec<Candidate>> {
        let down = |p: Point| self.descend(self.evaluate(p, None, dt_s), active, dt_s);
        let mut found: Vec<Candidate> = from.into_par_iter().map(down).collect::<Result<_>>()?;
        found.retain(|c| c.cost.is_finite());
        found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        Ok(found)
    }

    /// Whether the poses show the motion of a candidate, but miss it by more than their noise explains, and the place of the start is open.
    fn starts_elsewhere(&self, c: &Candidate) -> bool {
        let poses: usize = self.problems.iter().map(|p| p.times_s.len()).sum();
        let is_open = self.coordinates.iter().any(|k| k.slot == Slot::Named(Parameter::StartX));
        is_open && c.cost > POOR * poses as f64 && self.shown(c) > 1.0
    }

    /// Whether the poses show the motion of none of the candidates by this share of what it takes, at a mass that is not fixed.
    fn is_unseen(&self, of: &[Candidate], share: f64) -> bool {
        self.fixed_mass().is_none() && !of.iter().any(|c| self.shown(c) > share)
    }

    /// The mass, where it is taken for known, kilograms.
    pub(crate) fn fixed_mass(&self) -> Option<f64> {
        match self.problems.first()?.parameters.get(Parameter::Mass)? {
            Knowledge::Fixed(kg) => Some(kg),
            _ => None,
        }
    }

    /// How well the poses of the push that does best show the motion of a candidate, as a share of what it takes.
    fn shown(&self, c: &Candidate) -> f64 {
        let of = self.problems.iter().zip(&c.motions).zip(&c.fits).map(|((p, m), f)| p.shown(m, f));
        of.fold(f64::NEG_INFINITY, f64::max)
    }

    /// The best points of scans from other starts than the expected ones, about the lightest mass that does as well as any: a push of
    /// something round that is a hair beside its middle goes elsewhere, and what only just tips (`!is_seen`) does so at hardly any mass.
    fn probes(&self, scan: &[(Point, f64)], is_seen: bool, options: &IdentifyOptions) -> Vec<Point> {
        let lowest = scan.iter().map(|s| s.1).fold(f64::INFINITY, f64::min);
        let Some((from, _)) = scan.iter().find(|s| s.1 <= lowest + PLATEAU) else { return Vec::new() };
        let mut random = ChaCha8Rng::seed_from_u64(options.seed);
        let mut best: Vec<(Point, f64)> = Vec::new();
        let mut round = |sds: f64, range: Option<[f64; 2]>| {
            let around = best.first().map_or(from, |b| &b.0).clone();
            let mut drawn = || {
                let sd = |c: &Coordinate| c.prior.map_or(0.0, |(_, sd)| sds * sd);
                let by = self.coordinates.iter().map(|c| sd(c) * normal(&mut random));
                self.moved(&around, &DVector::from_iterator(self.coordinates.len(), by))
            };
            let at = |mut point: Point, log_mass: f64| {
                point[0] = log_mass;
                point
            };
            let points: Vec<Point> = if let Some([low, high]) = range {
                let mass = |k: usize| around[0] + low + (high - low) * (k as f64 + 0.5) / POINTS as f64;
                (0..POINTS).map(|k| at(drawn(), mass(k))).collect()
            } else {
                let masses = 0..options.scan_points.max(5);
                let starts = (0..STARTS).map(|_| drawn());
                starts.flat_map(|s| masses.clone().map(move |k| at(s.clone(), scan_mass(options, k)))).collect()
            };
            let moving = |p: Point| {
                let c = self.evaluate(p, None, options.scan_dt_s);
                (c.cost.is_finite() && self.shown(&c) > HARDLY_SHOWN).then_some((c.point, c.cost))
            };
            best.par_extend(points.into_par_iter().filter_map(moving));
            best.sort_by(|a, b| a.1.total_cmp(&b.1));
            best.truncate(FOLLOWED);
        };
        if is_seen {
            ELSEWHERE.iter().for_each(|sds| round(*sds, None));
        } else {
            BARELY.iter().for_each(|(sds, range)| round(*sds, Some(*range)));
        }
        best.into_iter().map(|b| b.0).collect()
    }

    /// Rounds of draws with a coarse step from a candidate until the posterior stays where it is; `None` if the mass goes ever farther
    /// without agreeing better.
    fn settled(&self, from: &Candidate, told: bool, dt_s: f64, options: &IdentifyOptions) -> Option<Round> {
        let mut gaussian = self.first_guess(from);
        let (mut lowest, mut moved_before) = (f64::INFINITY, f64::INFINITY);
        for round in 1..=MOST_ROUNDS {
            let found = self.linearise(&gaussian, Steps::One(dt_s), options.seed)?;
            let moved = (found.gaussian.mean[0] - gaussian.mean[0]).abs() / found.gaussian.covariance[(0, 0)].sqrt();
            let stands = moved.max(std::mem::replace(&mut moved_before, moved)) < STANDS;
            let is_settled = round >= ROUNDS.0 && (stands || !found.is_far && moved < SETTLED);
            if !told || is_settled || round >= ROUNDS.1 && !found.mass_is_far {
                return Some(found);
            }
            let best = found.best.first().map_or(f64::INFINITY, |c| c.cost);
            if round >= ROUNDS.1 && best >= lowest {
                return None;
            }
            lowest = lowest.min(best);
            let last = std::mem::replace(&mut gaussian, found.gaussian);
            if round >= ROUNDS.0 && !found.is_far {
                // Half of the way: around a mean that chatters rounds jump to and fro.
                gaussian.mean.iter_mut().zip(&last.mean).for_each(|(m, l)| *m = 0.5 * (*m + l));
            }
        }
        None
    }

    /// The last round, with the step that is asked for, or a few if the mass goes far; `None` if it still does, where masses differ (`told`).
    fn refine(&self, from: Round, told: bool, options: &IdentifyOptions) -> Option<Round> {
        let steps = Steps::Extrapolated(options.dt_s);
        let mut round = self.linearise(&from.gaussian, steps, options.seed)?;
        for _ in 1..ROUNDS.1 {
            if round.mass_is_far && told {
                round = self.linearise(&round.gaussian, steps, options.seed)?;
            }
        }
        Some(round).filter(|r| !told || !r.mass_is_far)
    }

    /// The best draws with the errors of the tracks fitted to their own motions, what is missed counted as noise.
    fn refit(&mut self, of: Round) -> Vec<Candidate> {
        for (problem, excess) in self.problems.iter_mut().zip(&of.excess) {
            problem.excess.copy_from_slice(&excess[..6]);
            problem.encoder_m *= excess[6];
        }
        let refit = |mut c: Candidate| {
            for ((problem, motion), fit) in self.problems.iter().zip(&c.motions).zip(&mut c.fits) {
                *fit = problem.fit(motion, Some(&fit.nuisance));
            }
            c
        };
        of.best.into_iter().map(refit).collect()
    }

    /// How far two correct simulators differ about the mass, whose logarithm follows that of the friction by `follows`.
    pub(crate) fn simulators(&self, follows: f64) -> f64 {
        let beside = |p: &Problem| match (p.has_finger(), p.readings()) {
            (false, _) => SIMULATORS,
            (true, 0) => SIMULATORS_BLIND,
            (true, _) => SIMULATORS_FINGER,
        };
        self.problems.iter().map(beside).fold(0.0, f64::max).hypot(SAME_FRICTION * follows)
    }

    /// The estimated parameters besides the mass.
    fn others(&self, gaussian: &Gaussian) -> Vec<ParameterEstimate> {
        // Where a push starts is estimated along its own axes.
        let n = self.coordinates.len();
        let mut turn = DMatrix::identity(n, n);
        for (i, problem) in self.problems.iter().enumerate() {
            let place = |p| self.coordinates.iter().position(|c| c.slot == Slot::Named(p) && c.pushes == [i]);
            if let (Some(x), Some(y)) = (place(Parameter::StartX), place(Parameter::StartY)) {
                let [to_x, to_y] = [Vector3::x(), Vector3::y()].map(|v| problem.world_from_push * v);
                turn[(x, x)] = to_x.x;
                turn[(y, x)] = to_x.y;
                turn[(x, y)] = to_y.x;
                turn[(y, y)] = to_y.y;
            }
        }
        let mean = &turn * DVector::from_column_slice(&gaussian.mean);
        let covariance = &turn * &gaussian.covariance * turn.transpose();
        let of = |(k, c): (usize, &Coordinate)| {
            let Slot::Named(parameter) = c.slot else { return None };
            let value = parameter.of_coordinate(mean[k]);
            let sd = covariance[(k, k)].sqrt() * if parameter.is_logarithmic() { value } else { 1.0 };
            let push = parameter.is_of_push().then(|| self.problems[c.pushes[0]].name.clone());
            Some(ParameterEstimate { parameter, push, value, sd })
        };
        self.coordinates.iter().enumerate().skip(1).filter_map(of).collect()
    }

    /// Cost over the grid of masses (and, if it is all but unknown, of frictions: the best of each mass is kept), everything else as in `start`.
    fn scan_from(&self, start: &Point, options: &IdentifyOptions) -> Vec<(Point, f64)> {
        let n = options.scan_points.max(5);
        let step = scan_mass(options, 1) - scan_mass(options, 0);
        let friction = self.friction().filter(|&c| self.coordinates[c].prior.is_none_or(|(_, sd)| sd > VAGUE));
        let column = |masses: &[f64]| -> Vec<(Point, f64)> {
            let grid: Vec<Point> = masses
                .iter()
                .flat_map(|&log_mass| {
                    let count = if friction.is_some() { FRICTIONS.len() } else { 1 };
                    (0..count).map(move |k| (log_mass, FRICTIONS[k]))
                })
                .map(|(log_mass, mu)| {
                    let mut point = start.clone();
                    point[0] = log_mass;
                    if let Some(c) = friction {
                        point[c] = mu.ln();
                    }
                    point
                })
                .collect();
            let costs = self.costs(&grid, options.scan_dt_s);
            let per = grid.len() / masses.len().max(1);
            grid.chunks(per.max(1))
                .zip(costs.chunks(per.max(1)))
                .map(|(p, c)| {
                    let k = (0..c.len()).min_by(|&a, &b| c[a].total_cmp(&c[b])).unwrap_or(0);
                    (p[k].clone(), c[k])
                })
                .collect()
        };
        let mut scan = column(&(0..n).map(|k| scan_mass(options, k)).collect::<Vec<_>>());
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

    /// The scan with the cells around its two best minima divided: where an object rocks, the cost has narrow minima, and one that is
    /// just tipped over has its own between the last mass that stays and the first that falls.
    fn refined(&self, mut scan: Vec<(Point, f64)>, dt_s: f64) -> Vec<(Point, f64)> {
        const PARTS: usize = 8;
        let mut more: Vec<Point> = Vec::new();
        for center in promising(&scan, 2) {
            let Some(k) = scan.iter().position(|s| s.0 == center) else { continue };
            let cells = [slope(scan[..=k].iter().rev()), slope(scan[k..].iter())];
            for (from, to) in cells.into_iter().flatten() {
                more.extend((1..PARTS).map(|i| {
                    let mut point = center.clone();
                    point[0] = from + (to - from) * i as f64 / PARTS as f64;
                    point
                }));
            }
        }
        let costs = self.costs(&more, dt_s);
        scan.extend(more.into_iter().zip(costs));
        scan.sort_by(|a, b| a.0[0].total_cmp(&b.0[0]));
        scan.dedup_by(|a, b| a.0[0] == b.0[0]);
        scan
    }
}

impl Estimate {
    /// What is known of the mass.
    pub(crate) fn mass(&self) -> Result<MassDistribution> {
        let mut knots: Vec<f64> = Vec::new();
        for [_, mean, sd] in &self.modes {
            knots.extend((-KNOTS..=KNOTS).map(|k| mean + sd * f64::from(k) * KNOT_SD));
        }
        knots.sort_by(f64::total_cmp);
        let density = |x: f64| {
            let of = |[w, mean, sd]: &[f64; 3]| w / sd * (-0.5 * ((x - mean) / sd).powi(2)).exp();
            self.modes.iter().map(of).sum::<f64>()
        };
        // Between two far modes the density is nothing, which has no logarithm.
        let costs: Vec<(f64, f64)> = knots.into_iter().map(|x| (x.exp(), -density(x).max(1e-300).ln())).collect();
        MassDistribution::from_costs(&costs)
    }
}

/// The modes that play a part, best first, without those that are another one found again.
fn distinct(modes: &mut Vec<Round>) {
    modes.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut kept: Vec<Round> = Vec::new();
    for mode in modes.drain(..) {
        let same = |k: &Round| {
            (k.gaussian.mean[0] - mode.gaussian.mean[0]).abs()
                < k.gaussian.covariance[(0, 0)].max(mode.gaussian.covariance[(0, 0)]).sqrt()
        };
        if kept.first().is_none_or(|k| mode.cost < k.cost + ODDS) && !kept.iter().any(same) {
            kept.push(mode);
        }
    }
    *modes = kept;
}

/// Log masses of the first cell of a scan over which the cost changes, from a minimum on: on a plateau there is nothing to find.
fn slope<'a>(mut from: impl Iterator<Item = &'a (Point, f64)>) -> Option<(f64, f64)> {
    let (first, cost) = from.next()?;
    let mut near = first[0];
    for (point, c) in from {
        if (c - cost).abs() <= PLATEAU {
            near = point[0];
        } else {
            return Some((near, point[0]));
        }
    }
    None
}

/// Log mass number `k` of the scan.
fn scan_mass(options: &IdentifyOptions, k: usize) -> f64 {
    let [low, high] = options.scan_kg.map(f64::ln);
    low + (high - low) * k as f64 / (options.scan_points.max(5) - 1) as f64
}

/// Masses in kilograms and costs of a scan.
fn by_mass(scan: &[(Point, f64)]) -> Vec<(f64, f64)> {
    scan.iter().map(|(p, c)| (p[0].exp(), *c)).collect()
}

/// Cost at the worst mass of a scan minus cost at the best.
fn relief(scan: &[(Point, f64)]) -> f64 {
    let costs = || scan.iter().map(|s| s.1).filter(|c| c.is_finite());
    costs().fold(f64::NEG_INFINITY, f64::max) - costs().fold(f64::INFINITY, f64::min)
}

/// The local minima of a scan by mass, best first, without those that no refinement makes the best.
fn promising(scan: &[(Point, f64)], most: usize) -> Vec<Point> {
    let lowest = scan.iter().map(|s| s.1).fold(f64::INFINITY, f64::min);
    let cost = |k: Option<usize>| k.and_then(|k| scan.get(k)).map_or(f64::INFINITY, |s| s.1);
    let is_minimum = |k: usize| scan[k].1 <= cost(k.checked_sub(1)) && scan[k].1 <= cost(Some(k + 1));
    let mut found: Vec<&(Point, f64)> = (0..scan.len())
        .filter(|&k| scan[k].1.is_finite() && scan[k].1 <= 3.0 * lowest + 20.0 && is_minimum(k))
        .map(|k| &scan[k])
        .collect();
    found.sort_by(|a, b| a.1.total_cmp(&b.1));
    found.into_iter().take(most).map(|f| f.0.clone()).collect()
}
