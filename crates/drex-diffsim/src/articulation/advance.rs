//! From the velocity at the end of a step to the next state.

use drex_core::Pose;
use nalgebra::{Translation3, Vector3};

use super::{Articulation, ArticulationState, Base, JointForce, JointForceKind, TreeWork};
use crate::Scalar;
use crate::math::{exp, renormalized};

impl<T: Scalar> Articulation<T> {
    /// Moves `state` from time `t` over a step `h` with the generalised velocity `u` that the step found. `forces` are
    /// those of [`Articulation::joint_forces`], `work` the kinematics of `state`; `work` is used up.
    ///
    /// Joints move by h u, a free base turns by the exponential map. Its centre of mass moves on a straight line and
    /// keeps its velocity into the new configuration (see [`Articulation::step_bias`]).
    pub(crate) fn advance(
        &self,
        state: &mut ArticulationState<T>,
        u: &[T],
        (t, h): (f64, f64),
        forces: &[JointForce<T>],
        work: &mut TreeWork<T>,
    ) {
        let first = self.base_dof();
        let joints = &u[first..];
        for force in forces.iter().filter(|force| force.kind == JointForceKind::Friction) {
            let (j, stretch) = (force.joint, &mut state.friction[force.joint]);
            *stretch = self.joints[j].friction_stretch(force, *stretch, joints[j], h);
        }
        let h_t = T::lift(h);
        for (j, &rate) in joints.iter().enumerate() {
            state.q[j] += rate * h_t;
            state.velocities[j] = rate;
        }
        if !matches!(self.base, Base::Free) {
            state.base = self.prescribed_base(t + h);
            return;
        }
        let (v, w) = (Vector3::new(u[0], u[1], u[2]), Vector3::new(u[3], u[4], u[5]));
        let old = &state.base.world_from_base;
        let (center, carried) = work.center_motion(&w, joints);
        let velocity = v + carried;
        let at = old.translation.vector + center + velocity * h_t;
        let rotation = renormalized(exp(&(w * h_t)) * old.rotation);
        state.base.world_from_base = Pose::from_parts(old.translation, rotation);
        self.kinematics(state, t, 0.0, work);
        let (center, carried) = work.center_motion(&w, joints);
        state.base.world_from_base.translation = Translation3::from(at - center);
        (state.base.velocity, state.base.angular_velocity) = (velocity - carried, w);
    }
}

impl<T: Scalar> TreeWork<T> {
    /// Centre of mass of the robot from the base's origin, and its velocity against it.
    fn center_motion(&self, w: &Vector3<T>, joints: &[T]) -> (Vector3<T>, Vector3<T>) {
        let per_mass = T::one() / self.base.mass;
        let mut momentum = w.cross(&self.base.first);
        for (motion, &rate) in self.joints.iter().zip(joints) {
            momentum += motion.linear * rate;
        }
        (self.base.first * per_mass, momentum * per_mass)
    }
}
