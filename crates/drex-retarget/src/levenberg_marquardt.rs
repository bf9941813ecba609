//! Levenberg-Marquardt for the pose of a hand and its joints, each within an interval.

use drex_core::Pose;
use nalgebra::{DMatrix, DVector, Point3, Translation3, UnitQuaternion, Vector3};

/// The unknowns of a grasp.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct HandState {
    /// Pose of the robot's base in the object's frame.
    pub(crate) object_from_base: Pose,
    /// Joint vector in the model's order, rad.
    pub(crate) q: Vec<f64>,
}

impl HandState {
    /// The state after `step`: a rotation about `pivot` (rad), a translation (m), and the joints (rad), within `intervals`.
    pub(crate) fn moved(&self, step: &DVector<f64>, pivot: &Point3<f64>, intervals: &[(f64, f64)]) -> Self {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
        let shift = Vector3::new(step[3], step[4], step[5]);
        let mut next = self.clone();
        let (pose, pivot) = (&mut next.object_from_base, pivot.coords);
        pose.rotation = turn * pose.rotation;
        pose.rotation.renormalize();
        pose.translation = Translation3::from(pivot + turn * (pose.translation.vector - pivot) + shift);
        for (k, (q, (lo, hi))) in next.q.iter_mut().zip(intervals).enumerate() {
            *q = (*q + step[6 + k]).max(*lo).min(*hi);
        }
        next
    }
}

/// How damping changes and when a search ends.
pub(crate) struct Schedule {
    /// Damping of the first step.
    pub(crate) damping: f64,
    /// Factor on the damping after an accepted step, and the least damping.
    pub(crate) decrease: (f64, f64),
    /// Factor on the damping after a rejected step, and the largest damping.
    pub(crate) increase: (f64, f64),
    /// Most steps that are tried from one state.
    pub(crate) tries: usize,
    /// Relative decrease of the cost that the linear model must promise for a step to be tried.
    pub(crate) promise: f64,
    /// Relative decrease of the cost at or below which an iteration is slow, and the number of slow ones in a row that ends the search.
    pub(crate) slow: (f64, usize),
}

/// A sum of squares over a hand's unknowns: rotation, translation, joints.
pub(crate) trait LeastSquares {
    /// What an evaluation found; buffers are used again.
    type View: Default;
    /// The schedule of the search.
    const SCHEDULE: Schedule;

    /// Evaluates the residuals at `state` and returns the cost, half the sum of squares.
    fn evaluate(&self, state: &HandState, view: &mut Self::View) -> f64;

    /// Fills the normal equations (Hessian and gradient) at the state that was evaluated.
    fn normal(&self, state: &HandState, view: &Self::View, hessian: &mut DMatrix<f64>, gradient: &mut DVector<f64>);

    /// The point that a step turns the hand about.
    fn pivot(&self, view: &Self::View) -> Point3<f64>;

    /// The interval of each joint.
    fn intervals(&self) -> &[(f64, f64)];

    /// Whether joints move.
    fn joints_move(&self) -> bool {
        true
    }

    /// The damped entry `k` of the Hessian's diagonal.
    fn damped(&self, k: usize, entry: f64, damping: f64) -> f64;

    /// Shortens a step that is longer than the linear model holds.
    fn shorten(&self, step: &mut DVector<f64>);
}

/// Improves `state` by at most `iterations` steps; returns the cost and the view of the last state.
pub(crate) fn minimise<P: LeastSquares>(problem: &P, state: &mut HandState, iterations: usize) -> (f64, P::View) {
    let Schedule { mut damping, decrease, increase, tries, promise, slow } = P::SCHEDULE;
    let n = 6 + state.q.len();
    let (mut hessian, mut gradient) = (DMatrix::zeros(n, n), DVector::zeros(n));
    let (mut view, mut next_view) = (P::View::default(), P::View::default());
    let mut cost = problem.evaluate(state, &mut view);
    let mut slow_steps = 0;
    for _ in 0..iterations {
        problem.normal(state, &view, &mut hessian, &mut gradient);
        freeze(problem, state, &mut hessian, &mut gradient);
        let before = cost;
        let mut accepted = false;
        for _ in 0..tries {
            let mut damped = hessian.clone();
            for k in 0..n {
                damped[(k, k)] = problem.damped(k, damped[(k, k)], damping);
            }
            let Some(factor) = damped.cholesky() else {
                damping *= 10.0;
                continue;
            };
            let mut step = -factor.solve(&gradient);
            // The linear model promises ½ gᵀ (A + λ D)⁻¹ g.
            if -0.5 * gradient.dot(&step) <= promise * before {
                break;
            }
            problem.shorten(&mut step);
            let next = state.moved(&step, &problem.pivot(&view), problem.intervals());
            let next_cost = problem.evaluate(&next, &mut next_view);
            if next_cost < before {
                (*state, cost) = (next, next_cost);
                std::mem::swap(&mut view, &mut next_view);
                damping = (damping * decrease.0).max(decrease.1);
                accepted = true;
                break;
            }
            damping = (damping * increase.0).min(increase.1);
        }
        slow_steps = if before - cost <= slow.0 * before { slow_steps + 1 } else { 0 };
        if !accepted || slow_steps >= slow.1 {
            break;
        }
    }
    (cost, view)
}

/// Takes joints out that do not move or that the descent would push over an end of their interval.
fn freeze<P: LeastSquares>(problem: &P, state: &HandState, hessian: &mut DMatrix<f64>, gradient: &mut DVector<f64>) {
    for (j, (q, (lo, hi))) in state.q.iter().zip(problem.intervals()).enumerate() {
        let k = 6 + j;
        if !problem.joints_move() || (q <= lo && gradient[k] > 0.0) || (q >= hi && gradient[k] < 0.0) {
            hessian.row_mut(k).fill(0.0);
            hessian.column_mut(k).fill(0.0);
            hessian[(k, k)] = 1.0;
            gradient[k] = 0.0;
        }
    }
}
