//! Levenberg-Marquardt on the wrist pose and the boxed joints.

use nalgebra::{DMatrix, DVector, Translation3, UnitQuaternion, Vector3};

use super::residuals::{Scene, Stage, State, cost, linearise};

/// Longest step: rotation in rad, translation in metres.
const MAX_STEP: (f64, f64) = (0.35, 0.03);

/// Improves `state` by at most `iterations` steps; returns the cost and the state.
pub(crate) fn minimise(scene: &Scene<'_>, mut state: State, stage: Stage, iterations: usize) -> (f64, State) {
    let mut lambda = 1e-2;
    let mut at = cost(scene, &state, stage);
    for _ in 0..iterations {
        let (r, j) = linearise(scene, &state, stage);
        let gradient = j.tr_mul(&r);
        let mut normal = j.tr_mul(&j);
        freeze(scene, &state, &gradient, &mut normal);
        let gradient = masked(scene, &state, gradient);
        let before = at;
        for _ in 0..6 {
            let mut damped = normal.clone();
            for k in 0..damped.nrows() {
                damped[(k, k)] += lambda * (normal[(k, k)] + scale(k));
            }
            let Some(factor) = damped.cholesky() else {
                lambda *= 10.0;
                continue;
            };
            let next = moved(scene, &state, &-factor.solve(&gradient));
            let next_cost = cost(scene, &next, stage);
            if next_cost < at {
                state = next;
                at = next_cost;
                lambda = (lambda * 0.3).max(1e-9);
                break;
            }
            lambda = (lambda * 4.0).min(1e9);
        }
        if before - at <= 1e-5 * before {
            break;
        }
    }
    (at, state)
}

/// Damping of variables that no residual sees: one residual unit per 10 cm, radian or joint radian, scaled down.
fn scale(k: usize) -> f64 {
    match k {
        0..3 => 10.0,
        3..6 => 1e3,
        _ => 1.0,
    }
}

/// Whether joint `q[k]` is at an end of its interval that the descent would push it over.
fn stuck(scene: &Scene<'_>, state: &State, gradient: &DVector<f64>, k: usize) -> bool {
    let (lo, hi) = scene.recorded.intervals[k];
    let g = gradient[6 + k];
    (state.joints[k] <= lo && g > 0.0) || (state.joints[k] >= hi && g < 0.0)
}

fn freeze(scene: &Scene<'_>, state: &State, gradient: &DVector<f64>, normal: &mut DMatrix<f64>) {
    for k in 0..state.joints.len() {
        if stuck(scene, state, gradient, k) {
            normal.row_mut(6 + k).fill(0.0);
            normal.column_mut(6 + k).fill(0.0);
            normal[(6 + k, 6 + k)] = 1.0;
        }
    }
}

fn masked(scene: &Scene<'_>, state: &State, mut gradient: DVector<f64>) -> DVector<f64> {
    let full = gradient.clone();
    for k in 0..state.joints.len() {
        if stuck(scene, state, &full, k) {
            gradient[6 + k] = 0.0;
        }
    }
    gradient
}

/// The state after a step: rotation (about the pivot, object frame), translation, joints.
pub(crate) fn moved(scene: &Scene<'_>, state: &State, step: &DVector<f64>) -> State {
    let rotation = Vector3::new(step[0], step[1], step[2]);
    let translation = Vector3::new(step[3], step[4], step[5]);
    let shrink = (MAX_STEP.0 / rotation.norm().max(1e-12)).min(MAX_STEP.1 / translation.norm().max(1e-12)).min(1.0);
    let pivot = state.pivot(scene).coords;
    let turn = UnitQuaternion::from_scaled_axis(rotation * shrink);
    let old = &state.object_from_base;
    let mut next = state.clone();
    next.object_from_base.rotation = turn * old.rotation;
    next.object_from_base.rotation.renormalize();
    next.object_from_base.translation =
        Translation3::from(pivot + turn * (old.translation.vector - pivot) + translation * shrink);
    for (k, q) in next.joints.iter_mut().enumerate() {
        let (lo, hi) = scene.recorded.intervals[k];
        *q = (*q + shrink * step[6 + k]).max(lo).min(hi);
    }
    next
}
