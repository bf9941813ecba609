//! What acts inside joints: drives, damping, dry friction, limits. All of it is taken at the end of the step, as a force
//! that never grows with the velocity, so that the step can be solved however stiff it is.

use super::{ActuatorKind, ActuatorParams, Articulation, ArticulationState, JointParams, TreeWork};
use crate::Scalar;

/// Natural frequency of a joint on its stop, rad/s: it gives by torque / (inertia ω²).
const LIMIT_FREQUENCY: f64 = 3e3;
/// Damping over stiffness of a stop, seconds; far above critical: a joint does not bounce off.
const LIMIT_RELAXATION_S: f64 = 4e-3;
/// A stop nearer than this (rad or m), or than twice the way of one step, is looked at.
const LIMIT_MARGIN: f64 = 0.01;

/// A force on one generalised velocity u, implicit in it: f(u) = clamp(preload - kappa u, low, high), kappa >= 0.
#[derive(Debug, Clone, Copy)]
pub(crate) struct JointForce<T: Scalar> {
    /// Index of the generalised velocity, counted within the robot.
    pub dof: usize,
    /// Index of the joint.
    pub joint: usize,
    pub preload: T,
    pub kappa: T,
    pub low: T,
    pub high: T,
    pub kind: JointForceKind,
}

/// Where a [`JointForce`] comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum JointForceKind {
    Damping,
    Friction,
    Limit,
    /// The drive of this index.
    Actuator(usize),
}

impl<T: Scalar> JointForce<T> {
    pub fn force(&self, u: T) -> T {
        let f = self.preload - self.kappa * u;
        if f.value() < self.low.value() {
            self.low
        } else if f.value() > self.high.value() {
            self.high
        } else {
            f
        }
    }

    /// -df/du at `u`.
    pub fn stiffness(&self, u: f64) -> f64 {
        let f = self.preload.value() - self.kappa.value() * u;
        if f < self.low.value() || f > self.high.value() { 0.0 } else { self.kappa.value() }
    }

    /// The force without derivatives.
    pub fn value(&self) -> JointForce<f64> {
        JointForce {
            dof: self.dof,
            joint: self.joint,
            preload: self.preload.value(),
            kappa: self.kappa.value(),
            low: self.low.value(),
            high: self.high.value(),
            kind: self.kind,
        }
    }
}

impl<T: Scalar> Articulation<T> {
    /// The forces of all joints for a step of length `h` from `state`, whose kinematics are in `work`. `control` has one
    /// number per drive ([`Articulation::check_control`]).
    pub(crate) fn joint_forces(
        &self,
        state: &ArticulationState<T>,
        work: &TreeWork<T>,
        control: &[f64],
        h: f64,
        out: &mut Vec<JointForce<T>>,
    ) {
        out.clear();
        let (first, none, open) = (self.base_dof(), T::zero(), T::lift(f64::INFINITY));
        for (joint, p) in self.joints.iter().enumerate() {
            let mut put = |preload: T, kappa: T, low: T, high: T, kind: JointForceKind| {
                out.push(JointForce { dof: first + joint, joint, preload, kappa, low, high, kind });
            };
            if p.damping.value() > 0.0 {
                put(none, p.damping, -open, open, JointForceKind::Damping);
            }
            if p.friction_loss.value() > 0.0 {
                let (k, damping) = p.friction_spring(work.joints[joint].inertia);
                let bound = p.friction_loss;
                put(-k * state.friction[joint], k * T::lift(h) + damping, -bound, bound, JointForceKind::Friction);
            }
            let Some((lo, hi)) = p.limits else { continue };
            let (q, reach) = (state.q[joint], LIMIT_MARGIN.max(2.0 * h * state.velocities[joint].value().abs()));
            let k = work.joints[joint].inertia * T::lift(LIMIT_FREQUENCY * LIMIT_FREQUENCY);
            let kappa = k * T::lift(h + LIMIT_RELAXATION_S);
            // A gap may close by the end of the step, and no further.
            let push = |depth: T| depth * if depth.value() > 0.0 { k } else { kappa / T::lift(h) };
            if q.value() < lo + reach {
                put(push(T::lift(lo) - q), kappa, none, open, JointForceKind::Limit);
            }
            if q.value() > hi - reach {
                put(-push(q - T::lift(hi)), kappa, -open, none, JointForceKind::Limit);
            }
        }
        for (i, (a, &control)) in self.actuators.iter().zip(control).enumerate() {
            let (q, u) = (state.q[a.joint], state.velocities[a.joint]);
            let (mut preload, mut kappa) = a.effort(q, control, h);
            if kappa.value() < 0.0 {
                // A drive that feeds its own motion is taken at the velocity that there is.
                preload -= kappa * u;
                kappa = none;
            }
            let (mut low, mut high) = (-open, open);
            if let Some((lo, hi)) = a.force_range {
                (low, high) = (lo * a.gear, hi * a.gear);
                if a.gear.value() < 0.0 {
                    (low, high) = (high, low);
                }
            }
            out.push(JointForce {
                dof: first + a.joint,
                joint: a.joint,
                preload,
                kappa,
                low,
                high,
                kind: JointForceKind::Actuator(i),
            });
        }
    }
}

impl<T: Scalar> JointParams<T> {
    /// Stiffness and damping of the spring that dry friction is while it sticks; critically damped with the inertia that
    /// the joint moves alone. The stiffness does not depend on configuration or step, so that what the spring carries
    /// does not change while it stands still.
    fn friction_spring(&self, inertia: T) -> (T, T) {
        let k = self.friction_loss / T::lift(self.presliding);
        (k, (k * inertia).sqrt() * T::lift(2.0))
    }

    /// The stretch of that spring at the end of a step at velocity `u`, from `stretch`: it grows while it sticks, and is
    /// dragged along at its bound while it slips.
    pub(super) fn friction_stretch(&self, force: &JointForce<T>, stretch: T, u: T, h: f64) -> T {
        let f = force.preload - force.kappa * u;
        if f.value() < force.low.value() {
            T::lift(self.presliding)
        } else if f.value() > force.high.value() {
            T::lift(-self.presliding)
        } else {
            stretch + u * T::lift(h)
        }
    }
}

impl<T: Scalar> ActuatorParams<T> {
    /// Joint effort as preload - kappa u, with the joint at q + h u, before the effort is capped.
    fn effort(&self, q: T, control: f64, h: f64) -> (T, T) {
        let c = T::lift(self.ctrl_range.map_or(control, |(lo, hi)| control.max(lo).min(hi)));
        let (g, h) = (self.gear, T::lift(h));
        match self.kind {
            ActuatorKind::Motor { gain } => (g * gain * c, T::zero()),
            ActuatorKind::Position { kp, kv } => (g * kp * (c - g * q), g * g * (kp * h + kv)),
            ActuatorKind::Velocity { kv } => (g * kv * c, g * g * kv),
            ActuatorKind::Affine { gain, bias: [b0, b1, b2] } => {
                (g * (gain * c + b0 + b1 * g * q), -(g * g * (b1 * h + b2)))
            }
        }
    }
}
