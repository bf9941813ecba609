//! Newton's method for a hand: joints in a box, a base that may float.
//!
//! Chains of rotations have second derivatives that cost hardly more than the first (see [`crate::objective`]), and the
//! targets of a hand are often out of reach, where Gauss-Newton is slow: so the true Hessian is used, damped where it is
//! not convex (Levenberg-Marquardt). Each step minimises the quadratic model in the box: variables that would leave it are
//! held at its wall and the rest is solved for again (active set).

#[cfg(test)]
mod tests;
mod unknowns;

use nalgebra::{Cholesky, DMatrix, DVector};
pub(crate) use unknowns::{BASE, State, Unknowns};

/// Something to minimise.
pub(crate) trait Problem {
    /// What may move.
    fn unknowns(&self) -> &Unknowns;

    /// The value at `at`.
    fn value(&mut self, at: &State) -> f64;

    /// Adds gradient and Hessian at the state of the last call of [`Problem::value`] to `normal`, which is zero.
    fn derivatives(&mut self, at: &State, normal: &mut Normal);
}

/// Gradient and Hessian.
#[derive(Debug, Clone, Default)]
pub(crate) struct Normal {
    pub(crate) gradient: Vec<f64>,
    /// Row by row; only the lower triangle is used.
    hessian: Vec<f64>,
}

impl Normal {
    pub(crate) fn reset(&mut self, n: usize) {
        self.gradient.clear();
        self.gradient.resize(n, 0.0);
        self.hessian.clear();
        self.hessian.resize(n * n, 0.0);
    }

    /// Adds `value` to entries (i, j) and (j, i); to a diagonal entry twice.
    pub(crate) fn add_both(&mut self, i: usize, j: usize, value: f64) {
        let n = self.gradient.len();
        self.hessian[i.max(j) * n + i.min(j)] += if i == j { 2.0 * value } else { value };
    }

    /// Adds `value` to the diagonal entry `i`.
    pub(crate) fn add_diagonal(&mut self, i: usize, value: f64) {
        let n = self.gradient.len();
        self.hessian[i * n + i] += value;
    }

    pub(crate) fn entry(&self, i: usize, j: usize) -> f64 {
        self.hessian[i.max(j) * self.gradient.len() + i.min(j)]
    }
}

/// Buffers of the solver, to be used again.
#[derive(Debug, Clone, Default)]
pub(crate) struct Newton {
    normal: Normal,
    /// The damped Hessian of what is solved for.
    model: DMatrix<f64>,
    solution: DVector<f64>,
    step: Vec<f64>,
    /// Variables of the step that are solved for.
    free: Vec<usize>,
    trial: Option<State>,
}

/// The last step (rad, m) for a solution to the last digits: the next would be its square.
pub(crate) const EXACT: f64 = 1e-9;
/// Part of the decrease that the quadratic model promises which a step must keep.
const KEPT: f64 = 1e-4;
/// Changes of the value below this part of it are rounding.
const ROUNDING: f64 = 1e-11;
/// Longest step of one unknown, rad or m: the quadratic model holds no farther.
const LONGEST_STEP: f64 = 0.7;

impl Newton {
    /// Moves `state` to a minimum of `problem`; returns the value there. A step shorter than `tolerance` (rad, m) is the last.
    pub(crate) fn minimise(
        &mut self,
        problem: &mut impl Problem,
        state: &mut State,
        tolerance: f64,
        iterations: usize,
    ) -> f64 {
        let n = problem.unknowns().len();
        let mut trial = self.trial.take().filter(|t| t.q.len() == state.q.len()).unwrap_or_else(|| state.clone());
        let mut value = problem.value(state);
        let mut damping = 0.0;
        'steps: for _ in 0..iterations {
            self.normal.reset(n);
            problem.derivatives(state, &mut self.normal);
            loop {
                let Some(promised) = self.model_step(problem.unknowns(), state, damping) else {
                    damping = more(damping);
                    if damping > MOST_DAMPING {
                        break 'steps;
                    }
                    continue;
                };
                let longest = self.step.iter().fold(0.0_f64, |a, s| a.max(s.abs()));
                problem.unknowns().step(state, &self.step, &mut trial);
                let next = problem.value(&trial);
                let short = longest < tolerance;
                // A damped step is short of the minimum.
                let last = short && damping == 0.0;
                // Within the rounding of the value only the model knows which way is down.
                let unseen = promised <= ROUNDING * value.abs();
                if next <= value - KEPT * promised || (unseen && next <= value + ROUNDING * value.abs()) {
                    std::mem::swap(state, &mut trial);
                    value = next;
                    damping = less(damping);
                    if last {
                        break 'steps;
                    }
                    break;
                }
                if short {
                    break 'steps;
                }
                damping = more(damping);
                if damping > MOST_DAMPING {
                    break 'steps;
                }
            }
        }
        self.trial = Some(trial);
        value
    }

    /// Minimises the damped quadratic model in the box; the step is in `self.step`. Returns the decrease of the model, or
    /// `None` where the model is not convex.
    fn model_step(&mut self, unknowns: &Unknowns, state: &State, damping: f64) -> Option<f64> {
        let n = unknowns.len();
        let joints = unknowns.joints.len();
        let room = |k: usize| {
            if k < joints {
                let (at, (lo, hi)) = (state.q[unknowns.joints[k]], unknowns.bounds[k]);
                ((lo - at).clamp(-LONGEST_STEP, 0.0), (hi - at).clamp(0.0, LONGEST_STEP))
            } else {
                (-LONGEST_STEP, LONGEST_STEP)
            }
        };
        let mean = (0..n).map(|k| self.normal.entry(k, k).abs()).sum::<f64>() / n.max(1) as f64;
        self.step.clear();
        self.step.resize(n, 0.0);
        self.free.clear();
        for k in 0..n {
            let (g, (lo, hi)) = (self.normal.gradient[k], room(k));
            let at_wall = (lo >= 0.0 && g > 0.0) || (hi <= 0.0 && g < 0.0);
            if !at_wall && !unknowns.held[k] {
                self.free.push(k);
            }
        }
        loop {
            let m = self.free.len();
            let mut model = std::mem::take(&mut self.model);
            model.resize_mut(m, m, 0.0);
            for (a, &i) in self.free.iter().enumerate() {
                for (b, &j) in self.free[..=a].iter().enumerate() {
                    model[(a, b)] = self.normal.entry(i, j);
                }
                model[(a, a)] += damping * (self.normal.entry(i, i).abs() + 0.1 * mean);
            }
            let factor = Cholesky::new(model)?;
            // Steps other than zero are held at a wall; they move the right side.
            self.solution.resize_vertically_mut(m, 0.0);
            for (a, &i) in self.free.iter().enumerate() {
                let held = (0..n).filter(|&j| self.step[j] != 0.0);
                let moved: f64 = held.map(|j| self.normal.entry(i, j) * self.step[j]).sum();
                self.solution[a] = -(self.normal.gradient[i] + moved);
            }
            factor.solve_mut(&mut self.solution);
            self.model = factor.unpack_dirty();
            let mut solution = self.solution.iter();
            let step = &mut self.step;
            self.free.retain(|&k| {
                let ((lo, hi), s) = (room(k), solution.next().copied().unwrap_or(0.0));
                let inside = s >= lo && s <= hi;
                if !inside {
                    step[k] = s.max(lo).min(hi);
                }
                inside
            });
            if self.free.len() == m {
                for (&k, &s) in self.free.iter().zip(&self.solution) {
                    self.step[k] = s;
                }
                break;
            }
        }
        if !self.step.iter().all(|s| s.is_finite()) {
            return None;
        }
        let mut decrease = 0.0;
        for i in 0..n {
            let row: f64 = (0..n).map(|j| self.normal.entry(i, j) * self.step[j]).sum();
            decrease -= self.step[i] * (self.normal.gradient[i] + 0.5 * row);
        }
        Some(decrease.max(0.0))
    }
}

const MOST_DAMPING: f64 = 1e8;

fn more(damping: f64) -> f64 {
    (damping * 8.0).max(1e-3)
}

fn less(damping: f64) -> f64 {
    if damping < 1e-3 { 0.0 } else { damping * 0.125 }
}
