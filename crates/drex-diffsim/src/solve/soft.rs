//! Contact as MuJoCo has it: soft, convex and without memory.
//!
//! The velocity of a contact is drawn to that of a damped spring, whatever mass moves behind it, so how far it rebounds
//! is fixed by the damping ratio alone (critical: e⁻² = 0.135 of the speed). Force and velocity minimise one convex
//! function of the velocity: `u` is the velocity at the end of the step, `x = u - reference` its miss, D a stiffness,
//! and with miss n along the normal and t across the force is
//!
//! | zone | where | force |
//! |---|---|---|
//! | open | n ≥ μ\|t\| | 0 |
//! | sticks | \|t\| ≤ -μ n / ρ | -D n along, -D ρ t across |
//! | slips | between | f = D (μ\|t\| - n) / (1 + μ² / ρ) along, μ f against t |
//!
//! (MuJoCo documentation, chapters "Computation: constraint model" and "Modeling: solver parameters"; elliptic cones,
//! friction-to-normal impedance ratio ρ.) Two properties are those of the model and not of bodies: a sticking contact
//! creeps, and a sliding one is pushed off the support (the slip widens the gap by μ\|t\|).

use nalgebra::{Matrix3, Vector3};

use super::Mode;
use crate::{Scalar, SoftContact};

/// The soft contact model of one contact in one step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SoftModel<T: Scalar> {
    /// Velocity that the contact is drawn to.
    pub reference: Vector3<T>,
    /// D: force per unit mass and velocity.
    pub stiffness: T,
    /// ρ.
    pub ratio: f64,
}

impl SoftContact {
    /// The contact model of a contact of this depth that moves at `velocity` at the start of a step of `dt` and carries `mass`.
    pub(crate) fn model<T: Scalar>(
        &self,
        depth: T,
        velocity: Vector3<T>,
        normal: &Vector3<T>,
        mass: T,
        dt: f64,
    ) -> SoftModel<T> {
        let [d0, d1] = self.impedance.map(|d| d.clamp(1e-4, 0.9999));
        let tc = self.time_constant_s.max(2.0 * dt);
        let damping = 2.0 / (d1 * tc);
        let spring = 1.0 / (d1 * tc * self.damping_ratio).powi(2);
        let s = depth / T::lift(self.width_m);
        let one = T::one();
        let rise = match s.value() {
            s if s >= 1.0 => one,
            v if v <= 0.5 => s * s * T::lift(2.0),
            _ => one - (one - s) * (one - s) * T::lift(2.0),
        };
        let d = T::lift(d0) + rise * T::lift(d1 - d0);
        let reference = velocity * T::lift(1.0 - damping * dt) + normal * (depth * d * T::lift(spring * dt));
        // Open contacts wait until the depth is positive.
        let stiffness = if depth.value() > 0.0 { d / (one - d) * mass * T::lift(1.0 / dt) } else { T::zero() };
        SoftModel { reference, stiffness, ratio: self.friction_ratio.max(1e-3) }
    }
}

impl<T: Scalar> SoftModel<T> {
    pub(crate) fn value(&self) -> SoftModel<f64> {
        SoftModel { reference: self.reference.map(|x| x.value()), stiffness: self.stiffness.value(), ratio: self.ratio }
    }

    /// Force per unit mass on the body at velocity `u` of the contact, and what the contact does.
    pub(crate) fn force(&self, u: &Vector3<T>, normal: &Vector3<T>, friction: T) -> (Vector3<T>, Mode) {
        let x = u - self.reference;
        let n = x.dot(normal);
        let t = x - normal * n;
        let size2 = t.norm_squared();
        // The root has no derivative at zero, where it is not needed either.
        let size = if size2.value() > 0.0 { size2.sqrt() } else { T::zero() };
        if self.stiffness.value() <= 0.0 || n.value() >= (friction * size).value() {
            return (Vector3::zeros(), Mode::Open);
        }
        if size.value() <= -(friction * n).value() / self.ratio {
            return (normal * (-self.stiffness * n) - t * (self.stiffness * T::lift(self.ratio)), Mode::Sticks);
        }
        let f = self.stiffness * (friction * size - n) / (T::one() + friction * friction * T::lift(1.0 / self.ratio));
        (normal * f - t * (friction * f / size), Mode::Slips)
    }
}

impl SoftModel<f64> {
    /// Minus the derivative of the force by the velocity: symmetric, positive semidefinite; `None` where it is open.
    pub(crate) fn tangent(&self, u: &Vector3<f64>, normal: &Vector3<f64>, friction: f64) -> Option<Matrix3<f64>> {
        let x = u - self.reference;
        let n = x.dot(normal);
        let t = x - normal * n;
        let size = t.norm();
        let along = normal * normal.transpose();
        let across = Matrix3::identity() - along;
        if self.stiffness <= 0.0 || n >= friction * size {
            return None;
        }
        if size <= -friction * n / self.ratio {
            return Some((along + across * self.ratio) * self.stiffness);
        }
        let d = self.stiffness / (1.0 + friction * friction / self.ratio);
        let t = t / size;
        let cone = normal - t * friction;
        let turn = friction * d * (friction - n / size);
        Some(cone * cone.transpose() * d + (across - t * t.transpose()) * turn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn force_is_continuous_and_its_tangent_is_its_derivative() {
        let contact_model = SoftModel { reference: Vector3::new(0.1, -0.2, 0.05), stiffness: 30.0, ratio: 2.0 };
        let normal = Vector3::new(0.2, -0.1, 1.0).normalize();
        let mut seen = [0; 3];
        for k in 0..400 {
            let a = f64::from(k);
            let u = contact_model.reference
                + Vector3::new(0.3 * (1.3 * a).sin(), 0.3 * (2.1 * a).cos(), 2.0 * (0.7 * a).sin());
            let (f, mode) = contact_model.force(&u, &normal, 0.4);
            seen[mode as usize] += 1;
            let tangent = contact_model.tangent(&u, &normal, 0.4).unwrap_or_else(Matrix3::zeros);
            assert!((tangent - tangent.transpose()).norm() < 1e-12);
            for i in 0..3 {
                let h = Vector3::ith(i, 1e-6);
                let ahead = contact_model.force(&(u + h), &normal, 0.4).0;
                let slope = (ahead - contact_model.force(&(u - h), &normal, 0.4).0) / 2e-6;
                assert!((slope + tangent.column(i)).norm() < 1e-4, "{k}: {slope} against {}", tangent.column(i));
                assert!((ahead - f).norm() < 1e-3, "continuous");
            }
        }
        assert!(seen.iter().all(|n| *n > 20), "{seen:?}");
    }
}
