//! What every mass of a range costs. Masses weigh alike in log m.
//!
//! Where a touch stands out, most errors are factors, and log m is normal about the least-squares answer. A touch that is lost
//! in the joint friction still bounds the mass from above, for a heavy object would have shown: at mass m the equations miss by
//! g r + J θ̈ − M / m, whose variance has the noise of M over m² and that of lean and model. Half the sum of squares over that
//! variance, at the likeliest values of all that is known to within an error, has its least mean at the true mass although
//! both sides are noisy (Deming's regression).

use nalgebra::{Cholesky, DVector};

use super::scene::Scene;
use crate::MassDistribution;

/// Masses per factor of e.
const PER_E: f64 = 12.0;
/// Gauss-Newton steps per mass.
const STEPS: usize = 12;

/// Masses (kg, increasing, evenly in the logarithm) with negative log likelihoods.
pub(super) type Profile = Vec<(f64, f64)>;

/// Profile of a least-squares answer 1/m = `per_kg` ± `sd_per_kg`: normal in log m while the standard deviation of that is below
/// 0.7, beyond in 1/m.
pub(super) fn normal(per_kg: f64, sd_per_kg: f64, range_kg: [f64; 2]) -> Profile {
    let off = |m: f64| {
        if sd_per_kg < 0.7 * per_kg { (m * per_kg).ln() * per_kg / sd_per_kg } else { (1.0 / m - per_kg) / sd_per_kg }
    };
    masses(range_kg).map(|m| (m, 0.5 * off(m).powi(2))).collect()
}

/// The profile of one way in which the mesh may sit, over masses from `range_kg[0]` to `range_kg[1]`.
pub(super) fn profile(scene: &Scene<'_>, range_kg: [f64; 2]) -> Option<Profile> {
    let plain = vec![0.0; scene.equations()];
    let first = costs(scene, range_kg, &plain, 1.0)?;
    // Equations that miss at the best mass are forgiven, and what the others miss counts as noise, before masses are compared.
    let best = first.iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
    let mut added = plain;
    scene.forgive(1.0 / best.0, &best.2, &mut added)?;
    let (_, r) = scene.linearised(1.0 / best.0, &best.2, &added)?;
    let scale = (r.norm_squared() / scene.equations() as f64).max(1.0);
    // What was missed is moment (a knock, a start of a joint), the same for every mass.
    added.iter_mut().for_each(|a| *a *= best.0 * best.0);
    Some(costs(scene, range_kg, &added, scale)?.into_iter().map(|(m, cost, _)| (m, cost)).collect())
}

fn masses([lo, hi]: [f64; 2]) -> impl Iterator<Item = f64> {
    let count = (PER_E * (hi / lo).ln()).ceil().max(2.0) as usize;
    (0..=count).map(move |k| lo * (hi / lo).powf(k as f64 / count as f64))
}

/// Per mass: cost, and the unknowns that go with it. `added`: variance of moments, (N m s)².
fn costs(scene: &Scene<'_>, range_kg: [f64; 2], added: &[f64], scale: f64) -> Option<Vec<(f64, f64, Vec<f64>)>> {
    let mut out: Vec<(f64, f64, Vec<f64>)> = Vec::new();
    for m in masses(range_kg) {
        let start = out.last().map_or_else(|| vec![0.0; scene.unknowns.len()], |o| o.2.clone());
        let (cost, u) = settle(scene, m, &start, added, scale)?;
        out.push((m, cost, u));
    }
    // Back again: neighbours are alike, but a local minimum may end.
    for k in (0..out.len().saturating_sub(1)).rev() {
        let (cost, u) = settle(scene, out[k].0, &out[k + 1].2, added, scale)?;
        if cost < out[k].1 {
            out[k] = (out[k].0, cost, u);
        }
    }
    Some(out)
}

/// The likeliest unknowns at mass `m` and the cost there.
fn settle(scene: &Scene<'_>, m: f64, start: &[f64], added: &[f64], scale: f64) -> Option<(f64, Vec<f64>)> {
    let mut u = start.to_vec();
    let equations = scene.equations();
    let shrink = scale.sqrt().recip();
    let per_mass: Vec<f64> = added.iter().map(|a| a / (m * m)).collect();
    let mut best: Option<(f64, Vec<f64>)> = None;
    for _ in 0..STEPS {
        let (jacobian, mut residual) = scene.linearised(1.0 / m, &u, &per_mass)?;
        let mut slopes = jacobian.columns(1, u.len()).into_owned();
        slopes.rows_mut(0, equations).scale_mut(shrink);
        residual.rows_mut(0, equations).scale_mut(shrink);
        let cost = 0.5 * residual.norm_squared();
        if best.as_ref().is_none_or(|b| cost < b.0) {
            best = Some((cost, u.clone()));
        }
        let step: DVector<f64> = Cholesky::new(slopes.transpose() * &slopes)?.solve(&(slopes.transpose() * &residual));
        let longest = step.iter().fold(1.0, |m: f64, s| m.max(2.0 * s.abs()));
        u.iter_mut().zip(step.iter()).for_each(|(u, s)| *u -= s / longest);
        if longest == 1.0 && step.norm() < 0.02 {
            break;
        }
    }
    best
}

/// Profiles over the same masses, each with its probability beforehand, as one distribution.
pub(super) fn mixture(profiles: &[(f64, Profile)]) -> Option<MassDistribution> {
    let least = profiles.iter().flat_map(|p| p.1.iter().map(|x| x.1)).fold(f64::INFINITY, f64::min);
    let density = |k: usize| profiles.iter().map(|(odds, p)| odds * (least - p[k].1).exp()).sum::<f64>();
    let cost = |(k, x): (usize, &(f64, f64))| (x.0, -density(k).max(1e-300).ln());
    MassDistribution::from_costs(&profiles.first()?.1.iter().enumerate().map(cost).collect::<Vec<_>>()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A lognormal likelihood over 5 g to 5 kg.
    fn lognormal(center: f64, sd: f64) -> Profile {
        let masses = (0..=56).map(|k| 0.005 * 1000.0f64.powf(f64::from(k) / 56.0));
        masses.map(|m| (m, 0.5 * ((m / center).ln() / sd).powi(2))).collect()
    }

    #[test]
    fn a_lognormal_likelihood_gives_its_own_median_and_interval() {
        let p = mixture(&[(1.0, lognormal(0.2, 0.3))]).unwrap();
        assert!((p.median_kg() / 0.2 - 1.0).abs() < 0.01 && (p.sd_log() / 0.3 - 1.0).abs() < 0.05, "{p:?}");
        let [lo, hi] = p.bounds_kg().map(|m| (m.unwrap() / 0.2).ln() / 0.3);
        assert!((lo + 1.96).abs() < 0.1 && (hi - 1.96).abs() < 0.1, "{lo} {hi}");
    }

    #[test]
    fn a_bound_from_above_ends_at_the_lightest_mass() {
        let above: Profile = lognormal(0.2, 0.3).into_iter().map(|(m, c)| (m, if m < 0.2 { 0.0 } else { c })).collect();
        let p = mixture(&[(1.0, above)]).unwrap();
        let ([lo, hi], [open, closed]) = (p.ends_kg(), p.bounds_kg());
        assert_eq!((open, closed), (None, Some(hi)));
        assert!((lo / 0.005 - 1.0).abs() < 1e-9 && (0.2..0.3).contains(&hi), "{p:?}");
        let nothing: Profile = lognormal(0.2, 0.3).into_iter().map(|(m, _)| (m, 7.0)).collect();
        assert_eq!(mixture(&[(0.3, nothing)]).unwrap().bounds_kg(), [None, None]);
    }

    #[test]
    fn two_ways_to_sit_count_by_their_odds() {
        let p = mixture(&[(1.0, lognormal(0.1, 0.1)), (0.25, lognormal(0.4, 0.1))]).unwrap();
        let [lo, hi] = p.ends_kg();
        assert!((p.median_kg() / 0.1 - 1.0).abs() < 0.1 && lo < 0.1 && hi > 0.4, "{p:?}");
    }
}
