//! The contact model of one contact: force and torque by the velocity at the end of the step.
//!
//! Normal: k depth + c rate, never pulling. Friction: a spring that sticks, returned to the Coulomb cone when it slips
//! (elastic predictor, return mapping), so that a loaded contact below the cone does not creep; a second spring resists
//! turning about the normal. All are taken at the end of the step (implicit Euler), so that contact can be as stiff as
//! rigid bodies are at any step.

use nalgebra::{Matrix3, Vector3};

use super::Mode;
use super::soft::SoftModel;
use crate::contact::Contact;
use crate::{Scalar, SoftContact};

/// Constants of one closed or closing contact in one step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ContactModel<T: Scalar> {
    /// Out of the support, unit.
    pub normal: Vector3<T>,
    pub friction: T,
    /// Share of the patch.
    pub share: T,
    /// Normal force at zero velocity.
    pub preload: T,
    /// Loss of normal force per velocity.
    pub kappa_n: T,
    /// Stretch of the friction spring at the start of the step, world, tangential.
    pub stretch: Vector3<T>,
    pub k_t: T,
    pub kappa_t: T,
    /// Lever of the torsional friction: its bound is friction · lever · normal force. Zero: none.
    pub lever: f64,
    /// Angle of the torsional spring at the start of the step.
    pub twist: T,
    pub k_r: T,
    pub kappa_r: T,
    /// A normal force that bounds the friction in place of the contact's own: the contact model is then the gradient of a convex
    /// function.
    pub lagged: Option<f64>,
    /// The soft contact model in place of all others.
    pub soft: Option<SoftModel<T>>,
}

/// Force and torque of a contact on the body that the normal points into.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reaction<T: Scalar> {
    pub force: Vector3<T>,
    /// About the normal.
    pub torque: T,
    pub mode: Mode,
    /// Whether the torsional spring slips.
    pub turns: bool,
}

/// Minus the derivative of a reaction by the velocity of the contact.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stiffness {
    /// Force by velocity.
    pub force: Matrix3<f64>,
    /// Torque by the spin about the normal.
    pub torque: f64,
    /// Torque by velocity.
    pub coupling: Vector3<f64>,
}

impl<T: Scalar> ContactModel<T> {
    pub(crate) fn value(&self) -> ContactModel<f64> {
        let f = |v: &Vector3<T>| v.map(|x| x.value());
        ContactModel {
            normal: f(&self.normal),
            friction: self.friction.value(),
            share: self.share.value(),
            preload: self.preload.value(),
            kappa_n: self.kappa_n.value(),
            stretch: f(&self.stretch),
            k_t: self.k_t.value(),
            kappa_t: self.kappa_t.value(),
            lever: self.lever,
            twist: self.twist.value(),
            k_r: self.k_r.value(),
            kappa_r: self.kappa_r.value(),
            lagged: self.lagged,
            soft: self.soft.as_ref().map(SoftModel::value),
        }
    }

    /// Makes it the soft contact model of a contact that moves at `u` at the start of the step. `mass` is what the patch carries.
    /// Every corner is as stiff as if it carried alone: the spring behind it, not the stiffness, says how it moves.
    pub(crate) fn soften(&mut self, soft: &SoftContact, contact: &Contact<T>, u: Vector3<T>, mass: T, dt: f64) {
        let corners = if contact.sampled { self.share * T::lift(super::FACE_CORNERS) } else { T::one() };
        self.soft = Some(soft.model(contact.depth, u, &self.normal, corners * mass, dt));
    }

    /// Reaction at relative velocity `u` (world) and relative spin about the normal.
    pub(crate) fn reaction(&self, u: &Vector3<T>, spin: T) -> Reaction<T> {
        if let Some(soft) = &self.soft {
            let (force, mode) = soft.force(u, &self.normal, self.friction);
            return Reaction { force, torque: T::zero(), mode, turns: false };
        }
        let rate = u.dot(&self.normal);
        let normal = self.preload - self.kappa_n * rate;
        if normal.value() <= 0.0 {
            return Reaction { force: Vector3::zeros(), torque: T::zero(), mode: Mode::Open, turns: false };
        }
        let trial = self.trial(u, rate);
        let (size2, bound) = (trial.norm_squared(), self.friction * self.lagged.map_or(normal, T::lift));
        let (tangential, mode) = if size2.value() > (bound * bound).value() {
            (trial * (bound / size2.sqrt()), Mode::Slips)
        } else {
            (trial, Mode::Sticks)
        };
        let (mut torque, mut turns) = (T::zero(), false);
        if self.lever > 0.0 {
            torque = -(self.twist * self.k_r + spin * self.kappa_r);
            let bound = bound * T::lift(self.lever);
            if torque.value().abs() > bound.value() {
                torque = if torque.value() > 0.0 { bound } else { -bound };
                turns = true;
            }
        }
        Reaction { force: self.normal * normal + tangential, torque, mode, turns }
    }

    /// The springs at the end of a step with the reaction `r`: dragged along while they stick, on their bound while they
    /// slip, gone when the contact carries nothing.
    pub(crate) fn springs(&self, r: &Reaction<T>, u: &Vector3<T>, spin: T, dt: f64) -> (Vector3<T>, T) {
        if self.soft.is_some() {
            return (Vector3::zeros(), T::zero());
        }
        let stretch = match r.mode {
            Mode::Open => return (Vector3::zeros(), T::zero()),
            Mode::Slips => (r.force - self.normal * r.force.dot(&self.normal)) * (-T::one() / self.k_t),
            Mode::Sticks => self.stretch + (u - self.normal * u.dot(&self.normal)).map(|x| x.scaled(dt)),
        };
        let twist = match (self.lever > 0.0, r.turns) {
            (false, _) => T::zero(),
            (true, true) => -r.torque / self.k_r,
            (true, false) => self.twist + spin.scaled(dt),
        };
        (stretch, twist)
    }

    fn trial(&self, u: &Vector3<T>, rate: T) -> Vector3<T> {
        -(self.stretch * self.k_t + (u - self.normal * rate) * self.kappa_t)
    }
}

impl ContactModel<f64> {
    /// How the reaction changes with the velocity; nothing where the contact carries nothing.
    #[inline(always)]
    pub(crate) fn stiffness(&self, u: &Vector3<f64>, spin: f64) -> Option<Stiffness> {
        let n = &self.normal;
        if let Some(soft) = &self.soft {
            let force = soft.tangent(u, n, self.friction)?;
            return Some(Stiffness { force, torque: 0.0, coupling: Vector3::zeros() });
        }
        let rate = u.dot(n);
        let normal = self.preload - self.kappa_n * rate;
        if normal <= 0.0 {
            return None;
        }
        let along = n * n.transpose();
        let across = Matrix3::identity() - along;
        let trial = self.trial(u, rate);
        let (size, bound) = (trial.norm(), self.friction * self.lagged.unwrap_or(normal));
        // How fast the bound of the friction falls with the rate.
        let fall = if self.lagged.is_some() { 0.0 } else { self.friction * self.kappa_n };
        let force = if size > bound {
            let t = trial / size;
            along * self.kappa_n
                + t * n.transpose() * fall
                + (across - t * t.transpose()) * (bound / size * self.kappa_t)
        } else {
            along * self.kappa_n + across * self.kappa_t
        };
        let (mut torque, mut coupling) = (0.0, Vector3::zeros());
        if self.lever > 0.0 {
            let trial = -(self.twist * self.k_r + spin * self.kappa_r);
            if trial.abs() > bound * self.lever {
                coupling = n * (trial.signum() * self.lever * fall);
            } else {
                torque = self.kappa_r;
            }
        }
        Some(Stiffness { force, torque, coupling })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)] // a test may panic
    use super::*;

    const DT_S: f64 = 0.01;

    /// A contact under way along `u` and about its normal, springs stretched.
    fn contact_model(lagged: Option<f64>) -> ContactModel<f64> {
        let normal = Vector3::new(0.2, -0.3, 0.9).normalize();
        let stretch = Vector3::new(1e-4, 2e-4, -1e-4);
        ContactModel {
            normal,
            friction: 0.6,
            share: 1.0,
            preload: 2.0,
            kappa_n: 30.0,
            stretch: stretch - normal * stretch.dot(&normal),
            k_t: 800.0,
            kappa_t: 25.0,
            lever: 0.004,
            twist: 0.01,
            k_r: 0.03,
            kappa_r: 0.001,
            lagged,
            soft: None,
        }
    }

    /// Slow and fast along and about the normal: sticks and slips, turns and does not, pressed and let go.
    fn motions() -> impl Iterator<Item = (Vector3<f64>, f64)> {
        let slides = [Vector3::new(1e-4, -2e-4, 1e-4), Vector3::new(0.3, 0.2, -0.02), Vector3::new(-0.2, 0.1, 0.03)];
        slides.into_iter().flat_map(|u| [-20.0, -0.1, 0.2, 25.0].map(|spin| (u, spin)))
    }

    #[test]
    fn stiffness_is_minus_the_derivative_of_the_reaction() {
        let (mut slips, mut turns) = ([0, 0], [0, 0]);
        for contact_model in [contact_model(None), contact_model(Some(1.5))] {
            for (u, spin) in motions() {
                let stiffness = contact_model.stiffness(&u, spin).unwrap();
                let there = contact_model.reaction(&u, spin);
                slips[usize::from(there.mode == Mode::Slips)] += 1;
                turns[usize::from(there.turns)] += 1;
                let h = 1e-7;
                for k in 0..3 {
                    let step = Vector3::ith(k, h);
                    let (more, less) =
                        (contact_model.reaction(&(u + step), spin), contact_model.reaction(&(u - step), spin));
                    let force = (more.force - less.force) / (2.0 * h);
                    assert!((force + stiffness.force.column(k)).norm() < 1e-5, "{force} {}", stiffness.force);
                    let torque = (more.torque - less.torque) / (2.0 * h);
                    assert!((torque + stiffness.coupling[k]).abs() < 1e-7, "{torque} {}", stiffness.coupling);
                }
                let torque = (contact_model.reaction(&u, spin + h).torque
                    - contact_model.reaction(&u, spin - h).torque)
                    / (2.0 * h);
                assert!((torque + stiffness.torque).abs() < 1e-9, "{torque} {}", stiffness.torque);
            }
        }
        assert!(slips.iter().chain(&turns).all(|&n| n >= 4), "{slips:?} {turns:?}");
    }

    /// What slipped holds, at rest, with the force that it slipped with.
    #[test]
    fn springs_keep_the_reaction() {
        for (u, spin) in motions() {
            let contact_model = contact_model(None);
            let r = contact_model.reaction(&u, spin);
            let (stretch, twist) = contact_model.springs(&r, &u, spin, DT_S);
            if r.mode == Mode::Slips {
                assert!(
                    (r.force - contact_model.normal * r.force.dot(&contact_model.normal) + stretch * contact_model.k_t)
                        .norm()
                        < 1e-12
                );
            } else {
                assert!(
                    (stretch - contact_model.stretch).dot(&contact_model.normal).abs() < 1e-12
                        && (stretch - contact_model.stretch).norm() > 1e-7
                );
            }
            let kept = if r.turns { -r.torque / contact_model.k_r } else { contact_model.twist + spin * DT_S };
            assert!((twist - kept).abs() < 1e-12, "{twist} {kept}");
        }
    }
}
