#![allow(clippy::unwrap_used)]

use drex_demo::{HandSkeleton, Side};

use super::*;
use crate::Objective;
use crate::{RetargetOptions, Retargeter, Scale, TargetHand};

/// Joints away from their limits, the base away from its place.
fn states(retargeter: &Retargeter) -> Vec<State> {
    let problem = &retargeter.problem;
    (0..3)
        .map(|sample| {
            let mut state = problem.previous.clone();
            for (k, &(lo, hi)) in problem.unknowns.bounds.iter().enumerate() {
                let part = 0.5 + 0.4 * ((7 * sample + 3 * k) as f64).sin();
                problem.unknowns.set(k, lo + part * (hi - lo), &mut state.q);
            }
            state
        })
        .collect()
}

/// The value after moving unknown `i` by `a` and unknown `j` by `b`.
fn value(problem: &mut FrameProblem, at: &State, (i, a): (usize, f64), (j, b): (usize, f64)) -> f64 {
    let mut step = vec![0.0; problem.unknowns.len()];
    step[i] += a;
    step[j] += b;
    let mut to = at.clone();
    problem.unknowns.step(at, &step, &mut to);
    problem.value(&to)
}

#[test]
fn gradients_and_hessians_are_those_of_the_values() {
    let demonstration = HandSkeleton::new(Side::Right).moving(40);
    for name in ["leap_right", "allegro_left"] {
        for objective in [Objective::Vector, Objective::DexPilot, Objective::Position] {
            let hand = TargetHand::bundled(name).unwrap();
            let mut options = RetargetOptions::new(objective);
            options.scale = Scale::Fixed(1.2);
            let mut retargeter = Retargeter::new(&hand, options).unwrap();
            // Key points of a right hand serve a left one as well as any.
            for frame in [3, 20] {
                let targets = retargeter.set_targets(&demonstration.frames[frame].points).unwrap();
                if objective == Objective::Position {
                    retargeter.problem.previous.base = targets.source_from_base;
                }
                for at in states(&retargeter) {
                    let problem = &mut retargeter.problem;
                    let n = problem.unknowns.len();
                    let mut normal = Normal::default();
                    normal.reset(n);
                    problem.value(&at);
                    problem.derivatives(&at, &mut normal);
                    let largest = normal.gradient.iter().fold(0.0_f64, |a, g| a.max(g.abs()));
                    for i in 0..n {
                        let h = 1e-6;
                        let slope = (value(problem, &at, (i, h), (i, 0.0)) - value(problem, &at, (i, -h), (i, 0.0)))
                            / (2.0 * h);
                        assert!((slope - normal.gradient[i]).abs() < 1e-6 * largest, "{name} {objective:?} {i}");
                        for j in 0..=i {
                            let h = 2e-5; // farther apart, one may be beyond the bend of a Huber function
                            let mut f = |a: f64, b: f64| value(problem, &at, (i, a * h), (j, b * h));
                            let bend = (f(1.0, 1.0) - f(1.0, -1.0) - f(-1.0, 1.0) + f(-1.0, -1.0)) / (4.0 * h * h);
                            let error = (bend - normal.entry(i, j)).abs();
                            assert!(error < 1e-4 * largest, "{name} {objective:?} {i} {j}: {bend} {error:.1e}");
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn huber_is_a_parabola_and_then_a_line() {
    let loss = Loss { delta: 0.02, per_coordinate: false };
    assert!((loss.value(&Vector3::new(0.006, 0.0, 0.008)) - 0.5 * 1e-4 / 0.02).abs() < 1e-15);
    assert!((loss.value(&Vector3::new(0.03, 0.04, 0.0)) - (0.05 - 0.01)).abs() < 1e-15);
    let each = Loss { delta: 0.02, per_coordinate: true };
    assert!((each.value(&Vector3::new(0.03, -0.04, 0.0)) - (0.02 + 0.03)).abs() < 1e-15);
}
