//! How far other models of rigid contact, as right as ours, move an object elsewhere under the same push.
//!
//! Stiffness, rebound and creep of a contact are not known. Where an object flies or leans on an edge, all models agree; after
//! an impact, while it rocks or turns on its patch, they do not, and what they disagree on is no knowledge about the mass.
//! The mean square of their differences is added to the variance of each pose.

use drex_diffsim::{ContactOptions, SoftContact};
use rayon::prelude::*;

use crate::fit::Fit;
use crate::problem::{Action, Problem, Values};

/// Time constants of contacts that rebound a little and creep, seconds.
const SOFT_S: [f64; 2] = [4e-3, 8e-3];
/// A softer and less damped spring: factors on frequency and relaxation.
const SPRING: [f64; 2] = [0.3, 0.3];

/// The contact models that are as right as a problem's own.
fn models(own: &ContactOptions) -> [ContactOptions; 3] {
    let soft = SOFT_S.map(|time_constant_s| {
        let mut soft = SoftContact::default();
        soft.time_constant_s = time_constant_s;
        soft.impedance = [0.95, 0.99];
        soft.width_m = 5e-4;
        soft.friction_ratio = 10.0;
        let mut out = *own;
        out.soft = Some(soft);
        out
    });
    let mut spring = *own;
    spring.frequency_rad_s *= SPRING[0];
    spring.relaxation_s *= SPRING[1];
    [soft[0], soft[1], spring]
}

impl Problem {
    /// Adds to the variance of each pose what the models disagree on around a motion; only where a known force acts.
    pub(crate) fn tolerate(&mut self, values: &Values<f64>, fit: &Fit, dt_s: f64) {
        if !matches!(self.action, Action::Force(_)) {
            return;
        }
        self.tolerance.clear();
        let Ok(motion) = self.simulate(values, dt_s) else { return };
        let base = self.residuals(&motion, &fit.nuisance);
        let others: Vec<Vec<f64>> = models(&self.contact)
            .par_iter()
            .filter_map(|contact| {
                let mut other = self.clone();
                other.contact = *contact;
                Some(other.residuals(&other.simulate(values, dt_s).ok()?, &fit.nuisance))
            })
            .collect();
        let count = others.len().max(1) as f64;
        let excess = |row: usize| {
            let square: f64 = others.iter().map(|o| (o[row] - base[row]).powi(2)).sum();
            (1.0 + square / count).sqrt()
        };
        self.tolerance = (0..self.times_s.len()).map(|k| std::array::from_fn(|i| excess(6 * k + i))).collect();
    }
}
