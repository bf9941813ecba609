//! Poses, velocities and inertias of all links in one pass, and how points of links move with the joints.

use drex_core::Pose;
use nalgebra::{Matrix3, Quaternion, Translation3, UnitQuaternion, Vector3};

use super::model::map_pose;
use super::spatial::{Sym3, mul};
use super::{Articulation, ArticulationState, Base, LinkInertia};
use crate::Scalar;
use crate::path::mean_rate;

/// What one configuration of a robot needs; filled by [`Articulation::kinematics`], reused from step to step.
#[derive(Debug, Clone)]
pub(crate) struct TreeWork<T: Scalar> {
    pub links: Vec<LinkMotion<T>>,
    /// In the order of the robot's joints.
    pub joints: Vec<JointMotion<T>>,
    pub base: BaseMotion<T>,
    /// Scratch of the recursions: bodies with all that hangs on them; angular and linear acceleration, later moment and
    /// force, of each link; columns and factors of the mass matrix.
    pub(super) composite: Vec<Composite<T>>,
    pub(super) pairs: Vec<[Vector3<T>; 2]>,
    pub(super) column: Vec<T>,
    pub(super) factor: Vec<T>,
}

/// A link in the world.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LinkMotion<T: Scalar> {
    pub world_from_link: Pose<T>,
    pub rotation: Matrix3<T>,
    /// Velocity of the link's origin, m/s.
    pub velocity: Vector3<T>,
    pub angular_velocity: Vector3<T>,
    pub mass: T,
    /// Inertia about the centre of mass along the world's axes.
    pub inertia: Sym3<T>,
    /// Origin and centre of mass from the base's origin, along the world's axes. The recursions use these, so that the
    /// place of the robot in the world costs no digits.
    pub origin: Vector3<T>,
    pub center: Vector3<T>,
}

/// A joint in the world.
#[derive(Debug, Clone, Copy)]
pub(crate) struct JointMotion<T: Scalar> {
    pub prismatic: bool,
    pub axis: Vector3<T>,
    /// A point on the axis, from the base's origin.
    pub anchor: Vector3<T>,
    /// Velocity along the axis: axis times joint velocity.
    pub rate: Vector3<T>,
    /// Momentum of all that the joint moves per unit of its velocity, the base at rest: linear, and angular about the
    /// base's origin.
    pub linear: Vector3<T>,
    pub angular: Vector3<T>,
    /// Inertia that the joint moves with all others locked, armature included.
    pub inertia: T,
    pub above: Option<usize>,
}

/// How the base moves.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BaseMotion<T: Scalar> {
    pub world_from_base: Pose<T>,
    pub velocity: Vector3<T>,
    pub angular_velocity: Vector3<T>,
    /// Prescribed accelerations, mean over the step; zero for a free base.
    pub acceleration: Vector3<T>,
    pub angular_acceleration: Vector3<T>,
    /// Prescribed velocities, mean over the step; zero for a free base.
    pub mean_velocity: Vector3<T>,
    pub mean_angular_velocity: Vector3<T>,
    /// Mass of the robot, and its first and second moment about the base's origin.
    pub mass: T,
    pub first: Vector3<T>,
    pub second: Sym3<T>,
}

/// A link and all that hangs on it, locked: mass, first and second moment about the base's origin.
#[derive(Debug, Clone, Copy)]
pub(super) struct Composite<T: Scalar> {
    mass: T,
    first: Vector3<T>,
    second: Sym3<T>,
}

/// The velocity of a point of a link per unit of one generalised velocity.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Column<T: Scalar> {
    pub dof: usize,
    pub linear: Vector3<T>,
    pub angular: Vector3<T>,
}

impl<T: Scalar> Default for TreeWork<T> {
    fn default() -> Self {
        let (o, zero) = (Vector3::zeros(), T::zero());
        let base = BaseMotion {
            world_from_base: Pose::identity(),
            velocity: o,
            angular_velocity: o,
            acceleration: o,
            angular_acceleration: o,
            mean_velocity: o,
            mean_angular_velocity: o,
            mass: zero,
            first: o,
            second: Sym3::zero(),
        };
        Self {
            links: Vec::new(),
            joints: Vec::new(),
            base,
            composite: Vec::new(),
            pairs: Vec::new(),
            column: Vec::new(),
            factor: Vec::new(),
        }
    }
}

impl<T: Scalar> Articulation<T> {
    /// Poses, velocities and inertias at `state` and time `t`. `h` is the step about to be taken: accelerations and
    /// mean velocities of a base on a path are those over [t, t + h], so that its velocity changes by exactly what the
    /// path says; h = 0 gives the instantaneous ones. `state` must have one number per joint.
    pub(crate) fn kinematics(&self, state: &ArticulationState<T>, t: f64, h: f64, work: &mut TreeWork<T>) {
        work.base = self.base_motion(state, t, h);
        work.links.clear();
        work.joints.clear();
        work.joints.resize(self.joints.len(), JointMotion::zero());
        let base = work.base;
        for (node, body) in self.tree.iter().zip(&self.links) {
            let Some(parent) = node.parent else {
                let q = base.world_from_base.rotation;
                let moves = (base.velocity, base.angular_velocity);
                work.links.push(LinkMotion::new(&base, q, Vector3::zeros(), moves, body));
                continue;
            };
            let p = &work.links[parent];
            let offset = mul(&p.rotation, &node.parent_from_link.translation.vector.map(T::lift));
            let mut q = p.world_from_link.rotation * lift(&node.parent_from_link.rotation);
            let mut origin = p.origin + offset;
            let mut w = p.angular_velocity;
            let mut v = p.velocity + w.cross(&offset);
            if let Some(j) = &node.joint {
                let local = j.axis.map(T::lift);
                let axis = q * local;
                let travel = state.q[j.index] - T::lift(j.reference);
                let rate = axis * state.velocities[j.index];
                let mut anchor = origin;
                if j.prismatic {
                    let slide = axis * travel;
                    origin += slide;
                    v += w.cross(&slide) + rate;
                } else {
                    let (sin, cos) = (travel * T::lift(0.5)).sin_cos();
                    let turned = q * UnitQuaternion::new_unchecked(Quaternion::from_parts(cos, local * sin));
                    if let Some(a) = j.anchor.map(|a| a.map(T::lift)) {
                        let (there, back) = (q * a, -(turned * a));
                        anchor += there;
                        origin = anchor + back;
                        v += w.cross(&there) + (w + rate).cross(&back);
                    }
                    q = turned;
                    w += rate;
                }
                let motion = &mut work.joints[j.index];
                (motion.prismatic, motion.above) = (j.prismatic, j.above);
                (motion.axis, motion.anchor, motion.rate) = (axis, anchor, rate);
            }
            work.links.push(LinkMotion::new(&base, q, origin, (v, w), body));
        }
        self.compose(work);
    }

    /// Composite bodies from the leaves to the base, and the momentum that each joint gives to its own.
    fn compose(&self, work: &mut TreeWork<T>) {
        let TreeWork { links, joints, base, composite, .. } = work;
        composite.clear();
        composite.extend(links.iter().map(|l| {
            let first = l.center * l.mass;
            Composite { mass: l.mass, first, second: l.inertia.shifted(&l.center, &first) }
        }));
        for i in (0..links.len()).rev() {
            let body = composite[i];
            if let Some(j) = self.tree[i].joint {
                let motion = &mut joints[j.index];
                if motion.prismatic {
                    motion.linear = motion.axis * body.mass;
                    motion.angular = body.first.cross(&motion.axis);
                } else {
                    // Turning about the anchor, the point at the base's origin would move at anchor x axis.
                    let v = motion.anchor.cross(&motion.axis);
                    motion.linear = motion.axis.cross(&body.first) + v * body.mass;
                    motion.angular = body.second.times(&motion.axis) + body.first.cross(&v);
                }
                motion.inertia = motion.along(&motion.linear, &motion.angular) + self.joints[j.index].armature;
            }
            match self.tree[i].parent {
                None => (base.mass, base.first, base.second) = (body.mass, body.first, body.second),
                Some(p) => {
                    let p = &mut composite[p];
                    p.mass += body.mass;
                    p.first += body.first;
                    p.second += body.second;
                }
            }
        }
    }

    fn base_motion(&self, state: &ArticulationState<T>, t: f64, h: f64) -> BaseMotion<T> {
        let mut out = TreeWork::default().base;
        let up = |v: Vector3<f64>| v.map(T::lift);
        match &self.base {
            Base::Fixed(pose) => out.world_from_base = *pose,
            Base::Free => {
                out.world_from_base = state.base.world_from_base;
                (out.velocity, out.angular_velocity) = (state.base.velocity, state.base.angular_velocity);
            }
            Base::Path(path) => {
                let now = path.at(t);
                let (mut a, mut alpha) = (now.acceleration, now.angular_acceleration);
                let (mut v, mut w) = (now.velocity, now.angular_velocity);
                if h > 0.0 {
                    let next = path.at(t + h);
                    a = (next.velocity - v) / h;
                    alpha = (next.angular_velocity - w) / h;
                    v = (next.pose.translation.vector - now.pose.translation.vector) / h;
                    w = mean_rate(&now.pose.rotation, &next.pose.rotation, h);
                }
                out.world_from_base = map_pose(&now.pose, |x| T::lift(*x));
                (out.velocity, out.angular_velocity) = (up(now.velocity), up(now.angular_velocity));
                (out.acceleration, out.angular_acceleration) = (up(a), up(alpha));
                (out.mean_velocity, out.mean_angular_velocity) = (up(v), up(w));
            }
        }
        out
    }

    /// How the point of `link` that is at `point` (world) moves with the generalised velocities, appended to `out`:
    /// the base first if it is free, then from the last joint up. Velocities that are zero whatever the state are left
    /// out, those that happen to be zero are not.
    pub(crate) fn columns(&self, work: &TreeWork<T>, link: usize, point: &Vector3<T>, out: &mut Vec<Column<T>>) {
        let offset = point - work.base.world_from_base.translation.vector;
        let first = self.base_dof();
        if first > 0 {
            for (k, axis) in [Vector3::x(), Vector3::y(), Vector3::z()].into_iter().enumerate() {
                out.push(Column { dof: k, linear: axis, angular: Vector3::zeros() });
            }
            for (k, axis) in [Vector3::x(), Vector3::y(), Vector3::z()].into_iter().enumerate() {
                out.push(Column { dof: k + 3, linear: axis.cross(&offset), angular: axis });
            }
        }
        let mut at = self.tree[link].driver;
        while let Some(j) = at {
            let motion = &work.joints[j];
            let (linear, angular) = if motion.prismatic {
                (motion.axis, Vector3::zeros())
            } else {
                (motion.axis.cross(&(offset - motion.anchor)), motion.axis)
            };
            out.push(Column { dof: first + j, linear, angular });
            at = motion.above;
        }
    }

    /// The part of the velocity of `point` (world) and of the angular velocity that comes from a base on a path: the
    /// mean over the step given to [`Articulation::kinematics`]. All links share it; zero for other bases.
    pub(crate) fn prescribed_velocity(&self, work: &TreeWork<T>, point: &Vector3<T>) -> (Vector3<T>, Vector3<T>) {
        let b = &work.base;
        let offset = point - b.world_from_base.translation.vector;
        (b.mean_velocity + b.mean_angular_velocity.cross(&offset), b.mean_angular_velocity)
    }

    /// The generalised velocity of `state`, appended to `out`.
    pub(crate) fn velocity(&self, state: &ArticulationState<T>, out: &mut Vec<T>) {
        if self.base_dof() > 0 {
            out.extend(state.base.velocity.iter().chain(state.base.angular_velocity.iter()));
        }
        out.extend(&state.velocities);
    }
}

impl<T: Scalar> LinkMotion<T> {
    fn new(
        base: &BaseMotion<T>,
        q: UnitQuaternion<T>,
        origin: Vector3<T>,
        (velocity, angular_velocity): (Vector3<T>, Vector3<T>),
        body: &LinkInertia<T>,
    ) -> Self {
        let rotation = q.to_rotation_matrix().into_inner();
        let at = base.world_from_base.translation.vector + origin;
        Self {
            world_from_link: Pose::from_parts(Translation3::from(at), q),
            rotation,
            velocity,
            angular_velocity,
            mass: body.mass_kg,
            inertia: Sym3::turned(&rotation, &body.inertia),
            origin,
            center: origin + mul(&rotation, &body.center_of_mass.coords),
        }
    }

    #[cfg(test)]
    /// Centre of mass in the world.
    pub fn center_of_mass(&self) -> Vector3<T> {
        self.world_from_link.translation.vector - self.origin + self.center
    }
}

impl<T: Scalar> JointMotion<T> {
    fn zero() -> Self {
        let (o, zero) = (Vector3::zeros(), T::zero());
        Self { prismatic: false, axis: o, anchor: o, rate: o, linear: o, angular: o, inertia: zero, above: None }
    }

    /// The part of a force and a moment (about the base's origin) that the joint feels along its axis.
    pub(super) fn along(&self, force: &Vector3<T>, moment: &Vector3<T>) -> T {
        if self.prismatic { self.axis.dot(force) } else { self.axis.dot(&(moment - self.anchor.cross(force))) }
    }
}

/// A constant rotation.
fn lift<T: Scalar>(q: &UnitQuaternion<f64>) -> UnitQuaternion<T> {
    UnitQuaternion::new_unchecked(q.coords.map(T::lift).into())
}
