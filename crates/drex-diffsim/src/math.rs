//! Rotations that are smooth at zero, for dual numbers.

use drex_core::Pose;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use crate::Scalar;

/// exp of half a rotation vector: the unit quaternion of the rotation vector `r`. Never takes a root at zero.
pub(crate) fn exp<T: Scalar>(r: &Vector3<T>) -> UnitQuaternion<T> {
    let x = r.norm_squared() * T::lift(0.25);
    let (c, s) = if x.value() < 1e-4 {
        // cos √x and sin(√x)/√x as series; the first term left out is below 1e-18.
        let c = T::one() - x * (T::lift(0.5) - x * (T::lift(1.0 / 24.0) - x * T::lift(1.0 / 720.0)));
        let s = T::one() - x * (T::lift(1.0 / 6.0) - x * (T::lift(1.0 / 120.0) - x * T::lift(1.0 / 5040.0)));
        (c, s)
    } else {
        let a = x.sqrt();
        (a.cos(), a.sin() / a)
    };
    let v = r * (s * T::lift(0.5));
    UnitQuaternion::new_unchecked(Quaternion::from_parts(c, v))
}

/// `q` with its norm brought back to one (one Newton step: the drift is of rounding size).
pub(crate) fn renormalized<T: Scalar>(q: UnitQuaternion<T>) -> UnitQuaternion<T> {
    let q = q.into_inner();
    let k = T::lift(1.5) - q.norm_squared() * T::lift(0.5);
    UnitQuaternion::new_unchecked(q * k)
}

/// A rotation as a constant of the scalar `T`.
pub(crate) fn lift_rotation<T: Scalar>(q: &UnitQuaternion<f64>) -> UnitQuaternion<T> {
    UnitQuaternion::new_unchecked(Quaternion::from_vector(q.coords.map(T::lift)))
}

/// A pose as a constant of the scalar `T`.
pub(crate) fn lift_pose<T: Scalar>(pose: &Pose) -> Pose<T> {
    Pose::from_parts(pose.translation.vector.map(T::lift).into(), lift_rotation(&pose.rotation))
}

/// R A Rᵀ of a symmetric A. Spelled out, because the library's product costs a dual number three times as much.
pub(crate) fn congruent<T: Scalar>(r: &Matrix3<T>, a: &Matrix3<T>) -> Matrix3<T> {
    let row = |m: &Matrix3<T>, i: usize| [m[(i, 0)], m[(i, 1)], m[(i, 2)]];
    let dot = |x: &[T; 3], y: &[T; 3]| x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
    let rows = [0, 1, 2].map(|i| row(r, i));
    let columns = [0, 1, 2].map(|i| row(a, i));
    let ra = rows.map(|x| [dot(&x, &columns[0]), dot(&x, &columns[1]), dot(&x, &columns[2])]);
    let (xx, xy, xz) = (dot(&ra[0], &rows[0]), dot(&ra[0], &rows[1]), dot(&ra[0], &rows[2]));
    let (yy, yz, zz) = (dot(&ra[1], &rows[1]), dot(&ra[1], &rows[2]), dot(&ra[2], &rows[2]));
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}

/// M v, spelled out for the same reason.
pub(crate) fn apply<T: Scalar>(m: &Matrix3<T>, v: &Vector3<T>) -> Vector3<T> {
    Vector3::new(
        m[(0, 0)] * v.x + m[(0, 1)] * v.y + m[(0, 2)] * v.z,
        m[(1, 0)] * v.x + m[(1, 1)] * v.y + m[(1, 2)] * v.z,
        m[(2, 0)] * v.x + m[(2, 1)] * v.y + m[(2, 2)] * v.z,
    )
}

/// M v of a constant v.
pub(crate) fn apply_constant<T: Scalar>(m: &Matrix3<T>, v: &Vector3<f64>) -> Vector3<T> {
    Vector3::new(
        m[(0, 0)].scaled(v.x) + m[(0, 1)].scaled(v.y) + m[(0, 2)].scaled(v.z),
        m[(1, 0)].scaled(v.x) + m[(1, 1)].scaled(v.y) + m[(1, 2)].scaled(v.z),
        m[(2, 0)].scaled(v.x) + m[(2, 1)].scaled(v.y) + m[(2, 2)].scaled(v.z),
    )
}

/// [s] M: s crossed with every column.
pub(crate) fn cross_columns<T: Scalar>(s: &Vector3<T>, m: &Matrix3<T>) -> Matrix3<T> {
    Matrix3::from_fn(|i, j| {
        let (k, l) = ((i + 1) % 3, (i + 2) % 3);
        s[k] * m[(l, j)] - s[l] * m[(k, j)]
    })
}

/// The matrix of a cross product from the left.
pub(crate) fn skew<T: Scalar>(v: &Vector3<T>) -> Matrix3<T> {
    let o = T::zero();
    Matrix3::new(o, -v.z, v.y, v.z, o, -v.x, -v.y, v.x, o)
}

/// x of A x = b by Cramer's rule; smooth in duals. A is the matrix of a gyroscopic step and far from singular.
pub(crate) fn solve3<T: Scalar>(a: &Matrix3<T>, b: &Vector3<T>) -> Vector3<T> {
    let (c0, c1, c2) = (a.column(0).into_owned(), a.column(1).into_owned(), a.column(2).into_owned());
    let k = T::one() / c0.dot(&c1.cross(&c2));
    Vector3::new(b.dot(&c1.cross(&c2)), c0.dot(&b.cross(&c2)), c0.dot(&c1.cross(b))) * k
}
