//! Elementary functions against differences, and on hostile numbers.

use drex_diffsim::{Dual, Scalar};
use nalgebra::{ComplexField, Matrix3, Quaternion, RealField, UnitQuaternion, Vector3};
use num_traits::{Signed, Zero};
use proptest::prelude::*;

use crate::{close, difference};

/// Functions of one number by their names, with an interval inside which each is smooth.
pub const UNARY: [(&str, f64, f64); 32] = [
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

pub fn unary<T: RealField + Copy>(name: &str, x: T) -> T {
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
pub const UNARY_OURS: [(&str, f64, f64); 7] = [
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
pub const BINARY: [&str; 15] = [
    "add", "sub", "mul", "div", "powf", "powc", "log", "hypot", "atan2", "max", "min", "scale", "unscale", "mul_add",
    "copysign",
];

pub fn binary<T: RealField + Copy>(name: &str, x: T, y: T) -> T {
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
