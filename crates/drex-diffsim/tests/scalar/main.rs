//! Dual numbers: every function against finite differences and against num-dual, linear algebra on them, hostile input.
#![allow(clippy::unwrap_used, missing_docs)] // a test may panic

mod algebra;
mod functions;
#[cfg(feature = "num-dual")]
mod reference;

use drex_diffsim::{Dual, Scalar, parameter, tangents};
use nalgebra::{RealField, Rotation3, UnitQuaternion, Vector3};
use num_traits::{FromPrimitive, Num};

fn close(a: f64, b: f64, tolerance: f64) -> bool {
    (a - b).abs() <= tolerance * (1.0 + a.abs().max(b.abs()))
}

/// Central difference of fourth order.
fn difference(f: impl Fn(f64) -> f64, h: f64) -> f64 {
    (8.0 * (f(h) - f(-h)) - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)
}

#[test]
fn derivatives_where_there_is_none() {
    let at = |x: f64| Dual::new(x, [1.0, 0.0]);
    assert_eq!(at(0.0).sqrt().eps, [f64::INFINITY, 0.0]);
    assert_eq!(at(0.0).ln().eps, [f64::INFINITY, 0.0]);
    assert_eq!(at(0.0).cbrt().eps, [f64::INFINITY, 0.0]);
    assert_eq!(at(1.0).asin().eps, [f64::INFINITY, 0.0]);
    assert_eq!(at(1.0).acos().eps, [f64::NEG_INFINITY, 0.0]);
    assert_eq!((at(0.0).abs().eps, at(-0.0).abs().eps), ([1.0, 0.0], [-1.0, 0.0]));
    assert_eq!((at(0.0).sinc().eps, at(0.0).sinc().re), ([0.0, 0.0], 1.0));
    assert_eq!(at(0.0).hypot(at(0.0)).eps, [0.0, 0.0]);
    assert_eq!(at(0.0).atan2(at(0.0)).eps, [0.0, 0.0]);
    let v = Vector3::new(at(0.0), at(0.0), at(0.0));
    assert_eq!((v.norm().re, v.norm().eps), (0.0, [0.0, 0.0]));
    // 0^n for n > 0 does not change with n; 0^1 changes with its base.
    assert_eq!(at(0.0).powf(Dual::new(2.0, [0.0, 1.0])).eps, [0.0, 0.0]);
    assert_eq!(at(0.0).powf(Dual::from_re(1.0)).eps, [1.0, 0.0]);
    assert_eq!((at(0.0).powi(1).eps, at(0.0).powi(0).eps), ([1.0, 0.0], [0.0, 0.0]));
    // At a tie the first operand, or the number inside the bounds.
    let other = Dual::new(1.0, [5.0, 6.0]);
    assert_eq!((RealField::max(at(1.0), other).eps, RealField::min(at(1.0), other).eps), ([1.0, 0.0], [1.0, 0.0]));
    assert_eq!(RealField::clamp(at(1.0), other, other).eps, [1.0, 0.0]);
    assert_eq!(RealField::clamp(at(2.0), at(0.0), other).eps, [5.0, 6.0]);
}

/// Which of nalgebra's rotations keep the derivative at zero (see `src/docs/derivatives.md`).
#[test]
fn rotations_at_zero() {
    let (x, o) = (Dual::new(0.0, [1.0]), Dual::<1>::from_re(0.0));
    let z = Vector3::z_axis().map(Dual::from_re);
    let z = nalgebra::Unit::new_unchecked(z);
    assert_eq!(UnitQuaternion::from_axis_angle(&z, x).k.eps, [0.5]);
    assert_eq!(UnitQuaternion::from_euler_angles(o, o, x).k.eps, [0.5]);
    assert_eq!(UnitQuaternion::from_euler_angles(o, o, x).euler_angles().2.eps, [1.0]);
    let matrix = UnitQuaternion::from_axis_angle(&z, x).to_rotation_matrix();
    assert_eq!(matrix[(1, 0)].eps, [1.0]);
    assert_eq!(UnitQuaternion::from_rotation_matrix(&matrix).k.eps, [0.5]);
    // These return a constant there.
    assert_eq!(UnitQuaternion::from_scaled_axis(Vector3::new(o, o, x)).k.eps, [0.0]);
    assert_eq!(Rotation3::new(Vector3::new(o, o, x))[(1, 0)].eps, [0.0]);
    assert_eq!(Rotation3::from_axis_angle(&z, x)[(1, 0)].eps, [0.0]);
    assert_eq!(UnitQuaternion::from_axis_angle(&z, x).scaled_axis().z.eps, [0.0]);
}

#[test]
fn a_cardinal_function_is_as_exact_at_zero_as_elsewhere() {
    // d/dx sin x / x = -x/3 + x³/30 - x⁵/840 + …, on both sides of where the formula changes.
    for x in [1e-9_f64, 1e-4, 0.1, 0.249, 0.251, 0.4] {
        let series = (1..12).rev().fold(0.0, |sum, k| {
            let factorial: f64 = (1..=2 * k + 1).map(f64::from).product();
            sum + (-1.0_f64).powi(k) * 2.0 * f64::from(k) * x.powi(2 * k - 1) / factorial
        });
        let d = Dual::new(x, [1.0]).sinc().eps[0];
        assert!((d / series - 1.0).abs() < 3e-14, "{x}: {d} {series}");
    }
}

#[test]
fn parameters_constants_and_text() {
    let x = parameter::<3>(0.5, 1);
    assert_eq!((x.value(), x.eps, Dual::<3>::TANGENTS, f64::TANGENTS), (0.5, [0.0, 1.0, 0.0], 3, 0));
    assert_eq!((x.tangent(1), x.tangent(2), x.tangent(3), 0.5_f64.tangent(0)), (1.0, 0.0, 0.0, 0.0));
    assert_eq!(parameter::<3>(0.5, 9).eps, [0.0; 3]);
    assert_eq!(tangents(&x), Vector3::y());
    assert_eq!(Dual::<2>::with_tangents(2.0, |i| i as f64).eps, [0.0, 1.0]);
    assert_eq!(<f64 as Scalar>::with_tangents(2.0, |_| 7.0), 2.0);
    assert_eq!((Dual::<2>::lift(4.0).re, Dual::<2>::lift(4.0).eps, f64::lift(4.0)), (4.0, [0.0; 2], 4.0));
    assert_eq!(x.to_string(), "0.5 + [0, 1, 0]ε");
    assert_eq!(format!("{x:.2}"), "0.50 + [0.00, 1.00, 0.00]ε");
    assert_eq!(Dual::<0>::from_re(1.5).to_string(), "1.5");
    assert_eq!(Dual::<1>::from_str_radix("2.5", 10).unwrap().re, 2.5);
    assert!(Dual::<1>::from_str_radix("two", 10).is_err());
    assert_eq!(Dual::<1>::from_i32(-3).unwrap(), Dual::from(-3.0));
    assert_eq!(Dual::<1>::from_u8(3).unwrap().re, 3.0);
    assert_eq!([x, x, x].into_iter().sum::<Dual<3>>().eps, [0.0, 3.0, 0.0]);
    assert_eq!(nalgebra::convert::<f32, Dual<1>>(0.25).re, 0.25);
    assert_eq!(nalgebra::try_convert::<Dual<3>, f64>(x), Some(0.5));
    assert_eq!((Dual::<1>::pi().re, Dual::<1>::ln_10().re), (f64::pi(), f64::ln_10()));
    assert_eq!(Vector3::new(1.0, 2.0, 3.0).cast::<Dual<1>>().z.re, 3.0);
    approx::assert_relative_eq!(x, Dual::new(0.5 + 1e-17, [9.0; 3]));
    assert_eq!(size_of::<Dual<4>>(), 40);
}
