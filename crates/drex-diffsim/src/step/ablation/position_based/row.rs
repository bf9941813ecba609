//! One contact and the bodies that it moves.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::collide::Frame;
use crate::contact::Contact;
use crate::math::{exp, lift_pose, lift_rotation, solve3};
use crate::step::ablation::log;
use crate::{Motion, Part, Scalar, Scene, State, Workspace};

/// A body on its way through a substep. The way is kept by itself: velocities from it lose no digits.
#[derive(Debug)]
pub(super) struct Moving<T: Scalar> {
    /// Centre of mass in the world at the start, and in the body's frame.
    pub com: Vector3<T>,
    pub center: Vector3<T>,
    pub rotation: UnitQuaternion<T>,
    /// Inverse of the inertia per unit mass at the start, world.
    pub inverse: Matrix3<T>,
    pub moved: Vector3<T>,
    pub turned: UnitQuaternion<T>,
}

/// One side of a contact.
#[derive(Debug)]
pub(super) struct Grip<T: Scalar> {
    pub body: usize,
    /// Mass of the patch over that of the body.
    pub share: T,
    /// From the centre of mass to the contact at the start, world.
    pub arm: Vector3<T>,
}

/// What a contact is against.
#[derive(Debug)]
pub(super) enum Against<T: Scalar> {
    Body(Grip<T>),
    /// Something fixed or on a path: where it is at the end of the substep, which way its point of contact goes, and by
    /// how much it turns about the normal.
    Support {
        frame: Frame<T>,
        way: Vector3<T>,
        turn: T,
    },
}

/// A contact while it is solved; forces are on `a`, per mass of the patch.
#[derive(Debug)]
pub(super) struct Row<T: Scalar> {
    /// Index of contact, feature and contact model.
    pub index: usize,
    pub a: Grip<T>,
    pub b: Against<T>,
    /// Inverse masses, in patch masses: along the normal, across it (the largest), of a turn about it.
    pub normal_mobility: T,
    pub across_mobility: T,
    pub turn_mobility: T,
    pub normal: T,
    pub across: Vector3<T>,
    pub torque: T,
    pub slips: bool,
    /// Whether the torsional spring is at its bound.
    pub turns: bool,
}

/// Something that no contact moves, at the end of the substep.
pub(super) fn support<T: Scalar>(scene: &Scene<T>, work: &Workspace<T>, end_s: f64, c: &Contact<T>) -> Against<T> {
    match c.key.b {
        Part::Kinematic(i) => {
            let (start, end): (&Motion, Motion) =
                (&work.motions[i as usize], scene.kinematic_bodies[i as usize].path.at(end_s));
            let turned = end.pose.rotation * start.pose.rotation.inverse();
            let arm = c.point - start.pose.translation.vector.map(T::lift);
            let way = (end.pose.translation.vector - start.pose.translation.vector).map(T::lift)
                + swung(&lift_rotation(&turned), &arm);
            let turn = turned.scaled_axis().map(T::lift).dot(&c.normal);
            Against::Support { frame: Frame::of(&lift_pose(&end.pose)), way, turn }
        }
        Part::Static(i) => {
            let frame = Frame::of(&lift_pose(&scene.static_bodies[i as usize].world_from_body));
            Against::Support { frame, way: Vector3::zeros(), turn: T::zero() }
        }
        Part::Body(_) | Part::Link { .. } => Against::Support {
            frame: Frame { r: Matrix3::identity(), p: Vector3::zeros() },
            way: Vector3::zeros(),
            turn: T::zero(),
        },
    }
}

impl<T: Scalar> Moving<T> {
    pub fn frame(&self) -> Frame<T> {
        let r = (self.turned * self.rotation).to_rotation_matrix().into_inner();
        Frame { r, p: self.com + self.moved - r * self.center }
    }

    /// The way of a point that began at `arm` from the centre of mass.
    pub fn way(&self, arm: &Vector3<T>) -> Vector3<T> {
        self.moved + swung(&self.turned, arm)
    }
}

impl<T: Scalar> Row<T> {
    /// Way of `a` against `b` across the normal so far, and turn about it where it matters.
    pub fn way(&self, bodies: &[Moving<T>], c: &Contact<T>, turning: bool) -> (Vector3<T>, T) {
        let a = &bodies[self.a.body];
        let mut way = a.way(&self.a.arm);
        let mut turn = if turning { log(&a.turned).dot(&c.normal) } else { T::zero() };
        match &self.b {
            Against::Body(grip) => {
                way -= bodies[grip.body].way(&grip.arm);
                if turning {
                    turn -= log(&bodies[grip.body].turned).dot(&c.normal);
                }
            }
            Against::Support { way: support, turn: support_turn, .. } => {
                way -= support;
                turn -= *support_turn;
            }
        }
        (way - c.normal * way.dot(&c.normal), turn)
    }

    /// Velocity of `a` against `b` at the end of the substep.
    pub fn velocity(&self, state: &State<T>, h: f64) -> Vector3<T> {
        let of = |grip: &Grip<T>| {
            let s = &state.bodies[grip.body];
            s.velocity + s.angular_velocity.cross(&grip.arm)
        };
        of(&self.a)
            - match &self.b {
                Against::Body(grip) => of(grip),
                Against::Support { way, .. } => scaled(way, 1.0 / h),
            }
    }
}

/// Moves both sides by what a force and a moment on `a` do in a substep.
pub(super) fn push<T: Scalar>(bodies: &mut [Moving<T>], row: &Row<T>, force: &Vector3<T>, moment: &Vector3<T>, h: f64) {
    let mut side = |grip: &Grip<T>, share: T| {
        let (body, share) = (&mut bodies[grip.body], share.scaled(h * h));
        body.moved += force * share;
        body.turned = exp(&(body.inverse * (grip.arm.cross(force) + moment) * share)) * body.turned;
    };
    side(&row.a, row.a.share);
    if let Against::Body(grip) = &row.b {
        side(grip, -grip.share);
    }
}

/// A friction force brought back to its bound, and whether it had to be.
pub(super) fn bounded<T: Scalar>(force: Vector3<T>, bound: T) -> (Vector3<T>, bool) {
    let square = force.norm_squared();
    if square.value() > (bound * bound).value() { (force * (bound / square.sqrt()), true) } else { (force, false) }
}

/// The same for a torque.
pub(super) fn clamped<T: Scalar>(torque: T, bound: T) -> (T, bool) {
    if torque.value() > bound.value() {
        (bound, true)
    } else if torque.value() < -bound.value() {
        (-bound, true)
    } else {
        (torque, false)
    }
}

/// How far a rotation takes the end of `arm`. Small ways keep their digits.
pub(super) fn swung<T: Scalar>(q: &UnitQuaternion<T>, arm: &Vector3<T>) -> Vector3<T> {
    let v = Vector3::new(q.i, q.j, q.k);
    let t = v.cross(arm).map(|x| x.scaled(2.0));
    t * q.w + v.cross(&t)
}

pub(super) fn scaled<T: Scalar>(v: &Vector3<T>, k: f64) -> Vector3<T> {
    v.map(|x| x.scaled(k))
}

pub(super) fn inverse<T: Scalar>(a: &Matrix3<T>) -> Matrix3<T> {
    Matrix3::from_columns(&[0, 1, 2].map(|k| solve3(a, &Vector3::ith(k, T::one()))))
}
