//! Dual numbers: a value and its first derivatives by `N` parameters, on the stack.

use std::array::from_fn;
use std::cmp::Ordering;
use std::fmt;
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Rem, RemAssign, Sub, SubAssign};

/// A dual number: a value and its derivatives by `N` parameters, without heap and without branches in its arithmetic.
///
/// Comparisons look at the value alone, so that a branch is taken as `f64` would take it; so do `is_zero`, `is_finite`
/// and the tolerances of `approx`.
///
/// # Derivatives where there is none
/// Arithmetic is that of IEEE 754 in the value and in every tangent. For the elementary functions
/// - a tangent of exactly zero stays zero: a constant is never given a derivative, not even at a pole (√0, ln 0, asin 1);
///   a tangent that is not zero becomes infinite there;
/// - at a kink the derivative is one-sided: `abs` follows the sign bit, `max`, `min` and `clamp` follow the operand
///   that they return (the first one, or the number inside the bounds, if both are equal);
/// - `hypot` and `atan2` at the origin, and thereby norms of zero vectors, have the derivative zero;
/// - the steps `floor`, `ceil`, `round`, `trunc` and `signum` have the derivative zero.
///
/// Nothing panics, whatever the value.
#[derive(Clone, Copy, Debug)]
pub struct Dual<const N: usize> {
    /// The value.
    pub re: f64,
    /// The derivative by each parameter.
    pub eps: [f64; N],
}

impl<const N: usize> Dual<N> {
    /// A value with its derivatives.
    #[inline(always)]
    pub const fn new(re: f64, eps: [f64; N]) -> Self {
        Self { re, eps }
    }

    /// A constant.
    #[inline(always)]
    pub const fn from_re(re: f64) -> Self {
        Self { re, eps: [0.0; N] }
    }

    /// This value as parameter number `index`: derivative one by itself, zero by the others (and by all if there is no
    /// such parameter).
    #[inline]
    pub fn derivative(self, index: usize) -> Self {
        Self { re: self.re, eps: from_fn(|i| f64::from(u8::from(i == index))) }
    }

    /// Chain rule: a function with value `f` and derivative `d` at this value.
    #[inline(always)]
    fn chain(self, f: f64, d: f64) -> Self {
        if d.is_finite() {
            Self { re: f, eps: from_fn(|i| self.eps[i] * d) }
        } else {
            Self { re: f, eps: self.eps.map(|e| product_or_zero(e, d)) }
        }
    }

    /// Chain rule in two arguments, with the partial derivatives `d` and `e`.
    #[inline]
    fn chain2(self, other: Self, f: f64, d: f64, e: f64) -> Self {
        Self { re: f, eps: from_fn(|i| product_or_zero(self.eps[i], d) + product_or_zero(other.eps[i], e)) }
    }
}

/// A tangent times a derivative that may be infinite or undefined; nothing comes of a tangent of zero.
#[inline]
fn product_or_zero(tangent: f64, d: f64) -> f64 {
    if tangent == 0.0 { 0.0 } else { tangent * d }
}

macro_rules! operators {
    ($($op:ident $method:ident $assign:ident $assign_method:ident, |$a:ident, $b:ident| $dual:expr, |$c:ident, $k:ident| $plain:expr;)*) => {$(
        impl<const N: usize> $op for Dual<N> {
            type Output = Self;
            #[allow(clippy::suspicious_arithmetic_impl)] // the product rule has a sum
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                let ($a, $b) = (self, other);
                $dual
            }
        }
        impl<const N: usize> $op<f64> for Dual<N> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: f64) -> Self {
                let ($c, $k) = (self, other);
                $plain
            }
        }
        impl<const N: usize> $assign for Dual<N> {
            #[inline(always)]
            fn $assign_method(&mut self, other: Self) {
                *self = $op::$method(*self, other);
            }
        }
        impl<const N: usize> $assign<f64> for Dual<N> {
            #[inline(always)]
            fn $assign_method(&mut self, other: f64) {
                *self = $op::$method(*self, other);
            }
        }
    )*};
}

operators! {
    Add add AddAssign add_assign,
        |a, b| Self { re: a.re + b.re, eps: from_fn(|i| a.eps[i] + b.eps[i]) },
        |a, k| Self { re: a.re + k, eps: a.eps };
    Sub sub SubAssign sub_assign,
        |a, b| Self { re: a.re - b.re, eps: from_fn(|i| a.eps[i] - b.eps[i]) },
        |a, k| Self { re: a.re - k, eps: a.eps };
    Mul mul MulAssign mul_assign,
        |a, b| Self { re: a.re * b.re, eps: from_fn(|i| a.eps[i] * b.re + b.eps[i] * a.re) },
        |a, k| Self { re: a.re * k, eps: from_fn(|i| a.eps[i] * k) };
    Div div DivAssign div_assign,
        |a, b| {
            let (q, inverse) = (a.re / b.re, 1.0 / b.re);
            Self { re: q, eps: from_fn(|i| (a.eps[i] - b.eps[i] * q) * inverse) }
        },
        |a, k| {
            let inverse = 1.0 / k;
            Self { re: a.re / k, eps: from_fn(|i| a.eps[i] * inverse) }
        };
    Rem rem RemAssign rem_assign,
        |a, b| {
            let whole = (a.re / b.re).trunc();
            Self { re: a.re % b.re, eps: from_fn(|i| a.eps[i] - b.eps[i] * whole) }
        },
        |a, k| Self { re: a.re % k, eps: a.eps };
}

impl<const N: usize> Neg for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self { re: -self.re, eps: from_fn(|i| -self.eps[i]) }
    }
}

impl<const N: usize> Sum for Dual<N> {
    fn sum<I: Iterator<Item = Self>>(terms: I) -> Self {
        terms.fold(Self::from_re(0.0), Add::add)
    }
}

impl<const N: usize> From<f64> for Dual<N> {
    #[inline(always)]
    fn from(x: f64) -> Self {
        Self::from_re(x)
    }
}

impl<const N: usize> PartialEq for Dual<N> {
    #[inline(always)]
    fn eq(&self, other: &Self) -> bool {
        self.re == other.re
    }
}

impl<const N: usize> PartialOrd for Dual<N> {
    #[inline(always)]
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        self.re.partial_cmp(&other.re)
    }
    #[inline(always)]
    fn lt(&self, other: &Self) -> bool {
        self.re < other.re
    }
    #[inline(always)]
    fn le(&self, other: &Self) -> bool {
        self.re <= other.re
    }
    #[inline(always)]
    fn gt(&self, other: &Self) -> bool {
        self.re > other.re
    }
    #[inline(always)]
    fn ge(&self, other: &Self) -> bool {
        self.re >= other.re
    }
}

/// The value and, in brackets, the derivatives: `1.5 + [1, 0]ε`. A precision applies to all of them.
impl<const N: usize> fmt::Display for Dual<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(&self.re, f)?;
        for (i, e) in self.eps.iter().enumerate() {
            f.write_str(if i == 0 { " + [" } else { ", " })?;
            fmt::Display::fmt(e, f)?;
        }
        f.write_str(if N == 0 { "" } else { "]ε" })
    }
}

macro_rules! functions {
    ($($(#[$doc:meta])* $name:ident |$x:ident| $body:expr;)*) => {
        /// Elementary functions, with the value of `f64`'s function of the same name.
        impl<const N: usize> Dual<N> {
            $(
                $(#[$doc])*
                #[inline]
                pub fn $name(self) -> Self {
                    let $x = self.re;
                    let (f, d): (f64, f64) = $body;
                    self.chain(f, d)
                }
            )*
        }
    };
}

functions! {
    /// √x.
    sqrt |x| { let f = x.sqrt(); (f, 0.5 / f) };
    /// ∛x.
    cbrt |x| { let f = x.cbrt(); (f, 1.0 / (3.0 * f * f)) };
    /// 1/x.
    recip |x| { let f = x.recip(); (f, -f * f) };
    /// eˣ.
    exp |x| { let f = x.exp(); (f, f) };
    /// 2ˣ.
    exp2 |x| { let f = x.exp2(); (f, f * std::f64::consts::LN_2) };
    /// eˣ - 1.
    exp_m1 |x| (x.exp_m1(), x.exp());
    /// Natural logarithm.
    ln |x| (x.ln(), 1.0 / x);
    /// ln (1 + x).
    ln_1p |x| (x.ln_1p(), 1.0 / (1.0 + x));
    /// Logarithm to base 2.
    log2 |x| (x.log2(), std::f64::consts::LOG2_E / x);
    /// Logarithm to base 10.
    log10 |x| (x.log10(), std::f64::consts::LOG10_E / x);
    /// Sine, radians.
    sin |x| x.sin_cos();
    /// Cosine, radians.
    cos |x| { let (s, c) = x.sin_cos(); (c, -s) };
    /// Tangent, radians.
    tan |x| { let f = x.tan(); (f, 1.0 + f * f) };
    /// Inverse sine.
    asin |x| (x.asin(), 1.0 / ((1.0 - x) * (1.0 + x)).sqrt());
    /// Inverse cosine.
    acos |x| (x.acos(), -1.0 / ((1.0 - x) * (1.0 + x)).sqrt());
    /// Inverse tangent.
    atan |x| (x.atan(), 1.0 / (1.0 + x * x));
    /// Hyperbolic sine.
    sinh |x| (x.sinh(), x.cosh());
    /// Hyperbolic cosine.
    cosh |x| (x.cosh(), x.sinh());
    /// Hyperbolic tangent.
    tanh |x| { let c = x.cosh().recip(); (x.tanh(), c * c) };
    /// Inverse hyperbolic sine.
    asinh |x| (x.asinh(), 1.0 / x.hypot(1.0));
    /// Inverse hyperbolic cosine.
    acosh |x| (x.acosh(), 1.0 / ((x - 1.0).sqrt() * (x + 1.0).sqrt()));
    /// Inverse hyperbolic tangent.
    atanh |x| (x.atanh(), 1.0 / ((1.0 - x) * (1.0 + x)));
    /// |x|.
    abs |x| (x.abs(), if x.is_sign_negative() { -1.0 } else { 1.0 });
    /// Sign of x, by the sign bit: 1 for +0, -1 for -0.
    signum |x| (x.signum(), 0.0);
    /// Largest integer not above x.
    floor |x| (x.floor(), 0.0);
    /// Smallest integer not below x.
    ceil |x| (x.ceil(), 0.0);
    /// Nearest integer, half-way cases away from zero.
    round |x| (x.round(), 0.0);
    /// Integer part.
    trunc |x| (x.trunc(), 0.0);
    /// x without its integer part.
    fract |x| (x.fract(), 1.0);
    /// sin x / x, smooth at zero.
    sinc |x| cardinal(x, x.sin(), x.cos(), -1.0);
    /// sinh x / x, smooth at zero.
    sinhc |x| cardinal(x, x.sinh(), x.cosh(), 1.0);
}

impl<const N: usize> Dual<N> {
    /// Sine and cosine.
    #[inline]
    pub fn sin_cos(self) -> (Self, Self) {
        let (s, c) = self.re.sin_cos();
        (self.chain(s, c), self.chain(c, -s))
    }

    /// xⁿ for an integer.
    #[inline]
    pub fn powi(self, n: i32) -> Self {
        let d = match n.checked_sub(1) {
            _ if n == 0 => 0.0,
            Some(m) => f64::from(n) * self.re.powi(m),
            None => f64::from(n) * self.re.powf(f64::from(n) - 1.0),
        };
        self.chain(self.re.powi(n), d)
    }

    /// xⁿ; the exponent may carry derivatives too.
    pub fn powf(self, n: Self) -> Self {
        let f = self.re.powf(n.re);
        let by_base = if n.re == 0.0 { 0.0 } else { n.re * self.re.powf(n.re - 1.0) };
        // x^n ln x goes to zero with x if n > 0.
        let by_exponent = if self.re == 0.0 && n.re > 0.0 { 0.0 } else { f * self.re.ln() };
        self.chain2(n, f, by_base, by_exponent)
    }

    /// Logarithm to any base.
    pub fn log(self, base: Self) -> Self {
        let (f, l) = (self.re.log(base.re), base.re.ln());
        self.chain2(base, f, 1.0 / (self.re * l), -f / (base.re * l))
    }

    /// √(x² + y²) without overflow.
    pub fn hypot(self, other: Self) -> Self {
        let f = self.re.hypot(other.re);
        let (d, e) = if f == 0.0 { (0.0, 0.0) } else { (self.re / f, other.re / f) };
        self.chain2(other, f, d, e)
    }

    /// Angle of the point (`x`, `self`) from the x axis, radians.
    pub fn atan2(self, x: Self) -> Self {
        let r = self.re.hypot(x.re);
        let (d, e) = if r == 0.0 { (0.0, 0.0) } else { (x.re / r / r, -(self.re / r / r)) };
        self.chain2(x, self.re.atan2(x.re), d, e)
    }

    /// `self` a + b, rounded once in the value.
    #[inline]
    pub fn mul_add(self, a: Self, b: Self) -> Self {
        Self { re: self.re.mul_add(a.re, b.re), eps: (self * a + b).eps }
    }
}

/// Value and derivative of s(x)/x, for s = sin (`sign` -1) or sinh (`sign` 1) with the derivative c.
fn cardinal(x: f64, s: f64, c: f64, sign: f64) -> (f64, f64) {
    let f = if x == 0.0 { 1.0 } else { s / x };
    if x.abs() > 0.25 {
        return (f, (c - f) / x);
    }
    // c - s/x cancels here. Σ ±2k x^(2k-1) / (2k+1)!; the first term left out is below 1e-14 of the first.
    let y = sign * x * x;
    let series = 1.0 / 3.0 + y * (1.0 / 30.0 + y * (1.0 / 840.0 + y * (1.0 / 45_360.0 + y / 3_991_680.0)));
    (f, sign * x * series)
}
