//! The cost along the mass, everything else following.

use nalgebra::DVector;
use rayon::prelude::*;

use crate::Result;
use crate::estimate::FRICTIONS;
use crate::fit::Fit;
use crate::information::Information;
use crate::joint::{Candidate, Joint, Point, Slopes};

/// What the likelihood must lose to exclude a mass.
pub(crate) const BOUND: f64 = crate::distribution::EXCLUDES;

/// A cost that rises by as many times what the information says, beyond the bound, may be a fit that ended beside the motion.
const STEEP: f64 = 3.0;
/// Fits to one mass that are followed to their ends.
const TRIED: usize = 2;

/// Points along the valley around an estimate, by mass.
#[derive(Default)]
pub(crate) struct Profile {
    points: Vec<(Point, f64)>,
}

impl Profile {
    /// Costs on both sides of `best`, outwards until a mass is excluded. The other coordinates follow the valley of the slopes,
    /// and where that would exclude a mass, they are fitted to it.
    pub(crate) fn around(joint: &Joint, best: &Candidate, information: &Information, dt_s: f64) -> Result<Self> {
        let sides: Vec<Result<Vec<(Point, f64)>>> =
            [-1.0, 1.0].par_iter().map(|side| one_side(joint, best, information, *side, dt_s)).collect();
        let mut points = Vec::new();
        for side in sides {
            points.extend(side?);
        }
        points.sort_by(|a: &(Point, f64), b| a.0[0].total_cmp(&b.0[0]));
        Ok(Self { points })
    }

    pub(crate) fn lowest(&self) -> Option<(Point, f64)> {
        self.points.iter().min_by(|a, b| a.1.total_cmp(&b.1)).cloned()
    }

    /// Masses (kg) and costs.
    pub(crate) fn masses(&self) -> Vec<(f64, f64)> {
        self.points.iter().map(|(p, c)| (p[0].exp(), *c)).collect()
    }

    /// Standard deviation of log mass from the outermost masses whose cost is within the 95 % bound of the best.
    pub(crate) fn sd(&self, best: &Candidate, scale: f64) -> f64 {
        let bound = best.cost + BOUND * scale;
        let x0 = best.point[0];
        let reach = |side: f64| {
            let mut points: Vec<(f64, f64)> =
                self.points.iter().map(|(p, c)| ((p[0] - x0) * side, *c)).filter(|(d, _)| *d > 0.0).collect();
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
}

fn one_side(
    joint: &Joint,
    best: &Candidate,
    information: &Information,
    side: f64,
    dt_s: f64,
) -> Result<Vec<(Point, f64)>> {
    const STEPS: [f64; 8] = [0.7, 1.4, 2.0, 3.0, 5.0, 8.0, 14.0, 25.0];
    let unit = information.sd().clamp(0.002, 0.15);
    let valley = information.valley();
    let others: Vec<usize> = (1..joint.coordinates.len()).collect();
    let bound = best.cost + BOUND * information.scale;
    let mut out: Vec<(Point, f64)> = Vec::new();
    let mut from = (best.point.clone(), 0.0, best.fits.clone());
    for step in STEPS {
        let mut point = from.0.clone();
        for (p, v) in point.iter_mut().zip(valley.iter()) {
            *p += v * side * unit * (step - from.1);
        }
        let all = joint.active(true);
        let (point, _) = joint.stepped(&point, &all, &DVector::zeros(all.len()));
        let mut there = joint.evaluate(point, Some(&from.2), dt_s);
        if !others.is_empty() {
            there = joint.polish(there, &others, information, dt_s);
            if there.cost > bound {
                there = joint.descend(there, &others, Slopes::Mean, 2, dt_s)?;
            }
            if there.cost > bound + STEEP * 0.5 * step * step * information.scale {
                there = joint.fitted_elsewhere(there, &from.0, &from.2, information, dt_s)?;
            }
        }
        let cost = there.cost;
        out.push((there.point.clone(), cost));
        if cost > bound {
            break;
        }
        from = (there.point, step, there.fits);
    }
    Ok(out)
}

impl Joint {
    /// The best fit to the mass of `there`, tried again from other points than the valley's: where an object rocks, a few hundredths of a
    /// newton decide whether it falls over, and one fit that ends beside the motion would exclude a mass that is as good as its
    /// neighbours. `from` is the point of the neighbour, `fits` what belongs to it.
    fn fitted_elsewhere(
        &self,
        there: Candidate,
        from: &Point,
        fits: &[Fit],
        information: &Information,
        dt_s: f64,
    ) -> Result<Candidate> {
        let others: Vec<usize> = (1..self.coordinates.len()).collect();
        let mut beside = from.clone();
        beside[0] = there.point[0];
        let mut starts = vec![beside.clone()];
        if let Some(friction) = self.friction().filter(|&c| self.coordinates[c].prior.is_none()) {
            let with = |point: &Point, x: f64| {
                let mut point = point.clone();
                point[friction] = x;
                point
            };
            starts.push(with(&there.point, from[friction]));
            starts.extend(FRICTIONS.iter().map(|mu| with(&beside, mu.ln())));
        }
        let mut found: Vec<Candidate> = starts
            .into_par_iter()
            .map(|point| self.polish(self.evaluate(point, Some(fits), dt_s), &others, information, dt_s))
            .collect();
        found.push(there);
        found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        found.truncate(TRIED);
        let mut fitted: Vec<Candidate> =
            found.into_par_iter().map(|c| self.descend(c, &others, Slopes::Mean, 3, dt_s)).collect::<Result<_>>()?;
        fitted.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        // TRIED is not zero.
        Ok(fitted.swap_remove(0))
    }
}

/// The local minima of a scan by mass, best first.
pub(crate) fn minima(scan: &[(Point, f64)], most: usize) -> Vec<Point> {
    let cost = |k: Option<usize>| k.and_then(|k| scan.get(k)).map_or(f64::INFINITY, |s| s.1);
    let mut found: Vec<&(Point, f64)> = (0..scan.len())
        .filter(|&k| scan[k].1.is_finite() && scan[k].1 <= cost(k.checked_sub(1)) && scan[k].1 <= cost(Some(k + 1)))
        .map(|k| &scan[k])
        .collect();
    found.sort_by(|a, b| a.1.total_cmp(&b.1));
    found.into_iter().take(most).map(|f| f.0.clone()).collect()
}
