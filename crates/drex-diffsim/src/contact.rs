//! Where bodies touch, in the order in which friction springs are kept.

use nalgebra::Vector3;

use crate::Scalar;

/// Something that can touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Part {
    /// `scene.static_bodies[i]`.
    Static(u32),
    /// `scene.kinematic_bodies[i]`.
    Kinematic(u32),
    /// `model.bodies[i]`.
    Body(u32),
    /// Link `link` of `model.articulations[arm]`.
    Link {
        /// Index of the articulation.
        articulation: u32,
        /// Index of the link.
        link: u32,
    },
}

/// Which contact: friction springs are found again by it from step to step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ContactKey {
    /// The part that the normal points into.
    pub a: Part,
    /// The part that the normal points out of.
    pub b: Part,
    /// Index of the shape on `a`.
    pub geom_a: u16,
    /// Index of the shape on `b`.
    pub geom_b: u16,
    /// Pair of features of the two shapes.
    pub site: u32,
}

/// A contact that is closed or may close in this step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Contact<T: Scalar> {
    pub key: ContactKey,
    /// Where the force acts, world.
    pub point: Vector3<T>,
    /// From b towards a.
    pub normal: Vector3<T>,
    pub depth: T,
    /// Share of the patch: number of corners of a face that it stands for, or an area.
    pub weight: f64,
    /// Whether the weight is an area.
    pub sampled: bool,
    pub friction: T,
    /// Lever of torsional friction, metres.
    pub lever: f64,
}

/// A contact of the last step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactForce<T: Scalar> {
    /// The pair of parts, shapes and features.
    pub key: ContactKey,
    /// Where the force acts, world, metres.
    pub point: Vector3<T>,
    /// From `key.b` towards `key.a`, unit.
    pub normal: Vector3<T>,
    /// Penetration at the start of the step, metres; negative for a gap that closes in it.
    pub depth: T,
    /// Force on `key.a` at the end of the step, world, newtons.
    pub force: Vector3<T>,
    /// Torsional friction on `key.a` about the normal, N m.
    pub torque: T,
    /// Velocity of `key.a` against `key.b` there at the end of the step, world, m/s.
    pub velocity: Vector3<T>,
    /// Stretch of the friction spring at the end of the step, world, metres.
    pub stretch: Vector3<T>,
    /// Whether the friction is at its bound.
    pub slips: bool,
}

impl<T: Scalar> ContactForce<T> {
    /// A contact that carries nothing yet.
    pub(crate) fn of(c: &Contact<T>) -> Self {
        Self {
            key: c.key,
            point: c.point,
            normal: c.normal,
            depth: c.depth,
            force: Vector3::zeros(),
            torque: T::zero(),
            velocity: Vector3::zeros(),
            stretch: Vector3::zeros(),
            slips: false,
        }
    }
}
