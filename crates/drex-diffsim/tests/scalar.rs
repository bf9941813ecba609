//! Dual numbers: every function against finite differences and against num-dual, linear algebra on them, hostile input.
#![allow(clippy::unwrap_used, missing_docs)] // a test may panic

use drex_diffsim::{Dual, Scalar, parameter, tangents};
use nalgebra::{
    ComplexField, Isometry3, Matrix3, Matrix4, Quaternion, RealField, SMatrix, Translation3, UnitQuaternion, Vector3,
};
use num_traits::{FromPrimitive, Num, Signed, Zero};
use proptest::prelude::*;

/// Functions of one number by their names, with an interval inside which each is smooth.
const UNARY: [(&str, f64, f64); 32] = [
    ("sqrt", 0.05, 100.0),
    ("cbrt", 0.05, 100.0),
    ("recip", 0.1, 10.0),
    ("exp", -5.0, 5.0),
    ("exp2", -5.0, 5.0),
    ("exp_m1", -5.0, 5.0),
    ("ln", 0.05, 100.0),
    ("ln_1p", -0.9, 10.0),
    ("log2", 0.05, 100.0),
    ("log10", 0.05, 100.0),
    ("sin", -10.0, 10.0),
    ("cos", -10.0, 10.0),
    ("tan", -1.4, 1.4),
    ("asin", -0.95, 0.95),
    ("acos", -0.95, 0.95),
    ("atan", -20.0, 20.0),
    ("sinh", -5.0, 5.0),
    ("cosh", -5.0, 5.0),
    ("tanh", -5.0, 5.0),
    ("asinh", -20.0, 20.0),
    ("acosh", 1.1, 20.0),
    ("atanh", -0.95, 0.95),
    ("abs", 0.01, 5.0),
    ("powi 3", -3.0, 3.0),
    ("powi -2", 0.2, 3.0),
    ("powi 0", 0.2, 3.0),
    ("sin of sin_cos", -10.0, 10.0),
    ("cos of sin_cos", -10.0, 10.0),
    ("modulus_squared", -3.0, 3.0),
    ("abs of a negative number", -5.0, -0.01),
    ("argument", 0.1, 1.0),
    ("signum", 0.1, 1.0),
];

fn unary<T: RealField + Copy>(name: &str, x: T) -> T {
    match name {
        "sqrt" => x.sqrt(),
        "cbrt" => x.cbrt(),
        "recip" => x.recip(),
        "exp" => x.exp(),
        "exp2" => x.exp2(),
        "exp_m1" => x.exp_m1(),
        "ln" => x.ln(),
        "ln_1p" => x.ln_1p(),
        "log2" => x.log2(),
        "log10" => x.log10(),
        "sin" => x.sin(),
        "cos" => x.cos(),
        "tan" => x.tan(),
        "asin" => x.asin(),
        "acos" => x.acos(),
        "atan" => x.atan(),
        "sinh" => x.sinh(),
        "cosh" => x.cosh(),
        "tanh" => x.tanh(),
        "asinh" => x.asinh(),
        "acosh" => x.acosh(),
        "atanh" => x.atanh(),
        "abs" | "abs of a negative number" => ComplexField::abs(x),
        "powi 3" => x.powi(3),
        "powi -2" => x.powi(-2),
        "powi 0" => x.powi(0),
        "sin of sin_cos" => x.sin_cos().0,
        "cos of sin_cos" => x.sin_cos().1,
        "modulus_squared" => x.modulus_squared(),
        "argument" => x.argument(),
        "signum" => ComplexField::signum(x),
        _ => unreachable!("{name}"),
    }
}

/// Those that num-dual does not have (it panics, or is not smooth where ours is).
const UNARY_OURS: [(&str, f64, f64); 7] = [
    ("sinc", -6.0, 6.0),
    ("sinhc", -4.0, 4.0),
    ("floor", 0.1, 0.9),
    ("ceil", 0.1, 0.9),
    ("round", 0.6, 0.9),
    ("trunc", -0.9, -0.1),
    ("fract", 0.1, 0.9),
];

fn unary_ours<T: RealField + Copy>(name: &str, x: T) -> T {
    match name {
        "sinc" => x.sinc(),
        "sinhc" => x.sinhc(),
        "floor" => x.floor(),
        "ceil" => x.ceil(),
        "round" => x.round(),
        "trunc" => x.trunc(),
        "fract" => x.fract(),
        _ => unary(name, x),
    }
}

/// Functions of two numbers, smooth for x in 0.2..3 and y in 1.2..2.8, away from x = y.
const BINARY: [&str; 15] = [
    "add", "sub", "mul", "div", "powf", "powc", "log", "hypot", "atan2", "max", "min", "scale", "unscale", "mul_add",
    "copysign",
];

fn binary<T: RealField + Copy>(name: &str, x: T, y: T) -> T {
    match name {
        "add" => x + y,
        "sub" => x - y,
        "mul" => x * y,
        "div" => x / y,
        "powf" => x.powf(y),
        "powc" => x.powc(y),
        "log" => x.log(y),
        "hypot" => x.hypot(y),
        "atan2" => (-x).atan2(y),
        "max" => x.max(y),
        "min" => x.min(y),
        "scale" => x.scale(y),
        "unscale" => x.unscale(y),
        "mul_add" => x.mul_add(y, x),
        "copysign" => x.copysign(-y),
        "rem" => (x * T::from_f64(7.0).unwrap()) % y,
        "clamp" => x.clamp(y - T::one(), y),
        _ => unreachable!("{name}"),
    }
}

fn close(a: f64, b: f64, tolerance: f64) -> bool {
    (a - b).abs() <= tolerance * (1.0 + a.abs().max(b.abs()))
}

/// Central difference of fourth order.
fn difference(f: impl Fn(f64) -> f64, h: f64) -> f64 {
    (8.0 * (f(h) - f(-h)) - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)
}

proptest! {
    #[test]
    fn functions_of_one_number_have_the_slope_of_their_graph(s in 0.0..1.0_f64) {
        for (name, lo, hi) in UNARY.into_iter().chain(UNARY_OURS) {
            let x = lo + s * (hi - lo);
            // Two directions, so that a tangent that ends up in the wrong place shows.
            let y = unary_ours(name, Dual::new(x, [1.0, -2.0]));
            prop_assert_eq!(y.re, unary_ours(name, x), "{}({})", name, x);
            let slope = difference(|h| unary_ours(name, x + h), 2e-4);
            prop_assert!(close(y.eps[0], slope, 1e-8), "{}'({}) = {}, differences {}", name, x, y.eps[0], slope);
            prop_assert_eq!(y.eps[1], -2.0 * y.eps[0]);
        }
    }

    #[test]
    fn functions_of_two_numbers_have_the_slopes_of_their_graph(x in 0.2..3.0_f64, y in 1.2..2.8_f64) {
        let far = |z: f64| (z - z.round()).abs() > 0.02;
        prop_assume!((x - y).abs() > 0.02 && (x - y + 1.0).abs() > 0.02 && far(7.0 * x / y));
        for name in BINARY.into_iter().chain(["rem", "clamp"]) {
            let z = binary(name, Dual::new(x, [1.0, 0.0, 2.0]), Dual::new(y, [0.0, 1.0, 3.0]));
            prop_assert_eq!(z.re, binary(name, x, y), "{}({}, {})", name, x, y);
            let slopes = [
                difference(|h| binary(name, x + h, y), 1e-4),
                difference(|h| binary(name, x, y + h), 1e-4),
                difference(|h| binary(name, x + 2.0 * h, y + 3.0 * h), 1e-4),
            ];
            for i in 0..3 {
                prop_assert!(close(z.eps[i], slopes[i], 1e-8), "{}({}, {}), {}: {:?} {:?}", name, x, y, i, z, slopes);
            }
        }
    }

    #[test]
    fn a_plain_operand_is_a_constant(x in -3.0..3.0_f64, e in -2.0..2.0_f64, k in 0.1..3.0_f64) {
        let (a, c) = (Dual::new(x, [e, 1.0]), Dual::<2>::from_re(k));
        let pairs = [(a + k, a + c), (a - k, a - c), (a * k, a * c), (a / k, a / c), (a % k, a % c), (a.scaled(k), a * c)];
        for (plain, lifted) in pairs {
            prop_assert_eq!(plain.re, lifted.re);
            for i in 0..2 {
                prop_assert!(close(plain.eps[i], lifted.eps[i], 1e-14));
            }
        }
        let mut assigned = [a; 10];
        assigned[0] += c;
        assigned[1] -= c;
        assigned[2] *= c;
        assigned[3] /= c;
        assigned[4] %= c;
        assigned[5] += k;
        assigned[6] -= k;
        assigned[7] *= k;
        assigned[8] /= k;
        assigned[9] %= k;
        for (i, b) in assigned.into_iter().enumerate() {
            prop_assert_eq!(b.re, pairs[i % 5].0.re);
            prop_assert!((0..2).all(|j| close(b.eps[j], pairs[i % 5].1.eps[j], 1e-14)));
        }
    }

    #[test]
    fn hostile_numbers_go_where_f64_goes_and_give_constants_no_derivative(a in hostile(), b in hostile()) {
        let same = |p: f64, q: f64| p == q || (p.is_nan() && q.is_nan());
        for (name, ..) in UNARY.into_iter().chain(UNARY_OURS) {
            let y = unary_ours(name, Dual::new(a, [0.0, 1.0]));
            prop_assert!(same(y.re, unary_ours(name, a)), "{}({}): {}", name, a, y);
            if !["recip", "modulus_squared"].contains(&name) {
                prop_assert!(y.eps[0] == 0.0, "{}({}): {}", name, a, y);
            }
        }
        for name in BINARY.into_iter().chain(["rem", "clamp"]) {
            let y = binary(name, Dual::new(a, [0.0, 1.0]), Dual::new(b, [0.0, 1.0]));
            prop_assert!(same(y.re, binary(name, a, b)), "{}({}, {}): {}", name, a, b, y);
            if ["powf", "powc", "log", "hypot", "atan2", "max", "min", "clamp", "copysign", "add", "sub"].contains(&name) {
                prop_assert!(y.eps[0] == 0.0, "{}({}, {}): {}", name, a, b, y);
            }
        }
        for n in [i32::MIN, -1, 0, 1, 2, i32::MAX] {
            let y = Dual::new(a, [0.0]).powi(n);
            prop_assert!(same(y.re, a.powi(n)) && y.eps[0] == 0.0);
        }
        let (x, y) = (Dual::new(a, [1.0]), Dual::new(b, [2.0]));
        prop_assert_eq!(x.partial_cmp(&y), a.partial_cmp(&b));
        prop_assert_eq!((x < y, x <= y, x > y, x >= y, x == y), (a < b, a <= b, a > b, a >= b, a == b));
        prop_assert_eq!(x.try_sqrt().is_some(), a.try_sqrt().is_some());
        prop_assert!(same(Signed::abs_sub(&x, &y).re, Signed::abs_sub(&a, &b)));
        prop_assert_eq!((x.is_zero(), ComplexField::is_finite(&x)), (a == 0.0, a.is_finite()));
        let m = Matrix3::new(x, y, x, y, y, x, x * y, x, y);
        let _ = (m.try_inverse(), m.cholesky(), m.lu().solve(&Vector3::new(x, y, x)), m.determinant());
        let _ = UnitQuaternion::from_quaternion(Quaternion::new(x, y, x, y)).to_rotation_matrix();
        let _ = format!("{x} {y:?}");
    }

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

fn hostile() -> impl Strategy<Value = f64> {
    prop_oneof![
        prop::sample::select(vec![
            0.0,
            -0.0,
            1.0,
            -1.0,
            0.5,
            f64::NAN,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::MAX,
            f64::MIN,
            f64::MIN_POSITIVE,
            5e-324,
            -5e-324,
        ]),
        any::<f64>(),
    ]
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
trait Outputs<const K: usize> {
    fn at<T: Scalar>(&self, p: [T; 6]) -> [T; K];
}

macro_rules! outputs {
    ($($name:ident -> $k:literal |$p:ident: $t:ident| $body:expr;)*) => {$(
        #[allow(non_camel_case_types)] // reads as a function where it is passed on
        struct $name;
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

#[cfg(feature = "num-dual")]
mod against_num_dual {
    use num_dual::DualSVec64;

    use super::*;

    fn agree(ours: &Dual<2>, theirs: &DualSVec64<2>) -> bool {
        close(ours.re, theirs.value(), 1e-13) && (0..2).all(|i| close(ours.eps[i], Scalar::tangent(theirs, i), 1e-12))
    }

    fn both(x: f64, eps: [f64; 2]) -> (Dual<2>, DualSVec64<2>) {
        (Dual::new(x, eps), DualSVec64::with_tangents(x, |i| eps[i]))
    }

    proptest! {
        #[test]
        fn functions_agree(s in 0.0..1.0_f64, e in -2.0..2.0_f64) {
            for (name, lo, hi) in UNARY {
                if name == "argument" {
                    continue; // theirs is zero for negative numbers too
                }
                let (x, y) = both(lo + s * (hi - lo), [e, 1.0]);
                prop_assert!(agree(&unary(name, x), &unary(name, y)), "{}({}): {} {}", name, x, unary(name, x), unary(name, y));
            }
        }

        #[test]
        fn functions_of_two_numbers_agree(x in 0.2..3.0_f64, y in 1.2..2.8_f64, e in -2.0..2.0_f64) {
            prop_assume!((x - y).abs() > 1e-6);
            let ((a, c), (b, d)) = (both(x, [e, 1.0]), both(y, [0.5, -e]));
            for name in BINARY {
                prop_assert!(agree(&binary(name, a, b), &binary(name, c, d)), "{}({}, {})", name, a, b);
            }
        }

        #[test]
        fn linear_algebra_agrees(p in prop::array::uniform6(-1.0..1.0_f64), e in prop::array::uniform6(-1.0..1.0_f64)) {
            let ours: [Dual<2>; 6] = std::array::from_fn(|i| both(p[i], [e[i], e[5 - i]]).0);
            let theirs: [DualSVec64<2>; 6] = std::array::from_fn(|i| both(p[i], [e[i], e[5 - i]]).1);
            prop_assert!(inverse4.at(ours).iter().zip(&inverse4.at(theirs)).all(|(a, b)| agree(a, b)));
            prop_assert!(cholesky.at(ours).iter().zip(&cholesky.at(theirs)).all(|(a, b)| agree(a, b)));
            prop_assert!(quaternion.at(ours).iter().zip(&quaternion.at(theirs)).all(|(a, b)| agree(a, b)));
            prop_assert!(rotation_matrix.at(ours).iter().zip(&rotation_matrix.at(theirs)).all(|(a, b)| agree(a, b)));
            prop_assert!(isometry.at(ours).iter().zip(&isometry.at(theirs)).all(|(a, b)| agree(a, b)));
        }
    }
}
