//! One free body against what does not answer: the table, static bodies, bodies on prescribed paths. Per unit mass of
//! the body, so that a mass which cannot be seen leaves no trace, not even in rounding.

use std::any::Any;

use nalgebra::{Matrix3, Vector3};

use super::contact_model::ContactModel;
use super::six::{Lu6, Matrix6, Vector6};
use crate::Scalar;
use crate::math::{apply, cross_columns, skew};

/// Newton iterations at most; two or three are usual.
const ITERATIONS: usize = 16;
/// Change of velocity, relative, below which an iteration has converged.
const TOLERANCE: f64 = 1e-11;

/// Where a contact model acts.
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
    models: Vec<ContactModel<f64>>,
    levers: Vec<Lever<f64>>,
    /// Derivative of the velocities by each parameter.
    tangents: Vec<Vector6>,
}

/// Velocities at the end of the step, given those without contact (`free`), the inertia per unit mass about the centre
/// of mass in the world, and a `guess`. `None` if Newton's method does not converge.
pub(crate) fn solve<T: Scalar>(
    models: &Vec<ContactModel<T>>,
    levers: &Vec<Lever<T>>,
    dt: f64,
    inertia: &Matrix3<T>,
    free: (Vector3<T>, Vector3<T>),
    guess: (&Vector3<T>, &Vector3<T>),
    buffers: &mut Buffers,
) -> Option<(Vector3<T>, Vector3<T>)> {
    let (v0, w0) = free;
    let values = (
        values_of(models, &mut buffers.models, ContactModel::value),
        values_of(levers, &mut buffers.levers, Lever::value),
    );
    let j = inertia.map(|x| x.value());
    let (fv, fw) = (v0.map(|x| x.value()), w0.map(|x| x.value()));

    let mut u = Vector6::zeros();
    u.fixed_rows_mut::<3>(0).copy_from(&guess.0.map(|x| x.value()));
    u.fixed_rows_mut::<3>(3).copy_from(&guess.1.map(|x| x.value()));
    let mut r = residual(values, dt, &j, (&fv, &fw), &u);
    let lu = 'newton: {
        for iteration in 0..ITERATIONS {
            let lu = Lu6::new(&tangent(values, dt, &j, &u))?;
            let step = lu.solve(&r);
            // The contact model is piecewise smooth: steps that lead to a larger residual are cut.
            let mut length = 1.0;
            let mut next = u - step;
            let mut next_r = residual(values, dt, &j, (&fv, &fw), &next);
            while next_r.norm_squared() > r.norm_squared() && length > 0.05 && iteration > 2 {
                length *= 0.5;
                next = u - step * length;
                next_r = residual(values, dt, &j, (&fv, &fw), &next);
            }
            u = next;
            r = next_r;
            // Without a change of branch the equations are almost linear: the residual says so after one step.
            let scale = 1.0 + u.norm();
            if step.norm() * length < TOLERANCE * scale || is_solved(&r, &j, scale) {
                break 'newton lu;
            }
        }
        return None;
    };
    let (v, w) = (u.fixed_rows::<3>(0).into_owned(), u.fixed_rows::<3>(3).into_owned());
    if T::TANGENTS == 0 {
        return Some((v.map(T::lift), w.map(T::lift)));
    }

    // One more step with derivatives.
    let lu = Lu6::new(&tangent(values, dt, &j, &u)).unwrap_or(lu);
    let (lv, lw) = (v.map(T::lift), w.map(T::lift));
    let (mut rv, mut rw) = (lv - v0, apply(inertia, &(lw - w0)));
    for (contact, lever) in models.iter().zip(levers) {
        let (velocity, spin) = lever.relative(contact, &lv, &lw);
        let f = contact.reaction(&velocity, spin);
        let force = f.force.map(|x| x.scaled(dt));
        rv -= force;
        rw -= lever.arm.cross(&force);
        if contact.lever > 0.0 {
            rw -= contact.normal * f.torque.scaled(dt);
        }
    }
    let by = &mut buffers.tangents;
    by.clear();
    by.extend(
        (0..T::TANGENTS)
            .map(|i| lu.solve(&Vector6::from_fn(|k, _| -if k < 3 { rv[k].tangent(i) } else { rw[k - 3].tangent(i) }))),
    );
    let with = |k: usize| T::with_tangents(u[k], |i| by[i][k]);
    Some((Vector3::from_fn(|k, _| with(k)), Vector3::from_fn(|k, _| with(k + 3))))
}

/// What `of` holds without derivatives: itself, or copies by `value` in a buffer.
#[allow(clippy::ptr_arg)] // a slice cannot be asked for its type
fn values_of<'a, A: 'static, B: 'static>(of: &'a Vec<A>, buffer: &'a mut Vec<B>, value: impl Fn(&A) -> B) -> &'a [B] {
    (of as &dyn Any).downcast_ref::<Vec<B>>().unwrap_or_else(|| {
        buffer.clear();
        buffer.extend(of.iter().map(value));
        buffer
    })
}

/// Whether what is left of the momentum balance is of rounding size.
fn is_solved(r: &Vector6, inertia: &Matrix3<f64>, scale: f64) -> bool {
    let left = TOLERANCE * 1e-2 * scale;
    r.fixed_rows::<3>(0).norm() < left && r.fixed_rows::<3>(3).norm() < left * 0.1 * inertia.trace()
}

impl<T: Scalar> Lever<T> {
    fn value(&self) -> Lever<f64> {
        let f = |v: &Vector3<T>| v.map(|x| x.value());
        Lever { arm: f(&self.arm), support: f(&self.support), support_spin: self.support_spin.value() }
    }

    /// Velocity and spin of the body against the support.
    pub(crate) fn relative(&self, contact_model: &ContactModel<T>, v: &Vector3<T>, w: &Vector3<T>) -> (Vector3<T>, T) {
        let spin = if contact_model.lever > 0.0 { contact_model.normal.dot(w) - self.support_spin } else { T::zero() };
        (v + w.cross(&self.arm) - self.support, spin)
    }
}

/// Momentum balance of the step at velocities `u`, per unit mass.
fn residual(
    (models, levers): (&[ContactModel<f64>], &[Lever<f64>]),
    dt: f64,
    inertia: &Matrix3<f64>,
    free: (&Vector3<f64>, &Vector3<f64>),
    u: &Vector6,
) -> Vector6 {
    let (v, w) = (u.fixed_rows::<3>(0).into_owned(), u.fixed_rows::<3>(3).into_owned());
    let (mut rv, mut rw) = (v - free.0, inertia * (w - free.1));
    for (contact, lever) in models.iter().zip(levers) {
        let (velocity, spin) = lever.relative(contact, &v, &w);
        let f = contact.reaction(&velocity, spin);
        rv -= f.force * dt;
        rw -= (lever.arm.cross(&f.force) + contact.normal * f.torque) * dt;
    }
    let mut out = Vector6::zeros();
    out.fixed_rows_mut::<3>(0).copy_from(&rv);
    out.fixed_rows_mut::<3>(3).copy_from(&rw);
    out
}

/// Derivative of the residual.
fn tangent(
    (models, levers): (&[ContactModel<f64>], &[Lever<f64>]),
    dt: f64,
    inertia: &Matrix3<f64>,
    u: &Vector6,
) -> Matrix6 {
    let (v, w) = (u.fixed_rows::<3>(0).into_owned(), u.fixed_rows::<3>(3).into_owned());
    let mut a = Matrix3::identity();
    let (mut b, mut c) = (Matrix3::zeros(), Matrix3::zeros());
    let mut d = *inertia;
    for (contact, lever) in models.iter().zip(levers) {
        let (velocity, spin) = lever.relative(contact, &v, &w);
        if let Some(stiffness) = contact.stiffness(&velocity, spin) {
            // The contact moves at v - [arm] w, its force turns the body by [arm] f.
            let k = stiffness.force * dt;
            let ks = rows_cross(&k, &lever.arm);
            a += k;
            b -= ks;
            c += cross_columns(&lever.arm, &k);
            d -= cross_columns(&lever.arm, &ks);
            if contact.lever > 0.0 {
                let (n, g) = (contact.normal * dt, stiffness.coupling.transpose());
                c += n * g;
                d += n * (contact.normal.transpose() * stiffness.torque) - n * (g * skew(&lever.arm));
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

/// M [s]: every row crossed with s.
fn rows_cross(m: &Matrix3<f64>, s: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_fn(|i, j| {
        let (k, l) = ((j + 1) % 3, (j + 2) % 3);
        m[(i, k)] * s[l] - m[(i, l)] * s[k]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_with_cross_product_matrices() {
        let m = Matrix3::new(1.0, 2.0, 3.0, -4.0, 5.0, 6.5, 7.0, -8.0, 9.0);
        let s = Vector3::new(0.3, -0.2, 0.7);
        assert!((rows_cross(&m, &s) - m * skew(&s)).norm() < 1e-14);
        assert!((cross_columns(&s, &m) - skew(&s) * m).norm() < 1e-14);
    }
}
