//! The cost along the mass, everything else following.

use nalgebra::DVector;
use rayon::prelude::*;

use crate::IdentifyOptions;
use crate::information::Information;
use crate::joint::{Candidate, Joint, Point};

/// Half the 95 % point of chi-square with one degree of freedom.
const BOUND: f64 = 1.92;

/// Points along the valley around an estimate, by mass.
#[derive(Default)]
pub(crate) struct Profile {
    points: Vec<(Point, f64)>,
}

impl Profile {
    /// Costs around `best`, along the valley that the other coordinates follow, each improved by one Gauss-Newton step.
    pub(crate) fn around(
        joint: &Joint,
        best: &Candidate,
        information: &Information,
        options: &IdentifyOptions,
    ) -> Self {
        let mut unit = information.sd().clamp(0.002, 0.15);
        let valley = information.valley();
        let all = joint.active(true);
        let mut points: Vec<(Point, f64)> = Vec::new();
        for round in 0..3 {
            let grid: Vec<f64> = [-3.0, -2.0, -1.4, -0.7, 0.7, 1.4, 2.0, 3.0]
                .into_iter()
                .filter(|k: &f64| round == 0 || k.abs() > 1.0)
                .map(|k| k * unit)
                .collect();
            points.par_extend(grid.par_iter().map(|x| {
                let mut point = best.point.clone();
                for (p, v) in point.iter_mut().zip(valley.iter()) {
                    *p += v * x;
                }
                let (point, _) = joint.stepped(&point, &all, &DVector::zeros(all.len()));
                let there = joint.evaluate(point, Some(&best.fits), options.dt_s);
                let (point, cost) = (there.point.clone(), there.cost);
                match across(joint, &there, information) {
                    Some(step) => {
                        let (point2, _) = joint.stepped(&point, &all, &step);
                        let next = joint.evaluate(point2, Some(&there.fits), options.dt_s);
                        if next.cost < cost { (next.point, next.cost) } else { (point, cost) }
                    }
                    None => (point, cost),
                }
            }));
            points.sort_by(|a, b| a.0[0].total_cmp(&b.0[0]));
            let open = |s: Option<&(Point, f64)>| s.is_some_and(|s| s.1 < best.cost + BOUND * information.scale);
            if !(open(points.first()) || open(points.last())) {
                break;
            }
            unit *= 3.0;
        }
        Self { points }
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

/// The Gauss-Newton step in everything but the mass at a candidate, with the slopes of the estimate.
fn across(joint: &Joint, there: &Candidate, information: &Information) -> Option<DVector<f64>> {
    let n = joint.coordinates.len();
    if n < 2 || !there.cost.is_finite() {
        return None;
    }
    let (mut h, g) = joint.normal_equations(there, &joint.active(true), &information.slopes);
    (0..n).for_each(|k| h[(k, k)] += 1e-9);
    let (sub, right) = (h.view((1, 1), (n - 1, n - 1)).into_owned(), g.rows(1, n - 1).into_owned());
    let step = sub.cholesky()?.solve(&right);
    Some(DVector::from_fn(n, |k, _| if k == 0 { 0.0 } else { -step[k - 1] }))
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
