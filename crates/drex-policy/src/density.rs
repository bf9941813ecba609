//! The density that a policy is trained by: a mixture of Student's t distributions over grasps.
//!
//! With q the J joint angles, t the wrist's translation and θ the angle between wrists, mode k has
//!
//! z² = Σ_j (Δq_j / σ_j)² + |Δt|² / σ_t² + θ² / σ_r²,
//! p_k = Γ((ν + D) / 2) / (Γ(ν / 2) (ν π)^(D/2) Π σ) · (1 + z² / ν)^(-(ν + D) / 2), D = J + 6,
//!
//! a density over rad^J m³ rad³ (rotation vectors about the mode; exact for small angles). One spread per joint, one of the translation and one
//! of the rotation serve all modes. Without the wrist, D = J gives the marginal over the joints: leaving out coordinates of a Student's t
//! leaves a Student's t with the same ν.

use std::f64::consts::PI;

/// ν: tails heavy enough that a grasp unlike all others does not pull a mode towards it, light enough to have a variance.
pub(crate) const TAIL: f64 = 5.0;

/// ln of the constant Γ((ν + D) / 2) / (Γ(ν / 2) (ν π)^(D/2)).
pub(crate) fn log_constant(dimensions: usize) -> f64 {
    let d = dimensions as f64;
    ln_gamma((TAIL + d) / 2.0) - ln_gamma(TAIL / 2.0) - d / 2.0 * (TAIL * PI).ln()
}

/// ln p_k from z² and the sum of the logarithms of the D spreads.
pub(crate) fn log_student(z2: f64, log_spreads: f64, dimensions: usize) -> f64 {
    log_constant(dimensions) - log_spreads - (TAIL + dimensions as f64) / 2.0 * (z2 / TAIL).ln_1p()
}

/// ln Σ exp, without overflow; minus infinity for none.
pub(crate) fn log_sum_exp(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let most = values.clone().fold(f64::NEG_INFINITY, f64::max);
    if most == f64::NEG_INFINITY {
        return most;
    }
    most + values.map(|v| (v - most).exp()).sum::<f64>().ln()
}

/// ln Γ for arguments over 0 (Stirling's series after shifting above 10: 1e-12).
fn ln_gamma(mut x: f64) -> f64 {
    let mut shift = 0.0;
    while x < 10.0 {
        shift -= x.ln();
        x += 1.0;
    }
    let r = 1.0 / (x * x);
    let series = (1.0 / 12.0 - r * (1.0 / 360.0 - r * (1.0 / 1260.0 - r / 1680.0))) / x;
    shift + (x - 0.5) * x.ln() - x + 0.5 * (2.0 * PI).ln() + series
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gamma_has_its_known_values() {
        for (x, expected) in
            [(0.5, PI.sqrt()), (1.0, 1.0), (2.5, 0.75 * PI.sqrt()), (7.0, 720.0), (13.5, 1_710_542_068.319_572_4)]
        {
            assert!((ln_gamma(x) - f64::ln(expected)).abs() < 1e-10, "{x}");
        }
    }

    #[test]
    fn the_density_sums_to_one() {
        // In one and three dimensions, over the radius, with the area of the sphere.
        for (d, area) in [(1usize, 2.0), (3, 4.0 * PI)] {
            let spread: f64 = 0.3;
            let step = 1e-3;
            let sum: f64 = (0..400_000)
                .map(|i| {
                    let r = (f64::from(i) + 0.5) * step;
                    let log = log_student((r / spread).powi(2), d as f64 * spread.ln(), d);
                    log.exp() * area * r.powi(d as i32 - 1) * step
                })
                .sum();
            assert!((sum - 1.0).abs() < 1e-3, "{d} dimensions: {sum}");
        }
    }

    #[test]
    fn sums_of_exponentials_do_not_overflow() {
        assert!((log_sum_exp([1000.0, 1000.0].into_iter()) - 1000.0 - 2f64.ln()).abs() < 1e-12);
        assert_eq!(log_sum_exp(std::iter::empty()), f64::NEG_INFINITY);
    }
}
