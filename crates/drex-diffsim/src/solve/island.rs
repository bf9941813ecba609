//! Bodies and articulated trees that touch each other: one system of equations for all of them.
//!
//! M (u - ũ) - g = h Σ Jᵀ f(u) with the mass matrix M, contact models on the velocities of contact points, and forces on
//! single joints.

use nalgebra::Vector3;

use super::contact_model::ContactModel;
use super::lu::{Lu, copy};
use crate::Scalar;
use crate::articulation::{Column, JointForce};

const ITERATIONS: usize = 60;
/// Points tried along one direction, at most.
const SEARCHES: usize = 12;
/// A full step is good if it leaves this part of the squared residual.
const DESCENT: f64 = 0.5;
/// Part of the residual's component along a direction that may be left at its end.
const FLAT: f64 = 0.1;
/// Updates of the friction bounds, at most, where Newton's method fails.
const SETTLINGS: usize = 300;
/// Relative change of the bounds from where on Newton's method is tried again, and its iterations then.
const SETTLED: f64 = 1e-5;
/// The bounds move by this many times what they are off, at most.
const LONGEST: f64 = 4.0;
const POLISHES: usize = 12;
/// Change of velocity, relative, below which an iteration has converged.
const TOLERANCE: f64 = 1e-11;

/// The equations of one step of one island.
#[derive(Debug)]
pub(crate) struct Island<T: Scalar> {
    pub n: usize,
    /// Mass matrix, n × n, row-major.
    pub mass: Vec<T>,
    /// Reference velocity ũ.
    pub reference: Vec<T>,
    /// Smooth impulse g.
    pub impulse: Vec<T>,
    /// Velocity at the start of the step, where Newton's method starts.
    pub start: Vec<T>,
    pub models: Vec<ContactModel<T>>,
    /// End of each contact's columns.
    pub ends: Vec<usize>,
    pub columns: Vec<Column<T>>,
    /// Velocity and spin of prescribed supports, per contact model.
    pub supports: Vec<(Vector3<T>, T)>,
    pub scalars: Vec<JointForce<T>>,
}

impl<T: Scalar> Default for Island<T> {
    fn default() -> Self {
        Self {
            n: 0,
            mass: Vec::new(),
            reference: Vec::new(),
            impulse: Vec::new(),
            start: Vec::new(),
            models: Vec::new(),
            ends: Vec::new(),
            columns: Vec::new(),
            supports: Vec::new(),
            scalars: Vec::new(),
        }
    }
}

/// Buffers of the solver and its answer.
#[derive(Debug)]
pub(crate) struct Solver<T: Scalar> {
    values: Island<f64>,
    /// Row and column of the entries of the mass matrix that are not zero: few, one block per finger.
    filled: Vec<(usize, usize)>,
    matrix: Vec<f64>,
    lu: Lu,
    u: Vec<f64>,
    step: Vec<f64>,
    trial: Vec<f64>,
    r: Vec<f64>,
    trial_r: Vec<f64>,
    columns: Vec<[f64; 8]>,
    /// Normal force less friction bound, per contact model.
    gaps: Vec<f64>,
    bounds: Vec<f64>,
    settled: Vec<f64>,
    dual_r: Vec<T>,
    /// Velocities at the end of the step.
    pub velocities: Vec<T>,
    /// Whether the last solve converged.
    pub converged: bool,
    /// Newton iterations of the last solve.
    pub iterations: usize,
}

impl<T: Scalar> Default for Solver<T> {
    fn default() -> Self {
        Self {
            values: Island::default(),
            filled: Vec::new(),
            matrix: Vec::new(),
            lu: Lu::default(),
            u: Vec::new(),
            step: Vec::new(),
            trial: Vec::new(),
            r: Vec::new(),
            trial_r: Vec::new(),
            columns: Vec::new(),
            gaps: Vec::new(),
            bounds: Vec::new(),
            settled: Vec::new(),
            dual_r: Vec::new(),
            velocities: Vec::new(),
            converged: true,
            iterations: 0,
        }
    }
}

impl<T: Scalar> Island<T> {
    pub(crate) fn clear(&mut self) {
        self.n = 0;
        self.mass.clear();
        self.reference.clear();
        self.impulse.clear();
        self.start.clear();
        self.models.clear();
        self.ends.clear();
        self.columns.clear();
        self.supports.clear();
        self.scalars.clear();
    }

    fn columns_of(&self, contact: usize) -> &[Column<T>] {
        let start = if contact == 0 { 0 } else { self.ends[contact - 1] };
        &self.columns[start..self.ends[contact]]
    }

    /// Velocity and spin about the normal of contact `contact` at velocities `u`.
    pub(crate) fn relative(&self, contact: usize, u: &[T]) -> (Vector3<T>, T) {
        let (support, support_spin) = self.supports[contact];
        let (mut v, mut spin) = (-support, -support_spin);
        let turning = self.models[contact].lever > 0.0;
        for c in self.columns_of(contact) {
            v += c.linear * u[c.dof];
            if turning {
                spin += self.models[contact].normal.dot(&c.angular) * u[c.dof];
            }
        }
        (v, spin)
    }

    /// M (u - ũ) - g - h Σ Jᵀ f(u), of a mass matrix with these entries `filled`.
    fn residual(&self, u: &[T], dt: f64, filled: &[(usize, usize)], out: &mut Vec<T>) {
        let n = self.n;
        let h = T::lift(dt);
        out.clear();
        out.extend(self.impulse.iter().map(|g| -*g));
        for &(i, j) in filled {
            out[i] += self.mass[i * n + j] * (u[j] - self.reference[j]);
        }
        for joint in &self.scalars {
            out[joint.dof] -= joint.force(u[joint.dof]) * h;
        }
        for (k, contact) in self.models.iter().enumerate() {
            let (v, spin) = self.relative(k, u);
            let f = contact.reaction(&v, spin);
            if f.mode == super::Mode::Open {
                continue;
            }
            let (force, torque) = (f.force * h, f.torque * h);
            for c in self.columns_of(k) {
                out[c.dof] -= c.linear.dot(&force);
                if contact.lever > 0.0 {
                    out[c.dof] -= c.angular.dot(&contact.normal) * torque;
                }
            }
        }
    }

    fn values_into(&self, out: &mut Island<f64>) {
        let f = |v: &Vector3<T>| v.map(|x| x.value());
        out.clear();
        out.n = self.n;
        out.mass.extend(self.mass.iter().map(Scalar::value));
        out.reference.extend(self.reference.iter().map(Scalar::value));
        out.impulse.extend(self.impulse.iter().map(Scalar::value));
        out.start.extend(self.start.iter().map(Scalar::value));
        out.models.extend(self.models.iter().map(ContactModel::value));
        out.ends.extend_from_slice(&self.ends);
        out.columns.extend(self.columns.iter().map(|c| Column {
            dof: c.dof,
            linear: f(&c.linear),
            angular: f(&c.angular),
        }));
        out.supports.extend(self.supports.iter().map(|(v, s)| (f(v), s.value())));
        out.scalars.extend(self.scalars.iter().map(JointForce::value));
    }
}

impl<T: Scalar> Solver<T> {
    /// Finds the velocities at the end of the step.
    pub(crate) fn solve(&mut self, island: &Island<T>, dt: f64) {
        island.values_into(&mut self.values);
        self.filled.clear();
        for (i, row) in self.values.mass.chunks_exact(island.n.max(1)).enumerate() {
            self.filled.extend(row.iter().enumerate().filter(|(_, m)| **m != 0.0).map(|(j, _)| (i, j)));
        }
        self.u.clear();
        self.u.extend(island.start.iter().map(Scalar::value));
        self.iterations = 0;
        self.converged = self.newton(dt, ITERATIONS) || self.settle(dt);

        // One more step with derivatives.
        self.velocities.clear();
        self.velocities.extend(self.u.iter().map(|&x| T::lift(x)));
        if T::TANGENTS > 0 {
            self.assemble(dt);
            if self.lu.factor(island.n, &self.matrix) {
                island.residual(&self.velocities, dt, &self.filled, &mut self.dual_r);
                self.lu.solve_scalars(&mut self.dual_r);
                for (u, r) in self.velocities.iter_mut().zip(&self.dual_r) {
                    *u -= *r;
                }
            } else {
                // The velocities are right, but their derivatives are lost: the step counts as not solved.
                self.converged = false;
            }
        }
    }

    /// Newton's method. Where the full step of the full contact model does not reduce the residual, the direction is searched with
    /// the normal force in the friction bound held at what it is now: that problem is convex, so the residual's
    /// component along the direction is monotone and its zero can be bracketed. Without that, friction that changes
    /// sides never settles.
    fn newton(&mut self, dt: f64, iterations: usize) -> bool {
        self.values.residual(&self.u, dt, &self.filled, &mut self.r);
        for _ in 0..iterations {
            self.iterations += 1;
            let mut found = self.direction(dt);
            let mut length = 1.0;
            if found {
                let before = self.merit(&self.r);
                self.try_step(1.0, dt);
                found = self.merit(&self.trial_r) <= DESCENT * before;
            }
            if !found {
                self.hold_bounds();
                let downhill = dot(&self.r, &self.step) > 0.0;
                if !(downhill || self.direction(dt)) {
                    return false;
                }
                length = self.line_search(dt);
                self.free_bounds();
                self.values.residual(&self.trial, dt, &self.filled, &mut self.trial_r);
            }
            let size = norm(&self.step) * length.max(0.1);
            std::mem::swap(&mut self.u, &mut self.trial);
            std::mem::swap(&mut self.r, &mut self.trial_r);
            if size < TOLERANCE * (1.0 + norm(&self.u)) {
                return true;
            }
        }
        false
    }

    /// A fixed-point iteration on the friction bounds from the start, for where Newton's method goes in circles (a body
    /// that is wedged between two others): the convex problem of held bounds is solved to the end, then the bounds move
    /// to the normal forces that it gives: further while they keep their direction, less far where they swing back.
    fn settle(&mut self, dt: f64) -> bool {
        self.u.clone_from(&self.values.start);
        if self.values.models.iter().any(|contact| contact.soft.is_some()) {
            // Soft contact models have no bounds: the problem is convex as it is.
            self.convex(dt);
            return self.newton(dt, POLISHES);
        }
        self.hold_bounds();
        self.bounds.clear();
        self.bounds.extend(self.values.models.iter().map(|contact| contact.lagged.unwrap_or(0.0)));
        self.gaps.clear();
        self.gaps.resize(self.bounds.len(), 0.0);
        let (mut part, mut goal) = (1.0, SETTLED);
        for _ in 0..SETTLINGS {
            for (contact, bound) in self.values.models.iter_mut().zip(&self.bounds) {
                contact.lagged = Some(*bound);
            }
            self.convex(dt);
            // From the bounds to the normal forces at u, and how far along what that was before.
            let (mut gap2, mut sum, mut along) = (0.0, 0.0, 0.0);
            for (k, contact) in self.values.models.iter().enumerate() {
                let (v, _) = self.values.relative(k, &self.u);
                let normal = (contact.preload - contact.kappa_n * v.dot(&contact.normal)).max(0.0);
                let gap = normal - self.bounds[k];
                (gap2, sum) = (gap2 + gap * gap, sum + normal);
                along += gap * self.gaps[k];
                self.gaps[k] = gap;
            }
            if gap2.sqrt() <= goal * sum {
                // Near enough for Newton's method; where it leaves again, the fixed point itself is the answer.
                self.free_bounds();
                self.settled.clone_from(&self.u);
                if self.newton(dt, POLISHES) {
                    return true;
                }
                self.u.clone_from(&self.settled);
                if goal <= TOLERANCE {
                    return true;
                }
                goal *= 1e-3;
            }
            part = if along < 0.0 { 0.5 * part } else { f64::min(1.5 * part, LONGEST) };
            for (bound, gap) in self.bounds.iter_mut().zip(&self.gaps) {
                *bound = (*bound + part * gap).max(0.0);
            }
        }
        self.free_bounds();
        self.newton(dt, POLISHES)
    }

    /// Newton's method on the convex problem of held bounds, from `u`.
    fn convex(&mut self, dt: f64) {
        self.values.residual(&self.u, dt, &self.filled, &mut self.r);
        for _ in 0..ITERATIONS {
            self.iterations += 1;
            if !self.direction(dt) {
                return;
            }
            let length = self.line_search(dt);
            let size = norm(&self.step) * length;
            std::mem::swap(&mut self.u, &mut self.trial);
            std::mem::swap(&mut self.r, &mut self.trial_r);
            if size < TOLERANCE * (1.0 + norm(&self.u)) {
                return;
            }
        }
    }

    /// The part of the step at whose end the residual has almost no component left along it; leaves the end in `trial`.
    fn line_search(&mut self, dt: f64) -> f64 {
        let start = dot(&self.r, &self.step);
        let (mut low, mut at_low, mut high, mut at_high) = (0.0, start, f64::NAN, f64::NAN);
        let mut length = 1.0;
        for k in 0..SEARCHES {
            self.try_step(length, dt);
            let slope = dot(&self.trial_r, &self.step);
            // What has diverged is found out after the step.
            if slope.abs() < FLAT * start || (k == 0 && slope > 0.0) || !(slope.is_finite() && start.is_finite()) {
                break;
            }
            if slope > 0.0 {
                (low, at_low) = (length, slope)
            } else {
                (high, at_high) = (length, slope)
            }
            // The slope is piecewise linear: the secant, kept off the ends of the bracket.
            let secant = low + (high - low) * at_low / (at_low - at_high);
            let edge = 0.05 * (high - low);
            length = secant.clamp(low + edge, high - edge);
        }
        length
    }

    /// Holds the friction bounds at the normal forces of `u`.
    fn hold_bounds(&mut self) {
        for k in 0..self.values.models.len() {
            let (v, _) = self.values.relative(k, &self.u);
            let contact = &mut self.values.models[k];
            contact.lagged = Some((contact.preload - contact.kappa_n * v.dot(&contact.normal)).max(0.0));
        }
    }

    fn free_bounds(&mut self) {
        self.values.models.iter_mut().for_each(|contact| contact.lagged = None);
    }

    /// Size of a residual in the metric of the matrix's diagonal.
    fn merit(&self, r: &[f64]) -> f64 {
        let n = self.values.n;
        // Sliding may make an entry negative.
        r.iter().enumerate().map(|(i, x)| x * x / self.matrix[i * n + i].abs().max(self.values.mass[i * n + i])).sum()
    }

    /// The Newton step at `u` for the residual `r`, into `step`.
    fn direction(&mut self, dt: f64) -> bool {
        self.assemble(dt);
        if !self.lu.factor(self.values.n, &self.matrix) {
            return false;
        }
        self.step.clone_from(&self.r);
        self.lu.solve(&mut self.step);
        self.step.iter().all(|x| x.is_finite())
    }

    fn try_step(&mut self, length: f64, dt: f64) {
        self.trial.clear();
        self.trial.extend(self.u.iter().zip(&self.step).map(|(u, s)| u - s * length));
        self.values.residual(&self.trial, dt, &self.filled, &mut self.trial_r);
    }

    /// Derivative of the residual at `u`.
    fn assemble(&mut self, dt: f64) {
        let (n, island) = (self.values.n, &self.values);
        copy(&island.mass, &mut self.matrix);
        for joint in &island.scalars {
            self.matrix[joint.dof * n + joint.dof] += joint.stiffness(self.u[joint.dof]) * dt;
        }
        for (k, contact) in island.models.iter().enumerate() {
            let (v, spin) = island.relative(k, &self.u);
            let Some(stiffness) = contact.stiffness(&v, spin) else { continue };
            let columns = island.columns_of(k);
            // Per column: what its velocity does to the force, and to the torque about the normal.
            self.columns.clear();
            self.columns.extend(columns.iter().map(|c| {
                let f = stiffness.force * c.linear * dt;
                let turn = contact.normal.dot(&c.angular);
                let t = (stiffness.torque * turn + stiffness.coupling.dot(&c.linear)) * dt;
                [f.x, f.y, f.z, t, turn, 0.0, 0.0, 0.0]
            }));
            let turning = contact.lever > 0.0;
            for (row, r) in columns.iter().zip(&self.columns) {
                let start = row.dof * n;
                for (column, c) in columns.iter().zip(&self.columns) {
                    let mut x = row.linear.x * c[0] + row.linear.y * c[1] + row.linear.z * c[2];
                    if turning {
                        x += r[4] * c[3];
                    }
                    self.matrix[start + column.dof] += x;
                }
            }
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}
