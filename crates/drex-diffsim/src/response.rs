//! The forces of closed contacts, and the velocity of the body that they agree with at the end of a step.
//!
//! Normal: k depth + c rate, never pulling. Friction: a spring per contact that sticks, returned to the Coulomb cone
//! when it slips (elastic predictor, return mapping), so that a loaded contact below the cone does not creep. Both are
//! taken at the end of the step (implicit Euler), so that contact can be as stiff as rigid bodies are at any step.
//! All is per unit mass of the body. The stiffness of one contact is shared with those that carry beside it, weighed by
//! how evenly they carry (participation ratio), so the total does not grow with the number of points.
//!
//! The implicit equations are solved by Newton's method on plain numbers; derivatives then follow from one more step on
//! dual numbers with the converged matrix (implicit function theorem).

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::Scalar;
use crate::contact::Contact;
use crate::math::skew;
use crate::model::{Anchor, BodyState, ContactOptions};

/// Number of contacts that carry a flat face at full stiffness: the corners of a box face.
const FACE_CONTACTS: f64 = 4.0;
/// Newton iterations at most; two or three are usual.
const ITERATIONS: usize = 30;

type Vector6 = SVector<f64, 6>;
type Matrix6 = SMatrix<f64, 6, 6>;

/// A contact with the constants of its law: f_n = max(0, preload - kappa_n v_n), spring k_t.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Law<T: Scalar> {
    site: u32,
    arm: Vector3<T>,
    normal: Vector3<T>,
    support: Vector3<T>,
    friction: T,
    /// Normal force at zero velocity.
    preload: T,
    /// Loss of normal force per velocity.
    kappa_n: T,
    /// Stretch of the friction spring at the start of the step.
    stretch: Vector3<T>,
    k_t: T,
    kappa_t: T,
}

/// Buffers of the solver.
#[derive(Debug)]
pub(crate) struct Buffers<T: Scalar> {
    laws: Vec<Law<T>>,
    values: Vec<Law<f64>>,
}

impl<T: Scalar> Default for Buffers<T> {
    fn default() -> Self {
        Self { laws: Vec::new(), values: Vec::new() }
    }
}

/// Velocities at the end of the step, given those without contact (`v`, `w`, world) and the inertia about the centre of
/// mass in the world. Replaces the anchors of `state`.
pub(crate) fn solve<T: Scalar>(
    contacts: &[Contact<T>],
    options: &ContactOptions,
    dt: f64,
    inertia: &Matrix3<T>,
    free: (Vector3<T>, Vector3<T>),
    state: &mut BodyState<T>,
    buffers: &mut Buffers<T>,
) -> (Vector3<T>, Vector3<T>) {
    let (v0, w0) = free;
    if contacts.is_empty() {
        state.anchors.clear();
        return (v0, w0);
    }
    prepare(contacts, options, dt, &state.anchors, &mut buffers.laws);
    buffers.values.clear();
    buffers.values.extend(buffers.laws.iter().map(Law::value));
    let values = &buffers.values;
    let j = inertia.map(|x| x.value());
    let (fv, fw) = (v0.map(|x| x.value()), w0.map(|x| x.value()));

    // Newton on plain numbers, from the velocity that the last step ended with.
    let mut u = Vector6::zeros();
    u.fixed_rows_mut::<3>(0).copy_from(&state.velocity.map(|x| x.value()));
    u.fixed_rows_mut::<3>(3).copy_from(&state.angular_velocity.map(|x| x.value()));
    let mut matrix = Matrix6::identity();
    let mut r = residual(values, dt, &j, (&fv, &fw), &u);
    for iteration in 0..ITERATIONS {
        matrix = tangent(values, dt, &j, &u);
        let Some(step) = matrix.lu().solve(&r) else { break };
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
            break;
        }
    }
    matrix = if r.norm() > 0.0 { tangent(values, dt, &j, &u) } else { matrix };

    // One more step with derivatives.
    let v = u.fixed_rows::<3>(0).map(T::lift);
    let w = u.fixed_rows::<3>(3).map(T::lift);
    let (mut rv, mut rw) = (v - v0, inertia * (w - w0));
    for law in &buffers.laws {
        let f = law.force(&v, &w).0 * T::lift(dt);
        rv -= f;
        rw -= law.arm.cross(&f);
    }
    let (mut v, mut w) = (v, w);
    if let Some(inverse) = matrix.try_inverse() {
        for row in 0..3 {
            for column in 0..3 {
                v[row] -=
                    rv[column] * T::lift(inverse[(row, column)]) + rw[column] * T::lift(inverse[(row, column + 3)]);
                w[row] -= rv[column] * T::lift(inverse[(row + 3, column)])
                    + rw[column] * T::lift(inverse[(row + 3, column + 3)]);
            }
        }
    }
    state.anchors.clear();
    for law in &buffers.laws {
        let stretch = law.stretched(&v, &w, dt);
        state.anchors.push(Anchor { site: law.site, stretch });
    }
    (v, w)
}

/// The laws of all contacts in this step.
fn prepare<T: Scalar>(
    contacts: &[Contact<T>],
    options: &ContactOptions,
    dt: f64,
    anchors: &[Anchor<T>],
    out: &mut Vec<Law<T>>,
) {
    out.clear();
    let w = options.frequency_rad_s;
    let (mut sum, mut squares) = (T::zero(), T::zero());
    for c in contacts {
        if c.depth.value() > 0.0 {
            sum += c.depth;
            squares += c.depth * c.depth;
        }
    }
    let ratio = if squares.value() > 0.0 { sum * sum / squares * T::lift(1.0 / FACE_CONTACTS) } else { T::zero() };
    let share = if ratio.value() > 1.0 { T::one() / ratio } else { T::one() } * T::lift(1.0 / FACE_CONTACTS);
    let k_n = share * T::lift(w * w);
    let kappa_n = k_n * T::lift(dt + options.relaxation_s);
    let k_t = k_n * T::lift(options.tangential_ratio);
    let kappa_t = k_t * T::lift(dt + options.tangential_relaxation_s);
    let mut old = anchors.iter().peekable();
    for c in contacts {
        while old.next_if(|a| a.site < c.site).is_some() {}
        let kept = old.next_if(|a| a.site == c.site).map_or_else(Vector3::zeros, |a| a.stretch);
        out.push(Law {
            site: c.site,
            arm: c.arm,
            normal: c.normal,
            support: c.support_velocity.map(T::lift),
            friction: c.friction,
            // A gap may close by the end of the step, and no further.
            preload: if c.depth.value() > 0.0 { k_n * c.depth } else { kappa_n * c.depth * T::lift(1.0 / dt) },
            kappa_n,
            stretch: kept - c.normal * kept.dot(&c.normal),
            k_t,
            kappa_t,
        });
    }
}

impl<T: Scalar> Law<T> {
    fn value(&self) -> Law<f64> {
        let f = |v: &Vector3<T>| v.map(|x| x.value());
        Law {
            site: self.site,
            arm: f(&self.arm),
            normal: f(&self.normal),
            support: f(&self.support),
            friction: self.friction.value(),
            preload: self.preload.value(),
            kappa_n: self.kappa_n.value(),
            stretch: f(&self.stretch),
            k_t: self.k_t.value(),
            kappa_t: self.kappa_t.value(),
        }
    }

    fn velocity(&self, v: &Vector3<T>, w: &Vector3<T>) -> Vector3<T> {
        v + w.cross(&self.arm) - self.support
    }

    /// Force per unit mass on the body, and whether the contact slips (`None`: it carries nothing).
    fn force(&self, v: &Vector3<T>, w: &Vector3<T>) -> (Vector3<T>, Option<bool>) {
        let u = self.velocity(v, w);
        let rate = u.dot(&self.normal);
        let normal = self.preload - self.kappa_n * rate;
        if normal.value() <= 0.0 {
            return (Vector3::zeros(), None);
        }
        let trial = -(self.stretch * self.k_t + (u - self.normal * rate) * self.kappa_t);
        let (size2, bound) = (trial.norm_squared(), self.friction * normal);
        if size2.value() > (bound * bound).value() {
            (self.normal * normal + trial * (bound / size2.sqrt()), Some(true))
        } else {
            (self.normal * normal + trial, Some(false))
        }
    }

    /// The friction spring at the end of the step: dragged along while it sticks, on the cone while it slips, gone
    /// when the contact carries nothing.
    fn stretched(&self, v: &Vector3<T>, w: &Vector3<T>, dt: f64) -> Vector3<T> {
        let (f, slips) = self.force(v, w);
        match slips {
            None => Vector3::zeros(),
            Some(true) => (f - self.normal * f.dot(&self.normal)) * (-T::one() / self.k_t),
            Some(false) => {
                let u = self.velocity(v, w);
                self.stretch + (u - self.normal * u.dot(&self.normal)) * T::lift(dt)
            }
        }
    }
}

impl Law<f64> {
    /// Minus the derivative of the force by the velocity of the contact.
    fn stiffness(&self, v: &Vector3<f64>, w: &Vector3<f64>) -> Option<Matrix3<f64>> {
        let u = self.velocity(v, w);
        let n = &self.normal;
        let rate = u.dot(n);
        let normal = self.preload - self.kappa_n * rate;
        if normal <= 0.0 {
            return None;
        }
        let along = n * n.transpose();
        let across = Matrix3::identity() - along;
        let trial = -(self.stretch * self.k_t + (u - n * rate) * self.kappa_t);
        let (size, bound) = (trial.norm(), self.friction * normal);
        Some(if size > bound {
            let t = trial / size;
            along * self.kappa_n
                + t * n.transpose() * (self.friction * self.kappa_n)
                + (across - t * t.transpose()) * (bound / size * self.kappa_t)
        } else {
            along * self.kappa_n + across * self.kappa_t
        })
    }
}

/// Momentum balance of the step at velocities `u`, per unit mass.
fn residual(
    laws: &[Law<f64>],
    dt: f64,
    inertia: &Matrix3<f64>,
    free: (&Vector3<f64>, &Vector3<f64>),
    u: &Vector6,
) -> Vector6 {
    let (v, w) = (u.fixed_rows::<3>(0).into_owned(), u.fixed_rows::<3>(3).into_owned());
    let (mut rv, mut rw) = (v - free.0, inertia * (w - free.1));
    for law in laws {
        let f = law.force(&v, &w).0 * dt;
        rv -= f;
        rw -= law.arm.cross(&f);
    }
    let mut out = Vector6::zeros();
    out.fixed_rows_mut::<3>(0).copy_from(&rv);
    out.fixed_rows_mut::<3>(3).copy_from(&rw);
    out
}

/// Derivative of the residual.
fn tangent(laws: &[Law<f64>], dt: f64, inertia: &Matrix3<f64>, u: &Vector6) -> Matrix6 {
    let (v, w) = (u.fixed_rows::<3>(0).into_owned(), u.fixed_rows::<3>(3).into_owned());
    let mut out = Matrix6::identity();
    let mut a = Matrix3::identity();
    let (mut b, mut c) = (Matrix3::zeros(), Matrix3::zeros());
    let mut d = *inertia;
    for law in laws {
        if let Some(k) = law.stiffness(&v, &w) {
            let (k, s) = (k * dt, skew(&law.arm));
            // The contact moves at v + w x arm = v - [arm] w, its force turns the body by [arm] f.
            a += k;
            b -= k * s;
            c += s * k;
            d -= s * k * s;
        }
    }
    out.fixed_view_mut::<3, 3>(0, 0).copy_from(&a);
    out.fixed_view_mut::<3, 3>(0, 3).copy_from(&b);
    out.fixed_view_mut::<3, 3>(3, 0).copy_from(&c);
    out.fixed_view_mut::<3, 3>(3, 3).copy_from(&d);
    out
}
