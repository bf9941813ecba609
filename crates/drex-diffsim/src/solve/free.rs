//! One free body against what does not answer: the table, fixed things, things on prescribed paths. Per unit mass of
//! the body, so that a mass which cannot be seen leaves no trace, not even in rounding.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::law::Law;
use crate::Scalar;
use crate::math::skew;

/// Newton iterations at most; two or three are usual.
const ITERATIONS: usize = 30;

type Vector6 = SVector<f64, 6>;
type Matrix6 = SMatrix<f64, 6, 6>;

/// Where a law acts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lever<T: Scalar> {
    /// From the centre of mass to the contact, world.
    pub arm: Vector3<T>,
    /// Velocity of the support there.
    pub support: Vector3<T>,
    /// Spin of the support about the normal.
    pub support_spin: T,
}

/// Buffers of the solver.
#[derive(Debug, Default)]
pub(crate) struct Buffers {
    values: Vec<(Law<f64>, Lever<f64>)>,
}

/// Velocities at the end of the step, given those without contact (`free`), the inertia per unit mass about the centre
/// of mass in the world, and a `guess`. `None` if Newton's method does not converge.
pub(crate) fn solve<T: Scalar>(
    laws: &[Law<T>],
    levers: &[Lever<T>],
    dt: f64,
    inertia: &Matrix3<T>,
    free: (Vector3<T>, Vector3<T>),
    guess: (&Vector3<T>, &Vector3<T>),
    buffers: &mut Buffers,
) -> Option<(Vector3<T>, Vector3<T>)> {
    let (v0, w0) = free;
    let values = &mut buffers.values;
    values.clear();
    values.extend(laws.iter().zip(levers).map(|(law, lever)| (law.value(), lever.value())));
    let j = inertia.map(|x| x.value());
    let (fv, fw) = (v0.map(|x| x.value()), w0.map(|x| x.value()));

    let mut u = Vector6::zeros();
    u.fixed_rows_mut::<3>(0).copy_from(&guess.0.map(|x| x.value()));
    u.fixed_rows_mut::<3>(3).copy_from(&guess.1.map(|x| x.value()));
    let mut matrix = Matrix6::identity();
    let mut r = residual(values, dt, &j, (&fv, &fw), &u);
    let mut converged = false;
    for iteration in 0..ITERATIONS {
        matrix = tangent(values, dt, &j, &u);
        let step = matrix.lu().solve(&r)?;
        // The law is piecewise smooth: steps that lead to a larger residual are cut.
        let mut length = 1.0;
        let mut next = u - step;
        let mut next_r = residual(values, dt, &j, (&fv, &fw), &next);
        while next_r.norm_squared() > r.norm_squared() && length > 0.05 && iteration > 2 {
            length *= 0.5;
            next = u - step * length;
            next_r = residual(values, dt, &j, (&fv, &fw), &next);
        }
        let change = step.norm() * length;
        u = next;
        r = next_r;
        if change < 1e-11 * (1.0 + u.norm()) {
            converged = true;
            break;
        }
    }
    if !converged {
        return None;
    }
    if r.norm() > 0.0 {
        matrix = tangent(values, dt, &j, &u);
    }

    // One more step with derivatives.
    let (mut v, mut w) = (u.fixed_rows::<3>(0).map(T::lift), u.fixed_rows::<3>(3).map(T::lift));
    let (mut rv, mut rw) = (v - v0, inertia * (w - w0));
    for (law, lever) in laws.iter().zip(levers) {
        let (velocity, spin) = lever.relative(law, &v, &w);
        let f = law.reaction(&velocity, spin);
        let force = f.force * T::lift(dt);
        rv -= force;
        rw -= lever.arm.cross(&force) + law.normal * (f.torque * T::lift(dt));
    }
    let inverse = matrix.try_inverse()?;
    for row in 0..3 {
        for column in 0..3 {
            v[row] -= rv[column] * T::lift(inverse[(row, column)]) + rw[column] * T::lift(inverse[(row, column + 3)]);
            w[row] -=
                rv[column] * T::lift(inverse[(row + 3, column)]) + rw[column] * T::lift(inverse[(row + 3, column + 3)]);
        }
    }
    Some((v, w))
}

impl<T: Scalar> Lever<T> {
    fn value(&self) -> Lever<f64> {
        let f = |v: &Vector3<T>| v.map(|x| x.value());
        Lever { arm: f(&self.arm), support: f(&self.support), support_spin: self.support_spin.value() }
    }

    /// Velocity and spin of the body against the support.
    pub(crate) fn relative(&self, law: &Law<T>, v: &Vector3<T>, w: &Vector3<T>) -> (Vector3<T>, T) {
        let spin = if law.lever > 0.0 { law.normal.dot(w) - self.support_spin } else { T::zero() };
        (v + w.cross(&self.arm) - self.support, spin)
    }
}

/// Momentum balance of the step at velocities `u`, per unit mass.
fn residual(
    laws: &[(Law<f64>, Lever<f64>)],
    dt: f64,
    inertia: &Matrix3<f64>,
    free: (&Vector3<f64>, &Vector3<f64>),
    u: &Vector6,
) -> Vector6 {
    let (v, w) = (u.fixed_rows::<3>(0).into_owned(), u.fixed_rows::<3>(3).into_owned());
    let (mut rv, mut rw) = (v - free.0, inertia * (w - free.1));
    for (law, lever) in laws {
        let (velocity, spin) = lever.relative(law, &v, &w);
        let f = law.reaction(&velocity, spin);
        rv -= f.force * dt;
        rw -= (lever.arm.cross(&f.force) + law.normal * f.torque) * dt;
    }
    let mut out = Vector6::zeros();
    out.fixed_rows_mut::<3>(0).copy_from(&rv);
    out.fixed_rows_mut::<3>(3).copy_from(&rw);
    out
}

/// Derivative of the residual.
fn tangent(laws: &[(Law<f64>, Lever<f64>)], dt: f64, inertia: &Matrix3<f64>, u: &Vector6) -> Matrix6 {
    let (v, w) = (u.fixed_rows::<3>(0).into_owned(), u.fixed_rows::<3>(3).into_owned());
    let mut a = Matrix3::identity();
    let (mut b, mut c) = (Matrix3::zeros(), Matrix3::zeros());
    let mut d = *inertia;
    for (law, lever) in laws {
        let (velocity, spin) = lever.relative(law, &v, &w);
        if let Some(stiffness) = law.stiffness(&velocity, spin) {
            let (k, s) = (stiffness.force * dt, skew(&lever.arm));
            // The contact moves at v + w x arm = v - [arm] w, its force turns the body by [arm] f.
            a += k;
            b -= k * s;
            c += s * k;
            d -= s * k * s;
            if law.lever > 0.0 {
                let n = law.normal * dt;
                let g = stiffness.coupling.transpose();
                c += n * g;
                d += n * (law.normal.transpose() * stiffness.torque) - n * (g * s);
            }
        }
    }
    let mut out = Matrix6::zeros();
    out.fixed_view_mut::<3, 3>(0, 0).copy_from(&a);
    out.fixed_view_mut::<3, 3>(0, 3).copy_from(&b);
    out.fixed_view_mut::<3, 3>(3, 0).copy_from(&c);
    out.fixed_view_mut::<3, 3>(3, 3).copy_from(&d);
    out
}
