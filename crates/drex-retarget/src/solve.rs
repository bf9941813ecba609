//! Newton's method for a hand: joints in a box, a base that may float.
//!
//! Chains of rotations have second derivatives that cost hardly more than the first (see [`crate::objective`]), and the
//! targets of a hand are often out of reach, where Gauss-Newton is slow: so the true Hessian is used, damped where it is
//! not convex (Levenberg-Marquardt). Each step minimises the quadratic model in the box: variables that would leave it are
//! held at its wall and the rest is solved for again (active set).

use drex_core::Pose;
use drex_robot::Robot;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Unknowns of a floating base: translation, then rotation about the base's origin, both along the source frame's axes.
pub(crate) const BASE: usize = 6;

/// A hand: the base's pose in the source frame and the joint vector.
#[derive(Debug, Clone)]
pub(crate) struct State {
    /// `source_from_base`.
    pub(crate) base: Pose,
    /// Model order.
    pub(crate) q: Vec<f64>,
}

/// Which coordinates are solved for.
#[derive(Debug, Clone)]
pub(crate) struct Unknowns {
    /// Lowest and highest value of each joint unknown.
    pub(crate) bounds: Vec<(f64, f64)>,
    /// Joint whose coordinate each joint unknown is.
    pub(crate) joints: Vec<usize>,
    /// Per joint of the model, the unknown that moves it: coordinate = factor · unknown + offset.
    pub(crate) drive: Vec<Option<Drive>>,
    /// Whether the base is unknown too; its six come after the joints.
    pub(crate) floating: bool,
    /// Unknowns that are left alone for now.
    pub(crate) held: Vec<bool>,
}

/// coordinate = factor · unknown + offset; factor 1 and offset 0 but for coupled (`mimic`) joints.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Drive {
    pub(crate) unknown: usize,
    pub(crate) factor: f64,
    offset: f64,
}

impl Unknowns {
    /// The joints marked in `wanted`; a joint that follows another (`mimic`) stands for the one that it follows.
    pub(crate) fn new(robot: &Robot, wanted: &[bool], floating: bool) -> Self {
        let leaders: Vec<_> = (0..robot.dof()).map(|j| leader(robot, j)).collect();
        let mut unknowns =
            Self { bounds: Vec::new(), joints: Vec::new(), drive: vec![None; robot.dof()], floating, held: Vec::new() };
        for j in 0..robot.dof() {
            if (0..robot.dof()).any(|k| wanted[k] && leaders[k].0 == j) {
                unknowns.joints.push(j);
                unknowns.bounds.push((f64::NEG_INFINITY, f64::INFINITY));
            }
        }
        for (j, &(lead, factor, offset)) in leaders.iter().enumerate() {
            let Some(unknown) = unknowns.joints.iter().position(|&l| l == lead) else { continue };
            unknowns.drive[j] = Some(Drive { unknown, factor, offset });
            // A follower's limits bind its leader.
            if let Some((lo, hi)) = robot.joints[j].limits
                && factor != 0.0
            {
                let ends = [(lo - offset) / factor, (hi - offset) / factor];
                let bounds = &mut unknowns.bounds[unknown];
                let (low, high) = (bounds.0.max(ends[0].min(ends[1])), bounds.1.min(ends[0].max(ends[1])));
                if low <= high {
                    *bounds = (low, high);
                }
            }
        }
        unknowns.held = vec![false; unknowns.len()];
        unknowns
    }

    /// Number of unknowns.
    pub(crate) fn len(&self) -> usize {
        self.joints.len() + if self.floating { BASE } else { 0 }
    }

    /// Puts unknown `k` (a joint) at `value`, and the joints that follow it.
    pub(crate) fn set(&self, k: usize, value: f64, q: &mut [f64]) {
        for (coordinate, drive) in q.iter_mut().zip(&self.drive) {
            if let Some(d) = drive
                && d.unknown == k
            {
                *coordinate = d.factor * value + d.offset;
            }
        }
    }

    /// `to` = `from` after `step`, joints within their bounds.
    pub(crate) fn step(&self, from: &State, step: &[f64], to: &mut State) {
        to.q.copy_from_slice(&from.q);
        for (k, (&j, &(lo, hi))) in self.joints.iter().zip(&self.bounds).enumerate() {
            let value = (from.q[j] + step[k]).max(lo).min(hi);
            if self.drive.len() == self.joints.len() {
                to.q[j] = value;
            } else {
                self.set(k, value, &mut to.q);
            }
        }
        to.base = from.base;
        if self.floating {
            let n = self.joints.len();
            let turn = |axis: usize| UnitQuaternion::from_axis_angle(&Vector3::ith_axis(axis), step[n + 3 + axis]);
            let translation = from.base.translation.vector + Vector3::new(step[n], step[n + 1], step[n + 2]);
            let mut rotation = turn(0) * turn(1) * turn(2) * from.base.rotation;
            rotation.renormalize();
            to.base = Isometry3::from_parts(Translation3::from(translation), rotation);
        }
    }
}

/// The joint that moves joint `j`, with the factor and the offset of the coupling.
fn leader(robot: &Robot, j: usize) -> (usize, f64, f64) {
    let (mut at, mut factor, mut offset) = (j, 1.0, 0.0);
    // Couplings in a circle end after as many steps as there are joints.
    for _ in 0..robot.dof() {
        let Some(m) = robot.joints[at].mimic else { break };
        offset += factor * m.offset;
        factor *= m.multiplier;
        at = m.joint;
    }
    (at, factor, offset)
}

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
    factor: Vec<f64>,
    solution: Vec<f64>,
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
const ROUNDING: f64 = 1e-13;
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
                let last = longest < tolerance;
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
                if last {
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
            self.factor.clear();
            self.factor.resize(m * m, 0.0);
            for (a, &i) in self.free.iter().enumerate() {
                for (b, &j) in self.free[..=a].iter().enumerate() {
                    self.factor[a * m + b] = self.normal.entry(i, j);
                }
                self.factor[a * m + a] += damping * (self.normal.entry(i, i).abs() + 0.1 * mean);
            }
            if !cholesky(&mut self.factor, m) {
                return None;
            }
            // Steps other than zero are held at a wall; they move the right side.
            self.solution.clear();
            for &i in &self.free {
                let held = (0..n).filter(|&j| self.step[j] != 0.0);
                let moved: f64 = held.map(|j| self.normal.entry(i, j) * self.step[j]).sum();
                self.solution.push(-(self.normal.gradient[i] + moved));
            }
            substitute(&self.factor, &mut self.solution);
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

/// Factors the lower triangle of the n × n matrix `a` in place; false if it is not positive definite.
fn cholesky(a: &mut [f64], n: usize) -> bool {
    for i in 0..n {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| a[i * n + k] * a[j * n + k]).sum();
            let rest = a[i * n + j] - dot;
            if i == j {
                if !(rest > 1e-14 * a[i * n + i].abs()) {
                    return false;
                }
                a[i * n + i] = rest.sqrt();
            } else {
                a[i * n + j] = rest / a[j * n + j];
            }
        }
    }
    true
}

/// Solves L Lᵀ x = b in place.
fn substitute(l: &[f64], b: &mut [f64]) {
    let n = b.len();
    for i in 0..n {
        let dot: f64 = (0..i).map(|k| l[i * n + k] * b[k]).sum();
        b[i] = (b[i] - dot) / l[i * n + i];
    }
    for i in (0..n).rev() {
        let dot: f64 = (i + 1..n).map(|k| l[k * n + i] * b[k]).sum();
        b[i] = (b[i] - dot) / l[i * n + i];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// |x − centre|² with the coupling of neighbours, in a box.
    struct Bowl {
        unknowns: Unknowns,
        centre: Vec<f64>,
        coupling: f64,
    }

    impl Bowl {
        fn new(centre: &[f64], coupling: f64, bounds: (f64, f64)) -> Self {
            let n = centre.len();
            let drive = (0..n).map(|unknown| Some(Drive { unknown, factor: 1.0, offset: 0.0 })).collect();
            let unknowns = Unknowns {
                bounds: vec![bounds; n],
                joints: (0..n).collect(),
                drive,
                floating: false,
                held: vec![false; n],
            };
            Self { unknowns, centre: centre.to_vec(), coupling }
        }

        fn minimum(&mut self) -> Vec<f64> {
            let mut state = State { base: Pose::identity(), q: vec![0.0; self.centre.len()] };
            Newton::default().minimise(self, &mut state, EXACT, 50);
            state.q
        }
    }

    impl Problem for Bowl {
        fn unknowns(&self) -> &Unknowns {
            &self.unknowns
        }

        fn value(&mut self, at: &State) -> f64 {
            let far: f64 = at.q.iter().zip(&self.centre).map(|(x, c)| (x - c).powi(2)).sum();
            far + self.coupling * at.q.windows(2).map(|w| w[0] * w[1]).sum::<f64>()
        }

        fn derivatives(&mut self, at: &State, normal: &mut Normal) {
            let n = at.q.len();
            for i in 0..n {
                normal.gradient[i] += 2.0 * (at.q[i] - self.centre[i]);
                normal.add_diagonal(i, 2.0);
                if i + 1 < n {
                    normal.gradient[i] += self.coupling * at.q[i + 1];
                    normal.gradient[i + 1] += self.coupling * at.q[i];
                    normal.add_both(i, i + 1, self.coupling);
                }
            }
        }
    }

    #[test]
    fn the_minimum_in_a_box_meets_its_conditions() {
        for coupling in [-1.5, -0.4, 0.0, 0.9, 1.7] {
            let mut bowl = Bowl::new(&[0.3, 2.0, -1.4, 0.1, 0.9, -0.2], coupling, (-0.5, 0.6));
            let q = bowl.minimum();
            let mut normal = Normal::default();
            normal.reset(q.len());
            bowl.derivatives(&State { base: Pose::identity(), q: q.clone() }, &mut normal);
            for (x, g) in q.iter().zip(&normal.gradient) {
                let met = match *x {
                    x if x <= -0.5 => *g >= 0.0,
                    x if x >= 0.6 => *g <= 0.0,
                    _ => g.abs() < 1e-12,
                };
                assert!(met && (-0.5..=0.6).contains(x), "{coupling}: {x} {g}");
            }
        }
    }

    #[test]
    fn a_saddle_is_left() {
        let mut bowl = Bowl::new(&[1e-3, 0.0], 4.0, (-1.0, 1.0));
        let q = bowl.minimum();
        assert!((q[0] - 1.0).abs() < 1e-12 && (q[1] + 1.0).abs() < 1e-12, "{q:?}");
    }

    #[test]
    fn a_follower_binds_its_leader() {
        let mut robot = drex_robot::Robot::bundled("leap_right").expect("it is bundled");
        robot.joints[3].mimic = Some(drex_robot::Mimic { joint: 2, multiplier: -2.0, offset: 0.5 });
        let unknowns = Unknowns::new(&robot, &vec![true; robot.dof()], false);
        assert_eq!(unknowns.len(), robot.dof() - 1);
        let ((lo, hi), (low, high)) = (unknowns.bounds[2], robot.joints[3].limits.expect("it has limits"));
        let mut q = robot.mid_range();
        for value in [lo, hi] {
            unknowns.set(2, value, &mut q);
            assert!((q[3] - (0.5 - 2.0 * value)).abs() < 1e-12);
            assert!(q[3] >= low - 1e-12 && q[3] <= high + 1e-12);
        }
    }
}
