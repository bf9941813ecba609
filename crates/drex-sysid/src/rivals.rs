//! Other answers that do nearly as well as the best one: valleys of the mass beside it, and other frictions.

use rayon::prelude::*;

use crate::Result;
use crate::estimate::{FRICTIONS, MEAN_ITERATIONS};
use crate::information::Information;
use crate::joint::{Candidate, Joint, Point, Slopes};
use crate::profile::{BOUND, minima};

/// Masses on each side, and the logarithm between neighbours, that are looked at again with the shortest step.
const NEAR: i32 = 14;
const NEAR_STEP: f64 = 0.007;
/// A valley whose cost is higher by this does not become the best one.
const FAR_WORSE: f64 = 15.0;

impl Joint {
    /// The best two valleys of the cost near a candidate: where an object rocks they are narrow, and a coarse step misses them.
    pub(crate) fn valleys(&self, around: &Candidate, dt_s: f64) -> Vec<Candidate> {
        let near: Vec<Point> = (-NEAR..=NEAR)
            .map(|k| {
                let mut point = around.point.clone();
                point[0] += NEAR_STEP * f64::from(k);
                point
            })
            .collect();
        let costs = self.costs(&near, Some(&around.fits), dt_s);
        let scan: Vec<(Point, f64)> = near.into_iter().zip(costs).collect();
        let mut found: Vec<Candidate> =
            minima(&scan, 2).into_iter().map(|p| self.evaluate(p, Some(&around.fits), dt_s)).collect();
        let bound = found.first().map_or(0.0, |c| c.cost + FAR_WORSE);
        found.retain(|c| c.cost <= bound);
        found
    }

    /// What other minima that are not excluded add to the standard deviation of log mass: the interval is to reach them.
    pub(crate) fn rivals(
        &self,
        found: Vec<Candidate>,
        best: &Candidate,
        information: &Information,
        dt_s: f64,
    ) -> Result<f64> {
        let away = |c: &Candidate| (c.point[0] - best.point[0]).abs();
        let all = self.active(true);
        let mut reach = 0.0_f64;
        for c in found.into_iter().filter(|c| away(c) > 2.0 * information.sd()) {
            let mut rival = self.evaluate(c.point, Some(&best.fits), dt_s);
            // A few steps make up for the coarser step that it was found with, not for more.
            if rival.cost <= best.cost + 10.0 * BOUND * information.scale {
                rival = self.descend(rival, &all, Slopes::Mean, 3, dt_s)?;
            }
            if rival.cost <= best.cost + BOUND * information.scale {
                reach = reach.max(away(&rival));
            }
        }
        Ok(reach / 1.96)
    }

    /// The best candidates at other frictions, if friction is free and nothing is known of it: from the value on at which something sticks
    /// all frictions do equally well, and slopes at one of them do not tell.
    pub(crate) fn across_frictions(&self, best: &Candidate, all: &[usize], dt_s: f64) -> Result<Vec<Candidate>> {
        let Some(friction) = self.friction().filter(|&c| self.coordinates[c].prior.is_none()) else {
            return Ok(Vec::new());
        };
        let others: Vec<usize> = all.iter().copied().filter(|k| *k != friction).collect();
        let found: Vec<Option<Candidate>> = FRICTIONS
            .par_iter()
            .map(|mu| {
                let mut point = best.point.clone();
                point[friction] = mu.ln();
                let there = self.evaluate(point, Some(&best.fits), dt_s);
                let there = self.descend(there, &[0], Slopes::Mean, MEAN_ITERATIONS, dt_s)?;
                // Errors of the force make up for a little, not for a wrong friction.
                if there.cost > best.cost + 10.0 * BOUND {
                    return Ok(None);
                }
                self.descend(there, &others, Slopes::Mean, 3, dt_s).map(Some)
            })
            .collect::<Result<_>>()?;
        Ok(found.into_iter().flatten().collect())
    }
}

/// A standard deviation of log mass from a profile around `best`, widened to hold the profiles around `others` as far as these are not
/// excluded.
pub(crate) fn widened(sd: f64, best: &Candidate, others: &[Candidate], scale: f64) -> f64 {
    let reach = |c: &Candidate| {
        let left = 1.0 - (c.cost - best.cost) / (BOUND * scale);
        if left > 0.0 { (c.point[0] - best.point[0]).abs() / 1.96 + sd * left.sqrt() } else { 0.0 }
    };
    others.iter().map(reach).fold(sd, f64::max)
}
