//! Levenberg-Marquardt on the wrist and the boxed joints of one frame.

use nalgebra::{DMatrix, DVector};

use super::terms::{Problem, State, View};

/// Longest step: turn in rad, shift in metres, joint in rad.
const LONGEST: (f64, f64, f64) = (0.3, 0.03, 0.3);
/// Relative decrease below which the search has arrived.
const ARRIVED: f64 = 2e-3;
/// and promised relative decrease below which no step is tried.
const PROMISING: f64 = 5e-4;

/// Improves `state` by at most `iterations` steps. Returns the view of the end.
pub(crate) fn minimise(problem: &Problem<'_>, state: &mut State, iterations: usize) -> View {
    let n = 6 + state.q.len();
    let (mut a, mut g) = (DMatrix::zeros(n, n), DVector::zeros(n));
    let (mut view, mut next_view) = (View::default(), View::default());
    problem.view(state, &mut view);
    let mut lambda = 1e-3;
    let mut slow = 0;
    for _ in 0..iterations {
        problem.normal(state, &view, &mut a, &mut g);
        freeze(problem, state, &mut a, &mut g);
        let before = view.cost;
        let mut accepted = false;
        for _ in 0..8 {
            let mut damped = a.clone();
            for k in 0..n {
                damped[(k, k)] *= 1.0 + lambda;
            }
            let Some(factor) = damped.cholesky() else {
                lambda *= 10.0;
                continue;
            };
            let mut step = -factor.solve(&g);
            // What the linear model promises: ½ gᵀ (A + λ D)⁻¹ g.
            if -0.5 * g.dot(&step) <= PROMISING * before {
                break;
            }
            shorten(&mut step);
            let next = problem.moved(state, &view, &step);
            problem.view(&next, &mut next_view);
            if next_view.cost < before {
                *state = next;
                std::mem::swap(&mut view, &mut next_view);
                lambda = (lambda * 0.2).max(1e-7);
                accepted = true;
                break;
            }
            lambda = (lambda * 6.0).min(1e6);
        }
        slow = if before - view.cost <= ARRIVED * before { slow + 1 } else { 0 };
        if !accepted || slow >= 2 {
            break;
        }
    }
    view
}

fn shorten(step: &mut DVector<f64>) {
    let turn = step.rows(0, 3).norm();
    let shift = step.rows(3, 3).norm();
    let joint = step.rows(6, step.len() - 6).amax();
    let most = (turn / LONGEST.0).max(shift / LONGEST.1).max(joint / LONGEST.2);
    if most > 1.0 {
        *step /= most;
    }
}

/// Takes joints out that do not move or that the descent would push over an end of their interval.
fn freeze(problem: &Problem<'_>, state: &State, a: &mut DMatrix<f64>, g: &mut DVector<f64>) {
    for (j, q) in state.q.iter().enumerate() {
        let (lo, hi) = problem.intervals[j];
        let k = 6 + j;
        if !problem.joints_move || (*q <= lo && g[k] > 0.0) || (*q >= hi && g[k] < 0.0) {
            a.row_mut(k).fill(0.0);
            a.column_mut(k).fill(0.0);
            a[(k, k)] = 1.0;
            g[k] = 0.0;
        }
    }
}
