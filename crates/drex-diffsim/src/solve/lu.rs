//! Small dense linear systems that are mostly zeros: a mass matrix with contacts has one block per finger.

/// An LU decomposition, row-major, in place and without exchange of rows as long as the pivots allow it.
#[derive(Debug, Default)]
pub(crate) struct Lu {
    n: usize,
    a: Vec<f64>,
    /// Row order, when rows were exchanged.
    order: Vec<usize>,
    exchanged: bool,
    scratch: Vec<f64>,
}

/// A pivot below this part of its row's diagonal asks for an exchange of rows.
const WEAK: f64 = 1e-8;

impl Lu {
    /// Decomposes `a` (n × n, row-major). False if it is singular.
    pub(crate) fn factor(&mut self, n: usize, a: &[f64]) -> bool {
        self.n = n;
        copy(a, &mut self.a);
        self.exchanged = false;
        if self.eliminate(false) {
            return true;
        }
        copy(a, &mut self.a);
        self.exchanged = true;
        self.order.clear();
        self.order.extend(0..n);
        self.eliminate(true)
    }

    fn eliminate(&mut self, exchange: bool) -> bool {
        let n = self.n;
        for k in 0..n {
            let own = self.a[k * n + k].abs();
            if exchange {
                let best = (k..n).max_by(|&i, &j| self.a[i * n + k].abs().total_cmp(&self.a[j * n + k].abs()));
                if let Some(best) = best.filter(|&b| b != k) {
                    self.order.swap(k, best);
                    for j in 0..n {
                        self.a.swap(k * n + j, best * n + j);
                    }
                }
            } else {
                let below = (k + 1..n).map(|i| self.a[i * n + k].abs()).fold(0.0, f64::max);
                if own <= WEAK * below {
                    return false;
                }
            }
            let pivot = self.a[k * n + k];
            if !(pivot.abs() > 0.0) || !pivot.is_finite() {
                return false;
            }
            let inverse = 1.0 / pivot;
            let (top, rest) = self.a.split_at_mut((k + 1) * n);
            let row = &top[k * n + k + 1..];
            for lower in rest.chunks_exact_mut(n) {
                if lower[k] != 0.0 {
                    let f = lower[k] * inverse;
                    lower[k] = f;
                    for (x, y) in lower[k + 1..].iter_mut().zip(row) {
                        *x -= f * y;
                    }
                }
            }
        }
        true
    }

    /// x of A x = b, in place.
    pub(crate) fn solve(&mut self, b: &mut [f64]) {
        let n = self.n;
        if self.exchanged {
            self.scratch.clear();
            self.scratch.extend(self.order.iter().map(|&i| b[i]));
            b.copy_from_slice(&self.scratch);
        }
        for i in 0..n {
            let row = &self.a[i * n..i * n + i];
            b[i] -= row.iter().zip(&b[..i]).map(|(l, x)| l * x).sum::<f64>();
        }
        for i in (0..n).rev() {
            let row = &self.a[i * n..(i + 1) * n];
            let s: f64 = row[i + 1..].iter().zip(&b[i + 1..n]).map(|(u, x)| u * x).sum();
            b[i] = (b[i] - s) / row[i];
        }
    }
}

impl Lu {
    /// As [`Lu::solve`], for right-hand sides with derivatives.
    pub(crate) fn solve_scalars<T: crate::Scalar>(&self, b: &mut Vec<T>) {
        let n = self.n;
        if self.exchanged {
            *b = self.order.iter().map(|&i| b[i]).collect();
        }
        for i in 0..n {
            for j in 0..i {
                let l = self.a[i * n + j];
                if l != 0.0 {
                    let x = b[j];
                    b[i] -= x * T::lift(l);
                }
            }
        }
        for i in (0..n).rev() {
            for j in i + 1..n {
                let u = self.a[i * n + j];
                if u != 0.0 {
                    let x = b[j];
                    b[i] -= x * T::lift(u);
                }
            }
            b[i] *= T::lift(1.0 / self.a[i * n + i]);
        }
    }
}

/// Makes `to` equal to `from` by adding zero: what the compiler makes of a plain copy of some kilobytes, `rep movsb`, takes some AMD processors longer
/// than the elimination.
pub(crate) fn copy(from: &[f64], to: &mut Vec<f64>) {
    to.clear();
    to.extend(from.iter().map(|x| x + 0.0));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(n: usize, a: &[f64]) {
        let x: Vec<f64> = (0..n).map(|i| (i as f64 * 1.7).sin() + 0.3).collect();
        let mut b: Vec<f64> = (0..n).map(|i| (0..n).map(|j| a[i * n + j] * x[j]).sum()).collect();
        let mut lu = Lu::default();
        assert!(lu.factor(n, a));
        lu.solve(&mut b);
        for (p, q) in b.iter().zip(&x) {
            assert!((p - q).abs() < 1e-10, "{p} {q}");
        }
    }

    #[test]
    fn solves_blocks_and_exchanges_rows_where_it_must() {
        let n = 9;
        // Two blocks of three coupled through a third one.
        let a: Vec<f64> = (0..n * n)
            .map(|k| {
                let (i, j) = (k / n, k % n);
                let coupled = i / 3 == j / 3 || i / 3 == 2 || j / 3 == 2;
                if i == j {
                    4.0 + i as f64
                } else if coupled {
                    ((i * 5 + j * 3) as f64).cos()
                } else {
                    0.0
                }
            })
            .collect();
        check(n, &a);
        check(2, &[0.0, 1.0, 2.0, 3.0]);
        check(3, &[1e-14, 1.0, 0.5, 1.0, 0.0, 2.0, 3.0, -1.0, 0.0]);
        // A weak pivot in the second column: without an exchange nine digits are lost.
        check(3, &[1.0, 0.0, 0.0, 0.0, 1e-20, 1e-13, 0.0, 1.0, 1.0]);
        // The same where all that stands beside what is below the pivot is zero.
        check(4, &[2.0, 0.0, 0.0, 0.0, 0.0, 1e-20, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        assert!(!Lu::default().factor(2, &[1.0, 2.0, 2.0, 4.0]));
        assert!(!Lu::default().factor(1, &[f64::NAN]));
    }
}
