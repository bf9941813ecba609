//! Linear algebra and rotations against differences.

use drex_diffsim::{Scalar, parameter};
use nalgebra::{Isometry3, Matrix3, Matrix4, Quaternion, SMatrix, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;

use crate::{close, difference};

proptest! {
    #[test]
    fn linear_algebra_has_the_derivative_of_its_result(p in prop::array::uniform6(-1.0..1.0_f64)) {
        check_outputs("inverse", inverse, p)?;
        check_outputs("inverse of 4 x 4", inverse4, p)?;
        check_outputs("LU", lu, p)?;
        check_outputs("Cholesky", cholesky, p)?;
        check_outputs("eigenvalues", eigenvalues, p)?;
        check_outputs("quaternion", quaternion, p)?;
        check_outputs("rotation matrix", rotation_matrix, p)?;
        check_outputs("isometry", isometry, p)?;
        check_outputs("norms", norms, p)?;
    }
}

/// All six derivatives of all outputs of `f`, written once for both kinds of numbers, against differences.
fn check_outputs<const K: usize>(
    name: &str,
    f: impl Outputs<K>,
    p: [f64; 6],
) -> std::result::Result<(), TestCaseError> {
    let exact = f.at(std::array::from_fn(|i| parameter::<6>(p[i], i)));
    let plain = f.at(p);
    for k in 0..K {
        prop_assert!(close(exact[k].re, plain[k], 1e-12), "{name}, output {k}: {} {}", exact[k], plain[k]);
        for i in 0..6 {
            let slope = difference(
                |h| {
                    let mut q = p;
                    q[i] += h;
                    f.at(q)[k]
                },
                1e-4,
            );
            let d = exact[k].tangent(i);
            prop_assert!(close(d, slope, 1e-8), "{name}, output {k}, parameter {i}: {d}, differences {slope}");
        }
    }
    Ok(())
}

/// A function that is generic over its numbers.
pub trait Outputs<const K: usize> {
    fn at<T: Scalar>(&self, p: [T; 6]) -> [T; K];
}

macro_rules! outputs {
    ($($name:ident -> $k:literal |$p:ident: $t:ident| $body:expr;)*) => {$(
        #[allow(non_camel_case_types)] // reads as a function where it is passed on
        pub struct $name;
        impl Outputs<$k> for $name {
            fn at<$t: Scalar>(&self, $p: [$t; 6]) -> [$t; $k] {
                $body
            }
        }
    )*};
}

/// Entries from the parameters, with a diagonal that dominates.
fn regular<T: Scalar, const D: usize>(p: &[T; 6]) -> SMatrix<T, D, D> {
    SMatrix::from_fn(|i, j| {
        p[(i * D + j) % 6] * p[(i + 2 * j) % 6] + T::lift(if i == j { 7.0 + 10.0 * i as f64 } else { 0.0 })
    })
}

outputs! {
    inverse -> 9 |p: T| {
        let m = regular::<T, 3>(&p).try_inverse().unwrap();
        std::array::from_fn(|k| m[k])
    };
    inverse4 -> 16 |p: T| {
        let m: Matrix4<T> = regular::<T, 4>(&p);
        let m = m.try_inverse().unwrap();
        std::array::from_fn(|k| m[k])
    };
    lu -> 7 |p: T| {
        let m = regular::<T, 6>(&p);
        let x = m.lu().solve(&nalgebra::SVector::<T, 6>::from(p)).unwrap();
        [x[0], x[1], x[2], x[3], x[4], x[5], m.determinant().scaled(1e-6)]
    };
    cholesky -> 6 |p: T| {
        let m = regular::<T, 6>(&p);
        let x = (m * m.transpose()).cholesky().unwrap().solve(&nalgebra::SVector::<T, 6>::from(p));
        x.into()
    };
    eigenvalues -> 3 |p: T| {
        let m = regular::<T, 3>(&p);
        let mut e: [T; 3] = (m + m.transpose()).symmetric_eigenvalues().into();
        e.sort_by(|a, b| a.partial_cmp(b).unwrap());
        e
    };
    quaternion -> 7 |p: T| {
        let a = UnitQuaternion::from_quaternion(Quaternion::new(T::lift(2.0) + p[0], p[1], p[2], p[3]));
        let b = UnitQuaternion::from_scaled_axis(Vector3::new(p[3], p[4], T::lift(1.5) + p[5]));
        let (q, r) = (a * b, a.inverse() * Vector3::new(p[5], p[1], p[2]));
        [q.w, q.i, q.j, q.k, r.x, r.y, r.z]
    };
    rotation_matrix -> 12 |p: T| {
        let q = UnitQuaternion::from_euler_angles(p[0], p[1], p[2]);
        let m = q.to_rotation_matrix().into_inner() * Matrix3::new(p[3], p[4], p[5], p[0], p[1], p[2], p[5], p[3], p[4]);
        let (a, b, c) = q.euler_angles();
        std::array::from_fn(|k| match k {
            0..9 => m[k],
            9 => a,
            10 => b,
            _ => c,
        })
    };
    isometry -> 6 |p: T| {
        let q = UnitQuaternion::from_scaled_axis(Vector3::new(p[3], p[4], T::lift(1.5) + p[5]));
        let a = Isometry3::from_parts(Translation3::new(p[0], p[1], p[2]), q);
        let (x, y) = ((a * a).inverse() * nalgebra::Point3::new(p[5], p[0], p[1]), a.inv_mul(&a));
        let z = a.inverse_transform_vector(&Vector3::new(p[2], p[3], p[4])) + y.translation.vector;
        [x.x, x.y, x.z, z.x, z.y, z.z]
    };
    norms -> 4 |p: T| {
        let v = Vector3::new(p[0], p[1], T::lift(2.0) + p[2]);
        let n = v.normalize().cross(&Vector3::new(p[3], p[4], p[5]));
        [v.norm(), n.x, n.y, n.z]
    };
}

#[test]
fn comparisons_and_bounds_are_those_of_the_value() {
    use drex_diffsim::Dual;
    use nalgebra::RealField;
    let x = parameter::<2>(0.3, 0);
    let near = Dual::<2>::from_re(0.3 + f64::EPSILON / 4.0);
    assert!(approx::ulps_eq!(x, near) && approx::relative_eq!(x, near) && approx::abs_diff_eq!(x, near));
    let far = Dual::<2>::from_re(0.3001);
    assert!(!approx::ulps_eq!(x, far) && !approx::relative_eq!(x, far) && !approx::abs_diff_eq!(x, far));
    assert_eq!(<Dual<2> as RealField>::min_value().map(|m| m.re), <f64 as RealField>::min_value());
    assert_eq!(<Dual<2> as RealField>::max_value().map(|m| m.re), <f64 as RealField>::max_value());
}
