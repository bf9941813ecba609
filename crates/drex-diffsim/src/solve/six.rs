//! Linear systems of six equations, the size of one free body.

use nalgebra::SMatrix;

pub(crate) type Vector6 = nalgebra::SVector<f64, 6>;
pub(crate) type Matrix6 = SMatrix<f64, 6, 6>;

/// A pivot below this part of the entries below it asks for an exchange of rows.
const WEAK: f64 = 1e-6;

/// The LU decomposition of a 6 × 6 matrix.
#[derive(Debug, Clone)]
pub(crate) enum Lu6 {
    /// Without exchange of rows: what the matrix of a body in contact is almost always good for. Rows, with the inverse
    /// pivots on the diagonal.
    Plain(Box<[[f64; 6]; 6]>),
    /// With.
    Exchanged(Box<nalgebra::LU<f64, nalgebra::Const<6>, nalgebra::Const<6>>>),
}

impl Lu6 {
    /// `None` if the matrix is singular or not finite.
    pub(crate) fn new(m: &Matrix6) -> Option<Self> {
        let mut a = [[0.0; 6]; 6];
        for (i, row) in a.iter_mut().enumerate() {
            for (j, x) in row.iter_mut().enumerate() {
                *x = m[(i, j)];
            }
        }
        for k in 0..6 {
            let pivot = a[k][k];
            let below = a[k + 1..].iter().map(|row| row[k].abs()).fold(0.0, f64::max);
            if !(pivot.abs() > WEAK * below && pivot != 0.0 && pivot.is_finite()) {
                let lu = m.lu();
                let good = m.iter().all(|x| x.is_finite()) && lu.is_invertible();
                return good.then(|| Self::Exchanged(Box::new(lu)));
            }
            let inverse = 1.0 / pivot;
            a[k][k] = inverse;
            let top = a[k];
            for row in &mut a[k + 1..] {
                let f = row[k] * inverse;
                row[k] = f;
                for j in k + 1..6 {
                    row[j] -= f * top[j];
                }
            }
        }
        Some(Self::Plain(Box::new(a)))
    }

    /// x of A x = b.
    pub(crate) fn solve(&self, b: &Vector6) -> Vector6 {
        match self {
            Self::Plain(a) => {
                let mut x = *b;
                for i in 1..6 {
                    for j in 0..i {
                        x[i] -= a[i][j] * x[j];
                    }
                }
                for i in (0..6).rev() {
                    for j in i + 1..6 {
                        x[i] -= a[i][j] * x[j];
                    }
                    x[i] *= a[i][i];
                }
                x
            }
            Self::Exchanged(lu) => lu.solve(b).unwrap_or_else(Vector6::zeros),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solves_with_and_without_exchange_of_rows() {
        let m = Matrix6::from_fn(|i, j| if i == j { 3.0 + i as f64 } else { ((7 * i + 3 * j) as f64).sin() });
        let mut swapped = m;
        swapped.swap_rows(0, 4);
        swapped[(0, 0)] = 0.0;
        let x = Vector6::from_fn(|i, _| 0.3 - i as f64);
        for (a, plain) in [(m, true), (swapped, false)] {
            let lu = Lu6::new(&a).unwrap_or_else(|| unreachable!("it is regular"));
            assert_eq!(matches!(lu, Lu6::Plain(_)), plain);
            assert!((lu.solve(&(a * x)) - x).norm() < 1e-12);
        }
        assert!(Lu6::new(&Matrix6::zeros()).is_none());
        assert!(Lu6::new(&(m * f64::NAN)).is_none());
    }
}
