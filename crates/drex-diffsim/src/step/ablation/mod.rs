//! The other methods of stepping time that the D-REX paper and its relatives use, to compare the default with: penalty
//! forces under semi-implicit or explicit Euler, and position-based dynamics. Free bodies only.

pub(crate) mod penalty;
pub(crate) mod position_based;

use drex_core::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use crate::math::exp;
use crate::{Body, BodyState, Scalar};

/// Buffers of the methods that a step reuses.
#[derive(Debug)]
pub(crate) struct Buffers<T: Scalar> {
    pub penalty: penalty::Buffers<T>,
    pub position: position_based::Buffers<T>,
}

impl<T: Scalar> Default for Buffers<T> {
    fn default() -> Self {
        Self { penalty: penalty::Buffers::default(), position: position_based::Buffers::default() }
    }
}

/// The pose at the part `s` of the way from `a` to `b`, for methods whose last velocity is not that of the whole step.
pub(crate) fn on_the_way<T: Scalar>(body: &Body<T>, a: &BodyState<T>, b: &BodyState<T>, s: T) -> Pose<T> {
    let (from, to) = (&a.world_from_body, &b.world_from_body);
    let mut turn = to.rotation * from.rotation.inverse();
    if turn.w.value() < 0.0 {
        turn = UnitQuaternion::new_unchecked(-turn.into_inner());
    }
    let rotation = exp(&(log(&turn) * s)) * from.rotation;
    let (start, end) = (from * body.center_of_mass, to * body.center_of_mass);
    let com = start.coords + (end - start) * s;
    Pose::from_parts(Translation3::from(com - rotation * body.center_of_mass.coords), rotation)
}

/// The rotation vector of a unit quaternion whose real part is positive (a turn of less than half a circle).
pub(crate) fn log<T: Scalar>(q: &UnitQuaternion<T>) -> Vector3<T> {
    let v = Vector3::new(q.i, q.j, q.k);
    let x = v.norm_squared();
    let k = if x.value() < 1e-4 {
        // 2 asin(√x) / √x as a series; the first term left out is below 1e-17.
        T::lift(2.0) + x * (T::lift(1.0 / 3.0) + x * (T::lift(3.0 / 20.0) + x * T::lift(5.0 / 56.0)))
    } else {
        let s = x.sqrt();
        s.atan2(q.w) / s * T::lift(2.0)
    };
    v * k
}
