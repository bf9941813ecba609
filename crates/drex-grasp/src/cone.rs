//! Small cone programmes, built row by row and handed to Clarabel (an interior-point solver).
//!
//! minimise cᵀx + ½ xᵀ diag(p) x subject to affine expressions in x being zero, not negative, or in a second-order cone
//! {(t, v) : |v| <= t}. Everything is kept dense until the end: the problems here have tens of unknowns.

use clarabel::algebra::CscMatrix;
use clarabel::solver::SupportedConeT::{NonnegativeConeT, SecondOrderConeT, ZeroConeT};
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus, SupportedConeT};

use crate::{GraspError, Result};

/// An affine expression: Σ coefficient·x\[index\] + constant.
#[derive(Debug, Clone, Default)]
pub(crate) struct Affine {
    pub(crate) terms: Vec<(usize, f64)>,
    pub(crate) constant: f64,
}

impl Affine {
    pub(crate) fn new(terms: Vec<(usize, f64)>, constant: f64) -> Self {
        Self { terms, constant }
    }

    pub(crate) fn var(index: usize, coefficient: f64) -> Self {
        Self { terms: vec![(index, coefficient)], constant: 0.0 }
    }
}

/// The answer of [`ConeProgram::minimise`].
#[derive(Debug, Clone)]
pub(crate) enum Answer {
    Solved {
        x: Vec<f64>,
    },
    Infeasible,
    /// The cost has no lower bound.
    Unbounded,
}

/// A programme under construction.
#[derive(Debug, Clone)]
pub(crate) struct ConeProgram {
    cost: Vec<f64>,
    quadratic: Vec<f64>,
    zero: Vec<Affine>,
    nonnegative: Vec<Affine>,
    second_order: Vec<Vec<Affine>>,
}

impl ConeProgram {
    pub(crate) fn new(unknowns: usize) -> Self {
        Self {
            cost: vec![0.0; unknowns],
            quadratic: vec![0.0; unknowns],
            zero: Vec::new(),
            nonnegative: Vec::new(),
            second_order: Vec::new(),
        }
    }

    pub(crate) fn cost(&mut self, index: usize, coefficient: f64) {
        self.cost[index] += coefficient;
    }

    pub(crate) fn set_cost(&mut self, index: usize, coefficient: f64) {
        self.cost[index] = coefficient;
    }

    /// Adds weight/2 · x\[index\]² to the cost; the weight must not be negative.
    pub(crate) fn quadratic(&mut self, index: usize, weight: f64) {
        self.quadratic[index] += weight;
    }

    pub(crate) fn zero(&mut self, expression: Affine) {
        self.zero.push(expression);
    }

    pub(crate) fn nonnegative(&mut self, expression: Affine) {
        self.nonnegative.push(expression);
    }

    /// `|rows[1..]| <= rows[0]`.
    pub(crate) fn second_order(&mut self, rows: Vec<Affine>) {
        self.second_order.push(rows);
    }

    /// Solves the programme. Deterministic: one thread, no time limit.
    pub(crate) fn minimise(&self) -> Result<Answer> {
        let n = self.cost.len();
        let mut cones: Vec<SupportedConeT<f64>> = Vec::new();
        if !self.zero.is_empty() {
            cones.push(ZeroConeT(self.zero.len()));
        }
        if !self.nonnegative.is_empty() {
            cones.push(NonnegativeConeT(self.nonnegative.len()));
        }
        cones.extend(self.second_order.iter().map(|rows| SecondOrderConeT(rows.len())));

        // Clarabel's form is A x + s = b with s in the cone, so A = -coefficients and b = constants.
        let (mut i, mut j, mut v, mut b) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for row in self.zero.iter().chain(&self.nonnegative).chain(self.second_order.iter().flatten()) {
            // Entries of the same place are added up.
            for &(column, value) in row.terms.iter().filter(|(_, value)| *value != 0.0) {
                i.push(b.len());
                j.push(column);
                v.push(-value);
            }
            b.push(row.constant);
        }
        let a = CscMatrix::new_from_triplets(b.len(), n, i, j, v);
        let diagonal: Vec<usize> = (0..n).filter(|&k| self.quadratic[k] > 0.0).collect();
        let weights = diagonal.iter().map(|&k| self.quadratic[k]).collect();
        let p = CscMatrix::new_from_triplets(n, n, diagonal.clone(), diagonal, weights);
        let settings = DefaultSettings {
            verbose: false,
            max_threads: 1,
            tol_gap_abs: 1e-9,
            tol_gap_rel: 1e-9,
            tol_feas: 1e-9,
            ..DefaultSettings::default()
        };
        let mut solver = DefaultSolver::new(&p, &self.cost, &a, &b, &cones, settings)
            .map_err(|e| GraspError::Solver { status: e.to_string(), iterations: 0 })?;
        solver.solve();
        match solver.solution.status {
            SolverStatus::Solved | SolverStatus::AlmostSolved => Ok(Answer::Solved { x: solver.solution.x.clone() }),
            SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible => Ok(Answer::Infeasible),
            SolverStatus::DualInfeasible | SolverStatus::AlmostDualInfeasible => Ok(Answer::Unbounded),
            other => Err(GraspError::Solver { status: format!("{other:?}"), iterations: solver.solution.iterations }),
        }
    }
}
