//! What is made small in a frame: differences between points of the robot and where the human hand has them.
//!
//! Sum of w · Huber(e) with e = p_task − p_origin − target, and norm_delta · |x − x_previous|². The value, the gradient and the
//! Hessian belong together: for a point p moved by the joints i (nearer to the base) and j with axes a and velocities J,
//! ∂²p / ∂i∂j = a_i × J_j.

pub(crate) mod dexpilot;
pub(crate) mod position;
#[cfg(test)]
mod tests;
pub(crate) mod vector;

use nalgebra::{Matrix3, Point3, Vector3};

use crate::kinematics::{ChainState, Chains};
use crate::solve::{BASE, Normal, Problem, State, Unknowns};

pub(crate) use dexpilot::{Projection, dexpilot_terms};
pub(crate) use position::{position_target, position_terms};
pub(crate) use vector::{tip_target, vector_terms};

/// One difference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Term {
    /// Point of [`Chains`] at the end of the vector.
    pub(crate) task: usize,
    /// Point at its beginning; `None` for a vector from the origin.
    pub(crate) origin: Option<usize>,
    /// Where the vector should be, m.
    pub(crate) target: Vector3<f64>,
    /// Weight.
    pub(crate) weight: f64,
}

/// How differences become numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Loss {
    /// Where Huber's function turns from a parabola into a line, m.
    pub(crate) delta: f64,
    /// Of each coordinate, instead of the length.
    pub(crate) per_coordinate: bool,
}

impl Loss {
    /// Huber's function as torch's SmoothL1: d²/(2 δ) below δ, d − δ/2 above.
    fn huber(&self, d: f64) -> f64 {
        if d < self.delta { 0.5 * d * d / self.delta } else { d - 0.5 * self.delta }
    }

    /// The loss of the difference `e`.
    pub(crate) fn value(&self, e: &Vector3<f64>) -> f64 {
        if self.per_coordinate { e.iter().map(|c| self.huber(c.abs())).sum() } else { self.huber(e.norm()) }
    }

    /// Gradient and Hessian with respect to `e`.
    fn derivatives(&self, e: &Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        if self.per_coordinate {
            let gradient = e.map(|c| (c / self.delta).clamp(-1.0, 1.0));
            let curvature = e.map(|c| if c.abs() < self.delta { 1.0 / self.delta } else { 0.0 });
            return (gradient, Matrix3::from_diagonal(&curvature));
        }
        let d = e.norm();
        if d < self.delta {
            return (e / self.delta, Matrix3::identity() / self.delta);
        }
        let unit = e / d;
        (unit, (Matrix3::identity() - unit * unit.transpose()) / d)
    }
}

/// The objective of one frame.
#[derive(Debug, Clone)]
pub(crate) struct FrameProblem {
    /// Points that the terms name.
    pub(crate) chains: Chains,
    /// Which coordinates move them.
    pub(crate) unknowns: Unknowns,
    /// What is to be small.
    pub(crate) terms: Vec<Term>,
    /// How.
    pub(crate) loss: Loss,
    /// Weight of |x − x_previous|².
    pub(crate) norm_delta: f64,
    /// Solution of the frame before.
    pub(crate) previous: State,
    placed: ChainState,
    /// Per point, how the unknowns move it.
    columns: Vec<Vec<Column>>,
    /// Per point, gradient of the terms.
    pulls: Vec<Vector3<f64>>,
    both: Vec<Column>,
}

/// How one unknown moves a point; from the point to the base.
#[derive(Debug, Clone, Copy)]
struct Column {
    unknown: usize,
    /// Axis of the rotation, zero for a slide.
    turn: Vector3<f64>,
    /// Velocity of the point.
    velocity: Vector3<f64>,
}

impl FrameProblem {
    /// A frame without terms.
    pub(crate) fn new(chains: Chains, unknowns: Unknowns, loss: Loss, norm_delta: f64, previous: State) -> Self {
        Self {
            chains,
            unknowns,
            terms: Vec::new(),
            loss,
            norm_delta,
            previous,
            placed: ChainState::default(),
            columns: Vec::new(),
            pulls: Vec::new(),
            both: Vec::new(),
        }
    }

    /// The objective without regularisation, at the state of the last call of [`Problem::value`].
    pub(crate) fn objective(&self) -> f64 {
        self.terms.iter().map(|t| t.weight * self.loss.value(&self.error(t))).sum()
    }

    /// Point `i` of the chains, at the state of the last call of [`Problem::value`].
    pub(crate) fn point(&self, i: usize) -> Point3<f64> {
        self.placed.points[i]
    }

    /// The difference of a term, at the state of the last call of [`Problem::value`].
    pub(crate) fn error(&self, term: &Term) -> Vector3<f64> {
        let begin = term.origin.map_or(Vector3::zeros(), |o| self.placed.points[o].coords);
        self.placed.points[term.task].coords - begin - term.target
    }

    /// How far the rotation of the base is from the previous one, as a rotation vector.
    fn turned(&self, at: &State) -> Vector3<f64> {
        if !self.unknowns.floating {
            return Vector3::zeros();
        }
        (at.base.rotation * self.previous.base.rotation.inverse()).scaled_axis()
    }

    /// How far the base is from the previous one.
    fn shifted(&self, at: &State) -> Vector3<f64> {
        at.base.translation.vector - self.previous.base.translation.vector
    }

    /// Fills [`FrameProblem::columns`].
    fn find_columns(&mut self, at: &State) {
        let n = self.unknowns.joints.len();
        let Self { chains, unknowns, placed, columns, .. } = self;
        columns.resize(placed.points.len(), Vec::new());
        for (i, columns) in columns.iter_mut().enumerate() {
            columns.clear();
            for (joint, axis, velocity) in chains.movers(placed, i) {
                if let Some(d) = unknowns.couplings[joint] {
                    columns.push(Column { unknown: d.unknown, turn: axis * d.factor, velocity: velocity * d.factor });
                }
            }
            if unknowns.floating {
                let arm = placed.points[i].coords - at.base.translation.vector;
                for k in (0..3).rev() {
                    let axis = Vector3::ith(k, 1.0);
                    columns.push(Column { unknown: n + 3 + k, turn: axis, velocity: axis.cross(&arm) });
                }
                for k in 0..3 {
                    columns.push(Column { unknown: n + k, turn: Vector3::zeros(), velocity: Vector3::ith(k, 1.0) });
                }
            }
        }
    }
}

impl Problem for FrameProblem {
    fn unknowns(&self) -> &Unknowns {
        &self.unknowns
    }

    fn value(&mut self, at: &State) -> f64 {
        self.chains.place(&at.base, &at.q, &mut self.placed);
        let mut travel = 0.0;
        for &j in &self.unknowns.joints {
            travel += (at.q[j] - self.previous.q[j]).powi(2);
        }
        if self.unknowns.floating {
            travel += self.shifted(at).norm_squared() + self.turned(at).norm_squared();
        }
        self.objective() + self.norm_delta * travel
    }

    fn derivatives(&mut self, at: &State, normal: &mut Normal) {
        self.find_columns(at);
        self.pulls.clear();
        self.pulls.resize(self.placed.points.len(), Vector3::zeros());
        let mut both = std::mem::take(&mut self.both);
        for term in &self.terms {
            let (gradient, curvature) = self.loss.derivatives(&self.error(term));
            let (gradient, curvature) = (gradient * term.weight, curvature * term.weight);
            self.pulls[term.task] += gradient;
            both.clear();
            both.extend_from_slice(&self.columns[term.task]);
            if let Some(origin) = term.origin {
                self.pulls[origin] -= gradient;
                both.extend(self.columns[origin].iter().map(|c| Column { velocity: -c.velocity, ..*c }));
            }
            // Jᵀ H J, first derivatives only.
            for (i, a) in both.iter().enumerate() {
                let curved = curvature * a.velocity;
                normal.add_diagonal(a.unknown, curved.dot(&a.velocity));
                for b in &both[..i] {
                    normal.add_both(a.unknown, b.unknown, curved.dot(&b.velocity));
                }
            }
        }
        self.both = both;
        for (pull, columns) in self.pulls.iter().zip(&self.columns) {
            for (i, a) in columns.iter().enumerate() {
                normal.gradient[a.unknown] += pull.dot(&a.velocity);
                // b is nearer to the point than a, or a itself.
                let bent = pull.cross(&a.turn);
                normal.add_diagonal(a.unknown, bent.dot(&a.velocity));
                for b in &columns[..i] {
                    normal.add_both(a.unknown, b.unknown, bent.dot(&b.velocity));
                }
            }
        }
        let w = 2.0 * self.norm_delta;
        for (k, &j) in self.unknowns.joints.iter().enumerate() {
            normal.gradient[k] += w * (at.q[j] - self.previous.q[j]);
            normal.add_diagonal(k, w);
        }
        if self.unknowns.floating {
            let n = self.unknowns.joints.len();
            let travel = [self.shifted(at), self.turned(at)];
            for k in 0..BASE {
                normal.gradient[n + k] += w * travel[k / 3][k % 3];
                normal.add_diagonal(n + k, w);
            }
        }
    }
}
