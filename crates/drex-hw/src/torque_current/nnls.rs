//! Non-negative least squares by Lawson and Hanson's active set.

use nalgebra::{DMatrix, DVector};

/// Smallest |A x − b| with x ≥ 0. `a` and `b` are finite and have as many rows.
pub(super) fn nnls(a: &DMatrix<f64>, b: &DVector<f64>) -> DVector<f64> {
    let n = a.ncols();
    let mut x = DVector::zeros(n);
    let mut passive = vec![false; n];
    let scale = a.amax().max(f64::MIN_POSITIVE) * b.amax();
    // Each round lowers the residual, so that no set comes twice; the bound only catches rounding that goes in circles.
    for _ in 0..4 * n + 8 {
        let w = a.tr_mul(&(b - a * &x));
        let entering = (0..n).filter(|j| !passive[*j] && w[*j] > 1e-12 * scale).max_by(|i, j| w[*i].total_cmp(&w[*j]));
        let Some(entering) = entering else { break };
        passive[entering] = true;
        loop {
            let z = solve_passive(a, b, &passive);
            let blocked = (0..n).filter(|j| passive[*j] && z[*j] <= 0.0);
            let step = blocked.map(|j| x[j] / (x[j] - z[j])).filter(|s| s.is_finite()).min_by(f64::total_cmp);
            match step {
                None if (0..n).all(|j| !passive[j] || z[j] > 0.0) => {
                    x = z;
                    break;
                }
                step => {
                    let s = step.unwrap_or(0.0).clamp(0.0, 1.0);
                    x = &x + s * (&z - &x);
                    for j in 0..n {
                        if passive[j] && (z[j] <= 0.0 && x[j] <= 1e-14 * x.amax().max(1e-300) || x[j] < 0.0) {
                            passive[j] = false;
                            x[j] = 0.0;
                        }
                    }
                }
            }
        }
    }
    x
}

/// Least squares over the columns that take part, the smallest answer where they depend on each other; zero elsewhere.
fn solve_passive(a: &DMatrix<f64>, b: &DVector<f64>, passive: &[bool]) -> DVector<f64> {
    let columns: Vec<usize> = (0..passive.len()).filter(|j| passive[*j]).collect();
    if columns.is_empty() {
        return DVector::zeros(passive.len());
    }
    let part = a.select_columns(&columns);
    let mut z = DVector::zeros(passive.len());
    let svd = part.svd(true, true);
    let small = 1e-10 * svd.singular_values.amax();
    // Both factors were asked for, so that `solve` has what it needs.
    if let Ok(solution) = svd.solve(b, small) {
        columns.iter().zip(solution.iter()).for_each(|(j, v)| z[*j] = *v);
    }
    z
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn meets_the_conditions_of_an_optimum(values in prop::collection::vec(-2.0..2.0_f64, 48), b in prop::collection::vec(-3.0..3.0_f64, 8)) {
            let (a, b) = (DMatrix::from_column_slice(8, 6, &values), DVector::from_vec(b));
            let x = nnls(&a, &b);
            let w = a.tr_mul(&(&b - &a * &x));
            for j in 0..6 {
                prop_assert!(x[j] >= 0.0);
                prop_assert!(w[j] <= 1e-8, "gradient {} of a value that could grow", w[j]);
                prop_assert!((x[j] * w[j]).abs() <= 1e-7);
            }
        }
    }

    #[test]
    fn equal_columns_end() {
        let a = DMatrix::from_fn(4, 3, |i, _| i as f64 + 1.0);
        let b = DVector::from_fn(4, |i, _| 2.0 * (i as f64 + 1.0));
        let x = nnls(&a, &b);
        assert!((x.sum() - 2.0).abs() < 1e-12 && x.iter().all(|v| *v >= 0.0));
    }
}
